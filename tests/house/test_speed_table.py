"""The table of the guide on speed is that of the benchmark that is committed."""

from benchmarks.ratios import Row
from benchmarks.speed_table import LINES, PAGE, between, kept, table


def test_the_page_shows_the_committed_benchmark():
    made = table(kept())
    assert between(PAGE.read_text(encoding="utf-8")) == made
    assert made.count("\n| ") == len(LINES) + 2


def test_nothing_that_is_shown_would_fail_the_benchmark():
    shown = [Row(**{k: v for k, v in line.row(kept()).items() if k != "verdict"}) for line in LINES]
    assert [row.what for row in shown if not row.acceptable] == []

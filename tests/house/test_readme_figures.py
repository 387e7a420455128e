"""The errors that the README prints are those of its command: one seed is run, all when asked for."""

from pathlib import Path

import pytest
from readme_figures import FIGURES, SAMPLE_TIMES_S, line, printed, written

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
ROUNDED = 0.05  # of two digits


def test_every_line_stands_in_the_readme():
    assert set(printed(README)) == {figure.words for figure in FIGURES}


def test_lines_of_a_figure_are_replaced_and_nothing_else():
    figure = FIGURES[0]
    before = f"a\n| {figure.words} | 1 to 2 |\n| another | 1 to 2 |\n"
    after = written(before, {figure.words: line(figure, [0.123, 4.56])})
    assert after == f"a\n| {figure.words} | 0.12 to 4.6 |\n| another | 1 to 2 |\n"


def _cases():
    """Other thresholds, an identification for each line, weekly: their baseline holds the same scenario."""
    for figure in FIGURES:
        weekly = [pytest.mark.long] if figure.scenario == "beyond_other_thresholds" else []
        yield pytest.param(figure, id=figure.words, marks=weekly)


@pytest.mark.parametrize("figure", list(_cases()))
@pytest.mark.full
def test_a_seed_lies_in_the_printed_range(figure):
    low, high = printed(README)[figure.words]
    values = figure.values(seed=7, sample_time_s=min(SAMPLE_TIMES_S))  # accepted numbers have the other one
    assert (1.0 - ROUNDED) * low <= min(values)
    assert max(values) <= (1.0 + ROUNDED) * high
    assert low < high < 100.0

"""The errors that README and guide print are those of their command: one seed is run, all when asked for."""

from pathlib import Path

import pytest
from readme_figures import FIGURES, SAMPLE_TIMES_S, line, printed, written

TOP = Path(__file__).parents[2]
PRINTED = {
    key: ranges
    for name in ("README.md", "hammerstein/guide/compensators.md")
    for key, ranges in printed((TOP / name).read_text(encoding="utf-8")).items()
}
ROUNDED = 0.05  # of two digits


def test_every_line_is_printed():
    assert {key: len(ranges) for key, ranges in PRINTED.items()} == {
        figure.key: max(len(figure.frequencies_hz), 1) for figure in FIGURES
    }


def test_lines_of_a_figure_are_replaced_and_nothing_else():
    figure = FIGURES[0]
    before = f"a\n| {figure.words} | 1 to 2 |\n| another | 1 to 2 |\n"
    after = written(before, {figure.key: line(figure, [[0.123, 4.56]])})
    assert after == f"a\n| {figure.words} | 0.12 to 4.6 |\n| another | 1 to 2 |\n"


def test_lines_of_two_tables_with_the_same_words_are_told_apart():
    circle, sine = (
        next(f for f in FIGURES if f.words == "with dynamics" and f.scenario == scenario)
        for scenario in ("beyond_circles", "beyond_error")
    )
    before = "".join(
        f"| {figure.heading} | A | B | C |\n| --- | ---: |\n| {figure.words} | old |\n\n"
        for figure in (circle, sine)
    )
    after = written(before, {sine.key: line(sine, [[0.1, 0.2, 0.4]] * 3)})
    cells = " | ".join(["0.2 (0.1 to 0.4)"] * 3)
    assert after == before[: before.rindex("old")] + cells + " |\n\n"
    assert printed(after)[sine.key] == [(0.1, 0.4)] * 3


def _cases():
    """Other thresholds, an identification for each line, weekly: their baseline holds the same scenario."""
    for figure in FIGURES:
        weekly = [pytest.mark.long] if figure.scenario == "beyond_other_thresholds" else []
        yield pytest.param(figure, id=" ".join(figure.key).strip(), marks=weekly)


@pytest.mark.parametrize("figure", list(_cases()))
@pytest.mark.full
def test_a_seed_lies_in_the_printed_range(figure):
    cells = figure.cells([(7, min(SAMPLE_TIMES_S))])  # accepted numbers have the other sample time
    for (low, high), values in zip(PRINTED[figure.key], cells, strict=True):
        assert (1.0 - ROUNDED) * low <= min(values)
        assert max(values) <= (1.0 + ROUNDED) * high
        assert low <= high < 100.0

"""The parts of a figure, which a telephone shows below each other: nothing is lost, and all is legible."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from browser import Page, browser, program
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from hammerstein.reporting.figures.path import PathRun, path_errors_figure, path_figure
from hammerstein.reporting.figures.style import styled
from hammerstein.reporting.figures.sweep import SweepCurve, sweep_figure
from hammerstein.reporting.figures.write import svg_of

SVG = "{http://www.w3.org/2000/svg}"


def _two_paths() -> Figure:
    time_s = 50e-6 * np.arange(800)
    turn = 2.0 * np.pi * 50.0 * time_s
    circle = 30.0 * np.array([np.cos(turn), np.sin(turn)])
    labels = ["a long label of " + "many words " * 6, "b"]
    runs = [PathRun(one, "", time_s, circle, circle + 2.0, 0.04) for one in labels]
    return path_figure(runs, ["x", "y" * 30], "reference", "A title of " + "many words " * 9)


def _errors_of_three() -> Figure:
    time_s = 50e-6 * np.arange(800)
    circle = np.array([np.cos(314.0 * time_s), np.sin(314.0 * time_s)])
    runs = [PathRun("a", f"{r} um", time_s, r * circle, r * circle + 2.0, 0.04) for r in (1, 2, 3)]
    return path_errors_figure(runs, ["x", "y"], "Errors")


def _sweep_with_a_band(columns: int = 1) -> Figure:
    x = np.array([10.0, 20.0, 50.0, 100.0, 200.0, 300.0])
    values = np.ones((1, columns, 6)) * x
    curve = SweepCurve("model", x, values, mark=50.0, band=(0.5 * values, 2.0 * values, 1.1 * values))
    return sweep_figure([curve], [["panel"] * columns], "error [um]", "A band")


DRAWN = [_two_paths, _errors_of_three, _sweep_with_a_band, lambda: _sweep_with_a_band(3)]


@pytest.mark.parametrize(
    "draw", [*DRAWN[:1], *(pytest.param(one, marks=pytest.mark.full) for one in DRAWN[1:])]
)
def test_every_panel_and_every_entry_of_the_legend_is_a_drawing_of_its_own(
    draw: Callable[[], Figure],
) -> None:
    figure = draw()
    root = ElementTree.fromstring(svg_of(figure))
    kinds = [part.attrib["class"] for part in root.findall(f"{SVG}svg")]
    (legend,) = figure.legends
    entries = len(legend.get_texts()) + bool(legend.get_title().get_text())
    assert kinds == ["legend"] * entries + ["axes"] * len(figure.axes)


@pytest.mark.parametrize("draw", DRAWN)
def test_every_panel_is_read_alone(draw: Callable[[], Figure]) -> None:
    figure = draw()
    figure.draw_without_rendering()
    for axes in figure.axes:
        assert axes.get_xlabel()
        assert axes.get_ylabel()
        for axis in (axes.xaxis, axes.yaxis):
            assert any(
                tick.label1.get_visible() and tick.label1.get_text() for tick in axis.get_major_ticks()
            )


@pytest.mark.parametrize("draw", [_two_paths, _errors_of_three, lambda: _sweep_with_a_band(2)])
def test_panels_have_what_their_labels_and_the_legend_leave(draw: Callable[[], Figure]) -> None:
    with styled():
        figure = draw()
        FigureCanvasAgg(figure).draw()
        taken = [axes.get_tightbbox() for axes in figure.axes] + [figure.legends[0].get_window_extent()]
    for one, other in combinations(taken, 2):
        apart = min(one.x1, other.x1) < max(one.x0, other.x0)
        assert apart or min(one.y1, other.y1) < max(one.y0, other.y0)
    whole, page = Bbox.union(taken), figure.bbox
    margins = [whole.x0, whole.y0, page.x1 - whole.x1, page.y1 - whole.y1]
    assert min(margins) > 0.0
    assert max(margins) < 0.5 * figure.dpi


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    path = program()
    if path is None:
        pytest.skip("no Chromium is here: no drawing was opened in a browser")
    with browser(path) as found:
        yield found


@pytest.mark.parametrize("draw", DRAWN)
def test_no_part_cuts_off_what_is_written_in_it(
    draw: Callable[[], Figure], page: Page, tmp_path: Path
) -> None:
    """Where a browser puts every text, against the room of the part that holds it [px]."""
    (tmp_path / "figure.svg").write_bytes(svg_of(draw()))
    page.open(tmp_path / "figure.svg", 1000)
    beyond = page.value("""[...document.querySelectorAll("svg > svg")].flatMap(part => {
        const room = part.getBoundingClientRect();
        return [...part.querySelectorAll("g[id^=text], .legend g[id^=line]")].map(text => {
            const own = text.getBoundingClientRect();
            return Math.max(room.left - own.left, room.top - own.top,
                            own.right - room.right, own.bottom - room.bottom);
        });
    })""")
    assert len(beyond) > 8
    assert max(beyond) <= 0.5

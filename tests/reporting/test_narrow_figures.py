"""A figure for a narrow screen: its panels below each other, and nothing is lost."""

from __future__ import annotations

import io
from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest
from figure_cases import as_matplotlib_draws
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from PIL import Image

from hammerstein.reporting.figures.drawing import Painting, Words, drawing_of
from hammerstein.reporting.figures.narrow import NARROW_PX, narrow_figure
from hammerstein.reporting.figures.path import PathRun, path_errors_figure, path_figure
from hammerstein.reporting.figures.style import styled
from hammerstein.reporting.figures.sweep import SweepCurve, sweep_figure
from hammerstein.reporting.figures.write import images


def _two_paths() -> Figure:
    time_s = 50e-6 * np.arange(800)
    turn = 2.0 * np.pi * 50.0 * time_s
    circle = 30.0 * np.array([np.cos(turn), np.sin(turn)])
    labels = ["a long label of " + "many words " * 6, "b"]
    runs = [PathRun(one, "", time_s, circle, circle + 2.0, circle + 1.0, 0.04) for one in labels]
    return path_figure(runs, ["x", "y" * 30], "reference", "A title of " + "many words " * 9)


def _errors_of_three() -> Figure:
    time_s = 50e-6 * np.arange(800)
    circle = np.array([np.cos(314.0 * time_s), np.sin(314.0 * time_s)])
    runs = [PathRun("a", f"{r} um", time_s, r * circle, r * circle + 2.0, None, 0.04) for r in (1, 2, 3)]
    return path_errors_figure(runs, ["x", "y"], "Errors")


def _sweep_with_a_band(columns: int = 1) -> Figure:
    x = np.array([10.0, 20.0, 50.0, 100.0, 200.0, 300.0])
    values = np.ones((1, columns, 6)) * x
    curve = SweepCurve("model", x, values, mark=50.0, band=(0.5 * values, 2.0 * values), nominal=1.1 * values)
    return sweep_figure([curve], [["panel"] * columns], "error [um]", "A band")


def _crowded() -> Figure:
    figure = _sweep_with_a_band()
    for axes in figure.axes:
        axes.set_xticks(np.linspace(10.0, 300.0, 12), [f"{k} 000 000" for k in range(12)])
    return figure


def _pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def _words_of(figure: Figure) -> list[tuple[str, Bbox]]:
    """Words that stand in the panels of a narrow figure, and the room of each."""
    (painting,) = (artist for artist in figure.artists if isinstance(artist, Painting))
    renderer = FigureCanvasAgg(figure).get_renderer()
    placed = [(stroke, move) for stroke, move in painting.strokes if isinstance(stroke, Words)]
    return [(words.text, Bbox(move.transform(words.box(renderer)))) for words, move in placed]


@pytest.mark.parametrize("draw", [_two_paths, _errors_of_three, _sweep_with_a_band, _crowded])
def test_a_narrow_drawing_cuts_nothing_off_and_no_word_hides_another(draw: Callable[[], Figure]) -> None:
    figure = draw()
    with styled():
        found = _words_of(narrow_figure(figure, drawing_of(figure)))
    for (_, one), (_, other) in combinations(found, 2):
        assert min(one.x1, other.x1) - max(one.x0, other.x0) < 1.0 or (
            min(one.y1, other.y1) - max(one.y0, other.y0) < 1.0
        )
    narrow = _pixels(images(draw())["narrow"])
    assert narrow.shape[1] == NARROW_PX
    for edge in (narrow[:3], narrow[-3:], narrow[:, :3], narrow[:, -3:]):
        assert (edge > 250).all()


def test_a_narrow_drawing_has_its_panels_below_each_other_each_with_its_numbers() -> None:
    figure = _errors_of_three()
    with styled():
        found = _words_of(narrow_figure(figure, drawing_of(figure)))
    letters = [next(room for text, room in found if text == f"({name})") for name in "abc"]
    assert letters[0].y0 > letters[1].y1 > letters[1].y0 > letters[2].y1
    assert np.ptp([room.x0 for room in letters]) < 1.0
    texts = [text for text, _ in found]
    assert texts.count("time [ms]") == 3  # once below each group
    assert texts.count("$e_x$ [µm]") == texts.count("distance") == 3  # the wide figure has them once


@pytest.mark.parametrize("draw", [_two_paths, _sweep_with_a_band])
def test_what_was_kept_of_a_drawing_is_painted_as_matplotlib_draws_it(draw: Callable[[], Figure]) -> None:
    with styled():
        figure = draw()
        painted = as_matplotlib_draws(drawing_of(figure).painted())
        figure.set_frameon(True)
        drawn = as_matplotlib_draws(figure)
    assert np.abs(drawn - painted).max() <= 2
    assert (drawn != painted).mean() < 5e-3


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


def test_a_band_is_squeezed_with_its_curves() -> None:
    pixels = _pixels(images(_sweep_with_a_band(2))["narrow"])
    below = pixels[pixels.shape[0] * 6 // 10 :].astype(int)  # the second panel
    red, _, blue = np.moveaxis(below, 2, 0)
    curve = np.flatnonzero(((blue - red > 100) & (red < 100)).any(axis=0))
    band = np.flatnonzero((((blue - red) > 15) & (red > 180)).sum(axis=0) > 20)
    assert np.ptp(curve) > 0.8 * NARROW_PX
    assert abs(curve[0] - band[0]) < 8  # a band has no markers at its ends
    assert abs(curve[-1] - band[-1]) < 8

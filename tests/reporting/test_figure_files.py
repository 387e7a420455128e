"""Files of figures: the same every time, small, and with the colours that were drawn."""

from __future__ import annotations

import io
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from figure_cases import CIRCLE, NONE, circles, loops, report_of
from matplotlib.colors import to_rgb
from PIL import Image

from hammerstein.errors import InputError
from hammerstein.experiment.report import Report
from hammerstein.reporting.figures import LoopRun, figures_of, loops_figure, save_figures
from hammerstein.reporting.figures.style import (
    COLOURS,
    MOST_POINTS,
    new_figure,
    thin_path,
    thin_trace,
)
from hammerstein.reporting.figures.write import png_of, svg_of

LARGEST_SVG_BYTES = 200_000
LARGEST_PNG_BYTES = 40_000
LARGEST_KEPT_BYTES = 55_000
"""Of a picture in this repository: three have eight panels, one of them crossing curves."""


@pytest.mark.full
def test_files_are_the_same_every_time_and_whatever_the_user_s_style(tmp_path: Path) -> None:
    report = report_of(reference=CIRCLE, compensators=[NONE])
    first = save_figures(figures_of(report), tmp_path / "a")
    with mpl.rc_context({"font.size": 31.0, "svg.hashsalt": None, "axes.facecolor": "red"}):
        second = save_figures(figures_of(report), tmp_path / "b")
        assert mpl.rcParams["font.size"] == 31.0
    assert [path.name for path in first] == ["path.svg", "path.png", "errors.svg", "errors.png"]
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert "dc:date" not in first[0].read_text()


@pytest.mark.full
def test_a_line_drawing_is_a_small_file_in_the_hues_of_its_inks() -> None:
    for figure in (figures_of(loops()) | figures_of(circles())).values():
        drawn = png_of(figure)
        assert len(drawn) < LARGEST_PNG_BYTES
        with Image.open(io.BytesIO(drawn)) as picture:
            assert picture.mode == "P"
            assert picture.info["dpi"] == pytest.approx((125, 125), abs=0.1)
            shown = {colour for _, colour in picture.convert("RGB").getcolors()}
        inks = {to_rgb(line.get_color()) for axes in figure.axes for line in axes.lines}
        hued = {tuple(round(255 * part) for part in ink) for ink in inks if np.ptp(ink) > 0.1}
        assert hued <= shown
        assert len(shown) <= 16


def test_a_curve_that_others_nearly_hide_keeps_its_colour_in_a_small_file() -> None:
    """Nine tenths of it lie below another curve, and many greys are more frequent than what is left."""
    figure = new_figure(3.0)
    axes = figure.subplots()
    x = np.linspace(0.0, 1.0, 400)
    axes.plot(x, np.sin(9.0 * x), color=COLOURS[2], linewidth=0.8)
    for part in range(12):
        axes.plot(x[8:], np.sin(9.0 * x[8:]) + 0.02 * part, color=str(0.1 + 0.05 * part), linewidth=3.0)
    with Image.open(io.BytesIO(png_of(figure))) as picture:
        shown = {colour for _, colour in picture.convert("RGB").getcolors()}
    assert tuple(round(255 * part) for part in to_rgb(COLOURS[2])) in shown


def test_the_pictures_of_this_repository_are_small() -> None:
    reports = Path(__file__).parents[2] / "reports"
    pictures = [path for kept in ("paper", "measured") for path in (reports / kept).rglob("*.png")]
    assert 10 < len(pictures) <= 20
    assert [path.name for path in pictures if path.stat().st_size > LARGEST_KEPT_BYTES] == []


def test_a_pale_band_keeps_its_colour_beside_others() -> None:
    """Bands of two inks, where they overlap a third colour: in a palette of the inks alone all turn grey."""
    figure = new_figure(2.0)
    axes = figure.subplots()
    for number, colour in enumerate(COLOURS[:2]):
        axes.axhspan(number, number + 2.0, color=colour, alpha=0.22, linewidth=0.0)
    drawn = np.asarray(Image.open(io.BytesIO(png_of(figure))).convert("RGB")).astype(float)
    inks = [np.array([255.0 * part for part in to_rgb(colour)]) for colour in COLOURS[:2]]
    alone = [255.0 + 0.22 * (ink - 255.0) for ink in inks]  # painted on white
    both = alone[0] + 0.22 * (inks[1] - alone[0])
    for height, colour in ((0.5, alone[0]), (1.5, both), (2.5, alone[1])):
        x, y = axes.transData.transform((0.45, height)).astype(int)
        np.testing.assert_allclose(drawn[-y, x], colour, atol=1.0)


@pytest.mark.full
def test_threads_draw_the_same_as_one_alone() -> None:
    def drawn(report: Report) -> list[bytes]:
        return [svg_of(figure) for figure in figures_of(report).values()]

    alone = drawn(loops())
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(drawn, [loops(), loops()])) == [alone, alone]


def test_a_long_noisy_run_gives_a_small_file() -> None:
    noise = np.random.default_rng(1).standard_normal
    runs = [LoopRun(str(n), k, noise(200_000), noise((2, 200_000))) for n in range(6) for k in range(2)]
    drawn = loops_figure(runs, ["u", "v"], ["x", "y"])
    assert sum(len(line.get_xdata()) for axes in drawn.axes for line in axes.lines) <= MOST_POINTS + 24
    assert len(svg_of(drawn)) < LARGEST_SVG_BYTES


def test_thinning_keeps_the_ends_and_the_peaks() -> None:
    values = np.random.default_rng(2).standard_normal(12_345)
    time = np.arange(12_345.0)
    few_times, few = thin_trace(time, values, 500)
    assert len(few) <= 500
    assert (few.min(), few.max()) == (values.min(), values.max())
    assert np.array_equal(few, values[few_times.astype(int)])
    x, y = thin_path([time, values], 500)
    assert len(x) <= 501
    assert (x[0], x[-1], y[-1]) == (0.0, 12_344.0, values[-1])


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        save_figures(figures_of(loops()), tmp_path / "file")


@pytest.mark.full
def test_drawing_needs_no_window_and_importing_no_matplotlib() -> None:
    code = """
import sys
import numpy as np
from hammerstein.reporting.figures import (LoopRun, loops_figure)
assert "matplotlib" not in sys.modules
from hammerstein.reporting.figures.write import png_of, svg_of
svg_of(loops_figure([LoopRun("a", 0, np.arange(3.0), np.ones((1, 3)))], ["u"], ["y"]))
assert "matplotlib" in sys.modules
assert "matplotlib.pyplot" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr

"""Style of all figures: colours and lines that survive grey print, sizes that fit a page.

Matplotlib keeps its style and its caches in global state; ``styled`` holds both for one thread at a time
and puts the user's own style back.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compiled import uncollected
from hammerstein.escaping import JOINT, clean, unbroken
from hammerstein.signals.units import is_unit, spoken

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

Role = Literal["reading", "reference", "voltage", "error"]

FEW_DECADES = 0.6  # of a logarithmic axis, on which 1, 2 and 4 alone would give a single tick
WIDTH_IN = 8.0  # at 100 pixels an inch the width of a page on a screen
ALONE_IN = 4.3  # width of a figure of one panel: as large as a panel may be to be read on a telephone
PNG_DPI = 125  # 1000 pixels wide
PNG_COLOURS = 16  # the most that half a byte holds
LONGEST_LINE = 46  # characters that fit half the width, or a telephone
MOST_POINTS = 8_000  # of all curves of a figure together: keeps an SVG below 200 kB

# Okabe and Ito's colours, told apart with any colour vision; the order keeps neighbours apart in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#E69F00", "#56B4E9", "#000000")
# The paper's order: solid, dashed, dashed-o, dashed-x, dash-dotted.
LINES: tuple[tuple[Any, str], ...] = (
    ("-", ""),
    ((0, (5, 1.6)), ""),
    ((0, (5, 1.6)), "o"),
    ((0, (5, 1.6)), "x"),
    ((0, (6, 1.5, 1, 1.5)), ""),
    ("-", "^"),
    ((0, (1, 1.2)), ""),
)
DARK = "#222222"
PALE = "#9a9a9a"
GRID = "#e4e4e4"
OVERLAYS: tuple[Any, ...] = ((0, (4, 2)), (0, (1, 1.5)), (0, (7, 2, 1, 2)), (0, (2, 1)))

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # it comes with matplotlib, so that figures are alike on every machine
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "legend.title_fontsize": 9.5,
    "legend.frameon": False,
    "legend.handlelength": 3.2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelcolor": DARK,
    "ytick.labelcolor": DARK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.4,
    "lines.markersize": 4.0,
    "lines.solid_capstyle": "round",
    "svg.hashsalt": "hammerstein",
}

REMARK_LETTERS = 66
"""Most letters of a remark above a panel with the width of the page."""
_LOCK = threading.RLock()


@contextmanager
def styled() -> Iterator[None]:
    """Draw in this style, whatever the user's own; one thread at a time.

    A figure consists of thousands of small objects that live until it is finished. Searching them for garbage
    meanwhile would take a sixth of the time.
    """
    import matplotlib as mpl

    with _LOCK, uncollected(), mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(cast("Any", STYLE))
        yield


def new_figure(height_in: float, columns: int = 2) -> Figure:
    """Return an empty figure, without any window behind it: of page width, or half of it for one column."""
    from matplotlib.figure import Figure

    width_in = WIDTH_IN if columns > 1 else ALONE_IN
    return Figure(figsize=(width_in, height_in), dpi=PNG_DPI, layout="constrained")


@contextmanager
def drawing(height_in: float, columns: int = 2) -> Iterator[Figure]:
    """An empty figure, in this style until the end of the block."""
    with styled():
        yield new_figure(height_in, columns)


def side_by_side(panels: int) -> tuple[int, int]:
    """Rows and columns for panels that have no arrangement of their own.

    >>> side_by_side(1), side_by_side(3)
    ((1, 1), (2, 2))
    """
    return math.ceil(panels / 2), min(panels, 2)


def line_style(number: int) -> dict[str, Any]:
    """Colour, line and marker of the curve with this number.

    >>> line_style(1)["color"]
    '#D55E00'
    """
    turn, place = divmod(number, len(COLOURS))
    line, marker = LINES[(place + turn) % len(LINES)]
    return {"color": COLOURS[place], "linestyle": line, "marker": marker, "markerfacecolor": "white"}


def unmarked_style(number: int) -> dict[str, Any]:
    """Colour and line of the curve with this number, without markers."""
    line = "-" if number == 0 else OVERLAYS[(number - 1) % len(OVERLAYS)]
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": line}


def overlay_style(number: int) -> dict[str, Any]:
    """Line of the model with this number over measured data: thin, dark and dashed."""
    return {"color": DARK, "linestyle": OVERLAYS[number % len(OVERLAYS)], "linewidth": 1.0}


def sparse_markers(samples: int, number: int, markers: int = 12) -> tuple[int, int]:
    """Give ``markevery``: about a dozen markers a curve, shifted so that curves do not hide each other's."""
    every = max(1, samples // markers)
    return (number * every // 3) % every, every


def symbol(axis: str, role: Role) -> str:
    """Text for a quantity of an axis; a letter as in the paper, a longer name as it is.

    >>> symbol("x", "voltage"), symbol("tip", "error")
    ('$u_x$', 'error of tip')
    """
    if len(axis) == 1 and axis.isalpha() and axis.isascii():
        forms = {"reading": "${}$", "reference": "${}_r$", "voltage": "$u_{}$", "error": "$e_{}$"}
        return forms[role].format(axis)
    return "error of " * (role == "error") + plain(axis)


def plain(label: str) -> str:
    r"""Return a user's label verbatim: without formulas, and visible despite a leading underscore.

    >>> plain("_5 $")
    ' _5 \\$'
    """
    return (" " if label.startswith("_") else "") + clean(label).replace("$", r"\$")


def in_lines(text: str, letters: int) -> str:
    r"""Text in lines of a largest length; a number and its unit stay together.

    >>> in_lines("circle (worst 3.42 µm)", 20)
    'circle (worst\n3.42 µm)'
    """
    return "\n".join(textwrap.wrap(unbroken(text), letters)).replace(JOINT, " ")


def column_words(column: str) -> str:
    """Name of a column without its unit, as a label; a number is preceded by "column".

    >>> column_words("3"), column_words("X (um)")
    ('column 3', 'X')
    """
    return plain(spoken(column))


def axis_label(column: str, unit: str) -> str:
    """Label of an axis that shows a column, with the unit that its numbers have now.

    >>> axis_label("X (um)", "µm"), axis_label("V", "V"), axis_label("[V]", "V"), axis_label("Volt_1", "V")
    ('X [µm]', 'V', '[V]', 'Volt_1 [V]')
    """
    named = column.isdigit() or not is_unit(column)
    return f"{column_words(column)} [{unit}]" if named else plain(column)


def letter(axes: Axes, number: int, remark: str = "") -> None:
    """Write the panel's letter above its left corner, and a remark in grey above its right one.

    Names of columns may be long: a remark that would reach the letter is written smaller.
    """
    name = f"({chr(ord('a') + number)})" if number < 26 else ""
    place = axes.get_subplotspec()
    share = len(place.colspan) / place.get_gridspec().ncols if place else 1.0
    figure = axes.get_figure(root=True)
    share *= 1.0 if figure is None else figure.get_figwidth() / WIDTH_IN
    letters = len(re.sub(r"[$_{}\\]", "", remark))
    size = STYLE["font.size"] * min(1.0, share * REMARK_LETTERS / max(letters, 1))
    axes.yaxis.get_offset_text().set_horizontalalignment("right")  # a power of ten, left of the letter
    # a given height spares the search for one above the ticks, which is slow
    axes.set_title(name, loc="left", y=1.0, fontweight="bold")
    axes.set_title(remark, loc="right", y=1.0, color="#666666", fontsize=size)


def legend_above(figure: Figure, entries: dict[str, Artist], title: str = "") -> None:
    """Legend of the whole figure above its panels, in the order given; no line is wider than a telephone."""
    words = [in_lines(label, LONGEST_LINE) for label in entries]
    longest = max((len(line) for text in words for line in text.split("\n")), default=0)
    most = 4 if longest < 20 else 3 if longest < 27 else 2
    most = most if figure.get_figwidth() > ALONE_IN else max(1, most // 2) if longest < 20 else 1
    columns = math.ceil(len(entries) / math.ceil(len(entries) / most))
    legend = figure.legend(
        list(entries.values()),
        words,
        loc="outside upper center",
        ncols=columns,
        title=in_lines(title, LONGEST_LINE) or None,
    )
    legend.get_title().set(fontweight="bold", multialignment="center")


def few_ticks(axes: Axes) -> None:
    """Few ticks at round numbers on both linear axes."""
    from matplotlib.ticker import MaxNLocator

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "linear":  # a logarithmic axis has its own few
            axis.set_major_locator(MaxNLocator(nbins=6, steps=(1, 2, 5, 10)))


def plain_numbers(axis: Axis) -> None:
    """Ticks of a logarithmic axis as 0.001, 10; between them 2 and 4 if there is room; evenly if few fit."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    low, high = axis.get_view_interval()
    decades = math.log10(high / low) if low > 0.0 else math.inf
    if decades < FEW_DECADES:
        axis.set_major_locator(MaxNLocator(nbins=5, steps=(1, 2, 5, 10)))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 4.0) if decades < 2.2 else (1.0,)))
    axis.set_major_formatter(
        FuncFormatter(lambda tick, _: re.sub(r"^1e(-?)[+0]*(\d+)", r"$10^{\1\2}$", f"{tick:g}"))
    )
    axis.set_minor_locator(NullLocator())


def time_axis(seconds: float) -> tuple[float, str]:
    """Factor and label of a time axis of this length.

    >>> time_axis(0.04), time_axis(3.0)
    ((1000.0, 'time [ms]'), (1.0, 'time [s]'))
    """
    return (1e3, "time [ms]") if seconds < 2.0 else (1.0, "time [s]")


def thin_path(curves: Sequence[Array], most: int) -> list[Array]:
    """Every so many samples of curves that belong together, the last one included."""
    samples = len(curves[0])
    if samples <= most:
        return list(curves)
    kept = np.unique(np.append(np.arange(0, samples, math.ceil(samples / most)), samples - 1))
    return [curve[kept] for curve in curves]


def extremes(time: Array, values: Array, parts: int) -> tuple[Array, Array, Array]:
    """Middle of each part of a trace, and its lowest and highest sample there.

    >>> [found.tolist() for found in extremes(np.arange(6.0), np.array([0.0, 3.0, 1.0, 5.0, 4.0, 9.0]), 2)]
    [[1.0, 4.0], [0.0, 4.0], [3.0, 9.0]]
    """
    edges = np.linspace(0, len(values), parts + 1).astype(int)
    middle = (time[edges[:-1]] + time[edges[1:] - 1]) / 2.0
    return middle, np.minimum.reduceat(values, edges[:-1]), np.maximum.reduceat(values, edges[:-1])


def thin_trace(time: Array, values: Array, most: int) -> tuple[Array, Array]:
    """Lowest and highest sample of each part: fewer points, and every peak is still there.

    >>> time = np.arange(1000.0)
    >>> peak = np.where(time == 333.0, 5.0, 0.0)
    >>> few, kept = thin_trace(time, peak, 100)
    >>> len(few) <= 100, float(kept.max())
    (True, 5.0)
    """
    samples = len(values)
    if samples <= most:
        return time, values
    starts = np.linspace(0, samples, max(1, most // 2) + 1).astype(int)
    parts = itertools.pairwise(starts)
    extremes = [a + pick(values[a:b]) for a, b in parts if b > a for pick in (np.argmin, np.argmax)]
    kept = np.unique(extremes)
    return time[kept], values[kept]

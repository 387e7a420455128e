"""A figure of merit against frequency, cycle or uncertain parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import hammerstein.reporting.figures.style as style
from hammerstein.arrays import Array
from hammerstein.experiment.report import TOO_FEW

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_CURVES = 4
"""Of a panel; more are drawn in several rows of panels, which share their axes."""
ALONE, IN_ROWS = 0.7, 0.5
"""Height of a panel in parts of its width: lower in several rows, so that a page still shows all of them."""
LOGARITHMIC_FROM = 12.0  # ratio of the ends from which an axis is logarithmic
BAND_ALPHA = 0.2
"""Transparency of overlapping bands."""
STAR: dict[str, Any] = {"linestyle": "none", "marker": "*", "markersize": 13, "markeredgecolor": "white"}
NOMINAL_WIDTH = 0.5
"""Line width of a nominal curve within a band."""
NOMINAL_POINT: dict[str, Any] = {"linestyle": "none", "marker": "D", "markersize": 3.0}
BAR_WIDTH = 2.5
"""Width of the bars of several bands beside each other [pt]."""
APART = 0.012
"""Of the length of the axis, between the bars of two curves."""


class SweepCurve(NamedTuple):
    """One compensator or model over frequency, or over another swept value.

    label : name in the legend
    x : (point,) frequency [Hz] or another swept value, positive and increasing
    values : (output, input, point); NaN where there is none
    mark : position of a star on the curve, such as the frequency of its identification; None: no star
    band : lower and upper edge around the curve, which is then the median, and the nominal values beside it,
        drawn thin; each as ``values``; None: no band
    """

    label: str
    x: Array
    values: Array
    mark: float | None = None
    band: tuple[Array, Array, Array] | None = None


def sweep_figure(
    curves: Sequence[SweepCurve],
    panel_titles: Sequence[Sequence[str]],
    quantity: str,
    title: str = "",
    x_label: str = "frequency [Hz]",
) -> Figure:
    """Curves against frequency in the paper's arrangement (Figs. 7, 9), in several rows if there are many.

    A star on a curve marks the frequency of its identification.

    Parameters
    ----------
    curves : the curves
    panel_titles : titles of the panels (output, input)
    quantity : label of the vertical axes, with unit
    title : written above the legend
    x_label : label of the horizontal axes, with unit

    Examples
    --------
    >>> f = np.array([10.0, 50.0, 200.0])
    >>> curve = SweepCurve("model", f, np.array([[[0.1, 0.2, 3.0]]]), mark=50.0)
    >>> figure = sweep_figure([curve], [["x"]], "RMS error [um]")
    >>> figure.axes[0].get_yscale()
    'log'
    """
    rows, columns = len(panel_titles), len(panel_titles[0])
    count = max(math.ceil(len(curves) / MOST_CURVES), 1)
    groups = [part.tolist() for part in np.array_split(np.arange(len(curves)), count)]
    lines, across = (rows, columns) if columns > 1 else style.side_by_side(rows)
    shape = ALONE if len(groups) == 1 else IN_ROWS
    with style.drawing(
        0.9 + len(groups) * lines * style.WIDTH_IN / max(columns, 2) * shape, across
    ) as figure:
        grid = figure.subplots(len(groups) * lines, across, squeeze=False, sharex=True, sharey=True)
        cells = grid.reshape(len(groups), -1)
        for axes in cells[:, rows * columns :].flat:
            axes.remove()
        panels = cells[:, : rows * columns].reshape(len(groups), rows, columns)
        entries: dict[str, Artist] = {}
        for (group, o, k), axes in np.ndenumerate(panels):
            for number in groups[group]:
                entries[style.plain(curves[number].label)] = _draw(axes, curves[number], o, k, number)
        entries = {
            label: entries[label] for curve in curves if (label := style.plain(curve.label)) in entries
        }
        _scale(panels, curves)
        for own, row in zip(groups, panels, strict=True):
            _draw_bands(row, [(number, curves[number]) for number in own])
        for number, axes in enumerate(panels.flat):
            if axes.get_yscale() == "linear":
                axes.set_ylim(bottom=0.0)
            axes.margins(x=0.02, y=0.08)  # about all that is drawn, bands included
            o, k = divmod(number % (rows * columns), columns)
            style.letter(axes, number, panel_titles[o][k])
            axes.set(xlabel=x_label, ylabel=quantity)
            axes.tick_params(labelbottom=True, labelleft=True)  # each panel is read alone on a telephone
        style.legend_above(figure, entries | _explained(curves), title)
    return figure


def _draw(axes: Axes, curve: SweepCurve, output: int, input_: int, number: int) -> Artist:
    """One curve in one panel, with its mark."""
    pen, values = style.line_style(number) | {"label": style.plain(curve.label)}, curve.values[output, input_]
    (line,) = axes.plot(
        curve.x, values, markevery=style.sparse_markers(len(values), number, markers=9), **pen
    )
    mark = _mark(curve)
    if mark is not None:
        logarithms = np.log(np.maximum(values, 1e-12))
        height = np.exp(np.interp(np.log(mark), np.log(curve.x), logarithms))
        axes.plot([mark], [height], color=pen["color"], zorder=3, clip_on=False, **STAR)
    return line


def _draw_bands(panels: np.ndarray, curves: Sequence[tuple[int, SweepCurve]]) -> None:
    """Band and nominal value of each curve: an area, or bars beside each other where areas would overlap."""
    banded = [(number, curve) for number, curve in curves if curve.band is not None]
    for place, (number, curve) in enumerate(banded):
        assert curve.band is not None
        pen = {"color": style.line_style(number)["color"], "label": style.plain(curve.label)}
        for (o, k), axes in np.ndenumerate(panels):
            low, high, nominal = (values[o, k] for values in curve.band)
            if len(banded) == 1:
                axes.fill_between(curve.x, low, high, alpha=BAND_ALPHA, linewidth=0.0, **pen)
                axes.plot(curve.x, nominal, linewidth=NOMINAL_WIDTH, **pen)
                continue
            x = _beside(axes, curve.x, place - 0.5 * (len(banded) - 1))
            bars = np.array([low, high, np.full_like(x, np.nan)]).T.ravel()
            axes.plot(np.repeat(x, 3), bars, linewidth=BAR_WIDTH, **pen)
            axes.plot(x, nominal, **NOMINAL_POINT, **pen)


def _beside(axes: Axes, x: Array, places: float) -> Array:
    """Places beside others on the horizontal axis, by parts of its length."""
    if axes.get_xscale() == "log":
        return np.asarray(x * (x[-1] / x[0]) ** (APART * places))
    return np.asarray(x + APART * places * (x[-1] - x[0]))


def _mark(curve: SweepCurve) -> float | None:
    """Place of the mark, if the curve passes it."""
    inside = curve.mark is not None and curve.x[0] <= curve.mark <= curve.x[-1]
    return curve.mark if inside else None


def _explained(curves: Sequence[SweepCurve]) -> dict[str, Artist]:
    """Entries of the legend for marks and bands."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: dict[str, Artist] = {}
    if any(_mark(curve) is not None for curve in curves):
        entries["identified here"] = Line2D([], [], color="#555555", **STAR)
    banded = sum(curve.band is not None for curve in curves)
    words, nominal = "median, 5 to 95 % of random actuators", "nominal actuator"
    grey: dict[str, Any] = {"color": "#555555"}
    if banded > 1:
        entries[words] = Line2D([], [], linewidth=BAR_WIDTH, **grey)
        entries[nominal] = Line2D([], [], **grey, **NOMINAL_POINT)
    elif banded:
        entries[words] = Patch(alpha=BAND_ALPHA, linewidth=0.0, **grey)
        entries[nominal] = Line2D([], [], **grey, linewidth=NOMINAL_WIDTH)
    return entries


def _scale(panels: np.ndarray, curves: Sequence[SweepCurve]) -> None:
    """Logarithmic axes where the values span more than about a decade."""
    x = np.concatenate([curve.x for curve in curves])
    values = np.concatenate([curve.values.ravel() for curve in curves])
    values = values[np.isfinite(values)]
    for axes in panels.flat:
        if x.max() >= LOGARITHMIC_FROM * x.min():
            axes.set_xscale("log")
            style.plain_numbers(axes.xaxis)
        elif (x == np.round(x)).all():
            axes.xaxis.get_major_locator().set_params(integer=True)
        log_where_wide(axes, values)


def log_where_wide(axes: Axes, values: Array) -> None:
    """Let the vertical axis be logarithmic where values span more than about a decade."""
    if values.min() > 0.0 and values.max() >= LOGARITHMIC_FROM * values.min():
        axes.set_yscale("log")
        style.plain_numbers(axes.yaxis)


MOST_CYCLES = 1000  # points of a curve
MINUTES_FROM_S = 180.0
"""Duration from which the axis is in minutes [s]."""


class DriftRun(NamedTuple):
    """Mean error of every cycle.

    label : compensator; axis : number of the axis from 0
    time_s : (cycle,) middle of each cycle [s]; mean_um : (cycle,) mean error of the true position [um]
    """

    label: str
    axis: int
    time_s: Array
    mean_um: Array


def drift_figure(runs: Sequence[DriftRun], names: Sequence[str]) -> Figure:
    """Mean error of each cycle over time, a panel for each axis that has runs."""
    axes_shown = sorted({run.axis for run in runs})
    labels = list(dict.fromkeys(run.label for run in runs))
    longest = max(float(run.time_s[-1]) for run in runs)
    factor, unit = (1.0 / 60.0, "min") if longest > MINUTES_FROM_S else (1.0, "s")
    rows, columns = style.side_by_side(len(axes_shown))
    with style.drawing(0.8 + 2.3 * rows, columns) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in panels[len(axes_shown) :]:
            axes.remove()
        entries: dict[str, Artist] = {}
        for number, (axis, axes) in enumerate(zip(axes_shown, panels, strict=False)):
            for run in (run for run in runs if run.axis == axis):
                time, mean = style.thin_path([run.time_s * factor, run.mean_um], MOST_CYCLES)
                place = labels.index(run.label)
                markers = style.sparse_markers(len(mean), place)
                (entries[style.plain(run.label)],) = axes.plot(
                    time, mean, markevery=markers, label=style.plain(run.label), **style.line_style(place)
                )
            axes.set_ylabel(f"mean error of {names[axis]} [µm]")
            axes.margins(x=0.01)
            style.few_ticks(axes)
            axes.set_xlabel(f"time [{unit}]")
            style.letter(axes, number)
        style.legend_above(figure, entries, "True position: mean error of each cycle")
    return figure


FILLED = 0.8  # of the height that a parameter has
PALE_ALPHA = 0.35
"""Of the total effect, behind the first order."""


def sensitivity_figure(
    names: Sequence[str], bars: Mapping[str, tuple[Array, Array]], title: str = ""
) -> Figure:
    """First and total indices as bars, a group for each parameter; none where the draws were too few.

    Parameters
    ----------
    names : of the parameters, from the top
    bars : by label, (parameter, 3) index of the parameter alone and with others, and its lower and upper
        limit; NaN where the draws were too few
    title : written above the legend

    Examples
    --------
    >>> index = np.array([[0.7, 0.6, 0.8], [0.2, 0.1, 0.3]])
    >>> figure = sensitivity_figure(["weights", "noise"], {"exact": (index, index)})
    >>> [label.get_text() for label in figure.axes[0].get_yticklabels()]
    ['weights', 'noise']
    """
    places, height = np.arange(len(names), dtype=np.float64), FILLED / len(bars)
    with style.drawing(1.2 + 0.24 * len(names) * max(2, len(bars)), columns=1) as figure:
        axes = figure.subplots()
        entries: dict[str, Artist] = {}
        for number, (label, (alone, together)) in enumerate(bars.items()):
            colour = style.line_style(number)["color"]
            middle = places + height * (number - 0.5 * (len(bars) - 1))
            known = np.isfinite(together[:, 0])
            total, low, high = together[known].T
            axes.barh(middle[known], total, height, color=colour, alpha=PALE_ALPHA, linewidth=0.0)
            first = np.nan_to_num(alone[:, 0])
            entries[label] = axes.barh(middle, first, 0.6 * height, color=colour, linewidth=0.0).patches[0]
            axes.hlines(middle[known], low, high, color=style.DARK, linewidth=0.8)
            for place in middle[~known]:
                axes.text(0.0, place, f" {TOO_FEW}", color=colour, va="center")
        axes.set_yticks(places, names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("share of the variance")
        axes.set_xlim(left=min(0.0, *(float(np.nan_to_num(one[:, 0]).min()) for one, _ in bars.values())))
        style.letter(axes, 0)
        style.legend_above(figure, entries, title)
    return figure

"""What a spread is due to, and how the mean of each cycle wanders over a long run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.report import TOO_FEW
from hammerstein.reporting.figures.style import (
    DARK,
    few_ticks,
    legend_above,
    letter,
    line_style,
    new_figure,
    plain,
    side_by_side,
    sparse_markers,
    styled,
    thin_path,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

MOST_CYCLES = 1000  # points of a curve
MINUTES_FROM_S = 180.0
"""Longer runs have an axis in minutes."""


@dataclass(frozen=True, eq=False)
class DriftRun:
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
    rows, columns = side_by_side(len(axes_shown))
    with styled():
        figure = new_figure(0.8 + 2.3 * rows, columns)
        panels = figure.subplots(rows, columns, squeeze=False).flat
        entries: dict[str, Artist] = {}
        for number, (axis, axes) in enumerate(zip(axes_shown, panels, strict=False)):
            for run in (run for run in runs if run.axis == axis):
                time, mean = thin_path([run.time_s * factor, run.mean_um], MOST_CYCLES)
                place = labels.index(run.label)
                markers = sparse_markers(len(mean), place)
                (line,) = axes.plot(
                    time, mean, markevery=markers, label=plain(run.label), **line_style(place)
                )
                entries[plain(run.label)] = line
            axes.set_ylabel(f"mean error of {names[axis]} [µm]")
            axes.margins(x=0.01)
            few_ticks(axes)
            axes.set_xlabel(f"time [{unit}]")
            letter(axes, number)
        legend_above(figure, entries, "True position: mean error of each cycle")
    return figure


FILLED = 0.8  # of the height that a parameter has
PALE_ALPHA = 0.35
"""Of the total effect, behind the first order."""


@dataclass(frozen=True, eq=False)
class SensitivityBars:
    """Indices of one compensator.

    label : what the legend calls it
    parameters : names, from the top
    first, total : (parameter, 3) index of the parameter alone and with others, and its lower and upper limit;
        NaN where the draws were too few
    """

    label: str
    parameters: tuple[str, ...]
    first: Array
    total: Array


def sensitivity_figure(bars: Sequence[SensitivityBars], title: str = "") -> Figure:
    """First and total indices as bars, a group for each parameter; none where the draws were too few.

    Parameters
    ----------
    bars : what to draw; all have the same parameters
    title : written above the legend

    Examples
    --------
    >>> index = np.array([[0.7, 0.6, 0.8], [0.2, 0.1, 0.3]])
    >>> figure = sensitivity_figure([SensitivityBars("exact", ("weights", "noise"), index, index)])
    >>> [label.get_text() for label in figure.axes[0].get_yticklabels()]
    ['weights', 'noise']
    """
    names = bars[0].parameters
    places, height = np.arange(len(names), dtype=np.float64), FILLED / len(bars)
    with styled():
        figure = new_figure(1.2 + 0.24 * len(names) * max(2, len(bars)), columns=1)
        axes = figure.subplots()
        entries: dict[str, Artist] = {}
        for number, own in enumerate(bars):
            colour = line_style(number)["color"]
            middle = places + height * (number - 0.5 * (len(bars) - 1))
            known = np.isfinite(own.total[:, 0])
            total, low, high = own.total[known].T
            axes.barh(middle[known], total, height, color=colour, alpha=PALE_ALPHA, linewidth=0.0)
            first = np.nan_to_num(own.first[:, 0])
            alone = axes.barh(middle, first, 0.6 * height, color=colour, linewidth=0.0)
            entries[own.label] = alone.patches[0]
            axes.hlines(middle[known], low, high, color=DARK, linewidth=0.8)
            for place in middle[~known]:
                axes.text(0.0, place, f" {TOO_FEW}", color=colour, va="center")
        axes.set_yticks(places, names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("share of the variance")
        axes.set_xlim(left=min(0.0, *(float(np.nan_to_num(own.first[:, 0]).min()) for own in bars)))
        letter(axes, 0)
        legend_above(figure, entries, title)
    return figure

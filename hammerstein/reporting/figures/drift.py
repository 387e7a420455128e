"""How the mean of each cycle wanders over a long run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hammerstein.arrays import Array
from hammerstein.reporting.figures.style import (
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

"""Paths: the plane and the axes over time; and the errors over time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.selection import significant
from hammerstein.reporting.figures.smooth_path import POINTS_OF_A_LAP, is_sparse, smooth_path
from hammerstein.reporting.figures.style import (
    COLOURS,
    DARK,
    MOST_POINTS,
    WIDTH_IN,
    few_ticks,
    in_lines,
    legend_above,
    letter,
    new_figure,
    plain,
    plain_numbers,
    side_by_side,
    styled,
    symbol,
    thin_path,
    thin_trace,
    time_axis,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Short dashes are the target's alone.
LINES: tuple[Any, ...] = (
    "-",
    (0, (8, 1.5, 1.5, 1.5)),
    (0, (1, 1)),
    (0, (12, 2)),
    (0, (8, 1.5, 1.5, 1.5, 1.5, 1.5)),
)
TARGET: dict[str, Any] = {"color": DARK, "linestyle": (0, (3, 2.5)), "linewidth": 0.9, "label": "target"}
APART = 1.02  # sizes of paths that the eye tells apart
LOGARITHMIC_FROM = 8.0  # ratio of the worst distances from which their axis is logarithmic
DEEPEST = 1e-4  # part of the worst error below which nothing is told apart: rounding is no result
OUTSIDE = 3.0  # ratio of the worst error to the end of the linear middle from which it has a tick, too


@dataclass(frozen=True, eq=False)
class PathRun:
    """All axes driven together.

    label : what the legend calls it; runs of one label are drawn alike
    group : the swept value, such as ``50 um``; runs of one group have the same target
    time_s : (sample,) [s]
    target_um : (axis, sample) where the path should go; None: nothing to compare with
    output_um : (axis, sample) where it goes
    true_um : (axis, sample) where it truly goes, if ``output_um`` is a sensor's reading
    period_s : length of time that is drawn [s]: that after which the path closes, or the whole of one that
        does not; the errors in the legend are those of the whole run
    closes : whether the path repeats after that time
    lap_s : time of one turn of a path without corners [s]; 0 of any other
    """

    label: str
    group: str
    time_s: Array
    target_um: Array | None
    output_um: Array
    true_um: Array | None
    period_s: float
    closes: bool = False
    lap_s: float = 0.0

    @property
    def shown(self) -> slice:
        """Samples of one period."""
        end_s = self.time_s[0] + self.period_s * (1.0 + 1e-9)
        return slice(0, int(np.searchsorted(self.time_s, end_s, "right")))

    def plane_of(self, path_um: Array) -> Array:
        """Points (axis, point) of one period of a path; few samples of a smooth one are joined smoothly."""
        if not is_sparse(self.time_s, self.lap_s):
            return path_um[:, self.shown]
        return smooth_path(self.time_s, path_um, self.period_s, self.lap_s, self.closes)

    def errors(self) -> list[tuple[str, Array]]:
        """Error of each axis, then its length over all axes, then that of the true position."""
        assert self.target_um is not None
        error = self.output_um - self.target_um
        rows = [("", axis) for axis in error]
        if len(error) > 1:
            rows.append((DISTANCE, np.linalg.norm(error, axis=0)))
        if self.true_um is not None:
            rows.append((TRULY, np.linalg.norm(self.true_um - self.target_um, axis=0)))
        return rows

    def drawn_errors(self) -> list[tuple[str, Array]]:
        """The true error first; the distance of the reading, which repeats its axes, is left out then."""
        rows = self.errors()
        if rows[-1][0] != TRULY:
            return rows
        return [rows[-1], *((name, error) for name, error in rows[:-1] if name != DISTANCE)]


DISTANCE = "distance"
TRULY = "true distance"
LABELS = {DISTANCE: "distance\n[µm]", TRULY: "true\ndistance\n[µm]"}  # as long as a low panel is high
UPRIGHT_LETTERS = 15
"""Of a line beside such a panel."""


def path_figure(runs: Sequence[PathRun], axes_names: Sequence[str], target: str, title: str = "") -> Figure:
    """Path in the plane (a) and axes over time (b), as in the paper's Figs. 10 to 13.

    All groups share the plane; (b) shows the group with the largest target. The plane is left out unless
    there are two axes. The legend gives the worst distance.

    Parameters
    ----------
    runs : what to draw
    axes_names : name of each axis
    target : what the dashed line is, such as ``reference``
    title : written above the legend
    """
    with styled():
        group = _largest_group(runs)
        largest = [run for run in runs if run.group == group]
        figure, plane, traces = _layout(len(axes_names))
        pens = _pens(runs)
        curves = 3 * len(runs) + len(largest) * len(axes_names) + len(axes_names)
        most = MOST_POINTS // curves  # a path in the plane is longer and gets three times as many
        if plane is not None:
            told_apart = _of_different_sizes(runs)
            _draw_plane(plane, runs if told_apart else largest, pens, axes_names, 3 * most)
            letter(plane, 0, "" if told_apart else group)
        entries = _draw_traces(traces, largest, pens, axes_names, target, most)
        letter(traces[0], 1 if plane else 0, group)
        legend_above(figure, entries, title)
    return figure


def path_errors_figure(runs: Sequence[PathRun], axes_names: Sequence[str], title: str = "") -> Figure:
    """Errors over time, a column a group; every run has a target."""
    groups = list(dict.fromkeys(run.group for run in runs))
    rows = len(runs[0].drawn_errors())
    with styled():
        high, wide = (rows, len(groups)) if len(groups) > 1 else side_by_side(rows)
        figure = new_figure(0.8 + 1.5 * high, wide)
        grid = figure.subplots(high, wide, squeeze=False, sharey="row" if len(groups) > 1 else False)
        for axes in grid.flat[rows * len(groups) :]:
            axes.remove()
        panels = np.reshape(grid.flat[: rows * len(groups)], (rows, len(groups)))
        entries: dict[str, Artist] = {}
        most = MOST_POINTS // (len(runs) * rows)
        for column, group in enumerate(groups):
            inside = [run for run in runs if run.group == group]
            lines = _draw_errors(list(panels[:, column]), inside, _pens(runs), axes_names, most)
            entries |= {_entry(label, runs): line for label, line in lines.items()}
            for row, axes in enumerate(panels[:, column]):
                letter(axes, row if len(groups) == 1 else None if row else column, group)
            for axes in panels[:, column]:
                axes.tick_params(labelleft=True)  # each panel is read alone on a telephone
        for (name, _), row in zip(runs[0].drawn_errors(), panels, strict=True):
            for axes in row:
                _scale_distance(axes, name, runs)
        legend_above(figure, entries, title)
    return figure


def _pens(runs: Sequence[PathRun]) -> dict[str, dict[str, Any]]:
    """Colour and line of each label."""
    labels = dict.fromkeys(run.label for run in runs)
    return {
        label: {
            "color": COLOURS[i % len(COLOURS)],
            "linestyle": LINES[i % len(LINES)],
            "linewidth": 1.2,
            "label": plain(label),
        }
        for i, label in enumerate(labels)
    }


def _largest_group(runs: Sequence[PathRun]) -> str:
    def size(run: PathRun) -> float:
        return float(np.abs(run.output_um if run.target_um is None else run.target_um).max())

    return max(runs, key=size).group


def _of_different_sizes(runs: Sequence[PathRun]) -> bool:
    """Whether the paths of the groups differ in size, so that the plane tells one from the other."""
    sizes: dict[str, float] = {}
    for run in runs:
        path = run.output_um if run.target_um is None else run.target_um
        sizes[run.group] = max(sizes.get(run.group, 0.0), float(np.abs(path).max()))
    ordered = sorted(sizes.values())
    return all(b > APART * a for a, b in itertools.pairwise(ordered))


def _layout(n_axes: int) -> tuple[Figure, Axes | None, list[Axes]]:
    """Empty panels: plane (of two axes only) left of the traces; without it the traces side by side."""
    if n_axes == 2:
        figure = new_figure(0.9 + 0.46 * WIDTH_IN)
        grid = figure.add_gridspec(2, 2)
        plane = figure.add_subplot(grid[:, 0])
        return figure, plane, [figure.add_subplot(grid[row, 1]) for row in range(2)]
    lines, columns = side_by_side(n_axes)
    figure = new_figure(0.7 + 2.0 * lines, columns)
    return figure, None, [figure.add_subplot(lines, columns, axis + 1) for axis in range(n_axes)]


def _draw_plane(
    axes: Axes, runs: Sequence[PathRun], pens: dict[str, Any], names: Sequence[str], most: int
) -> None:
    """One period of each path: broken lines drawn over themselves would look whole."""
    for run in runs:
        x, y = thin_path(list(run.plane_of(run.output_um)), _points(run, most))
        axes.plot(x, y, **pens[run.label])
        if is_sparse(run.time_s, run.lap_s):  # the samples themselves
            axes.plot(*run.output_um[:, run.shown], ".", color=pens[run.label]["color"], markersize=4.5)
    for run in {run.group: run for run in runs if run.target_um is not None}.values():
        assert run.target_um is not None
        x, y = thin_path(list(run.plane_of(run.target_um)), _points(run, most))
        axes.plot(x, y, **TARGET)
    axes.set_aspect("equal")
    few_ticks(axes)
    axes.set_xlabel(f"{symbol(names[0], 'reading')} [µm]")
    axes.set_ylabel(f"{symbol(names[1], 'reading')} [µm]")


def _points(run: PathRun, most: int) -> int:
    """Most points of a path in the plane: enough for every turn of a smooth one."""
    return max(most, math.ceil(POINTS_OF_A_LAP * run.period_s / run.lap_s)) if run.lap_s else most


def _draw_traces(
    traces: Sequence[Axes],
    runs: Sequence[PathRun],
    pens: dict[str, Any],
    names: Sequence[str],
    target: str,
    most: int,
) -> dict[str, Artist]:
    """Axes over time; gives the entries of the legend, with the worst distance of each curve."""
    entries: dict[str, Artist] = {}
    shown = runs[0].shown
    factor, time_label = time_axis(runs[0].period_s)
    for axis, axes in enumerate(traces):
        for run in runs:
            time, values = thin_trace(run.time_s[shown] * factor, run.output_um[axis, shown], most)
            (line,) = axes.plot(time, values, **pens[run.label])
            entries[_entry(run.label, runs)] = line
        if runs[0].target_um is not None:
            time, values = thin_trace(runs[0].time_s[shown] * factor, runs[0].target_um[axis, shown], most)
            (entries[target],) = axes.plot(time, values, **TARGET)
        few_ticks(axes)
        axes.set_ylabel(in_lines(f"{symbol(names[axis], 'reading')} [µm]", UPRIGHT_LETTERS))
        axes.set_xlabel(time_label)
        axes.margins(x=0.0)
    return entries


def _entry(label: str, runs: Sequence[PathRun]) -> str:
    """Label with the worst distance of its runs as a whole; of one axis, the worst error."""
    same = [run for run in runs if run.label == label]
    if same[0].target_um is None:
        return plain(label)
    names = dict(same[0].errors())
    truly = f", true {significant(_worst(same, TRULY))} µm" if TRULY in names else ""
    worst = significant(_worst(same, DISTANCE if DISTANCE in names else ""))
    return f"{plain(label)} (worst {worst} µm{truly})"


def _worst(runs: Sequence[PathRun], name: str) -> float:
    return max(float(np.abs(dict(run.errors())[name]).max()) for run in runs)


def _draw_errors(
    panels: Sequence[Axes],
    runs: Sequence[PathRun],
    pens: dict[str, Any],
    names: Sequence[str],
    most: int,
) -> dict[str, Artist]:
    """Errors over time, a panel each; gives the line of each label."""
    entries: dict[str, Artist] = {}
    factor, time_label = time_axis(runs[0].period_s)
    for run in runs:
        for axes, (_, error) in zip(panels, run.drawn_errors(), strict=True):
            time, values = thin_trace(run.time_s[run.shown] * factor, error[run.shown], most)
            (line,) = axes.plot(time, values, **pens[run.label])
            entries[run.label] = line
    own = iter(names)
    for i, (name, _) in enumerate(runs[0].drawn_errors()):
        panels[i].margins(x=0.0)
        few_ticks(panels[i])
        panels[i].set_ylabel(
            LABELS.get(name) or in_lines(f"{symbol(next(own), 'error')} [µm]", UPRIGHT_LETTERS)
        )
        panels[i].set_xlabel(time_label)
    return entries


def _scale_signed(axes: Axes, runs: Sequence[PathRun]) -> None:
    """Errors of an axis: linear, or logarithmic on both sides of a linear middle that the best run fills."""
    worst = [_worst([run], DISTANCE) if len(run.errors()) > 1 else _worst([run], "") for run in runs]
    if min(worst) > 0.0 and max(worst) >= LOGARITHMIC_FROM * min(worst):
        middle = 10.0 ** math.ceil(math.log10(max(min(worst), DEEPEST * max(worst))))
        axes.set_yscale("symlog", linthresh=middle, linscale=1.0)
        outermost = _one_digit(max(worst))
        told = [outermost, middle] if outermost >= OUTSIDE * middle else [middle]
        ticks = [-tick for tick in told] + [0.0, *reversed(told)]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
        axes.minorticks_off()
        words = f"{axes.get_ylabel()}, log beyond ±{middle:g} µm"
        axes.set_ylabel(in_lines(words, UPRIGHT_LETTERS))


def _one_digit(value: float) -> float:
    """Largest number of one digit that is not above a value."""
    decade = 10.0 ** math.floor(math.log10(value))
    return math.floor(value / decade) * decade


def _scale_distance(axes: Axes, name: str, runs: Sequence[PathRun]) -> None:
    """Distances start at zero; where one curve would hide another, every error is logarithmic."""
    worst = [_worst([run], name) for run in runs] if name else []
    if not name:
        _scale_signed(axes, runs)
        return
    if min(worst) > 0.0 and max(worst) >= LOGARITHMIC_FROM * min(worst):
        typical = min(float(np.median(dict(run.errors())[name])) for run in runs)
        axes.set_yscale("log")
        axes.set_ylim(0.3 * max(typical, DEEPEST * max(worst)), 1.4 * max(worst))
        plain_numbers(axes.yaxis)
    elif axes.get_yscale() == "linear":  # panels of one row share their scale
        axes.set_ylim(0.0, 1.08 * max(worst) or 1.0)

"""Paths: the plane, the axes over time, and the errors over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hammerstein.figures.style import (
    DARK,
    MOST_POINTS,
    WIDTH_IN,
    Array,
    legend_above,
    letter,
    line_style,
    new_figure,
    plain,
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


@dataclass(frozen=True, eq=False)
class PathRun:
    """All axes driven together.

    label : what the legend calls it; runs of one label are drawn alike
    group : the swept value, such as ``50 um``; runs of one group have the same target
    time_s : (sample,) [s]
    target_um : (axis, sample) where the path should go; None: nothing to compare with
    output_um : (axis, sample) where it goes
    shown_s : length of time that is drawn [s]; figures are taken over the whole run
    """

    label: str
    group: str
    time_s: Array
    target_um: Array | None
    output_um: Array
    shown_s: float

    @property
    def error_um(self) -> Array | None:
        """Output less target (axis, sample)."""
        return None if self.target_um is None else self.output_um - self.target_um


def path_figure(runs: Sequence[PathRun], axes_names: Sequence[str], target: str, title: str = "") -> Figure:
    """Path in the plane (a), axes over time (b) and errors over time (c), as in the paper's Figs. 10 to 13.

    All groups share the plane; (b) and (c) show the group with the largest target. The plane is left out
    unless there are two axes.

    Parameters
    ----------
    runs : what to draw
    axes_names : name of each axis
    target : what the dashed line is, such as ``reference``
    title : written above the legend
    """
    with styled():
        largest = [run for run in runs if run.group == _largest_group(runs)]
        compared = [run for run in largest if run.target_um is not None]
        n_errors = 0 if not compared else len(axes_names) + (len(axes_names) > 1)
        figure, plane, traces, errors = _layout(len(axes_names), n_errors)
        numbers = {label: i for i, label in enumerate(dict.fromkeys(run.label for run in runs))}
        most = MOST_POINTS // (len(runs) + len(largest) * (len(axes_names) + n_errors) + len(axes_names))
        if plane is not None:
            _draw_plane(plane, runs, numbers, axes_names, most)
            letter(plane, 0)
        entries = _draw_traces(traces, largest, numbers, axes_names, target, most)
        letter(traces[0], 1 if plane else 0, largest[0].group)
        if errors:
            _draw_errors(errors, compared, numbers, axes_names, most)
            letter(errors[0], 2 if plane else 1, largest[0].group)
        legend_above(figure, entries, title)
    return figure


def path_errors_figure(runs: Sequence[PathRun], axes_names: Sequence[str], title: str = "") -> Figure:
    """Errors over time, a column for each group: what ``path_figure`` shows of the largest one alone."""
    groups = list(dict.fromkeys(run.group for run in runs))
    numbers = {label: i for i, label in enumerate(dict.fromkeys(run.label for run in runs))}
    rows = len(axes_names) + (len(axes_names) > 1)
    with styled():
        figure = new_figure(0.8 + 1.5 * rows)
        panels = figure.subplots(rows, len(groups), squeeze=False, sharey="row", sharex="col")
        entries: dict[str, Artist] = {}
        for column, group in enumerate(groups):
            inside = [run for run in runs if run.group == group]
            most = MOST_POINTS // (len(runs) * rows)
            lines = _draw_errors(list(panels[:, column]), inside, numbers, axes_names, most)
            entries |= lines
            letter(panels[0, column], column, group)
            if column:
                for axes in panels[:, column]:
                    axes.set_ylabel("")
        legend_above(figure, entries, title)
    return figure


def _largest_group(runs: Sequence[PathRun]) -> str:
    return max(
        runs, key=lambda run: float(np.abs(run.output_um if run.target_um is None else run.target_um).max())
    ).group


def _layout(n_axes: int, n_errors: int) -> tuple[Figure, Axes | None, list[Axes], list[Axes]]:
    """Empty panels: plane (of two axes only), traces, errors."""
    top_in = 0.46 * WIDTH_IN if n_axes == 2 else 1.5 * n_axes
    figure = new_figure(0.7 + top_in + 1.25 * n_errors)
    heights = [top_in, 1.25 * n_errors] if n_errors else [top_in]
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    columns = 2 if n_axes == 2 else 1
    top = grid[0].subgridspec(n_axes, columns)
    plane = figure.add_subplot(top[:, 0]) if columns == 2 else None
    traces = _stack(figure, [top[row, columns - 1] for row in range(n_axes)])
    if not n_errors:
        return figure, plane, traces, []
    below = grid[1].subgridspec(n_errors, 1)
    return figure, plane, traces, _stack(figure, [below[row] for row in range(n_errors)])


def _stack(figure: Figure, places: Sequence[Any]) -> list[Axes]:
    """Panels above each other that share the time axis."""
    stack: list[Axes] = []
    for place in places:
        stack.append(figure.add_subplot(place, sharex=stack[0] if stack else None))
    for axes in stack[:-1]:
        axes.tick_params(labelbottom=False)
    return stack


def _shown(run: PathRun) -> Array:
    return np.asarray(run.time_s <= run.time_s[0] + run.shown_s * (1 + 1e-9))


def _draw_plane(
    axes: Axes, runs: Sequence[PathRun], numbers: dict[str, int], names: Sequence[str], most: int
) -> None:
    for run in runs:
        shown = _shown(run)
        x, y = thin_path(list(run.output_um[:, shown]), most)
        axes.plot(x, y, color=line_style(numbers[run.label])["color"], linewidth=1.2)
    drawn = set()
    for run in runs:
        if run.target_um is not None and run.group not in drawn:
            x, y = thin_path(list(run.target_um[:, _shown(run)]), most)
            axes.plot(x, y, color=DARK, linestyle=(0, (4, 3)), linewidth=1.0)
            drawn.add(run.group)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{symbol(names[0], 'reading')} [µm]")
    axes.set_ylabel(f"{symbol(names[1], 'reading')} [µm]")


def _draw_traces(
    traces: Sequence[Axes],
    runs: Sequence[PathRun],
    numbers: dict[str, int],
    names: Sequence[str],
    target: str,
    most: int,
) -> dict[str, Artist]:
    """Axes over time; gives the entries of the legend, with the worst error of each curve."""
    entries: dict[str, Artist] = {}
    factor, time_label = time_axis(float(np.ptp(runs[0].time_s[_shown(runs[0])])))
    for axis, axes in enumerate(traces):
        for run in runs:
            shown = _shown(run)
            time, values = thin_trace(run.time_s[shown] * factor, run.output_um[axis, shown], most)
            (line,) = axes.plot(time, values, color=line_style(numbers[run.label])["color"], linewidth=1.2)
            entries.setdefault(_entry(run), line)
        if runs[0].target_um is not None:
            shown = _shown(runs[0])
            time, values = thin_trace(runs[0].time_s[shown] * factor, runs[0].target_um[axis, shown], most)
            (line,) = axes.plot(time, values, color=DARK, linestyle=(0, (4, 3)), linewidth=1.0)
            entries[target] = line
        axes.set_ylabel(f"{symbol(names[axis], 'reading')} [µm]")
        axes.margins(x=0.0)
    traces[-1].set_xlabel(time_label)
    return entries


def _entry(run: PathRun) -> str:
    if run.error_um is None:
        return plain(run.label)
    return f"{plain(run.label)} (worst {float(np.linalg.norm(run.error_um, axis=0).max()):.3g} µm)"


def _draw_errors(
    panels: Sequence[Axes],
    runs: Sequence[PathRun],
    numbers: dict[str, int],
    names: Sequence[str],
    most: int,
) -> dict[str, Artist]:
    entries: dict[str, Artist] = {}
    factor, time_label = time_axis(float(np.ptp(runs[0].time_s[_shown(runs[0])])))
    for run in runs:
        assert run.error_um is not None
        error, shown = run.error_um, _shown(run)
        rows = list(error) + ([np.linalg.norm(error, axis=0)] if len(error) > 1 else [])
        for axes, row in zip(panels, rows, strict=True):
            time, values = thin_trace(run.time_s[shown] * factor, row[shown], most)
            style = line_style(numbers[run.label])
            (line,) = axes.plot(
                time, values, color=style["color"], linestyle=style["linestyle"], linewidth=1.1
            )
            entries.setdefault(plain(run.label), line)
    for axes, name in zip(panels, names, strict=False):
        axes.set_ylabel(f"{symbol(name, 'error')} [µm]")
    if len(names) > 1:
        panels[-1].set_ylabel("distance [µm]")
        panels[-1].set_ylim(bottom=0.0)
    for axes in panels:
        axes.margins(x=0.0)
    panels[-1].set_xlabel(time_label)
    return entries

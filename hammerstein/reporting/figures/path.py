"""Paths: the plane and the axes over time; and the errors over time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import hammerstein.reporting.figures.style as style
from hammerstein.arrays import Array
from hammerstein.experiment.report import significant

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
TARGET: dict[str, Any] = {
    "color": style.DARK,
    "linestyle": (0, (3, 2.5)),
    "linewidth": 0.9,
    "label": "target",
}
APART = 1.02  # sizes of paths that the eye tells apart
LOGARITHMIC_FROM = 8.0  # ratio of the worst distances from which their axis is logarithmic
DEEPEST = 1e-4  # part of the worst error below which nothing is told apart: rounding is no result
MOST_OF_A_PANEL = 4  # labels that the eye tells apart in one panel; more are split over several


class PathRun(NamedTuple):
    """All axes driven together.

    label : name in the legend; runs of one label are drawn alike
    group : the swept value, such as ``50 um``; runs of one group have the same target
    time_s : (sample,) [s]
    target_um : (axis, sample) wanted path; None: no comparison
    output_um : (axis, sample) actual path
    period_s : drawn time [s]: one period of a closed path, or all of another one; the errors in the legend
        are those of the whole run
    closes : whether the path repeats after that time
    lap_s : time of one turn of a path without corners [s]; 0 for any other path
    """

    label: str
    group: str
    time_s: Array
    target_um: Array | None
    output_um: Array
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

    def errors(self) -> list[Array]:
        """Length of the error over all axes, then the error of each axis."""
        assert self.target_um is not None
        error = self.output_um - self.target_um
        return [np.linalg.norm(error, axis=0), *error]

    @property
    def worst_um(self) -> float:
        """Worst distance of the whole run."""
        return float(self.errors()[0].max())


UPRIGHT_LETTERS = 15
"""Most letters of a line beside a low panel."""


def path_figure(runs: Sequence[PathRun], axes_names: Sequence[str], target: str, title: str = "") -> Figure:
    """Path in the plane and each axis over time, as in the paper's Figs. 10 to 13.

    All groups share the plane; over time the group with the largest target is shown. The plane needs two
    axes. If there are more labels than one panel holds, several panels of the same kind share them: only
    planes, if there are two axes. The legend gives the worst distance.

    Parameters
    ----------
    runs : paths
    axes_names : name of each axis
    target : name of the dashed line, such as ``reference``
    title : written above the legend
    """
    with style.styled():
        sizes: dict[str, float] = {}  # of the groups
        for run in runs:
            path = run.output_um if run.target_um is None else run.target_um
            sizes[run.group] = max(sizes.get(run.group, 0.0), float(np.abs(path).max()))
        group = max(sizes, key=sizes.__getitem__)
        largest = [run for run in runs if run.group == group]
        parts, pens = _parts(runs), _pens(runs)
        figure, planes, traces = _layout(len(axes_names), len(parts))
        curves = 3 * len(runs) + len(largest) * len(traces) + len(planes) + len(traces)
        most = style.MOST_POINTS // curves  # a path in the plane is longer and gets three times as many
        told_apart = all(b > APART * a for a, b in itertools.pairwise(sorted(sizes.values())))
        lines: dict[str, Artist] = {}
        for plane, labels in zip(planes, parts, strict=False):
            inside = [run for run in (runs if told_apart else largest) if run.label in labels]
            lines |= _draw_plane(plane, inside, pens, axes_names, 3 * most)
        for number, axes in enumerate(traces):
            part, axis = divmod(number, len(axes_names))
            inside = [run for run in largest if run.label in parts[part]]
            lines |= _draw_over_time(axes, inside, [run.output_um[axis] for run in inside], pens, most)
            if (target_um := inside[0].target_um) is not None:
                _draw_over_time(axes, inside[:1], [target_um[axis]], {inside[0].label: TARGET}, most)
            axes.set_ylabel(
                style.in_lines(f"{style.symbol(axes_names[axis], 'reading')} [µm]", UPRIGHT_LETTERS)
            )
        for number, axes in enumerate(panels := [*planes, *traces]):
            style.letter(axes, number, "" if axes in planes and told_apart else group)
            style.few_ticks(axes)
        entries = {_entry(label, largest, runs): line for label, line in lines.items()}
        goal = {target: panels[0].lines[-1]} if runs[0].target_um is not None else {}
        style.legend_above(figure, entries | goal, title)
    return figure


def path_errors_figure(runs: Sequence[PathRun], axes_names: Sequence[str], title: str = "") -> Figure:
    """Errors over time, a column a group: the distance, then each axis; every run has a target.

    Where there are more labels than one panel holds, rows of distances share them. Distances are logarithmic
    where one curve would hide another.
    """
    groups, parts = list(dict.fromkeys(run.group for run in runs)), _parts(runs)
    length = "distance" if len(axes_names) > 1 else "size of error"
    labels = [f"{length} [µm]", *(f"{style.symbol(name, 'error')} [µm]" for name in axes_names)]
    rows = [(part, 0) for part in parts] if len(parts) > 1 else [(parts[0], k) for k in range(len(labels))]
    high, wide = (len(rows), len(groups)) if len(groups) > 1 else style.side_by_side(len(rows))
    with style.drawing(0.8 + (1.6 if high > 1 else 2.4) * high, wide) as figure:
        shared: Any = "all" if len(parts) > 1 else "row" if len(groups) > 1 else False
        grid = figure.subplots(high, wide, squeeze=False, sharey=shared)
        for axes in grid.flat[len(rows) * len(groups) :]:
            axes.remove()
        panels = np.reshape(grid.flat[: len(rows) * len(groups)], (len(rows), len(groups)))
        lines: dict[str, Artist] = {}
        most, pens = style.MOST_POINTS // (len(runs) * (1 if len(parts) > 1 else len(labels))), _pens(runs)
        for (row, column), axes in np.ndenumerate(panels):
            part, quantity = rows[row]
            inside = [run for run in runs if run.group == groups[column] and run.label in part]
            lines |= _draw_over_time(axes, inside, [run.errors()[quantity] for run in inside], pens, most)
            style.few_ticks(axes)
            axes.set_ylabel(style.in_lines(labels[quantity], UPRIGHT_LETTERS))
            axes.tick_params(labelleft=True)  # each panel is read alone on a telephone
            style.letter(axes, row * len(groups) + column, groups[column])
            if quantity == 0:
                _scale_distance(axes, runs)
        style.legend_above(figure, {_entry(label, runs, runs): line for label, line in lines.items()}, title)
    return figure


def _parts(runs: Sequence[PathRun]) -> list[list[str]]:
    """Labels of each panel, about as many in each, in their order."""
    labels = list(dict.fromkeys(run.label for run in runs))
    panels = math.ceil(len(labels) / MOST_OF_A_PANEL)
    return [part.tolist() for part in np.array_split(np.array(labels, dtype=object), panels)]


def _pens(runs: Sequence[PathRun]) -> dict[str, dict[str, Any]]:
    """Colour and line of each label."""
    labels = dict.fromkeys(run.label for run in runs)
    return {
        label: {
            "color": style.COLOURS[i % len(style.COLOURS)],
            "linestyle": LINES[i % len(LINES)],
            "linewidth": 1.2,
            "label": style.plain(label),
        }
        for i, label in enumerate(labels)
    }


def _layout(n_axes: int, n_parts: int) -> tuple[Figure, list[Axes], list[Axes]]:
    """Empty planes (of two axes) and traces: a plane left of its traces, or planes side by side."""
    if n_axes == 2 and n_parts == 1:
        figure = style.new_figure(0.9 + 0.46 * style.WIDTH_IN)
        grid = figure.add_gridspec(2, 2)
        return figure, [figure.add_subplot(grid[:, 0])], [figure.add_subplot(grid[row, 1]) for row in (0, 1)]
    panels = n_parts if n_axes == 2 else n_parts * n_axes
    lines, columns = style.side_by_side(panels)
    figure = style.new_figure(0.9 + (0.46 * style.WIDTH_IN if n_axes == 2 else 2.0) * lines, columns)
    drawn = [figure.add_subplot(lines, columns, number + 1) for number in range(panels)]
    return (figure, drawn, []) if n_axes == 2 else (figure, [], drawn)


def _draw_plane(
    axes: Axes, runs: Sequence[PathRun], pens: dict[str, Any], names: Sequence[str], most: int
) -> dict[str, Artist]:
    """One period of each path: broken lines drawn over themselves would look whole.

    Targets are drawn last. Gives the line of each label.
    """
    lines: dict[str, Artist] = {}
    for run in runs:
        x, y = style.thin_path(list(run.plane_of(run.output_um)), _points(run, most))
        (lines[run.label],) = axes.plot(x, y, **pens[run.label])
        if is_sparse(run.time_s, run.lap_s):  # the samples themselves
            axes.plot(*run.output_um[:, run.shown], ".", color=pens[run.label]["color"], markersize=4.5)
    for run in {run.group: run for run in runs if run.target_um is not None}.values():
        assert run.target_um is not None
        x, y = style.thin_path(list(run.plane_of(run.target_um)), _points(run, most))
        axes.plot(x, y, **TARGET)
    axes.set_aspect("equal")
    axes.set_xlabel(f"{style.symbol(names[0], 'reading')} [µm]")
    axes.set_ylabel(f"{style.symbol(names[1], 'reading')} [µm]")
    return lines


def _points(run: PathRun, most: int) -> int:
    """Most points of a path in the plane: enough for every turn of a smooth one."""
    return max(most, math.ceil(POINTS_OF_A_LAP * run.period_s / run.lap_s)) if run.lap_s else most


def _draw_over_time(
    axes: Axes, runs: Sequence[PathRun], wires: Sequence[Array], pens: dict[str, Any], most: int
) -> dict[str, Artist]:
    """One signal (sample,) of each run over time; gives the line of each label."""
    lines: dict[str, Artist] = {}
    factor, time_label = style.time_axis(runs[0].period_s)
    for run, wire in zip(runs, wires, strict=True):
        time, values = style.thin_trace(run.time_s[run.shown] * factor, wire[run.shown], most)
        (lines[run.label],) = axes.plot(time, values, **pens[run.label])
    axes.set_xlabel(time_label)
    axes.margins(x=0.0)
    return lines


def _entry(label: str, runs: Sequence[PathRun], every: Sequence[PathRun]) -> str:
    """Label with the worst distance of its runs as a whole, and its group where there are several; of one
    axis, the worst error.
    """
    same = [run for run in runs if run.label == label]
    if same[0].target_um is None:
        return style.plain(label)
    worst = max(same, key=lambda run: run.worst_um)
    group = f", {worst.group}" if any(run.group != worst.group for run in every) else ""
    return f"{style.plain(label)} (worst {significant(worst.worst_um)} µm{group})"


def _scale_distance(axes: Axes, runs: Sequence[PathRun]) -> None:
    """Distances start at zero, or are logarithmic where one curve would hide another."""
    worst = [run.worst_um for run in runs]
    if min(worst) > 0.0 and max(worst) >= LOGARITHMIC_FROM * min(worst):
        typical = min(float(np.median(run.errors()[0])) for run in runs)
        axes.set_yscale("log")
        axes.set_ylabel(f"{axes.get_ylabel()}\n(log)")
        axes.set_ylim(0.3 * max(typical, DEEPEST * max(worst)), 1.4 * max(worst))
        style.plain_numbers(axes.yaxis)
    else:
        axes.set_ylim(0.0, 1.08 * max(worst) or 1.0)


POINTS_OF_A_LAP = 60
"""Samples per turn from which straight lines look smooth: their error is 0.14 % of the radius."""
MOST_HARMONICS = 30
"""Points of one period of a path in a figure."""
FEWEST_OF_A_SPLINE = 4
"""Points of a cubic."""


def smooth_path(time_s: Array, path: Array, period_s: float, lap_s: float, closed: bool) -> Array:
    """Points (axis, point) of one period of a smooth path with few samples.

    A closed path is drawn by its harmonics, found by least squares from all samples,

        p(t) = c + sum_h a_h cos(2 pi h t / T) + b_h sin(2 pi h t / T),

    as many as the samples of one period determine; an open path is drawn by a cubic spline over time.

    Parameters
    ----------
    time_s : (sample,) times [s]
    path : (axis, sample)
    period_s : drawn time [s]; for a closed path, its period
    lap_s : time of one turn [s]
    closed : whether the path repeats

    Examples
    --------
    Five samples a turn of a circle:

    >>> t = np.arange(11) / 5
    >>> circle = np.array([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)])
    >>> radius = np.hypot(*smooth_path(t, circle, 1.0, 1.0, closed=True))
    >>> bool(np.allclose(radius, 1.0))
    True
    """
    fine_s = np.linspace(0.0, period_s, round(2 * POINTS_OF_A_LAP * max(1.0, period_s / lap_s)) + 1)
    passed_s = time_s - time_s[0]
    if not closed:
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(passed_s, path, axis=1)(np.minimum(fine_s, passed_s[-1])))
    samples = round(period_s / float(passed_s[1] - passed_s[0]))
    harmonics = min((samples - 1) // 2, MOST_HARMONICS)
    found, *_ = np.linalg.lstsq(_waves(passed_s / period_s, harmonics), path.T, rcond=None)
    return np.asarray((_waves(fine_s / period_s, harmonics) @ found).T)


def _waves(turns: Array, harmonics: int) -> Array:
    """Columns 1, then cosine and sine of each harmonic (sample, 1 + 2 harmonics)."""
    angle = 2.0 * np.pi * np.outer(turns, np.arange(1, harmonics + 1))
    return np.hstack([np.ones((len(turns), 1)), np.cos(angle), np.sin(angle)])


def is_sparse(time_s: Array, lap_s: float) -> bool:
    """Whether straight lines between samples of a path that turns once in ``lap_s`` [s] show corners."""
    return (
        len(time_s) >= FEWEST_OF_A_SPLINE
        and lap_s / POINTS_OF_A_LAP < float(time_s[1] - time_s[0]) < lap_s / 2
    )

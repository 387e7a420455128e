"""Loops and errors of runs in which one input is driven at a time: one panel for each output and input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.selection import significant
from hammerstein.reporting.figures.style import (
    MOST_POINTS,
    PALE,
    WIDTH_IN,
    few_ticks,
    legend_above,
    letter,
    line_style,
    new_figure,
    overlay_style,
    plain,
    side_by_side,
    sparse_markers,
    styled,
    thin_path,
    thin_trace,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class LoopRun:
    """One input driven alone, for about one cycle.

    label : name in the legend; runs of one label are drawn alike
    driven : number of the input, from 0
    input_ : (sample,) voltage [V] or reference [um]
    outputs_um : (output, sample) measurement
    predictions_um : predictions of models (output, sample), by label
    """

    label: str
    driven: int
    input_: Array
    outputs_um: Array
    predictions_um: tuple[tuple[str, Array], ...] = ()


@dataclass(frozen=True, eq=False)
class ErrorRun:
    """Errors of one run with one input driven, over its cycles.

    label : what the legend calls it; runs of one label are drawn alike
    driven : number of the input, from 0
    cycles : (sample,) time in cycles
    errors_um : (output, sample)
    worst_um : largest error of the whole run, of which a part is drawn
    """

    label: str
    driven: int
    cycles: Array
    errors_um: Array
    worst_um: float


def loops_figure(
    runs: Sequence[LoopRun],
    input_labels: Sequence[str],
    output_labels: Sequence[str],
    title: str = "",
    ideal: bool = False,
) -> Figure:
    """Loops in the paper's arrangement (Figs. 5, 6, 8): a row of panels an output, a column an input.

    Parameters
    ----------
    runs : loops, each in the column of the input that it drives
    input_labels : labels of the horizontal axes, with units
    output_labels : labels of the vertical axes, with units
    title : written above the legend
    ideal : draw the result of a perfect compensator: output equal to reference, the other outputs at rest

    Examples
    --------
    >>> phase = np.linspace(0.0, 2.0 * np.pi, 200)
    >>> run = LoopRun("50 Hz", 0, 10.0 * np.sin(phase), 58.0 * np.sin(phase - 0.1)[None])
    >>> figure = loops_figure([run], ["voltage [V]"], ["displacement [um]"])
    >>> figure.axes[0].get_ylabel()
    'displacement [um]'
    """
    with styled():
        figure, panels = _panels(runs, len(output_labels), height=0.65)
        numbers = _numbers([run.label for run in runs])
        models = _numbers([label for run in runs for label, _ in run.predictions_um])
        most = MOST_POINTS // (len(runs) * len(output_labels) * (1 + len(models)))
        entries = {"ideal": _draw_ideal(panels, runs)} if ideal else {}
        for run in runs:
            for o in range(len(output_labels)):
                entries |= _draw_loop(panels[o, run.driven], run, o, numbers[run.label], models, most)
        for (o, k), axes in panels.items():
            axes.set(xlabel=input_labels[k], ylabel=output_labels[o])
            axes.margins(0.04)
        _letters(panels, len(output_labels) == len(input_labels))
        order = [*numbers, *models, *(["ideal"] if ideal else [])]
        legend_above(figure, {plain(label): entries[label] for label in order}, title)
    return figure


def errors_figure(
    runs: Sequence[ErrorRun],
    input_labels: Sequence[str],
    output_labels: Sequence[str],
    title: str = "",
) -> Figure:
    """Errors over the cycle, panels as in ``loops_figure``; the legend gives the worst error of all panels.

    Parameters
    ----------
    runs : loops
    input_labels : driven quantity of each column
    output_labels : labels of the vertical axes, with units
    title : written above the legend
    """
    with styled():
        figure, panels = _panels(runs, len(output_labels), height=0.6)
        numbers = _numbers([run.label for run in runs])
        most = MOST_POINTS // (len(runs) * len(output_labels))
        entries: dict[str, Artist] = {}
        for run in runs:
            number = numbers[run.label]
            for o in range(len(output_labels)):
                cycles, error = thin_trace(run.cycles, run.errors_um[o], most)
                style = line_style(number) | {"linewidth": 1.1, "label": plain(run.label)}
                markers = sparse_markers(len(error), number)
                (entries[run.label],) = panels[o, run.driven].plot(cycles, error, markevery=markers, **style)
        for (o, _), axes in panels.items():
            axes.set(xlabel="time [cycles]", ylabel=output_labels[o])
            axes.margins(x=0.0)
        remarks = [f"{label} driven" for label in input_labels]
        _letters(panels, len(output_labels) == len(input_labels), remarks)
        worst = {label: max(run.worst_um for run in runs if run.label == label) for label in numbers}
        named = {
            f"{plain(label)} (worst {significant(worst[label])} µm)": entries[label] for label in numbers
        }
        legend_above(figure, named, title)
    return figure


Panels = dict[tuple[int, int], "Axes"]


def _panels(runs: Sequence[LoopRun] | Sequence[ErrorRun], rows: int, height: float) -> tuple[Figure, Panels]:
    """Empty panels by output and input; an input that no run drives has no column."""
    driven = sorted({run.driven for run in runs})
    places = [(o, k) for o in range(rows) for k in driven]
    lines, columns = (rows, len(driven)) if len(driven) > 1 else side_by_side(rows)
    figure = new_figure(0.6 + lines * WIDTH_IN / max(columns, 2) * height, columns)
    grid = figure.subplots(lines, columns, squeeze=False)
    for axes in grid.flat[len(places) :]:
        axes.remove()
    return figure, dict(zip(places, grid.flat, strict=False))


def _numbers(labels: Sequence[str]) -> dict[str, int]:
    return {label: number for number, label in enumerate(dict.fromkeys(labels))}


def _draw_loop(
    axes: Axes, run: LoopRun, output: int, number: int, models: dict[str, int], most: int
) -> dict[str, Artist]:
    """One loop and the models' loops over it; gives the entries of the legend."""
    x, y = thin_path([run.input_, run.outputs_um[output]], most)
    (line,) = axes.plot(
        x, y, markevery=sparse_markers(len(x), number), label=plain(run.label), **line_style(number)
    )
    entries: dict[str, Artist] = {run.label: line}
    for label, prediction_um in run.predictions_um:
        x, y = thin_path([run.input_, prediction_um[output]], most)
        (entries[label],) = axes.plot(x, y, label=plain(label), **overlay_style(models[label]))
    return entries


def _draw_ideal(panels: Panels, runs: Sequence[LoopRun]) -> Artist:
    """Where a perfect compensator would be: on the diagonal, or at rest."""
    for (o, k), axes in panels.items():
        reach = max(float(np.abs(run.input_).max()) for run in runs if run.driven == k)
        ends = np.array([-reach, reach])
        (line,) = axes.plot(
            ends, ends if o == k else 0.0 * ends, color=PALE, linewidth=3.0, alpha=0.5, label="ideal"
        )
    return line


def _letters(panels: Panels, square: bool, remarks: Sequence[str] = ()) -> None:
    """Letters, and what kind of transfer each panel shows."""
    for number, ((o, k), axes) in enumerate(panels.items()):
        kind = ("direct" if o == k else "cross-coupling") if square and len(panels) > 1 else ""
        few_ticks(axes)
        letter(axes, number, ", ".join(word for word in (kind, remarks[k] if remarks else "") if word))

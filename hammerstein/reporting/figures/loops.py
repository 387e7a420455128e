"""Loops and errors, one input driven at a time; those of measured records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import hammerstein.reporting.figures.style as style
from hammerstein.arrays import Array
from hammerstein.experiment.report import significant
from hammerstein.records.loops import Loop, move_at_once, telling_loops, widest_cycle
from hammerstein.records.record import Record, driven_inputs
from hammerstein.runtime.staging import Owner

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class LoopRun(NamedTuple):
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


class ErrorRun(NamedTuple):
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
    with style.styled():
        figure, panels = _panels(runs, len(output_labels), height=0.65)
        numbers = _numbers([run.label for run in runs])
        models = _numbers([label for run in runs for label, _ in run.predictions_um])
        most = style.MOST_POINTS // (len(runs) * len(output_labels) * (1 + len(models)))
        entries = {"ideal": _draw_ideal(panels, runs)} if ideal else {}
        for run in runs:
            for o in range(len(output_labels)):
                entries |= _draw_loop(panels[o, run.driven], run, o, numbers[run.label], models, most)
        for (o, k), axes in panels.items():
            axes.set(xlabel=input_labels[k], ylabel=output_labels[o])
            axes.margins(0.04)
        _letters(panels, len(output_labels) == len(input_labels))
        order = [*numbers, *models, *(["ideal"] if ideal else [])]
        style.legend_above(figure, {style.plain(label): entries[label] for label in order}, title)
    return figure


def errors_figure(
    runs: Sequence[ErrorRun], input_labels: Sequence[str], output_labels: Sequence[str], title: str = ""
) -> Figure:
    """Errors over the cycle, panels as in ``loops_figure``; the legend gives the worst error of all panels.

    Parameters
    ----------
    runs : loops
    input_labels : driven quantity of each column
    output_labels : labels of the vertical axes, with units
    title : written above the legend
    """
    with style.styled():
        figure, panels = _panels(runs, len(output_labels), height=0.6)
        numbers = _numbers([run.label for run in runs])
        most = style.MOST_POINTS // (len(runs) * len(output_labels))
        entries: dict[str, Artist] = {}
        for run in runs:
            number = numbers[run.label]
            for o in range(len(output_labels)):
                cycles, error = style.thin_trace(run.cycles, run.errors_um[o], most)
                pen = style.line_style(number) | {"linewidth": 1.1, "label": style.plain(run.label)}
                markers = style.sparse_markers(len(error), number)
                (entries[run.label],) = panels[o, run.driven].plot(cycles, error, markevery=markers, **pen)
        for (o, _), axes in panels.items():
            axes.set(xlabel="time [cycles]", ylabel=output_labels[o])
            axes.margins(x=0.0)
        remarks = [f"{label} driven" for label in input_labels]
        _letters(panels, len(output_labels) == len(input_labels), remarks)
        worst = {label: max(run.worst_um for run in runs if run.label == label) for label in numbers}
        named = {
            f"{style.plain(label)} (worst {significant(worst[label])} µm)": entries[label]
            for label in numbers
        }
        style.legend_above(figure, named, title)
    return figure


Panels = dict[tuple[int, int], "Axes"]


def _panels(runs: Sequence[LoopRun] | Sequence[ErrorRun], rows: int, height: float) -> tuple[Figure, Panels]:
    """Empty panels by output and input; an input that no run drives has no column."""
    driven = sorted({run.driven for run in runs})
    places = [(o, k) for o in range(rows) for k in driven]
    lines, columns = (rows, len(driven)) if len(driven) > 1 else style.side_by_side(rows)
    figure = style.new_figure(0.6 + lines * style.WIDTH_IN / max(columns, 2) * height, columns)
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
    x, y = style.thin_path([run.input_, run.outputs_um[output]], most)
    (line,) = axes.plot(
        x,
        y,
        markevery=style.sparse_markers(len(x), number),
        label=style.plain(run.label),
        **style.line_style(number),
    )
    entries: dict[str, Artist] = {run.label: line}
    for label, prediction_um in run.predictions_um:
        x, y = style.thin_path([run.input_, prediction_um[output]], most)
        (entries[label],) = axes.plot(x, y, label=style.plain(label), **style.overlay_style(models[label]))
    return entries


def _draw_ideal(panels: Panels, runs: Sequence[LoopRun]) -> Artist:
    """Where a perfect compensator would be: on the diagonal, or at rest."""
    for (o, k), axes in panels.items():
        inputs = np.concatenate([run.input_ for run in runs if run.driven == k])
        ends = np.array([inputs.min(), inputs.max()])
        (line,) = axes.plot(
            ends, ends if o == k else 0.0 * ends, color=style.PALE, linewidth=3.0, alpha=0.5, label="ideal"
        )
    return line


def _letters(panels: Panels, square: bool, remarks: Sequence[str] = ()) -> None:
    """Letters, and what kind of transfer each panel shows."""
    for number, ((o, k), axes) in enumerate(panels.items()):
        kind = ("direct" if o == k else "cross-coupling") if square and len(panels) > 1 else ""
        style.few_ticks(axes)
        style.letter(axes, number, ", ".join(word for word in (kind, remarks[k] if remarks else "") if word))


LOOPS = Owner("loops")
LOOPS_FILES = ("loops.svg", "loops.png")
AT_ONCE = "all inputs move at once: no loop of one pair"
MOST_AMPLITUDES = 4  # line styles that can be told apart


def loops_of_records(records: Sequence[Record], tables: Sequence[Sequence[Loop]]) -> Figure | None:
    """Draw the last settled loop of each amplitude, largest first; None without loops.

    Of a record in which the inputs only move at once, the last cycle of each is drawn, and called so: what is
    measured then is no loop of one pair.

    Parameters
    ----------
    records : measured records of one actuator
    tables : their loops, as ``loop_table`` gives them
    """
    runs = []
    names = file_labels([record.source for record in records])
    for name, record, table in zip(names, records, tables, strict=True):
        whose = f", {name}" if len(records) > 1 else ""
        for loop in chosen_loops(table):
            part, k = slice(loop.start, loop.stop + 1), record.inputs.index(loop.input)
            label = f"swing {2.0 * loop.amplitude_v:.3g} V{whose}"
            runs.append(LoopRun(label, k, record.u_v[k, part], record.y_um[:, part]))
        if not table and move_at_once(record):
            for k in driven_inputs(record):
                if widest := widest_cycle([record], k, alone=False):
                    cycle = widest[1]
                    runs.append(LoopRun(AT_ONCE + whose, k, record.u_v[k, cycle], record.y_um[:, cycle]))
    return figure_of_columns(runs, records[0].inputs, records[0].outputs)


def figure_of_columns(
    runs: Sequence[LoopRun], inputs: Sequence[str], outputs: Sequence[str]
) -> Figure | None:
    """Loops of columns of records, by their names; None without loops."""
    units = (
        [style.axis_label(name, "V") for name in inputs],
        [style.axis_label(name, "µm") for name in outputs],
    )
    return loops_figure(runs, *units) if runs else None


def file_labels(sources: Sequence[str]) -> list[str]:
    """Names of files without suffix; with their folder if names are equal.

    >>> file_labels(["a/x.csv", "a/y.csv"]), file_labels(["a/x.csv", "b/x.csv"])
    (['x', 'y'], ['a_x', 'b_x'])
    """
    stems = [Path(source).stem for source in sources]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{Path(source).parent.name}_{stem}" for source, stem in zip(sources, stems, strict=True)]


def chosen_loops(table: Sequence[Loop]) -> Iterator[Loop]:
    """One loop for each amplitude that differs by more than a tenth, of the output that responds most."""
    for name in dict.fromkeys(loop.input for loop in table):
        direct = max((loop for loop in table if loop.input == name), key=lambda loop: loop.height_um).output
        own = [loop for loop in telling_loops(table) if (loop.input, loop.output) == (name, direct)]
        own.sort(key=lambda loop: (-loop.amplitude_v, not loop.settled, -loop.start))
        apart: list[Loop] = []
        for loop in own:
            if all(abs(loop.amplitude_v - other.amplitude_v) > 0.1 * other.amplitude_v for other in apart):
                apart.append(loop)
        yield from apart[:MOST_AMPLITUDES]

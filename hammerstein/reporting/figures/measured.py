"""Loops of measured records, in the arrangement of the simulated ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hammerstein.records.excitation import driven_inputs
from hammerstein.records.loops import Loop, move_at_once, telling_loops, widest_cycle
from hammerstein.records.record import Record
from hammerstein.reporting.figures.loops import LoopRun, loops_figure
from hammerstein.reporting.figures.style import axis_label
from hammerstein.runtime.storage.manifest import Owner

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOOPS = Owner("loops")
LOOPS_FILES = ("loops.svg", "loops.png")
AT_ONCE = "all inputs move at once: no loop of one pair"
MOST_AMPLITUDES = 4  # line styles that can be told apart


def loops_of_records(records: Sequence[Record], tables: Sequence[Sequence[Loop]]) -> Figure | None:
    """Draw the last settled loop of each amplitude, largest first; None where no record has anything to draw.

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
        for loop in chosen_loops(table):
            part = slice(loop.start, loop.stop + 1)
            driven = record.inputs.index(loop.input)
            label = f"{loop.amplitude_v:.3g} V" + (f", {name}" if len(records) > 1 else "")
            runs.append(LoopRun(label, driven, record.u_v[driven, part], record.y_um[:, part]))
        if not table and move_at_once(record):
            runs += list(_at_once(record, name if len(records) > 1 else ""))
    if not runs:
        return None
    first = records[0]
    return loops_figure(
        runs,
        [axis_label(name, "V") for name in first.inputs],
        [axis_label(name, "µm") for name in first.outputs],
    )


def _at_once(record: Record, name: str) -> Iterator[LoopRun]:
    """Last widest cycle of each input, the others in motion."""
    for k in driven_inputs(record):
        if part := widest_cycle(record, k, alone=False):
            label = ", ".join(word for word in (AT_ONCE, name) if word)
            yield LoopRun(label, k, record.u_v[k, part], record.y_um[:, part])


def file_labels(sources: Sequence[str]) -> list[str]:
    """Names of files without ending; with their folder where two have the same.

    >>> file_labels(["a/x.csv", "a/y.csv"]), file_labels(["a/x.csv", "b/x.csv"])
    (['x', 'y'], ['a_x', 'b_x'])
    """
    stems = [Path(source).stem for source in sources]
    if len(set(stems)) == len(stems):
        return stems
    return [f"{Path(source).parent.name}_{stem}" for source, stem in zip(sources, stems, strict=True)]


def chosen_loops(table: Sequence[Loop]) -> list[Loop]:
    """One loop for each amplitude that differs by more than a tenth, of the output that answers most."""
    chosen: list[Loop] = []
    inputs = dict.fromkeys(loop.input for loop in table)
    for name in inputs:
        direct = max((loop for loop in table if loop.input == name), key=lambda loop: loop.height_um).output
        own = [loop for loop in telling_loops(table) if (loop.input, loop.output) == (name, direct)]
        own.sort(key=lambda loop: (-loop.amplitude_v, not loop.settled, -loop.start))
        apart: list[Loop] = []
        for loop in own:
            if all(abs(loop.amplitude_v - other.amplitude_v) > 0.1 * other.amplitude_v for other in apart):
                apart.append(loop)
        chosen += apart[:MOST_AMPLITUDES]
    return chosen

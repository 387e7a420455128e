"""The paper's procedure on measured records: one settled loop of each input, then the closed form."""

from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification.static.closed_form import closed_form
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import Excursion, find_cycles

SAME_AMPLITUDE = 0.02
"""Part of the largest swing by which the cycles of one mean may differ."""


def closed_form_model(
    records: Sequence[Record], operators: int, thresholds_v: Sequence[Sequence[Array]] | None = None
) -> PrandtlIshlinskii:
    """Static block from the settled loops of records in which one input is driven at a time.

    Steps 1 to 4 of the paper's section 3.3: the loop of each input with the largest amplitude gives the
    pairs of that input with all outputs.

    Parameters
    ----------
    records : at least one for every input in which that input alone is driven
    operators : number of operators, for thresholds uniform in time
    thresholds_v : (output, input) thresholds [V] instead

    Raises
    ------
    IdentificationError : an input is never driven alone, or over less than two cycles
    """
    columns = []
    for k, name in enumerate(records[0].inputs):
        alone = [record for record in records if driven_inputs(record) == (k,)]
        if not alone:
            raise IdentificationError(
                f"the closed form needs a record in which only input {name} is driven over whole "
                "cycles; record one, or use least squares"
            )
        u, y = mean_cycle(max(alone, key=lambda record: float(np.ptp(record.u_v[k]))), k)
        grids = None if thresholds_v is None else [row[k] for row in thresholds_v]
        columns.append(closed_form(u, y, operators, thresholds_v=grids))
    rows: list[tuple[Pair, ...]] = [tuple(column[o] for column in columns) for o in range(len(columns[0]))]
    return PrandtlIshlinskii(tuple(rows))


def mean_cycle(record: Record, k: int) -> tuple[Array, Array]:
    """Mean of the cycles of largest swing: input (sample,) [V] and outputs (output, sample) [um].

    A cycle runs from tip to tip, so that what was before the first tip is forgotten in it.
    """
    u, y = record.u_v[k], record.y_um
    cycles = [e for e in find_cycles(u).excursions if not e.minor]
    if not cycles:
        raise IdentificationError(
            f"{record.source}: the closed form needs a whole cycle of {record.inputs[k]}"
        )
    swing = max(_swing(u, e) for e in cycles)
    alike = [e for e in cycles if _swing(u, e) >= (1.0 - SAME_AMPLITUDE) * swing]
    length = round(float(np.median([e.stop - e.start for e in alike])))
    phase = np.arange(length) / length
    stacks = [_resampled(np.vstack([u, y]), e, phase) for e in alike]
    turned = [np.roll(stack, -int(np.argmin(stack[0])), axis=1) for stack in stacks]
    mean = np.mean(turned, axis=0)
    return mean[0], mean[1:]


def _swing(u: Array, cycle: Excursion) -> float:
    return float(np.ptp(u[cycle.start : cycle.stop + 1]))


def _resampled(signals: Array, cycle: Excursion, phase: Array) -> Array:
    samples = cycle.start + phase * (cycle.stop - cycle.start)
    return np.array([np.interp(samples, np.arange(len(row)), row) for row in signals])

"""Thresholds for given records, and their number."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.options import Partition
from hammerstein.identification.score import ranges
from hammerstein.identification.static.closed_form import (
    thresholds_uniform_in_time,
    thresholds_uniform_in_voltage,
)
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.normal_equations import (
    PARTS,
    coefficients,
    left_out,
    moments_of_folds,
    pooled,
    refitted,
)
from hammerstein.identification.static.regressors import InitialState, delayed, regressor_blocks
from hammerstein.identification.static.static_block import half_swing, path_filters
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import find_cycles

COUNTS = (1, 2, 3, 4, 6, 8, 10, 12, 15, 20, 25, 30, 40, 60)
"""Numbers of operators that are tried."""
CURVE_SAMPLES = 50_000
"""Samples of all records together with which numbers of operators are compared."""
ENOUGH = 0.02
"""A number of operators is enough if its error is within this part of the least."""
FINE = 1000
"""Samples a node where the records have no cycle: the partition's limit for many samples."""


def input_grids(records: Sequence[Record], operators: int, partition: Partition = "time") -> list[Array]:
    """Thresholds of each input [V], up to half the largest swing in the records.

    Parameters
    ----------
    records : voltages and displacements
    operators : number of thresholds of every input
    partition : ``time``: uniform in the time of a sine of the records' slowest cycle, as in the paper;
        ``voltage``: uniform in the voltage, from 0; ``fitted``: what the fit begins with, as ``time``
    """
    grids = []
    for k, reach in enumerate(half_swing(records)):
        if reach == 0.0:
            grids.append(np.empty(0))
        elif operators == 1:
            grids.append(np.zeros(1))
        elif partition == "voltage":
            grids.append(thresholds_uniform_in_voltage(reach, operators))
        else:
            half = _samples_per_half_cycle(records, k)
            samples = half if half >= 2 * (operators + 1) else float(FINE * (operators + 1))
            grids.append(thresholds_uniform_in_time(reach, operators, samples)[0])
    return grids


def _samples_per_half_cycle(records: Sequence[Record], k: int) -> float:
    """Half the length of the slowest cycle of one input [samples]; 0 if there is none."""
    halves = [0.0]
    for record in records:
        if k in driven_inputs(record):
            cycles = [e.stop - e.start for e in find_cycles(record.u_v[k]).excursions if not e.minor]
            halves += [0.5 * float(np.median(cycles))] if cycles else []
    return max(halves)


@dataclass(frozen=True)
class CurvePoint:
    """Cross-validation errors with one number of operators.

    Parameters
    ----------
    operators : thresholds of each pair
    nrmse_percent : (output,) rms error in percent of the range
    """

    operators: int
    nrmse_percent: tuple[float, ...]

    @property
    def mean_percent(self) -> float:
        """Mean over the outputs."""
        return float(np.mean(self.nrmse_percent))


def error_curve(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    *,
    partition: Partition = "time",
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
) -> tuple[CurvePoint, ...]:
    """Cross-validation error against the number of operators.

    Each record is cut into 16 parts; every fourth part is a fold. The plays run through all of them.

    Parameters
    ----------
    records, starts : fitted records and their initial states
    partition : placement of the thresholds
    delay_samples : delay of the outputs in whole samples
    through : linear block of each record, if there is one
    """
    few, begun = shortened(records, starts, CURVE_SAMPLES)
    span = ranges(few, begun)
    points = []
    for n in COUNTS:
        grids = input_grids(few, n, partition)
        columns = sum(map(len, grids))
        squares = np.zeros(len(span))
        samples = 0
        for o in range(len(span)):
            parts = []
            for i, (record, start) in enumerate(zip(few, begun, strict=True)):
                filters = path_filters(through, i, o, len(span))
                blocks = regressor_blocks(delayed(record, start, delay_samples), start, grids, filters)
                parts.append(moments_of_folds(blocks, record.y_um[[o]], start.first, columns, PARTS))
            whole = pooled([moments for part in parts for moments in part.values()])
            found = partial(refitted, whole=whole, weights=coefficients(whole.gram, whole.cross[:, 0]))
            squares[o], samples = left_out(parts, found)
        points.append(CurvePoint(n, tuple((100.0 * np.sqrt(squares / samples) / span).tolist())))
    return tuple(points)


def enough_operators(curve: Sequence[CurvePoint]) -> int:
    """Smallest number of operators whose cross-validation error is within two percent of the least.

    Examples
    --------
    >>> enough_operators([CurvePoint(1, (7.0,)), CurvePoint(8, (0.81,)), CurvePoint(15, (0.8,))])
    8
    """
    least = min(point.mean_percent for point in curve)
    return next(point.operators for point in curve if point.mean_percent <= (1.0 + ENOUGH) * least)

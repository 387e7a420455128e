"""How many plays and dead-zones records call for, and how smooth their slopes: judged on what is left out.

The columns of a fine grid are summed into those of every coarser one, so that the records are passed once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.operators import CURVE_SAMPLES, input_grids
from hammerstein.identification.score import ranges
from hammerstein.identification.static.asymmetric import AsymmetricColumns, AsymmetricTask, breakpoints_in
from hammerstein.identification.static.folds import FOLDS
from hammerstein.identification.static.history import shortened
from hammerstein.identification.static.normal_equations import Moments, coefficients, pooled, squares_left
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import SlopeColumns, Thresholds
from hammerstein.records.record import Record

T = TypeVar("T")

PLAYS = (10, 15, 20, 30, 60)
"""Numbers of plays of an input that are tried: each grid holds some of the thresholds of the last one."""
DEAD_ZONES = (0, 1, 2, 3, 5, 7, 11, 23)
"""Numbers of dead-zones of an input that are tried, in the same way."""
BESIDE = 7
"""Dead-zones beside which the number of plays is found."""
RIDGES = tuple(10.0**-i for i in range(2, 9))
"""Penalties of the weights that are tried, the smoothest slopes first; below, rounding errors decide."""
BEGUN = RIDGES[-3]
"""Penalty with which the numbers are found: it decides nothing but what the records leave open."""
PARTS = 64
"""Parts of a record that are left out in turn: short against the way from one breakpoint to the next
where the record is a single loop, or what only they tell of it would be missing."""
NEAR = 5e-3
"""Part by which fewer columns or smoother slopes may leave more on what is left out."""


@dataclass(frozen=True, eq=False)
class AsymmetricChoice:
    """What the records call for.

    thresholds_v : (output, input) thresholds [V]; breakpoints_v : (input,) breakpoints, as sent [V]
    ridge : penalty of the weights
    """

    thresholds_v: Thresholds
    breakpoints_v: tuple[Array, ...]
    ridge: float


def chosen_asymmetric(
    records: Sequence[Record],
    thresholds_v: Thresholds | None = None,
    dead_zones: int | None = None,
    *,
    starts: Sequence[Start] = (),
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
) -> AsymmetricChoice:
    """Fewest plays and dead-zones, then smoothest slopes, within half a percent of the least error left out.

    Every record falls into 64 parts; every fourth of them is left out in turn. Loops of one amplitude do
    not tell plays from dead-zones whose slopes are alike on both sides of the middle: what raises the one and
    lowers the other by the same amount changes nothing. Of all weights that leave as little, the least are
    taken: a penalty that is as large as half a percent of the error allows.

    Parameters
    ----------
    thresholds_v : of every pair; uniform in voltage and as many as the records call for if not given
    dead_zones : of every input; found if not given
    records, starts, delay_samples, through : as for ``fit_asymmetric``
    """
    begun = tuple(starts) or (Start("rest"),) * len(records)
    folds = Folds.of(records, begun, thresholds_v, dead_zones, delay_samples, through)
    counts = DEAD_ZONES if dead_zones is None else (dead_zones,)
    beside, row = BESIDE if dead_zones is None else dead_zones, thresholds_v
    if row is None:
        plays = _first_near(PLAYS, lambda n: folds.error(folds.plays(n), beside, BEGUN))
        fitted, row = folds.plays(plays), [input_grids(records, plays, "voltage")] * len(records[0].y_um)
    else:
        fitted = [[*pair] for pair in row]
    count = _first_near(counts, lambda count: folds.error(fitted, count, BEGUN))
    ridge = _first_near(RIDGES, lambda ridge: folds.error(fitted, count, ridge))
    return AsymmetricChoice(row, tuple(breakpoints_in(records, count)), ridge)


def _some(breakpoints_v: Sequence[Array], count: int) -> list[Array]:
    """So many of the breakpoints of each input, at equal distances."""
    return [q[(step := (len(q) + 1) // (count + 1)) - 1 :: step] for q in breakpoints_v]


def _first_near(trials: Sequence[T], error: Callable[[T], float]) -> T:
    """First trial whose error is near the least."""
    errors = [error(trial) for trial in trials]
    return next(t for t, e in zip(trials, errors, strict=True) if e <= (1.0 + NEAR) * min(errors))


class Folds(NamedTuple):
    """Moments of every fold with all columns of the fine grids, and the inverse ranges of the outputs."""

    task: AsymmetricTask
    moments: list[list[dict[int, Moments]]]
    scale: Array

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        starts: Sequence[Start],
        thresholds_v: Thresholds | None,
        dead_zones: int | None,
        delay_samples: int,
        through: Sequence[LinearBlock],
    ) -> Folds:
        """Pass the beginnings of the records once, with thresholds and dead-zones given or the finest."""
        few, begun = shortened(records, starts, CURVE_SAMPLES)
        fine = thresholds_v or [input_grids(few, PLAYS[-1], "voltage")] * len(few[0].y_um)
        points = breakpoints_in(few, DEAD_ZONES[-1] if dead_zones is None else dead_zones)
        layout = SlopeColumns.of(fine)
        task = AsymmetricTask(few, begun, layout, tuple(points), delay_samples, tuple(through))
        return cls(task, task.folds(PARTS), 1.0 / ranges(few, begun))

    def plays(self, number: int) -> list[list[Array]]:
        """So many thresholds (output, input) of the finest grids."""
        row = [grid[:: PLAYS[-1] // number] for grid in self.task.layout.grids]
        return [row] * len(self.scale)

    def error(self, thresholds_v: Thresholds, dead_zones: int, ridge: float) -> float:
        """Rms error on the folds left out in turn, in parts of the ranges, with some of the columns."""
        p = len(thresholds_v)
        fine = [[*self.task.layout.grids]]
        plays = SlopeColumns.of([*fine, *thresholds_v])
        points = self.task.breakpoints_v
        zones = SlopeColumns.of([[*points], _some(points, dead_zones)])
        squares = []
        for o in range(p):
            columns = AsymmetricColumns.of(plays, 1 + o, zones, 1)
            squares.append(self._squares(o, columns, ridge))
        return float(np.sqrt(np.mean(np.array(squares) * self.scale**2)))

    def _squares(self, o: int, columns: AsymmetricColumns, ridge: float) -> float:
        """Mean squared error of one output [um^2]."""
        merge, total, samples = columns.merge, 0.0, 0
        for fold in range(FOLDS):
            test = [parts[fold] for parts in self.moments[o] if fold in parts]
            rest = [m for parts in self.moments[o] for f, m in parts.items() if f != fold]
            if not test or not rest:
                continue
            train, held = pooled(rest), pooled(test)
            gram = merge.T @ train.gram @ merge
            penalty = columns.penalty(gram, ridge)
            found = merge @ coefficients(
                gram if penalty is None else gram + penalty, merge.T @ train.cross[:, 0]
            )
            total += squares_left(held.gram, held.cross[:, 0], float(held.power[0]), found)
            samples += held.samples
        return total / samples

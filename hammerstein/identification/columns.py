"""Which columns of a kind the records call for, and how smooth their weights are: judged on folds.

The moments of all columns are gathered once; every set of them is a part of those.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import Dynamics
from hammerstein.hysteresis import Hysteresis
from hammerstein.hysteresis.identifiable import Driven, Identifiable
from hammerstein.identification.model_selection import moments_of_output
from hammerstein.identification.operators import CURVE_SAMPLES
from hammerstein.identification.score import ranges
from hammerstein.identification.static.folds import left_out
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.normal_equations import Moments, coefficients, ridge_penalty
from hammerstein.identification.task import Task

T = TypeVar("T")

RIDGES = tuple(10.0**-i for i in range(2, 9))
"""Penalties of the weights that are tried, the smoothest slopes first; below, rounding errors decide."""
BEGUN = RIDGES[-3]
"""Penalty with which the columns are chosen: it decides nothing but what the records leave open."""
PARTS = 64
"""Parts of a record that are left out in turn: short against the way from one breakpoint to the next
where the record is a single loop, or what only they tell of it would be missing."""
NEAR = 5e-3
"""Part by which fewer columns or smoother slopes may leave more on what is left out."""


def chosen_columns(
    task: Task, begins: Sequence[Identifiable], driven: Driven, dynamics: Dynamics, ridge: float = 0.0
) -> tuple[Identifiable, float]:
    """Block with the fewest columns and the largest penalty whose error is within 0.5 % of the least.

    If several blocks qualify, the first and smallest is taken.

    Each record is cut into 64 parts, and every fourth part is a fold. Loops of one amplitude cannot separate
    plays from dead-zones with the same slopes on both sides of the middle: raising one and lowering the other
    by the same amount changes nothing. Among weights with equal errors, the smallest are taken; the penalty
    may raise the error by 0.5 %.

    Parameters
    ----------
    task : records, starts, delay
    begins : blocks with all their columns, the smallest first
    driven : how the records drive the inputs
    dynamics : linear block behind the hysteresis
    ridge : requested penalty; 0: it is found
    """
    found = [_chosen(task, block, driven, dynamics, ridge) for block in begins]
    return _first_near(found, lambda one: one[2])[:2]


def as_good(task: Task, one: Identifiable, other: Identifiable, ridge: float, dynamics: Dynamics) -> bool:
    """Whether a block leaves at most 0.5 % more on the folds than another one with its penalty."""
    alone, beside = (
        _errors_left_out(task, block, dynamics)(np.ones(len(block.roughness.T), dtype=np.bool_), own)
        for block, own in ((one, RIDGES[-1]), (other, ridge))
    )
    return alone <= (1.0 + NEAR) * beside


def _chosen(
    task: Task, block: Identifiable, driven: Driven, dynamics: Dynamics, ridge: float
) -> tuple[Identifiable, float, float]:
    """One block with the columns and the penalty that are chosen, and the error that they leave."""
    choices = block.column_choices(driven)
    error = _errors_left_out(task, block, dynamics)
    taken = [choice.beside for choice in choices]
    for i, choice in enumerate(choices):

        def with_set(mask: Flags, i: int = i) -> float:
            others = [*taken[:i], *taken[i + 1 :]]
            return error(np.logical_and.reduce([mask, *others]), BEGUN)

        taken[i] = _first_near(choice.masks, with_set)
    kept = np.logical_and.reduce(taken)
    smooth = ridge or _first_near(RIDGES, lambda ridge: error(kept, ridge))
    return block.with_columns(kept), smooth, error(kept, smooth)


def _first_near(trials: Sequence[T], error: Callable[[T], float]) -> T:
    """First trial whose error is near the least; the only one without asking."""
    if len(trials) == 1:
        return trials[0]
    errors = [error(trial) for trial in trials]
    return next(t for t, e in zip(trials, errors, strict=True) if e <= (1.0 + NEAR) * min(errors))


def _errors_left_out(task: Task, block: Identifiable, dynamics: Dynamics) -> Callable[[Flags, float], float]:
    """Rms error on the folds left out in turn, in parts of the ranges, of some columns with a penalty."""
    few, starts = shortened(task.records, task.starts, CURVE_SAMPLES)
    candidate = task.candidate(cast("Hysteresis[Any]", block), dynamics)
    span = ranges(few, starts)
    folds = [moments_of_output(candidate, few, starts, o, PARTS) for o in range(len(span))]

    def error(kept: Flags, ridge: float) -> float:
        roughness, squares = block.roughness[:, kept], []

        def weights(train: Moments) -> Array:
            gram = train.gram[np.ix_(kept, kept)]
            found = np.zeros(len(kept))
            penalised = gram + ridge_penalty(gram, ridge, roughness)
            found[kept] = coefficients(penalised, train.cross[kept, 0])
            return found

        for parts, size in zip(folds, span, strict=True):
            total, samples = left_out(parts, weights)
            squares.append(total / samples / size**2)
        return float(np.sqrt(np.mean(squares)))

    return error

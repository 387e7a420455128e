"""Columns of a kind and smoothness of their weights, chosen by cross-validation.

The moments of all columns are gathered once; every set of them is a part of those.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import Dynamics
from hammerstein.hysteresis import Hysteresis
from hammerstein.hysteresis.identifiable import Driven, Identifiable
from hammerstein.identification.excitation import fastest_rad_per_s, rates_of_input
from hammerstein.identification.fit import Task
from hammerstein.identification.linear.axis_task import duration_s
from hammerstein.identification.model_selection import CURVE_SAMPLES, moments_of_output
from hammerstein.identification.options import identifiable_kinds
from hammerstein.identification.output_dynamics import OutputDynamics
from hammerstein.identification.projection import ROUGHLY, BlockFit, fit_block
from hammerstein.identification.score import ranges
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.normal_equations import Moments, coefficients, left_out, ridge_penalty
from hammerstein.identification.static.static_block import SlopeColumns, Thresholds, input_grids, swing_ends
from hammerstein.identification.static.threshold_search import price

T = TypeVar("T")

RIDGES = tuple(10.0**-i for i in range(2, 9))
"""Penalties of the weights that are tried, the smoothest slopes first; smaller ones are lost in rounding."""
BEGUN = RIDGES[-3]
"""Penalty for the choice of columns: it only affects what the records do not determine."""
PARTS = 64
"""Parts of a record that are left out in turn: short against the way from one breakpoint to the next
where the record is a single loop, or what only they tell of it would be missing."""
NEAR = 5e-3
"""Relative increase of the cross-validation error allowed for fewer columns or smoother slopes."""
SHARE = 0.1
"""Gain of a step, in parts of what a place must save, under which a search for places has arrived: beyond it,
places that are not worth their price wander, and rounding decides where to."""


def driven_of(task: Task, thresholds_v: Thresholds) -> Driven:
    """Excitation of the inputs, and thresholds: the finest of the kind if none are requested."""
    records, settings = task.records, task.settings
    finest = identifiable_kinds()[settings.hysteresis].finest
    auto = settings.operators == "auto" and settings.thresholds_v is None and settings.partition == "auto"
    if auto and finest:
        thresholds_v = [input_grids(records, finest, "voltage")]
    low, high = swing_ends(records)
    return Driven(
        low_v=low,
        high_v=high,
        working_point_v=records[0].rest_v,
        outputs=task.outputs,
        inputs=records[0].inputs,
        thresholds_v=SlopeColumns.of(thresholds_v).grids,
        sample_time_s=min(record.sample_time_s for record in records),
        duration_s=duration_s(records),
        fastest_rad_per_s=fastest_rad_per_s(records),
        several_rates=rates_of_input(records),
        invertible=settings.solver != "least_squares",
        given=not auto,
        dead_zones=settings.dead_zones,
    )


def chosen_columns(
    task: Task, begins: Sequence[Identifiable], driven: Driven, dynamics: Dynamics, ridge: float = 0.0
) -> tuple[Identifiable, float]:
    """Block with the fewest columns and the largest penalty whose error is within 0.5 % of the minimum.

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


def few_places(task: Task, begins: Sequence[Identifiable], driven: Driven, found: OutputDynamics) -> BlockFit:
    """Block with fitted places, without those that lower the error too little.

    All of them are left out before the others move, or else the least one alone. A place at the end of the
    swing leaves in any case: its column moves at the tips alone.

    Parameters
    ----------
    task : records, starts, delay
    begins : initial blocks, whose places are among their free numbers
    driven : how the records drive the inputs
    found : axes behind the hysteresis, which are fitted along
    """
    outputs = task.outputs
    due = price(1 + outputs, task.readings)
    arriving = SHARE * 0.5 * due * outputs

    def arrived(begun: Identifiable, behind: OutputDynamics) -> BlockFit:
        there = fit_block(task, [begun.released(driven)], driven, behind, enough=arriving)
        inside = np.ones(len(there.hysteresis.weights[0]), dtype=np.bool_)
        inside[np.flatnonzero(there.block.roughness.any(axis=0))[list(there.at_limit)]] = False
        return there if inside.all() else arrived(there.block.with_columns(inside), there.behind)

    def criterion(one: BlockFit) -> float:
        left = np.maximum(one.rms_um, np.finfo(float).tiny)
        return 2.0 * float(np.log(left).mean()) + due * len(one.hysteresis.weights[0])

    def thinned(most: int) -> BlockFit:
        fewer = fit
        for _ in range(most):
            if (kept := _worth(fewer, due * task.readings)).all():
                break
            begun = fewer.block.released(driven).with_columns(kept)
            fewer = fit_block(task, [begun], driven, fewer.behind, refined=False)
        return fewer if fewer is fit else arrived(fewer.block, fewer.behind)

    rough = fit_block(task, begins, driven, found, enough=ROUGHLY)
    fit = arrived(rough.block, rough.behind)
    while True:
        trials = (thinned(most) for most in (len(fit.block.free), 1))
        better = next((trial for trial in trials if criterion(trial) < criterion(fit)), None)
        if better is None:
            return fit._replace(hysteresis=cast("Hysteresis[Any]", fit.block.settled()))
        fit = better


def _worth(fit: BlockFit, due: float) -> Flags:
    """Every column but the one that takes away least of the squared error, if that is less than is due.

    A column takes away (w / its standard error)^2, in parts of the variance.
    """
    hysteresis = fit.hysteresis
    worth = np.zeros(len(hysteresis.weights[0]))
    for w, known in zip(hysteresis.weights, hysteresis.weight_covariance or (), strict=True):
        worth += w**2 / np.maximum(np.diag(known.covariance), np.finfo(float).tiny)
    worth = np.where(fit.block.roughness.any(axis=0), worth, np.inf)
    least = int(np.argmin(worth))
    return np.asarray(np.arange(len(worth)) != (least if worth[least] < due else -1))


def error_left_out(task: Task, block: Hysteresis[Any], dynamics: Dynamics, ridge: float) -> float:
    """Cross-validation rms error of a block with all its columns, in parts of the ranges."""
    whole = cast(Identifiable, block)
    return _errors_left_out(task, whole, dynamics)(np.ones(len(whole.roughness.T), dtype=np.bool_), ridge)


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

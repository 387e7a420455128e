"""Thresholds of all inputs fitted to records by alternating exchanges and damped steps."""

import math
from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.identification.static.normal_equations import coefficients
from hammerstein.identification.static.static_block import StaticFit
from hammerstein.identification.static.threshold_exchange import exchanged, finer, losses
from hammerstein.identification.static.threshold_search import (
    Grids,
    Linearised,
    ThresholdTask,
    place_at,
    search_near,
    split,
)

MOST_ROUNDS = 6
"""Most times that exchanges and steps follow each other."""
MOST_TRIED = 4
"""Thresholds that are tried to leave, the cheapest first."""
STEEPEST = 5.0
"""Slope, in parts of the largest mean slope of its output, beyond which its threshold is left out."""
WORTHWHILE = 1e-3
"""What a round must gain of the criterion, about the part of the squared error that it takes away."""


def fit_thresholds(task: ThresholdTask, grids: Sequence[Array], rounds: int = MOST_ROUNDS) -> Grids:
    """Thresholds of each input that minimise the squared error of all outputs.

    Thresholds that are not worth their price are removed.

    Parameters
    ----------
    task : records and the path behind the static block
    grids : initial thresholds of each input [V], sorted, below the largest half swing; at most as many are
        fitted
    rounds : largest number of rounds of exchanges and steps

    Returns
    -------
    Grids : thresholds of each input [V], sorted, from 0 to below the largest half swing; the initial ones if
        the outputs follow no voltage, so that no fitted threshold has a measured slope

    Examples
    --------
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> from hammerstein.records.record import Record
    >>> from hammerstein.identification.static.regressors import InitialState
    >>> u = 4.0 * np.sin(np.linspace(0.0, 20.0, 2000))
    >>> truth = PrandtlIshlinskii([[Pair([0.3, 1.7], [3.0, 1.0])]])
    >>> record = Record([u], truth.respond([u])[0], 1e-3)
    >>> fit_thresholds(ThresholdTask([record], [InitialState("rest")]), [np.array([1.0, 2.0])])[0].round(6)
    array([0.3, 1.7])
    """
    here = place_at(task, tuple(grids))
    for _ in range(rounds if any(grid.size for grid in grids) else 0):
        fine = [finer(grid, float(top)) for grid, top in zip(here.grids, task.reach_v, strict=True)]
        moments = task.moments(fine, with_derivatives=False)
        there = search_near(task, exchanged(moments, fine, here.grids, here.unit), here.unit)
        gain = here.criterion - there.criterion
        here = there if gain > 0.0 else here
        if gain < WORTHWHILE:
            break
    left = _of_measured_slopes(task, _pruned(task, here).grids)
    return left if any(grid.size for grid in left) else tuple(grids)


def _pruned(task: ThresholdTask, here: Linearised) -> Linearised:
    """The place without thresholds that are not worth their price once the others have moved.

    A search drives some pairs together, between which the model makes a step that follows the noise; rounding
    decides which pairs. Each of a pair is worth much while the other one stays, but the nearer they are, the
    smaller is their step.
    """
    lost = losses(task.moments(here.grids, with_derivatives=False), here.grids, here.unit)
    gaps = (np.diff(grid, prepend=-np.inf, append=np.inf) for grid in here.grids)
    nearest = np.concatenate([np.minimum(gap[:-1], gap[1:]) for gap in gaps])
    cheapest = (j for j in np.argsort(lost * nearest**2)[:MOST_TRIED] if np.isfinite(lost[j]))
    trials = (search_near(task, _without(here.grids, j), here.unit, here.criterion) for j in cheapest)
    better = next((trial for trial in trials if trial.criterion < here.criterion), None)
    return here if better is None else _pruned(task, better)


def _without(grids: Grids, j: int) -> Grids:
    """The thresholds of all inputs without number j of them."""
    begins = np.cumsum([0, *map(len, grids)])[:-1]
    return tuple(r[np.arange(i, i + len(r)) != j] for i, r in zip(begins, grids, strict=True))


def _of_measured_slopes(task: ThresholdTask, grids: Grids) -> Grids:
    """Thresholds without those whose slope far exceeds the measured ones, the worst one first.

    Just below the largest half swing, a play moves only at the tips, where any weight explains one or two
    readings. Beyond the recorded swing, the model would diverge with it.
    """
    while True:
        steepness = np.zeros(sum(map(len, grids)))
        for moment in task.moments(grids, with_derivatives=False):
            slopes = split(coefficients(moment.gram, moment.cross[:, 0]), grids)
            gains = [
                float(np.diff(own, prepend=0.0) @ (top - r)) / top if r.size else 0.0
                for own, r, top in zip(slopes, grids, task.reach_v, strict=True)
            ]
            largest = max(*map(abs, gains), np.finfo(float).tiny)
            steepness = np.maximum(steepness, np.abs(np.concatenate(slopes)) / largest)
        if not steepness.max(initial=0.0) > STEEPEST:
            return grids
        grids = _without(grids, int(np.argmax(steepness)))


def gained(start: StaticFit, fitted: StaticFit) -> bool:
    """Whether fitted thresholds lower the error by more than their number would by chance.

    The initial thresholds are not free parameters; their weights are.

    Parameters
    ----------
    start, fitted : static blocks with the initial and the fitted thresholds, by the same solver
    """
    p = len(start.rms_um)
    return criterion(fitted, 1 + p) < criterion(start, p)


def criterion(fit: StaticFit, parameters: int) -> float:
    """Criterion of Schwarz (Ann. Stat. 6 (1978) 461-464): the less, the better.

    Parameters
    ----------
    fit : static block whose outputs share their thresholds
    parameters : free ones of each threshold: the weights of all outputs, and itself if it was fitted
    """
    readings = len(fit.rms_um) * fit.samples
    thresholds = sum(len(pair.thresholds_v) for pair in fit.hysteresis.pairs[0])
    errors = np.log(np.maximum(fit.rms_um, np.finfo(float).tiny))
    return float(2.0 * fit.samples * errors.sum() + parameters * thresholds * math.log(readings))

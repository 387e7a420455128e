"""Thresholds of all inputs fitted to records by alternating exchanges and damped steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.identification.static.normal_equations import coefficients
from hammerstein.identification.static.static_block import StaticFit
from hammerstein.identification.static.threshold_exchange import LEAST_GAP, exchanged, finer
from hammerstein.identification.static.threshold_search import (
    Grids,
    ThresholdTask,
    place_at,
    search_near,
    split,
)

MOST_ROUNDS = 6
"""Most times that exchanges and steps follow each other."""
STEEPEST = 5.0
"""Slope, in parts of the largest mean slope of its output, beyond which its threshold is left out."""
WORTHWHILE = 1e-3
"""What a round must gain of the criterion, about the part of the squared error that it takes away."""


def fit_thresholds(task: ThresholdTask, grids: Sequence[Array], rounds: int = MOST_ROUNDS) -> Grids:
    """Thresholds of each input that minimise the squared error of all outputs.

    Thresholds that the noise leaves undetermined are removed, and neighbours that end within a thousandth of
    the largest half swing are merged into one.

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
    reach = task.reach_v
    for _ in range(rounds if any(grid.size for grid in grids) else 0):
        fine = [finer(grid, float(top)) for grid, top in zip(here.grids, reach, strict=True)]
        moments = task.moments(fine, with_derivatives=False)
        there = search_near(task, exchanged(moments, fine, here.grids, here.unit), here.unit)
        gain = here.criterion - there.criterion
        here = there if gain > 0.0 else here
        if gain < WORTHWHILE:
            break
    left = _of_measured_slopes(
        task, tuple(merged(grid, LEAST_GAP * top) for grid, top in zip(here.grids, reach, strict=True))
    )
    return left if any(grid.size for grid in left) else tuple(grids)


def _of_measured_slopes(task: ThresholdTask, grids: Grids) -> Grids:
    """Thresholds without those whose slope far exceeds the measured ones, the worst one first.

    Just below the largest half swing, a play moves only at the tips, where any weight explains one or two
    readings. Beyond the recorded swing, the model would diverge with it.
    """
    reach = task.reach_v
    while True:
        moments = task.moments(grids, with_derivatives=False)
        steepness = np.zeros(sum(map(len, grids)))
        for moment in moments:
            slopes = split(coefficients(moment.gram, moment.cross[:, 0]), grids)
            gains = [
                float(np.diff(own, prepend=0.0) @ (top - r)) / top if r.size else 0.0
                for own, r, top in zip(slopes, grids, reach, strict=True)
            ]
            largest = max(map(abs, gains), default=0.0)
            steep = np.abs(np.concatenate(slopes)) / max(largest, np.finfo(float).tiny)
            steepness = np.maximum(steepness, steep)
        if not steepness.max(initial=0.0) > STEEPEST:
            return grids
        worst = int(np.argmax(steepness))
        kept = np.delete(np.concatenate(grids), worst)
        ends = np.cumsum([len(grid) for grid in grids])
        owner = int(np.searchsorted(ends, worst, side="right"))
        sizes = [len(grid) - (k == owner) for k, grid in enumerate(grids)]
        grids = tuple(np.split(kept, np.cumsum(sizes)[:-1]))


def merged(grid: Array, least_gap_v: float) -> Array:
    """Thresholds with each run of neighbours nearer than a least distance [V] replaced by its mean.

    Examples
    --------
    >>> merged(np.array([1.0, 2.0, 2.002, 3.0]), 0.01)
    array([1.   , 2.001, 3.   ])
    """
    runs = np.split(grid, np.flatnonzero(np.diff(grid) >= least_gap_v) + 1)
    return np.array([run.mean() for run in runs if run.size])


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

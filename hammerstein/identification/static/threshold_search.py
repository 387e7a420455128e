"""Search for thresholds by Levenberg-Marquardt steps with the weights projected out.

Once the thresholds r are fixed, the weights w of each output follow by linear least squares. So only the
thresholds are searched (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432). Each
step solves the linearised problem for new slopes c and a change of r together,

    y ~ offset + G S c + sum over j of dr_j w_j G dp_j/dr_j

with S the differences of the plays p and G the path behind the static block. The derivative dp/dr is -1 after
a play was last moved upwards, 1 after downwards and 0 before it was moved; it passes G as the plays do. All
outputs share the thresholds, so that their normal equations are summed.

Thresholds of all inputs fitted to records by alternating exchanges and damped steps.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.static.damped_search import Damping, damped_change, steps
from hammerstein.identification.static.normal_equations import Moments, coefficients, squares_left
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit, half_swing, static_moments
from hammerstein.identification.static.threshold_exchange import LEAST_GAP, exchanged, finer, losses, price
from hammerstein.records.record import Record

Grids = tuple[Array, ...]

LARGEST_STEP = 0.4
"""Part of the distance to its neighbour that a threshold moves at most in one step: the order stays."""
MOST_STEPS = 60  # a search that has not arrived is given up
ENOUGH, ARRIVED_AFTER = 1e-4, 2
"""Relative gain of a step that counts as none, and how many such steps in a row end the search."""
HOPELESS = 10.0
"""Distance from the target, in gains of its last step, beyond which a search is abandoned."""
DAMPING = Damping(least=1e-12, most=1e3)
ROUNDING = 1e-15
"""Part of an output's power under which its squared errors are rounding."""


@dataclass(frozen=True, eq=False)
class ThresholdTask:
    """Data that stay fixed while the thresholds are fitted.

    Parameters
    ----------
    records, starts : fitted records and their initial states
    delay_samples : delay of the outputs in whole samples
    through : linear block of each record behind the static one, without coupling; empty if there is none
    every : of this many samples, one counts in the sums
    """

    records: Sequence[Record]
    starts: Sequence[InitialState]
    delay_samples: int = 0
    through: Sequence[LinearBlock] = ()
    every: int = 1

    def moments(self, grids: Sequence[Array], *, with_derivatives: bool) -> list[Moments]:
        """Moments of each output with the differences of the plays, and their derivatives on request.

        Plays of inputs that rest in a record are excluded from its sums.
        """
        known = self.records, grids, self.starts, self.delay_samples, self.through
        return static_moments(*known, with_derivatives=with_derivatives, every=self.every, driven=True)


@dataclass(frozen=True, eq=False)
class Linearised:
    """State of a search: its error, and the linearised problem.

    Parameters
    ----------
    grids : thresholds of each input [V]
    unit : (output,) squared error [um^2] that counts as one
    cost : sum of the squared errors of all outputs, each in its unit
    curvature, pull : (threshold, threshold) and (threshold,) normal equations of a change of the
        thresholds, with the weights eliminated
    price : part of the cost that a threshold must save
    """

    grids: Grids
    unit: Array
    cost: float
    curvature: Array
    pull: Array
    price: float

    @property
    def criterion(self) -> float:
        """Logarithm of the cost plus the price of the thresholds; smaller is better."""
        return math.log(max(self.cost, np.finfo(float).tiny)) + self.price * sum(map(len, self.grids))

    def step(self, damping: float, reach_v: Array) -> Grids:
        """Thresholds after a damped step that keeps their order and their range."""
        r = np.concatenate(self.grids)
        lowest, highest = _room(self.grids, reach_v)
        stuck = ((r <= lowest) & (self.pull < 0.0)) | ((r >= highest) & (self.pull > 0.0))
        free = np.flatnonzero(~stuck)
        diagonal = np.diag(self.curvature)
        if not diagonal.max(initial=0.0) > 0.0:  # rounding alone: the error depends on none of them
            return self.grids
        floor = 1e-12 * diagonal.max() + np.finfo(float).tiny
        moved = r.copy()
        moved[free] += damped_change(
            self.curvature[np.ix_(free, free)], self.pull[free], damping, math.inf, floor, 1e-14
        )
        return split(np.clip(moved, lowest, highest), self.grids)


def place_at(task: ThresholdTask, grids: Grids, unit: Array | None = None) -> Linearised:
    """Error and linearised problem at given thresholds; ``unit`` is the error there if not given."""
    moments = task.moments(grids, with_derivatives=True)
    each = [_projected(moment, grids) for moment in moments]
    squares = np.array([left for left, _, _ in each])
    if unit is None:
        least = ROUNDING * np.array([float(moment.power[0]) for moment in moments])
        unit = np.maximum(squares, np.maximum(least, np.finfo(float).tiny))
    return Linearised(
        grids=grids,
        unit=unit,
        cost=float(np.sum(squares / unit)),
        curvature=np.sum([h / u for (_, h, _), u in zip(each, unit, strict=True)], axis=0),
        pull=np.sum([g / u for (_, _, g), u in zip(each, unit, strict=True)], axis=0),
        price=price(1 + len(moments), len(moments) * moments[0].freedom),
    )


def search_near(
    task: ThresholdTask, grids: Grids, unit: Array | None = None, below: float = math.inf
) -> Linearised:
    """Levenberg-Marquardt steps from given thresholds until they converge; never worse than the start.

    below : criterion that is wanted; a search ends where its steps gain too little to come there
    """
    here, idle = place_at(task, grids, unit), 0

    def step(here: Linearised, damping: float) -> Linearised:
        return place_at(task, here.step(damping, half_swing(task.records)), here.unit)

    for tried in islice(steps(here, step, lambda place: place.cost, DAMPING), MOST_STEPS):
        here, gain = tried.best, tried.before.criterion - tried.best.criterion
        if tried.gained:
            idle = idle + 1 if tried.there.cost > (1.0 - ENOUGH) * tried.before.cost else 0
        if idle >= ARRIVED_AFTER or (tried.gained and here.criterion - below > HOPELESS * gain):
            break
    return here


def split(r: Array, grids: Sequence[Array]) -> Grids:
    """Thresholds of all inputs, one after the other, as a grid of each input."""
    return tuple(np.split(r, np.cumsum([len(grid) for grid in grids])[:-1]))


def _projected(moment: Moments, grids: Grids) -> tuple[float, Array, Array]:
    """Squared error of one output, curvature and pull of the thresholds with its weights eliminated."""
    n = len(moment.gram) // 2
    gram, mixed, cross = moment.gram[:n, :n], moment.gram[:n, n:], moment.cross[:, 0]
    both = coefficients(gram, np.column_stack([cross[:n], mixed]))
    slopes, drag = both[:, 0], both[:, 1:]
    weights = np.concatenate([np.diff(part, prepend=0.0) for part in split(slopes, grids)])
    curvature = (moment.gram[n:, n:] - mixed.T @ drag) * np.outer(weights, weights)
    pull = (cross[n:] - mixed.T @ slopes) * weights
    return squares_left(gram, cross[:n], float(moment.power[0]), slopes), curvature, pull


def _room(grids: Grids, reach_v: Array) -> tuple[Array, Array]:
    """Lowest and highest value (threshold,) that each threshold may take in one step [V]."""
    lowest, highest = [], []
    for r, reach in zip(grids, reach_v, strict=True):
        gaps = LARGEST_STEP * np.diff(r)
        top = max((1.0 - LEAST_GAP) * reach, float(r[-1])) if r.size else 0.0
        lowest += [0.0, *(r[1:] - gaps)][: r.size]
        highest += [*(r[:-1] + gaps), top][: r.size]
    return np.array(lowest), np.array(highest)


MOST_ROUNDS = 6
"""Most times that exchanges and steps follow each other."""
MOST_TRIED = 4
"""Thresholds that are tried to leave, the cheapest first."""
STEEPEST = 5.0
"""Slope, in parts of the largest mean slope of its output, above which its threshold is removed."""
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
    here, reach_v = place_at(task, tuple(grids)), half_swing(task.records)
    for _ in range(rounds if any(grid.size for grid in grids) else 0):
        fine = [finer(grid, float(top)) for grid, top in zip(here.grids, reach_v, strict=True)]
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
                for own, r, top in zip(slopes, grids, half_swing(task.records), strict=True)
            ]
            largest = max(*map(abs, gains), np.finfo(float).tiny)
            steepness = np.maximum(steepness, np.abs(np.concatenate(slopes)) / largest)
        if not steepness.max(initial=0.0) > STEEPEST:
            return grids
        grids = _without(grids, int(np.argmax(steepness)))


def gained(start: StaticFit, fitted: StaticFit) -> bool:
    """Whether fitted thresholds lower the error by more than chance.

    The initial thresholds are not free parameters; their weights are.

    Parameters
    ----------
    start, fitted : static blocks with the initial and the fitted thresholds, by the same solver
    """
    p = len(start.rms_um)
    return criterion(fitted, 1 + p) < criterion(start, p)


def criterion(fit: StaticFit, parameters: int) -> float:
    """Schwarz criterion (Ann. Stat. 6 (1978) 461-464); smaller is better.

    Parameters
    ----------
    fit : static block whose outputs share their thresholds
    parameters : free ones of each threshold: the weights of all outputs, and itself if it was fitted
    """
    readings = len(fit.rms_um) * fit.samples
    thresholds = sum(len(pair.thresholds_v) for pair in fit.hysteresis.pairs[0])
    errors = np.log(np.maximum(fit.rms_um, np.finfo(float).tiny))
    return float(2.0 * fit.samples * errors.sum() + parameters * thresholds * math.log(readings))

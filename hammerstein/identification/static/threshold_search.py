"""Thresholds by exchange on a fine grid, then by Levenberg-Marquardt steps with the weights projected out.

The error has many local minima over the thresholds: two thresholds may share a span where one is needed while
another span has none. Descent cannot move from one such minimum to another, but an exchange can (sequential
replacement: Miller, Subset Selection in Regression, 2002, section 3.4). The sums over the samples are
computed once for the fine grid; a play enters or leaves the regression by one sweep of their matrix
(Goodnight, Am. Stat. 33 (1979) 149-158).

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
from numpy.typing import NDArray
from scipy.linalg import block_diag

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.search import Damping, damped_change, steps
from hammerstein.identification.static.normal_equations import Moments, coefficients, squares_left
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit, half_swing, static_moments
from hammerstein.records.record import Record

Indices = NDArray[np.intp]

FINE_COLUMNS = 96  # places tried in all
LEAST_FINER, MOST_FINER = 3, 8
"""Places tried between neighbouring thresholds: so many that there are about 96 in all, but 3 to 8."""
WORTHWHILE = 1e-3
"""Part of the error that an exchange must gain."""
LEAST_GAP = 1e-3
"""Least distance of the last threshold from the largest half swing, in parts of it."""
LEAST_OWN = 1e-11
"""Part of a play's power that must not be explained by the chosen ones: less is rounding."""


def price(numbers: int, readings: int) -> float:
    """Part of the squared error that some fitted numbers must save, as a threshold with its weights.

    This is the criterion of Schwarz (Ann. Stat. 6 (1978) 461-464).

    Parameters
    ----------
    numbers : one for a threshold, and its weight for each output
    readings : samples of all outputs
    """
    return numbers * math.log(readings) / readings


def finer(grid: Array, reach_v: float) -> Array:
    """Grid from 0 to below the largest half swing that holds the given thresholds [V].

    Examples
    --------
    >>> finer(np.array([4.0]), 8.0)
    array([0. , 0.5, 1. , 1.5, 2. , 2.5, 3. , 3.5, 4. , 4.5, 5. , 5.5, 6. ,
           6.5, 7. , 7.5])
    """
    if not grid.size:
        return grid
    parts = int(np.clip(round(FINE_COLUMNS / grid.size), LEAST_FINER, MOST_FINER))
    ends = np.concatenate([[0.0], grid, [reach_v]])
    between = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(parts) / parts)
    return np.unique(between[(between <= (1.0 - LEAST_GAP) * reach_v) | np.isin(between, grid)])


def exchanged(
    moments: Sequence[Moments], fine: Sequence[Array], grids: Sequence[Array], unit: Array
) -> tuple[Array, ...]:
    """Thresholds of each input after all exchanges that lower the error; useless ones are removed.

    Parameters
    ----------
    moments : of each output with the differences of the plays of the fine grids
    fine : fine grid of each input [V]
    grids : thresholds of each input to begin with [V], all in the fine grids
    unit : (output,) squared error [um^2] that counts as one
    """
    sizes = [len(grid) for grid in fine]
    owner = np.repeat(np.arange(len(fine)), sizes)
    r = np.concatenate(fine)
    chosen = np.flatnonzero(np.concatenate([np.isin(*both) for both in zip(fine, grids, strict=True)]))
    swept = _within(moments, sizes, unit, chosen)
    for _ in range(2 * len(chosen)):
        found = _best(swept, owner, chosen)
        if found is None:
            break
        leaves, enters = found
        for matrix in swept:
            _sweep(matrix, chosen[leaves], -1.0)
            _sweep(matrix, enters, 1.0)
        chosen[leaves] = enters
    chosen = _worth(swept, owner, chosen, price(1 + len(moments), len(moments) * moments[0].freedom))
    return tuple(np.sort(r[chosen[owner[chosen] == k]]) for k in range(len(fine)))


def losses(moments: Sequence[Moments], grids: Sequence[Array], unit: Array) -> Array:
    """Increase of the squared error (threshold,) if one play is removed and all others are kept.

    Parameters
    ----------
    moments : of each output with the differences of the plays
    grids : thresholds of each input [V]; the only one of an input does not leave, at any price
    unit : (output,) squared error [um^2] that counts as one
    """
    sizes = [len(grid) for grid in grids]
    owner, chosen = np.repeat(np.arange(len(sizes)), sizes), np.arange(sum(sizes))
    return _lost(_within(moments, sizes, unit, chosen), owner, chosen)


def _within(moments: Sequence[Moments], sizes: Sequence[int], unit: Array, chosen: Indices) -> list[Array]:
    """Products of each output after the chosen plays entered the regression."""
    swept = [_scaled(moment, sizes, float(u)) for moment, u in zip(moments, unit, strict=True)]
    for matrix in swept:
        for j in chosen:
            _sweep(matrix, j, 1.0)
    return swept


def _lost(swept: Sequence[Array], owner: Indices, chosen: Indices) -> Array:
    """Squared error (chosen,) that comes back with each one; infinite for the only one of an input."""
    lost = np.sum([matrix[chosen, -1] ** 2 / -np.diag(matrix)[chosen] for matrix in swept], axis=0)
    return np.where(np.bincount(owner[chosen])[owner[chosen]] == 1, np.inf, lost)


def _worth(swept: Sequence[Array], owner: Indices, chosen: Indices, least: float) -> Indices:
    """The chosen plays without those that explain too little; every input keeps one."""
    while True:
        lost = _lost(swept, owner, chosen)
        i = int(np.argmin(lost))
        if not lost[i] < least * sum(float(matrix[-1, -1]) for matrix in swept):
            return chosen
        for matrix in swept:
            _sweep(matrix, chosen[i], -1.0)
        chosen = np.delete(chosen, i)


def _scaled(moment: Moments, sizes: Sequence[int], unit: float) -> Array:
    """Products of all plays, scaled to unit columns, and of the output in the last row and column.

    A play is the sum of the differences from its own on.
    """
    sums = np.asarray(block_diag(*[np.triu(np.ones((n, n))) for n in sizes if n]))
    gram = sums @ moment.gram @ sums.T
    norm = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    n = len(gram)
    matrix = np.empty((n + 1, n + 1))
    matrix[:n, :n] = gram / np.outer(norm, norm)
    matrix[:n, n] = matrix[n, :n] = (sums @ moment.cross[:, 0]) / norm / np.sqrt(unit)
    matrix[n, n] = moment.power[0] / unit
    return matrix


def _sweep(matrix: Array, j: int, way: float) -> None:
    """Let column j enter the regression (way 1) or leave it (way -1), in place.

    For columns j within it, row j holds the coefficients of all others, and the diagonal minus the inverse;
    the rest of the matrix holds the products of what these leave.
    """
    own = matrix[j, j]
    if way * own <= 0.5 * LEAST_OWN and way > 0.0:
        own = LEAST_OWN
    column = matrix[:, j].copy()
    matrix -= np.outer(column, column / own)
    matrix[:, j] = matrix[j] = way * column / own
    matrix[j, j] = -1.0 / own


def _best(swept: Sequence[Array], owner: Indices, chosen: Indices) -> tuple[int, int] | None:
    """Which of the chosen leaves and which column enters, of one input; None if no exchange is worth it."""
    lost = np.zeros((len(chosen), 1))
    gain = np.zeros((len(chosen), len(owner)))
    left = 0.0
    for matrix in swept:
        inverse, weights = -np.diag(matrix)[chosen, None], matrix[chosen, -1:]
        shares = matrix[chosen, :-1]
        own = np.diag(matrix)[:-1] + shares**2 / inverse
        told = matrix[-1, :-1] + shares * weights / inverse
        lost += weights**2 / inverse
        gain += np.where(own > LEAST_OWN, told**2 / np.maximum(own, LEAST_OWN), 0.0)
        left += float(matrix[-1, -1])
    gain[owner[chosen][:, None] != owner] = 0.0
    gain[:, chosen] = 0.0
    change = lost - gain
    leaves, enters = np.unravel_index(int(np.argmin(change)), change.shape)
    worthwhile = change[leaves, enters] < -WORTHWHILE * max(left, 0.0)
    return (int(leaves), int(enters)) if worthwhile else None


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

"""Simultaneous fit of a block of any kind, its axes and its weights by bounded variable projection.

Each output is linear in its weights w once the free numbers t of the block and x of its axis are fixed,

    y = offset + G(x) C(t) w,

with the columns C of the kind. At every place the weights are eliminated, within the bounds that an inverse
needs, and the problem linearised about it gives the next step of t and x (Golub and Pereyra, Inverse
Problems 19 (2003) R1; Marquardt 1963). Fitted in turn, thresholds that grow with the rate and a low-pass
would each take what belongs to the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple, cast

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import Axis
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Hysteresis, WeightCovariance
from hammerstein.hysteresis.identifiable import Driven, Identifiable, mean_slopes
from hammerstein.hysteresis.kind import slopes_of
from hammerstein.hysteresis.pair import triangle
from hammerstein.identification.fit import Task
from hammerstein.identification.linear.axis_fit import thinning
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask, ByColumn, axis_of, parameters_of
from hammerstein.identification.output_dynamics import OutputDynamics
from hammerstein.identification.score import bends_of, columns_of
from hammerstein.identification.search import Damping, damped_change, steps
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.normal_equations import (
    Bounds,
    Moments,
    Solution,
    are_within,
    coefficients,
    ridge_penalty,
    solve,
)
from hammerstein.identification.static.regressors import Regressors, SideBySide
from hammerstein.identification.static.static_block import LEAST_SLOPE, direct_pairs

SEARCH_SAMPLES = 20_000
"""Samples of all records together with which the first guesses are tried."""
SEARCHED = 4
"""Number of first guesses to refine; the best one is refined with all samples."""
MOST_STEPS, DAMPING = 60, Damping(most=1e6)
ROUGHLY, ENOUGH = 1e-3, 1e-6
"""Gain of a step, in parts of the error, under which a search has arrived: of a first guess, of the best."""
NOWHERE = 1e-6
"""Change of every parameter below which a step has no effect."""
ROUNDING = 1e-9
"""Rms error, in parts of the readings, that is only rounding."""
AT_LIMIT = 1e-6
"""Distance from its limit below which a free parameter counts as at it."""
HELD = 1.5 * LEAST_SLOPE
"""Slope, in parts of the mean one, under which a bound holds it: the bound was set by the mean slope of free
weights, which is another one. Weights that only keep their sign hold no slope."""


class BlockFit(NamedTuple):
    """Fitted hysteresis block and the linear dynamics behind it.

    rms_um : (output,) rms error [um]; held : pairs (output, input) with a slope at its bound
    at_limit : indices of free parameters at a limit: the records do not determine them
    """

    hysteresis: Hysteresis[Any]
    behind: OutputDynamics
    rms_um: Array
    held: tuple[tuple[int, int], ...]
    at_limit: tuple[int, ...] = ()

    @property
    def block(self) -> Identifiable:
        """The block as an ``Identifiable``."""
        return cast(Identifiable, self.hysteresis)


def fit_block(
    task: Task,
    begins: Sequence[Identifiable],
    driven: Driven,
    found: OutputDynamics,
    *,
    refined: bool = True,
    ridge: float = 0.0,
    enough: float = ENOUGH,
) -> BlockFit:
    """Parameters of a block, its axes and its weights that minimise the error together.

    Parameters
    ----------
    task : records, starts, settings
    begins : initial blocks; of several, those with the least error on a part of the records continue
    driven : how the records drive the inputs
    found : initial axes and delay
    refined : whether all parameters are fitted; otherwise only the weights
    ridge : penalty of the kind's roughness, relative to the power of its columns
    enough : gain of a step, in parts of the error, under which the search has arrived
    """
    late = replace(task, delay_samples=found.delay_samples)
    if len(begins) > 1:
        few, starts = shortened(task.records, task.starts, SEARCH_SAMPLES)
        quick = replace(late, records=few, starts=starts)
        tries = [_Search(quick, block, driven, found) for block in begins]
        places = [one.begun() for one in tries]
        order = np.argsort([place.cost for place in places], kind="stable")[:SEARCHED]
        near = [tries[i].arrived(places[i], ROUGHLY) for i in order]
        best = min(near, key=lambda place: place.cost)
        if not math.isfinite(best.cost):
            raise IdentificationError("no block of this kind follows the records")
        begins, found = [best.block], OutputDynamics(_axes_of(best, found), found.delay_samples)
    if refined:
        thinned = _Search(late, begins[0], driven, found, thinning(task.records) if found.axes else 1)
        here = thinned.arrived(thinned.begun(), enough)
        begins, found = [here.block], OutputDynamics(_axes_of(here, found), found.delay_samples)
    search = _Search(late, begins[0], driven, found, ridge=ridge)
    return search.result(search.begun())


def _axes_of(place: _Place, found: OutputDynamics) -> tuple[Axis, ...]:
    """Axes of a place, none where there are none."""
    each = zip(found.axes, place.x, strict=False)
    return tuple(axis_of(parameters_of(axis)[0], x) for axis, x in each)


@dataclass(frozen=True, eq=False)
class _Place:
    """One point of the search: block, axis parameters, error, and the problem linearised about them."""

    block: Identifiable
    x: tuple[Array, ...]
    solutions: tuple[Solution, ...]
    cost: float
    curvature: Array
    pull: Array

    @property
    def numbers(self) -> Array:
        """All free numbers, those of the block first."""
        return np.concatenate([self.block.free, *self.x])


@dataclass(frozen=True, eq=False)
class _Search:
    """What stays fixed while block and axes are fitted."""

    task: Task
    first: Identifiable
    driven: Driven
    found: OutputDynamics
    every: int = 1
    ridge: float = 0.0

    @cached_property
    def axes(self) -> tuple[tuple[AxisShape, Array], ...]:
        """Shape and first parameters of each axis; without any where there is no axis."""
        return tuple(map(parameters_of, self.found.axes or (Axis(),) * self.task.outputs))

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest value of every number."""
        own = self.first.limits(self.driven)
        axes = [self._axis_task(o, ()).limits for o in range(self.task.outputs)]
        lower = np.concatenate([own.lower, *(low for low, _ in axes)])
        return lower, np.concatenate([own.upper, *(high for _, high in axes)])

    def begun(self) -> _Place:
        """The place to begin with."""
        numbers = np.concatenate([self.first.free, *(x for _, x in self.axes)])
        return self.place(np.clip(numbers, *self.limits), None)

    def arrived(self, here: _Place, enough: float) -> _Place:
        """The place where damped steps end."""
        if not here.numbers.size:
            return here
        for tried in islice(steps(here, self.step, lambda place: place.cost, DAMPING), MOST_STEPS):
            moved = np.abs(tried.there.numbers - tried.before.numbers).max()
            here = tried.best
            if moved < NOWHERE or 0.0 < tried.before.cost - tried.there.cost < enough:
                break
        return here

    def step(self, here: _Place, damping: float) -> _Place:
        """Where a damped step leads to; a number at its limit that is pulled outwards stays there."""
        lower, upper = self.limits
        numbers = here.numbers
        stuck = ((numbers <= lower) & (here.pull < 0.0)) | ((numbers >= upper) & (here.pull > 0.0))
        free = np.flatnonzero(~stuck)
        moved = numbers.copy()
        if free.size:
            moved[free] += damped_change(here.curvature[np.ix_(free, free)], here.pull[free], damping)
        return self.place(np.clip(moved, lower, upper), here.solutions)

    def place(self, numbers: Array, near: Sequence[Solution] | None) -> _Place:
        """Error with given parameters, and the problem linearised about them.

        near : weights near the best ones, for the derivatives of the outputs
        """
        s = len(self.first.free)
        ends = np.cumsum([s, *(shape.parameters for shape, _ in self.axes)])
        theta, *x = np.split(numbers, ends[:-1])
        block = self.first.at(theta)
        tasks = [self._axis_task(o, self._columns(block, o)) for o in range(self.task.outputs)]
        if near is None:
            near = self.solved(block, [_moments(*both) for both in zip(tasks, x, strict=True)])
        kept, weights = [one.kept for one in tasks], [one.coefficients for one in near]
        kept = self._with_bends(block, kept, weights) if s else kept
        each = zip(tasks, kept, x, weights, strict=True)
        moments = [_derived(replace(one, kept=own), at, w) for one, own, at, w in each]
        counts = [one.columns for one in tasks]
        firsts = [_first(moment, n) for moment, n in zip(moments, counts, strict=True)]
        solutions = self.solved(block, firsts)
        size = len(numbers)
        curvature, pull, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for o, (solution, moment) in enumerate(zip(solutions, moments, strict=True)):
            rms = max(solution.residual_rms, ROUNDING * math.sqrt(moment.power[0] / moment.freedom))
            curved, pulled = _linearised(moment, solution.coefficients, solution.ways)
            at = np.r_[0:s, ends[o] : ends[o + 1]]
            curvature[np.ix_(at, at)] += curved / rms**2
            pull[at] += pulled / rms**2
            cost += math.log(max(rms, np.finfo(float).tiny))
        return _Place(block, tuple(x), tuple(solutions), cost, curvature, pull)

    def solved(self, block: Identifiable, moments: Sequence[Moments]) -> list[Solution]:
        """Weights of each output, those of direct pairs within the bounds that an inverse needs."""
        penalties = [self._penalty(block, m.gram) for m in moments]

        def of_output(o: int, bounds: Bounds | None = None) -> Solution:
            m = moments[o]
            whole = (m.gram, m.cross[:, 0], float(m.power[0]), m.freedom)
            return solve(*whole, bounds=bounds, penalty=penalties[o])

        found = [of_output(o) for o in range(len(moments))]
        if not self.driven.invertible:
            return found
        hysteresis = cast("Hysteresis[Any]", block)
        gains = mean_slopes(hysteresis.with_weights([s.coefficients for s in found]), self.driven)
        for o, k in direct_pairs(gains):
            bounds = block.weight_bounds(o, k, LEAST_SLOPE * float(gains[o, k]), self.driven)
            if bounds is not None and not are_within(bounds, found[o].coefficients):
                found[o] = of_output(o, bounds)
        return found

    def _penalty(self, block: Identifiable, gram: Array) -> Array | None:
        return (
            ridge_penalty(gram, self.ridge, block.roughness) if self.ridge and len(block.roughness) else None
        )

    def result(self, here: _Place) -> BlockFit:
        """The block with its weights and their covariance, and the axes."""
        known = tuple(WeightCovariance(triangle(s.spread), int(s.at_bound.sum())) for s in here.solutions)
        hysteresis = cast("Hysteresis[Any]", here.block).with_weights(
            [s.coefficients for s in here.solutions]
        )
        if "weight_covariance" in getattr(hysteresis, "__dataclass_fields__", ()):
            hysteresis = replace(cast(Any, hysteresis), weight_covariance=known)
        lower, upper = self.limits
        numbers, s = here.numbers, len(here.block.free)
        stands = (numbers <= lower + AT_LIMIT) | (numbers >= upper - AT_LIMIT)
        gains = mean_slopes(hysteresis, self.driven)
        held = [
            (o, k)
            for o, k in direct_pairs(gains)
            if here.solutions[o].at_bound.any()
            and self._least_slope(hysteresis, o, k) < HELD * abs(gains[o, k])
        ]
        return BlockFit(
            hysteresis,
            OutputDynamics(_axes_of(here, self.found), self.found.delay_samples),
            np.array([s.residual_rms for s in here.solutions]),
            tuple(held),
            tuple(np.flatnonzero(stands[:s]).tolist()),
        )

    def _least_slope(self, hysteresis: Hysteresis[Any], o: int, k: int) -> float:
        """Slope of a pair nearest to 0 [um/V]."""
        return float(np.abs(slopes_of(hysteresis, k, float(self.driven.half_swing_v[k]))[:, o]).min())

    def _axis_task(self, o: int, kept: tuple[Regressors, ...]) -> AxisTask:
        task = self.task
        (shape, _), delay, sensor = self.axes[o], task.delay_samples, task.settings.sensor
        return AxisTask(task.records, task.starts, (), o, shape, delay, sensor, self.every, kept)

    def _columns(self, block: Identifiable, o: int) -> tuple[Regressors, ...]:
        """Columns of one output over each record, and before it."""
        return tuple(
            columns_of(block, record, start, o)
            for record, start in zip(self.task.records, self.task.starts, strict=True)
        )

    def _with_bends(
        self, block: Identifiable, kept: Sequence[Sequence[Regressors]], weights: Sequence[Array]
    ) -> list[tuple[Regressors, ...]]:
        """Columns (output) (record), and behind them how the output changes with each number of the block."""
        weighted = cast(Identifiable, cast("Hysteresis[Any]", block).with_weights(weights))
        each = zip(self.task.records, self.task.starts, strict=True)
        bends = [bends_of(weighted, record, start) for record, start in each]
        return [
            tuple(
                Regressors(np.vstack([now.values, values[:, o]]), np.append(now.held, held[:, o]))
                for now, (values, held) in zip(own, bends, strict=True)
            )
            for o, own in enumerate(kept)
        ]


def _moments(one: AxisTask, x: Array) -> Moments:
    """Moments of the columns behind the axis."""
    return one.moments(lambda time: [SideBySide(one.path(x, time))], one.columns)


def _first(moments: Moments, n: int) -> Moments:
    """Moments of the first n columns alone."""
    means = moments.means[:, [*range(n), -1]]
    return Moments(moments.gram[:n, :n], moments.cross[:n], moments.power, moments.samples, means)


def _derived(one: AxisTask, x: Array, weights: Array) -> Moments:
    """Moments of the columns behind the axis, then of the derivatives of the output by its parameters."""
    whole = one.columns
    padded = np.append(weights, np.zeros(whole - len(weights)))

    def filters(time: float) -> list[ByColumn]:
        more = [one.derivatives(x, padded, time)] if len(x) else []
        return [SideBySide(one.path(x, time)), *more]

    return one.moments(filters, whole + len(x))


def _linearised(moments: Moments, weights: Array, ways: Array) -> tuple[Array, Array]:
    """Normal equations of a change of block and axis, the free directions of the weights eliminated."""
    n = len(weights)
    gram, mixed, cross = moments.gram[:n, :n], moments.gram[:n, n:], moments.cross[:, 0]
    drag = ways @ coefficients(ways.T @ gram @ ways, ways.T @ mixed)
    return moments.gram[n:, n:] - mixed.T @ drag, cross[n:] - mixed.T @ weights

"""What is not linear in a block, found together with the axes behind it.

Thresholds that grow with the rate and a low-pass explain much the same: fitted in turn, each takes for itself
what belongs to the other, and they hardly approach their best values from turn to turn. All of them are
moved at once here, as ``axis_steps`` moves the parameters of an axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from hammerstein.arrays import Array
from hammerstein.hysteresis import RateDependent
from hammerstein.identification.behind import Behind
from hammerstein.identification.linear.axis_fit import fit_axis
from hammerstein.identification.linear.axis_search import TINY, thinning
from hammerstein.identification.linear.axis_task import AxisTask, parameters_of
from hammerstein.identification.score import path_before
from hammerstein.identification.static.damped_search import Damping, damped_change, steps
from hammerstein.identification.static.history import shortened
from hammerstein.identification.static.normal_equations import Moments, coefficients
from hammerstein.identification.static.rate_dependent import SEARCH_SAMPLES, STABLE, Slopes, differences
from hammerstein.identification.static.regressors import Filter, Regressors, SideBySide, Start
from hammerstein.identification.static.static_block import half_swing
from hammerstein.identification.task import Task
from hammerstein.records.record import Record

MOST_STEPS, DAMPING = 30, Damping(most=1e6)
ENOUGH = 1e-5
"""Gain of a step, in parts of the error, under which the search has arrived."""
NOWHERE = 1e-5
"""Change of a logarithm under which a step goes nowhere."""
ROUNDING = 1e-9
"""Rms error, in parts of the readings, below which nothing but rounding is left."""
STEP = 1e-3
"""Change of a logarithm for its derivative: plays bend where they engage, so that it is not too small."""


@dataclass(frozen=True, eq=False)
class _Place:
    """Numbers of the block and of all axes, what is left there, and the problem linearised about them.

    ``slopes`` (output, slope) are the best ones there.
    """

    theta: Array
    x: tuple[Array, ...]
    slopes: Array
    cost: float
    curvature: Array
    pull: Array

    def moved(self, damping: float) -> tuple[Array, tuple[Array, ...]]:
        """All numbers after a step (Levenberg-Marquardt)."""
        change = damped_change(self.curvature, self.pull, damping)
        ends = np.cumsum([len(self.theta), *map(len, self.x)])[:-1]
        first, *others = np.split(change, ends)
        return self.theta + first, tuple(x + d for x, d in zip(self.x, others, strict=True))

    def distance(self, other: _Place) -> float:
        """Largest change of a number."""
        ours, theirs = (np.concatenate([place.theta, *place.x]) for place in (self, other))
        return float(np.abs(ours - theirs).max())


def fitted_together(task: Task, block: RateDependent, found: Behind) -> tuple[RateDependent, Behind]:
    """Growth and bandwidth of rate-dependent plays, and axes, at the least that both leave.

    The weights are eliminated at every place, as for an axis alone, but within the bounds that the block will
    have: numbers that suit free weights leave more with bounded ones. A block whose inverse would ring up is
    not gone to where one is asked for.
    """
    few, starts = shortened(task.records, task.starts, SEARCH_SAMPLES)
    search = _Search(
        replace(task, records=few, starts=starts, delay_samples=found.delay_samples), block, found
    )
    here = search.place(search.theta_of(block), tuple(parameters_of(axis)[1] for axis in found.axes), None)
    for tried in islice(steps(here, search.step, lambda place: place.cost, DAMPING), MOST_STEPS):
        if tried.before.distance(tried.there) < NOWHERE:
            break
        here = tried.best
        if 0.0 < tried.before.cost - tried.there.cost < ENOUGH:
            break
    block = search.block_of(here.theta)
    tasks = search.axis_tasks(block)
    solved = search.slopes.solved([_moments(*both) for both in zip(tasks, here.x, strict=True)])
    fits = [fit_axis(_within(one, free), x) for one, x, (_, free) in zip(tasks, here.x, solved, strict=True)]
    return block, Behind(tuple(fit.axis for fit in fits), found.delay_samples, tuple(fits))


@dataclass(frozen=True, eq=False)
class _Search:
    """What stays fixed while block and axes are fitted."""

    task: Task
    block: RateDependent
    found: Behind

    @property
    def slopes(self) -> Slopes:
        """How the slopes of its plays are found, with the bounds of the block."""
        grids = tuple(plays.thresholds_v for plays in self.block.inputs)
        return Slopes(grids, half_swing(self.task.records), self.task.settings.solver == "invertible")

    def theta_of(self, block: RateDependent) -> Array:
        """Logarithms of the growth of each input, and of the bandwidth."""
        growth = [max(float(plays.growth_s[-1]), TINY) for plays in block.inputs]
        return np.log([*growth, block.inputs[0].bandwidth_hz])

    def block_of(self, theta: Array) -> RateDependent:
        """The block with these numbers: all plays but play(0) grow alike."""
        *growth, bandwidth_hz = np.exp(theta).tolist()
        inputs = tuple(
            replace(plays, growth_s=np.where(plays.thresholds_v > 0.0, b, 0.0), bandwidth_hz=bandwidth_hz)
            for plays, b in zip(self.block.inputs, growth, strict=True)
        )
        return replace(self.block, inputs=inputs)

    def inside(self, theta: Array, x: tuple[Array, ...]) -> tuple[Array, tuple[Array, ...]]:
        """The same within what the records can tell of axes."""
        limits = [self._axis_task(o, ()).limits for o in range(self.task.outputs)]
        return theta, tuple(np.clip(one, *both) for one, both in zip(x, limits, strict=True))

    def axis_tasks(self, block: RateDependent) -> list[AxisTask]:
        """Tasks of the axes behind a block, with differences of its plays as columns."""
        kept = self._columns(block)
        return [self._axis_task(o, kept) for o in range(self.task.outputs)]

    def step(self, here: _Place, damping: float) -> _Place:
        """Where a damped step from a place leads to, within what the records can tell."""
        return self.place(*self.inside(*here.moved(damping)), here.slopes)

    def place(self, theta: Array, x: tuple[Array, ...], near: Array | None) -> _Place:
        """What is left with given numbers, and the problem linearised about them.

        near : slopes (output, slope) near the best ones, with which the outputs are derived by the numbers
        """
        s, block = len(theta), self.block_of(theta)
        size = s + sum(map(len, x))
        gain = float(block.on_grid(self.task.records[0].sample_time_s).loop_gain().max())
        if self.task.settings.solver == "invertible" and gain >= STABLE:
            return _Place(theta, x, np.empty((0, 0)), math.inf, np.eye(size), np.zeros(size))
        tasks = self.axis_tasks(block)
        if near is None:
            solved = self.slopes.solved([_moments(*both) for both in zip(tasks, x, strict=True)])
            near = np.array([solution.coefficients for solution, _ in solved])
        bends, n = self._bends(theta, tasks[0].kept, near), near.shape[1]
        moments = []
        for o, (one, own) in enumerate(zip(tasks, x, strict=True)):
            more = tuple(
                Regressors(np.vstack([kept.values, bend[o].values]), np.append(kept.held, bend[o].held))
                for kept, bend in zip(one.kept, bends, strict=True)
            )
            moments.append(_derived(replace(one, kept=more), own, near[o]))
        solved = self.slopes.solved([_first(moment, n) for moment in moments])
        curvature, pull, cost, first = np.zeros((size, size)), np.zeros(size), 0.0, s
        for (found, free), moment, own in zip(solved, moments, x, strict=True):
            rms = max(found.residual_rms, ROUNDING * math.sqrt(moment.power[0] / moment.freedom))
            curved, pulled = _linearised(moment, found.coefficients, free)
            at = np.r_[0:s, first : first + len(own)]
            curvature[np.ix_(at, at)] += curved / rms**2
            pull[at] += pulled / rms**2
            cost += math.log(rms)
            first += len(own)
        slopes = np.array([solution.coefficients for solution, _ in solved])
        return _Place(theta, x, slopes, cost, curvature, pull)

    def _axis_task(self, o: int, kept: tuple[Regressors, ...]) -> AxisTask:
        task, (shape, _) = self.task, parameters_of(self.found.axes[o])
        sensor, every = task.settings.sensor, thinning(task.records)
        return AxisTask(task.records, task.starts, (), o, shape, task.delay_samples, sensor, every, kept)

    def _columns(self, block: RateDependent) -> tuple[Regressors, ...]:
        """Differences of the plays of a block over each record, and before it."""
        each = zip(self.task.records, self.task.starts, strict=True)
        return tuple(_differences(block, *both) for both in each)

    def _bends(self, theta: Array, here: Sequence[Regressors], slopes: Array) -> list[list[Regressors]]:
        """Derivatives (record) (output) of the outputs of a block by its numbers, a row each.

        here : differences of its plays over each record; slopes : (output, slope) of the plays
        """
        ends = []
        for change in STEP * np.eye(len(theta)):
            pairs = zip(self._columns(self.block_of(theta + change)), here, strict=True)
            ends.append([slopes @ (ahead.values - kept.values) / STEP for ahead, kept in pairs])
        return [
            [
                Regressors(np.array([end[i][o] for end in ends]), np.zeros(len(theta)))
                for o in range(len(slopes))
            ]
            for i in range(len(self.task.records))
        ]


def _differences(block: RateDependent, record: Record, start: Start) -> Regressors:
    """Differences of neighbouring plays over a record, and before it."""
    before = path_before(record, start)[:, -1]
    values, held = (
        differences(u, block.inputs, record.sample_time_s, start, before)
        for u in (record.u_v, before[:, None])
    )
    return Regressors(values, held[:, 0])


def _within(one: AxisTask, free: Array) -> AxisTask:
    """The task with the columns of directions alone."""
    return replace(one, kept=tuple(Regressors(free.T @ c.values, free.T @ c.held) for c in one.kept))


def _moments(one: AxisTask, x: Array) -> Moments:
    """Moments of the columns behind the axis."""
    return one.moments(lambda time: [SideBySide(one.path(x, time), one.columns)], one.columns)


def _first(moments: Moments, n: int) -> Moments:
    """Moments of the first n columns alone."""
    means = moments.means[:, [*range(n), -1]]
    return Moments(moments.gram[:n, :n], moments.cross[:n], moments.power, moments.samples, means)


def _derived(one: AxisTask, x: Array, slopes: Array) -> Moments:
    """Moments of the columns behind the axis, then of the derivatives of the output by its parameters."""
    whole = one.columns
    padded = np.append(slopes, np.zeros(whole - len(slopes)))

    def filters(time: float) -> list[Filter]:
        more = [one.derivatives(x, padded, time)] if len(x) else []
        return [SideBySide(one.path(x, time), whole), *more]

    return one.moments(filters, whole + len(x))


def _linearised(moments: Moments, slopes: Array, free: Array) -> tuple[Array, Array]:
    """Normal equations of a change of block and axis with the free directions of the slopes eliminated.

    The columns are those of the slopes, then the derivatives by the numbers of block and axis.
    """
    n = len(slopes)
    gram, mixed, cross = moments.gram[:n, :n], moments.gram[:n, n:], moments.cross[:, 0]
    drag = free @ coefficients(free.T @ gram @ free, free.T @ mixed)
    return moments.gram[n:, n:] - mixed.T @ drag, cross[n:] - mixed.T @ slopes

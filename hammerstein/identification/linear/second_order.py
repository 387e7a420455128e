"""Resonance, damping, creep and delay of each axis, found together with the static block.

Once the linear block is fixed, the slopes c of the static block enter linearly,

    y = offset + G(x) S c,     x = (ln f, ln z, g_1, ln T_1, ...)

with S the differences of plays and G the axis with its sensor. Each step solves the linearised problem for
new slopes and a change of x together,

    y ~ offset + G(x) S c' + sum over i of dx_i (dG/dx_i) S c

which is the Gauss-Newton step of the separable problem (Golub and Pereyra, Inverse Problems 19 (2003) R1),
damped after Levenberg and Marquardt. The sums over the samples are gathered in one pass, so that the memory
does not grow with the record.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import AxesDynamics, Axis, LinearBlock
from hammerstein.identification.linear.axis_task import AxisTask, axis_of, duration_s
from hammerstein.identification.linear.delay import MOST_DELAY, shortest_delay
from hammerstein.identification.static.history import shortened
from hammerstein.identification.static.normal_equations import coefficients, squares_left
from hammerstein.identification.static.partition import thresholds_uniform_in_voltage
from hammerstein.identification.static.regressors import Filter, SideBySide, Start
from hammerstein.identification.static.static_block import half_swing
from hammerstein.records.record import Record

Array = NDArray[np.float64]
Progress = Callable[[str], None]

LARGEST_CHANGE = 0.5
SMALLEST_CHANGE = 1e-6
FIRST_DAMPING = 1e-3
MOST_STEPS = 25
ENOUGH = 1e-7
"""Relative gain of a step under which the search has arrived."""
TINY = 1e-300
WORSE_DELAYS = 2
CLEARLY_BETTER = 0.98
"""Part of the error under which another delay takes the place of the one found first."""
SEARCH_SAMPLES = 10_000
SEARCH_OPERATORS = 3
GUESS_SAMPLES = 30_000
GUESS_OPERATORS = 5
CREEP_OPERATORS = 6
SEARCH_DAMPING = 0.15
SEARCH_BEGINS = 3
SEARCH_RATIO = 1.3
"""Ratio of neighbouring frequencies tried: within reach of the Gauss-Newton steps."""


@dataclass(frozen=True)
class AxisFit:
    """One axis with what the records say about it.

    Parameters
    ----------
    axis : resonance, damping, creep
    resonance_error_percent, damping_error_percent : standard errors, in percent of the value
    creep_gain_errors : standard errors of the creep gains
    rms_um : rms of what is left [um]
    static_rms_um : the same without dynamics [um]
    """

    axis: Axis
    resonance_error_percent: float
    damping_error_percent: float
    creep_gain_errors: tuple[float, ...]
    rms_um: float
    static_rms_um: float


@dataclass(frozen=True, eq=False)
class Point:
    """The search at one place: parameters, best slopes there, and the problem linearised about them.

    ``curvature`` and ``pull`` are the normal equations of a change of x with the slopes eliminated, and
    ``drag`` (slope, parameter) is how the slopes follow such a change.
    """

    x: Array
    slopes: Array
    rms: float
    curvature: Array
    pull: Array
    drag: Array

    def step(self, damping: float) -> Array:
        """Change of the parameters (Levenberg-Marquardt)."""
        scale = np.sqrt(np.maximum(np.diag(self.curvature), np.finfo(float).tiny))
        scaled = self.curvature / np.outer(scale, scale) + damping * np.eye(len(scale))
        change = np.linalg.lstsq(scaled, self.pull / scale, rcond=1e-12)[0] / scale
        return np.asarray(np.clip(change, -LARGEST_CHANGE, LARGEST_CHANGE))

    @property
    def errors(self) -> Array:
        """Standard errors of the parameters, for independent errors."""
        spread = np.linalg.pinv(self.curvature, rcond=1e-14, hermitian=True)
        return np.asarray(self.rms * np.sqrt(np.maximum(np.diag(spread), 0.0)))


def refine(task: AxisTask, x: Array) -> Point:
    """Levenberg-Marquardt steps from x until nothing is gained."""
    lower, upper = task.limits
    begin = np.clip(x, lower, upper)
    here = _point(task, begin, _alone(task, partial(task.path, begin))[0])
    damping = FIRST_DAMPING
    for _ in range(MOST_STEPS):
        x = np.clip(here.x + here.step(damping), lower, upper)
        there = _point(task, x, here.slopes - here.drag @ (x - here.x))
        if there.rms < here.rms:
            arrived = there.rms >= here.rms * (1.0 - ENOUGH)
            here, damping = there, 0.1 * damping
        else:
            arrived = bool(np.abs(x - here.x).max() < SMALLEST_CHANGE)
            damping *= 10.0
        if arrived:
            break
    return here


def _alone(task: AxisTask, path: Callable[[float], LinearBlock]) -> tuple[Array, float]:
    """Slopes behind a fixed path, and the rms of what is left."""
    moments = task.moments(lambda time: [SideBySide(path(time), task.columns)], task.columns)
    cross = moments.cross[:, 0]
    slopes = coefficients(moments.gram, cross)
    left = squares_left(moments.gram, cross, float(moments.power[0]), slopes)
    return slopes, math.sqrt(left / max(moments.freedom, 1))


def _point(task: AxisTask, x: Array, slopes: Array) -> Point:
    """Best slopes at x, and the Gauss-Newton step from slopes that were best near by."""
    n, q = task.columns, len(x)

    def filters(time: float) -> list[Filter]:
        return [SideBySide(task.path(x, time), n), task.derivatives(x, slopes, time)]

    moments = task.moments(filters, n + q)
    cross = moments.cross[:, 0]
    gram, mixed = moments.gram[:n, :n], moments.gram[:n, n:]
    both = coefficients(gram, np.column_stack([cross[:n], mixed]))
    slopes, drag = both[:, 0], both[:, 1:]
    left = squares_left(gram, cross[:n], float(moments.power[0]), slopes)
    return Point(
        x=x,
        slopes=slopes,
        rms=math.sqrt(left / max(moments.freedom, 1)),
        curvature=moments.gram[n:, n:] - mixed.T @ drag,
        pull=cross[n:] - mixed.T @ slopes,
        drag=drag,
    )


def search(task: AxisTask) -> Array:
    """Resonance and damping near the best ones, from a coarse grid over all that the records can show."""
    lower, upper = task.limits
    frequencies = np.arange(math.log(10.0) + lower[0], upper[0], math.log(SEARCH_RATIO))
    grid = [np.array([f, math.log(SEARCH_DAMPING)]) for f in frequencies]
    errors = [_alone(task, partial(task.path, x))[1] for x in grid]
    begins = [grid[int(i)] for i in np.argsort(errors, kind="stable")[:SEARCH_BEGINS]]
    return min((refine(task, x) for x in begins), key=lambda point: point.rms).x


def fit_axis(task: AxisTask, begin: Array) -> AxisFit:
    """Fit one axis from parameters near the best ones."""
    x = np.concatenate([begin[:2], _first_creep(task)])
    if task.creep_modes and task.columns > len(task.grids):
        reach = half_swing(task.records)
        coarse = tuple(thresholds_uniform_in_voltage(r, CREEP_OPERATORS) for r in reach)
        x = refine(replace(task, grids=coarse), x).x  # many steps, each of them cheaper
    point = refine(task, x)
    percent = 100.0 * point.errors
    return AxisFit(
        axis=axis_of(point.x),
        resonance_error_percent=float(percent[0]),
        damping_error_percent=float(percent[1]),
        creep_gain_errors=tuple(point.errors[2::2].tolist()),
        rms_um=point.rms,
        static_rms_um=_alone(task, task.sensor)[1],
    )


def _first_creep(task: AxisTask) -> Array:
    """Gains and time constants to begin with: spread over what the longest record shows of slow modes."""
    span = duration_s(task.records)
    times = span * np.geomspace(0.02, 0.5, task.creep_modes + 2)[1:-1]
    return np.column_stack([np.full(len(times), 0.02), np.log(times)]).ravel()


@dataclass(frozen=True, eq=False)
class FirstGuess:
    """Resonances near the best ones, found quickly.

    Parameters
    ----------
    parameters : (output, 2) ln resonance and ln damping
    delay_samples : whole samples by which the outputs come late
    delay_rms_um : (delay, output) rms of what is left for every delay tried; empty if it was given
    """

    parameters: Array
    delay_samples: int
    delay_rms_um: Array

    def dynamics(self) -> AxesDynamics:
        """Give the axes, without delay."""
        return AxesDynamics(axes=tuple(axis_of(x) for x in self.parameters))

    @property
    def settle_s(self) -> float:
        """Time in which the slowest axis rings down to a thousandth [s]."""
        decay = 2.0 * math.pi * np.exp(self.parameters.sum(axis=1))
        return math.log(1e3) / float(decay.min())


def search_axes(
    records: Sequence[Record],
    starts: Sequence[Start],
    *,
    delay_samples: int | None = 0,
    most_delay: int = MOST_DELAY,
    sensor_bandwidth_hz: float | None = None,
    progress: Progress | None = None,
) -> FirstGuess:
    """Resonance and damping of every axis, and the delay, from the beginnings of the records.

    Parameters
    ----------
    records : all with the same axes
    starts : what went before each record
    delay_samples : whole samples by which the outputs come late; None: found, up to ``most_delay``, if all
        records have one sample time
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz], from its data sheet; none if not given
    progress : told what is being done
    """
    tell = progress or (lambda _: None)
    delay = delay_samples or 0

    def task(output: int, samples: int, operators: int) -> AxisTask:
        quick, begun = shortened(records, starts, samples)
        grids = tuple(thresholds_uniform_in_voltage(reach, operators) for reach in half_swing(quick))
        return AxisTask(quick, begun, grids, output, 0, delay, sensor_bandwidth_hz)

    names = records[0].outputs
    tasks = [task(o, GUESS_SAMPLES, GUESS_OPERATORS) for o in range(len(names))]
    begins = []
    for o, name in enumerate(names):
        tell(f"searching the resonance of {name}")
        begins.append(refine(tasks[o], search(task(o, SEARCH_SAMPLES, SEARCH_OPERATORS))).x)
    if delay_samples is not None or len({record.sample_time_s for record in records}) > 1:
        return FirstGuess(np.array(begins), delay, np.empty((0, len(tasks))))
    tell("searching the delay")
    points = _delay_search(tasks, begins, most_delay)
    rms = np.array([[point.rms for point in row] for row in points])
    found = shortest_delay(rms)
    return FirstGuess(np.array([point.x for point in points[found]]), found, rms)


def _delay_search(tasks: Sequence[AxisTask], begins: Sequence[Array], most_delay: int) -> list[list[Point]]:
    """Axes fitted anew for each delay, until two longer ones in a row are worse than the best."""
    points: list[list[Point]] = []
    errors: list[float] = []
    for d in range(most_delay + 1):
        points.append(
            [refine(replace(task, delay_samples=d), x) for task, x in zip(tasks, begins, strict=True)]
        )
        first = [point.rms for point in points[0]]
        errors.append(sum(point.rms / max(rms, TINY) for point, rms in zip(points[-1], first, strict=True)))
        if d - int(np.argmin(errors)) >= WORSE_DELAYS:
            break
    return points


def checked_delay(
    records: Sequence[Record],
    starts: Sequence[Start],
    grids: Sequence[Array],
    guess: FirstGuess,
    *,
    sensor_bandwidth_hz: float | None = None,
) -> FirstGuess:
    """Guess with the delay that is best with all thresholds; the guess itself if that is the one it has.

    The few thresholds of the search smooth the hysteresis, which looks like a delay of a sample or so.

    Parameters
    ----------
    records, starts : as for the search
    grids : thresholds of each input [V]
    guess : what the search has found; nothing is done if the delay was given
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz], from its data sheet; none if not given
    """
    if not len(guess.delay_rms_um):
        return guess
    quick, begun = shortened(records, starts, GUESS_SAMPLES)

    def points(delay: int, begins: Array) -> list[Point]:
        tasks = [
            AxisTask(quick, begun, tuple(grids), o, 0, delay, sensor_bandwidth_hz) for o in range(len(begins))
        ]
        return [refine(task, x) for task, x in zip(tasks, begins, strict=True)]

    here, delay = points(guess.delay_samples, guess.parameters), guess.delay_samples
    for step in (-1, 1):
        while 0 <= delay + step <= MOST_DELAY:
            there = points(delay + step, np.array([point.x for point in here]))
            ratios = [new.rms / max(old.rms, TINY) for new, old in zip(there, here, strict=True)]
            if math.prod(ratios) >= CLEARLY_BETTER ** len(ratios):
                break
            here, delay = there, delay + step
    if delay == guess.delay_samples:
        return guess
    return replace(guess, parameters=np.array([point.x for point in here]), delay_samples=delay)


@dataclass(frozen=True, eq=False)
class AxesFit:
    """Second-order dynamics of all axes and the delay of the inputs."""

    axes: tuple[AxisFit, ...]
    delay_samples: int

    def dynamics(self, sample_time_s: float) -> AxesDynamics:
        """Give the linear block of the model."""
        axes = tuple(fit.axis for fit in self.axes)
        return AxesDynamics(axes=axes, input_delay_s=self.delay_samples * sample_time_s)


def fit_axes(
    records: Sequence[Record],
    grids: Sequence[Array],
    starts: Sequence[Start],
    guess: FirstGuess,
    *,
    creep_modes: int = 0,
    sensor_bandwidth_hz: float | None = None,
    progress: Progress | None = None,
) -> AxesFit:
    """Resonance, damping and creep of every axis, each with its own static block in front.

    Parameters
    ----------
    records : all with the same axes; sample times may differ where there is no delay
    grids : thresholds of each input [V]
    starts : what went before each record
    guess : where to begin
    creep_modes : slow modes of each axis
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz]
    progress : told what is being done
    """
    tell = progress or (lambda _: None)
    fits = []
    for o, begin in enumerate(guess.parameters):
        tell(f"fitting the axis {records[0].outputs[o]}")
        task = AxisTask(
            tuple(records),
            tuple(starts),
            tuple(grids),
            o,
            creep_modes,
            guess.delay_samples,
            sensor_bandwidth_hz,
        )
        fits.append(fit_axis(task, begin))
    return AxesFit(tuple(fits), guess.delay_samples)

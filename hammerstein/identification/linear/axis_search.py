"""First guesses of resonance, lag, creep and delay of each axis.

Steps of the search for resonance, damping, lag and creep of an axis, together with the static block.

Once the linear block is fixed, the slopes c of the static block enter linearly,

    y = offset + G(x) S c,     x = (ln f, ln z, g_1, ln T_1, ...)

with S the differences of plays and G the axis with its sensor. Each step solves the linearised problem for
new slopes and a change of x together,

    y ~ offset + G(x) S c' + sum over i of dx_i (dG/dx_i) S c

which is the Gauss-Newton step of the separable problem (Golub and Pereyra, Inverse Problems 19 (2003) R1),
damped after Levenberg and Marquardt. The sums over the samples are gathered in one pass, so that the memory
does not grow with the record.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, LinearBlock
from hammerstein.identification.linear.axis_task import (
    AxisShape,
    AxisTask,
    ByColumn,
    OfSum,
    axis_of,
    duration_s,
)
from hammerstein.identification.linear.delay import best_delay
from hammerstein.identification.operators import input_grids
from hammerstein.identification.score import SensorModel
from hammerstein.identification.static.damped_search import Damping, damped_change, steps
from hammerstein.identification.static.initial_state import most_dynamic_segment
from hammerstein.identification.static.normal_equations import coefficients, squares_left
from hammerstein.identification.static.regressors import InitialState, SideBySide
from hammerstein.records.record import Record

SMALLEST_CHANGE = 1e-6  # of a logarithm, below which a search stands
MOST_STEPS = 25  # a search that has not arrived is given up
ENOUGH = 1e-7
"""Relative gain of a step below which the search has converged."""
ROUGHLY = 1e-5
"""The same where places are compared that are refined further afterwards."""


@dataclass(frozen=True, eq=False)
class Point:
    """State of a search: parameters, their best slopes, and the linearised problem.

    ``curvature`` and ``pull`` are the normal equations of a change of x with the slopes eliminated, and
    ``drag`` (slope, parameter) is how the slopes follow such a change.
    """

    x: Array
    slopes: Array
    rms: float
    curvature: Array
    pull: Array
    drag: Array

    @property
    def errors(self) -> Array:
        """Standard errors of the parameters, for independent errors."""
        spread = np.linalg.pinv(self.curvature, rcond=1e-14, hermitian=True)
        return np.asarray(self.rms * np.sqrt(np.maximum(np.diag(spread), 0.0)))


def refine(task: AxisTask, x: Array, enough: float = ENOUGH) -> Point:
    """Levenberg-Marquardt steps from x until a step gains less than ``enough`` of the error."""
    *_, here = refined(task, x, enough)
    return here


def refined(task: AxisTask, x: Array, enough: float = ENOUGH) -> Iterator[Point]:
    """Best point after each step of ``refine``; the caller may stop early."""
    lower, upper = task.limits
    begin = np.clip(x, lower, upper)
    here = _point(task, begin, fit_slopes(task, partial(task.path, begin))[0])
    yield here

    def step(here: Point, damping: float) -> Point:
        x = np.clip(here.x + damped_change(here.curvature, here.pull, damping), lower, upper)
        return _point(task, x, here.slopes - here.drag @ (x - here.x))

    for tried in islice(steps(here, step, lambda point: point.rms, Damping()), MOST_STEPS):
        before, there = tried.before, tried.there
        yield tried.best
        if tried.gained and there.rms >= before.rms * (1.0 - enough):
            break
        if not tried.gained and np.abs(there.x - before.x).max() < SMALLEST_CHANGE:
            break


def rms_behind(task: AxisTask, x: Array) -> float:
    """Rms error with given parameters and their best slopes [um]."""
    return fit_slopes(task, partial(task.path, x))[1]


def fit_slopes(task: AxisTask, path: Callable[[float], LinearBlock]) -> tuple[Array, float]:
    """Slopes behind a fixed path, and the rms error."""
    moments = task.moments(lambda time: [SideBySide(path(time))], task.columns)
    cross = moments.cross[:, 0]
    slopes = coefficients(moments.gram, cross)
    left = squares_left(moments.gram, cross, float(moments.power[0]), slopes)
    return slopes, math.sqrt(left / max(moments.freedom, 1))


def _point(task: AxisTask, x: Array, slopes: Array) -> Point:
    """Best slopes at x, and the Gauss-Newton step from slopes that were best near by."""
    n, q = task.columns, len(x)

    def filters(time: float) -> list[ByColumn]:
        moved = task.derivatives(x, slopes, time)
        return [SideBySide(moved.paths[0]), moved]

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


def residuals(task: AxisTask, path: Callable[[float], LinearBlock], slopes: Array) -> list[Array]:
    """Residual of each record (sample,) with the best slopes behind a path, about its mean [um]."""
    left = []
    for i, (record, start) in enumerate(zip(task.records, task.starts, strict=True)):
        filters = [OfSum(slopes, path(record.sample_time_s))]
        said = [x[0] for _, x in task.blocks(i, filters)]
        error = record.y_um[task.output, start.first :] - np.concatenate(said)
        left.append(np.asarray(error - error.mean()))
    return left


Progress = Callable[[str], None]

GUESS_SAMPLES = 60_000  # of the liveliest part, for the first guess
GUESS_OPERATORS = 20  # of the hysteresis beside that guess
SEARCH_TURNS = 2
"""Number of repeated fits of the hysteresis with the axis found so far."""
COUNTED_SAMPLES = 15_000
"""Samples that are counted in the sums of a search; more than so many are thinned out evenly."""
SEARCH_BEGINS = 3  # best places from which a search starts
TRIED, FAR = 4, 1.5
"""Steps after which a search is abandoned if its error exceeds this multiple of the best one."""
SAME_DAMPING, SAME_ERROR = 0.2, 1e-3
"""Logarithm of a ratio of dampings, and part of the error, within which two searches are at one place."""
PEAK_DAMPING = 0.03  # of a peak that the residual shows
LEAST_WINDOW, WINDOW = 256, 4096  # samples of a spectrum
PROMINENT = 0.7
"""Logarithm of the ratio by which an amplitude must stand out."""
LAG_SAMPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Time constants of a low-pass to begin with, in samples."""
CREEP_SPANS = (0.03, 0.3)
"""Time constants of a creep mode to begin with, in parts of the longest record."""
SEARCH_GRID = 1.3, 0.15
"""Ratio of neighbouring frequencies tried, and their damping: within reach of the Gauss-Newton steps."""


@dataclass(frozen=True, eq=False)
class FirstGuess:
    """Axes near the best ones, found quickly.

    Parameters
    ----------
    shapes : what each axis consists of
    parameters : of each axis, see ``AxisShape``
    delay_samples : samples by which the outputs come late
    free_delay : whether that was found, not given
    """

    shapes: tuple[AxisShape, ...]
    parameters: tuple[Array, ...]
    delay_samples: float
    free_delay: bool = False

    def dynamics(self) -> AxesDynamics:
        """Return the axes, without delay."""
        return AxesDynamics(axes=tuple(map(axis_of, self.shapes, self.parameters)))


def search_axes(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    *,
    delay_samples: int | None = 0,
    sensor: SensorModel | None = None,
    lag: bool = False,
    resonance: bool = True,
    progress: Progress | None = None,
) -> FirstGuess:
    """Resonance, damping and lag of every axis, and the delay, from the first parts of the records.

    Parameters
    ----------
    records : all with the same axes
    starts : initial state of each record
    delay_samples : whole samples by which the outputs come late; None: found, if all records have one sample
        time
    sensor : model of the sensor; ideal if not given
    lag, resonance : what each axis consists of
    progress : called with the current step
    """
    tell = progress or (lambda _: None)

    quick, begun = most_dynamic_segment(records, starts, GUESS_SAMPLES)
    every = thinning(quick)
    plays = tuple(input_grids(quick, GUESS_OPERATORS, "voltage"))
    tasks, begins = [], []
    for o, name in enumerate(records[0].outputs):
        tell(f"searching the {'resonance' if resonance else 'lag'} of {name}")
        shape = AxisShape(resonance, lag)
        full = AxisTask(quick, begun, plays, o, shape, delay_samples or 0, sensor or SensorModel(), every)
        task, x = _searched(full)
        tasks.append(task)
        begins.append(x)
    shapes = tuple(one.shape for one in tasks)
    if delay_samples is not None or len({record.sample_time_s for record in records}) > 1:
        return FirstGuess(shapes, tuple(begins), delay_samples or 0)
    tell("estimating the delay")
    delay, found = best_delay(partial(refined_late, tasks), begins)
    return FirstGuess(shapes, tuple(found), delay, free_delay=True)


def refined_late(
    tasks: Sequence[AxisTask], delay: float, begins: Sequence[Array], enough: float = ROUGHLY
) -> tuple[list[float], list[Array]]:
    """Prediction error of each output with a delay, and the parameters of its axis near given ones."""
    late = [replace(task, delay_samples=delay) for task in tasks]
    points = [refine(task, x, enough) for task, x in zip(late, begins, strict=True)]
    return [point.rms for point in points], [point.x for point in points]


def checked_delay(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    grids: Sequence[Array],
    guess: FirstGuess,
    *,
    sensor: SensorModel | None = None,
) -> FirstGuess:
    """Guess with the best delay for all thresholds, to a fraction of a sample; a given delay is kept.

    The few thresholds of the search smooth the hysteresis, which looks like a delay of about a sample.

    Parameters
    ----------
    records, starts : as for the search
    grids : thresholds of each input [V]
    guess : result of the search
    sensor : model of the sensor; ideal if not given
    """
    if not guess.free_delay:
        return guess
    quick, begun = most_dynamic_segment(records, starts, GUESS_SAMPLES)
    every, delay = thinning(quick), guess.delay_samples
    tasks = [
        AxisTask(quick, begun, tuple(grids), o, shape, delay, sensor or SensorModel(), every)
        for o, shape in enumerate(guess.shapes)
    ]
    best, found = best_delay(partial(refined_late, tasks), list(guess.parameters), first=delay, parts=True)
    return guess if best == delay else replace(guess, parameters=tuple(found), delay_samples=best)


def _searched(full: AxisTask) -> tuple[AxisTask, Array]:
    """Axis near the best one, and the task with few columns that it was found with."""
    shape = full.shape
    task = full.mixed(fit_slopes(full, full.sensor_path)[0])
    x = np.empty(0)
    for turn in range(SEARCH_TURNS):
        if shape.resonance:
            ringing = replace(task, shape=AxisShape())
            judged = replace(full, shape=ringing.shape)
            x = refine(ringing, x[:2]).x if turn else search(ringing, judged)
        if shape.lag:
            x = search_lag(task, x[: 2 * shape.resonance]).x
        task = full.mixed(fit_slopes(full, partial(full.path, x))[0])
    return task, refine(task, x).x


def thinning(records: Sequence[Record]) -> int:
    """Stride of the samples in the sums of a search."""
    return max(sum(record.samples for record in records) // COUNTED_SAMPLES, 1)


def search(task: AxisTask, judged: AxisTask) -> Array:
    """Resonance and damping near the best ones.

    The search begins at the best points of a coarse grid over all values that the records can show, and at
    frequencies where the error of a static block stands out. ``judged`` has all columns: with the few columns
    of ``task``, an axis could hide an error that thresholds can remove.
    """
    lower, upper = task.limits
    grid = resonances(lower, upper)
    errors = [rms_behind(task, x) for x in grid]
    begins = [grid[int(i)] for i in np.argsort(errors, kind="stable")[:SEARCH_BEGINS]]
    begins += [np.log([f, PEAK_DAMPING]) for f in ringing_hz(task) if lower[0] < math.log(f) < upper[0]]
    found = [point.x for point in _arrived(task, begins)]
    return min(found, key=lambda x: rms_behind(judged, x)) if len(found) > 1 else found[0]


def resonances(lower: Array, upper: Array) -> list[Array]:
    """Coarse grid of resonances (ln frequency, ln damping) between the limits of their frequency."""
    ratio, damping = SEARCH_GRID
    frequencies = np.arange(math.log(10.0) + lower[0], upper[0], math.log(ratio))
    return [np.array([f, math.log(damping)]) for f in frequencies]


def _arrived(task: AxisTask, begins: Sequence[Array]) -> list[Point]:
    """Where the searches for a resonance arrive, each place once.

    One is given up where it comes to what an earlier one has found, or where it is still far from the best.
    """
    found: list[Point] = []
    for x in begins:
        reach = FAR * min((point.rms for point in found), default=math.inf)
        for number, here in enumerate(refined(task, x, ROUGHLY)):
            if any(_is_at(here, point) for point in found) or (number >= TRIED and here.rms > reach):
                break
        else:
            found.append(here)
    return found


def _is_at(here: Point, found: Point) -> bool:
    """Whether a search has come to a resonance that is known: nearer than half its width, with its error."""
    apart, half_width = np.abs(here.x - found.x), 0.5 * math.exp(found.x[1])
    near = apart[0] < half_width and apart[1] < SAME_DAMPING
    return bool(near and abs(here.rms - found.rms) < SAME_ERROR * found.rms)


def ringing_hz(task: AxisTask) -> list[float]:
    """Frequencies at which the error of a static block rises above its neighbourhood, clearest first."""
    from scipy.signal import find_peaks, welch

    slopes, _ = fit_slopes(task, task.sensor_path)
    found: list[tuple[float, float]] = []
    for record, left in zip(task.records, residuals(task, task.sensor_path, slopes), strict=True):
        if len(left) < 2 * LEAST_WINDOW:
            continue
        frequency_hz, power = welch(left, 1.0 / record.sample_time_s, nperseg=min(len(left), WINDOW))
        level = 0.5 * np.log(np.maximum(power[1:], np.finfo(float).tiny))
        peaks, shape = find_peaks(level, prominence=PROMINENT)
        found += [
            (-float(p), float(frequency_hz[1:][i])) for p, i in zip(shape["prominences"], peaks, strict=True)
        ]
    return [f for _, f in sorted(found)[:SEARCH_BEGINS]]


def search_creep(task: AxisTask, before: Array) -> Point:
    """One slow mode in addition to the parameters ``before``, and an approximate optimum of all."""
    span = duration_s(task.records)
    begins = [np.concatenate([before, [0.02, math.log(part * span)]]) for part in CREEP_SPANS]
    return min((refine(task, x) for x in begins), key=lambda point: point.rms)


def search_lag(task: AxisTask, before: Array) -> Point:
    """Approximate low-pass, with the parameters (ln frequency, ln damping) of a resonance if there is one."""
    times = np.log(min(r.sample_time_s for r in task.records) * np.array(LAG_SAMPLES))
    lower, upper = task.limits
    begins = [np.append(before, time) for time in times if lower[-1] <= time <= upper[-1]]
    errors = [rms_behind(task, x) for x in begins]
    return refine(task, begins[int(np.argmin(errors))])

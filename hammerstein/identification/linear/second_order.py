"""Resonance, damping, lag, creep and delay of each axis, found together with the static block.

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

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import AxesDynamics, Axis, LinearBlock
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask, Heard, axis_of, duration_s
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
GUESS_SAMPLES = 60_000
GUESS_OPERATORS = 20
SEARCH_TURNS = 2
"""How often the hysteresis that the axis is searched with is found anew, behind the axis found."""
COUNTED_SAMPLES = 15_000
"""Samples that are counted in the sums of a search; more than so many are thinned out evenly."""
CREEP_OPERATORS = 6
SEARCH_BEGINS = 3
PEAK_DAMPING = 0.03
LEAST_WINDOW, WINDOW = 256, 4096
PROMINENT = 0.7
"""Logarithm of the ratio by which an amplitude must stand out."""
LAG_SAMPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Time constants of a low-pass to begin with, in samples."""
CREEP_SPANS = (0.03, 0.3)
"""Time constants of a creep mode to begin with, in parts of the longest record."""
STRETCHES = 16
"""Stretches of a record within which errors may be related."""
NEAR = 1.15
"""Ratio of frequencies that belong to a resonance."""
EXCITED = 2.0
"""Amplitude near a resonance, in parts of what the model leaves there, from which it counts as excited."""
SEARCH_GRID, CLOSE_GRID = (1.3, 0.15), (1.06, 0.03)
"""Ratio of neighbouring frequencies tried, and their damping: within reach of the Gauss-Newton steps."""


@dataclass(frozen=True)
class AxisFit:
    """One axis with what the records say about it.

    Parameters
    ----------
    axis : resonance, damping, lag, creep
    resonance_error_percent, damping_error_percent : standard errors, in percent of the value; None without
        a resonance
    creep_gain_errors : standard errors of the creep gains
    rms_um : rms of what is left [um]
    static_rms_um : the same without dynamics [um]
    lag_error_percent : standard error of the time constant, in percent of it; None without a lag
    excited : whether the resonance shows in the records: the model has more power near it than it leaves
    """

    axis: Axis
    resonance_error_percent: float | None
    damping_error_percent: float | None
    creep_gain_errors: tuple[float, ...]
    rms_um: float
    static_rms_um: float
    lag_error_percent: float | None = None
    excited: bool = True


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


def refine(task: AxisTask, x: Array, enough: float = ENOUGH) -> Point:
    """Levenberg-Marquardt steps from x until a step gains less than ``enough`` of the error."""
    lower, upper = task.limits
    begin = np.clip(x, lower, upper)
    here = _point(task, begin, _alone(task, partial(task.path, begin))[0])
    damping = FIRST_DAMPING
    for _ in range(MOST_STEPS):
        x = np.clip(here.x + here.step(damping), lower, upper)
        there = _point(task, x, here.slopes - here.drag @ (x - here.x))
        if there.rms < here.rms:
            arrived = there.rms >= here.rms * (1.0 - enough)
            here, damping = there, 0.1 * damping
        else:
            arrived = bool(np.abs(x - here.x).max() < SMALLEST_CHANGE)
            damping *= 10.0
        if arrived:
            break
    return here


def rms_behind(task: AxisTask, x: Array) -> float:
    """Rms of what is left with given parameters and the best slopes [um]."""
    return _alone(task, partial(task.path, x))[1]


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


def search(task: AxisTask, judged: AxisTask, closely: bool = False) -> Array:
    """Resonance and damping near the best ones.

    Begun with the best places of a coarse grid over all that the records can show, and with the frequencies
    that stand out of what a static block leaves. ``closely`` adds a grid so fine that no resonance of little
    damping is missed. ``judged`` has all columns: the few of ``task`` hide what thresholds can make good.
    """
    lower, upper = task.limits
    begins: list[Array] = []
    for ratio, damping in (SEARCH_GRID, *((CLOSE_GRID,) if closely else ())):
        frequencies = np.arange(math.log(10.0) + lower[0], upper[0], math.log(ratio))
        grid = [np.array([f, math.log(damping)]) for f in frequencies]
        errors = [rms_behind(task, x) for x in grid]
        begins += [grid[int(i)] for i in np.argsort(errors, kind="stable")[:SEARCH_BEGINS]]
    begins += [np.log([f, PEAK_DAMPING]) for f in ringing_hz(task) if lower[0] < math.log(f) < upper[0]]
    found = [refine(task, x).x for x in begins]
    return min(found, key=lambda x: rms_behind(judged, x))


def ringing_hz(task: AxisTask) -> list[float]:
    """Frequencies at which what a static block leaves stands out of its neighbourhood, clearest first."""
    from scipy.signal import find_peaks, welch

    slopes, _ = _alone(task, task.sensor)
    found: list[tuple[float, float]] = []
    for record, left in zip(task.records, residuals(task, task.sensor, slopes), strict=True):
        if len(left) < 2 * LEAST_WINDOW:
            continue
        frequency_hz, power = welch(left, 1.0 / record.sample_time_s, nperseg=min(len(left), WINDOW))
        level = 0.5 * np.log(np.maximum(power[1:], np.finfo(float).tiny))
        peaks, shape = find_peaks(level, prominence=PROMINENT)
        found += [
            (-float(p), float(frequency_hz[1:][i])) for p, i in zip(shape["prominences"], peaks, strict=True)
        ]
    return [f for _, f in sorted(found)[:SEARCH_BEGINS]]


def residuals(task: AxisTask, path: Callable[[float], LinearBlock], slopes: Array) -> list[Array]:
    """What the slopes behind a path leave of each record (sample,), about its mean [um]."""
    left = []
    for i, (record, start) in enumerate(zip(task.records, task.starts, strict=True)):
        filters = [Heard(slopes, path(record.sample_time_s))]
        said = [x[0] for _, x in task.blocks(i, filters)]
        error = record.y_um[task.output, start.first :] - np.concatenate(said)
        left.append(np.asarray(error - error.mean()))
    return left


def search_creep(task: AxisTask, before: Array) -> Point:
    """One slow mode beside the parameters ``before``, and all of them near the best ones."""
    span = duration_s(task.records)
    begins = [np.concatenate([before, [0.02, math.log(part * span)]]) for part in CREEP_SPANS]
    return min((refine(task, x) for x in begins), key=lambda point: point.rms)


def search_lag(task: AxisTask, before: Array) -> Point:
    """Low-pass near the best one, beside the parameters (ln frequency, ln damping) of a resonance if any."""
    times = np.log(min(r.sample_time_s for r in task.records) * np.array(LAG_SAMPLES))
    lower, upper = task.limits
    begins = [np.append(before, time) for time in times if lower[-1] <= time <= upper[-1]]
    errors = [rms_behind(task, x) for x in begins]
    return refine(task, begins[int(np.argmin(errors))])


def fit_axis(task: AxisTask, begin: Array) -> AxisFit:
    """Fit one axis from parameters near the best ones; creep is begun anew if ``begin`` holds none."""
    shape = task.shape
    static = _alone(task, task.sensor)[1]
    x = begin if len(begin) == shape.parameters else np.concatenate([begin[: shape.slow], _first_creep(task)])
    if not shape.parameters:
        return AxisFit(Axis(), None, None, (), static, static)
    if shape.creep_modes and task.columns > len(task.grids):
        x = refine(
            replace(task, grids=_uniform(task.records, CREEP_OPERATORS)), x
        ).x  # many steps, each of them cheaper
    point = refine(task, x)
    errors = 100.0 * standard_errors(task, point)
    return AxisFit(
        axis=axis_of(shape, point.x),
        resonance_error_percent=float(errors[0]) if shape.resonance else None,
        damping_error_percent=float(errors[1]) if shape.resonance else None,
        creep_gain_errors=tuple((0.01 * errors[shape.slow :: 2]).tolist()),
        rms_um=point.rms,
        static_rms_um=static,
        lag_error_percent=float(errors[shape.slow - 1]) if shape.lag else None,
        excited=not shape.resonance or _excited(task, point),
    )


def _uniform(records: Sequence[Record], operators: int) -> tuple[Array, ...]:
    """Thresholds of each input, uniform in voltage; none for one that does not move."""
    reach = half_swing(records)
    return tuple(thresholds_uniform_in_voltage(r, operators) if r else np.empty(0) for r in reach)


def standard_errors(task: AxisTask, point: Point) -> Array:
    """Standard errors of the parameters, with what the model misses.

    The larger of two: for errors that are independent from sample to sample, and

        (H^-1 (sum over stretches of g g^T) H^-1)_ii,    g = sum over the stretch of psi e

    with the derivatives psi of the output behind the slopes, and H = psi^T psi: errors may be related
    within a stretch (White, Econometrica 48 (1980) 817-838; Liang and Zeger, Biometrika 73 (1986) 13-22).
    """
    n = task.columns
    inverse = np.linalg.pinv(point.curvature, rcond=1e-14, hermitian=True)
    spread = np.zeros_like(inverse)
    path = partial(task.path, point.x)
    left = residuals(task, path, point.slopes)
    for i, (record, error) in enumerate(zip(task.records, left, strict=True)):
        time = record.sample_time_s
        filters: list[Filter] = [
            SideBySide(path(time), n),
            task.derivatives(point.x, point.slopes, time),
        ]
        moves = np.hstack([x[n:] - point.drag.T @ x[:n] for _, x in task.blocks(i, filters)])
        moves -= moves.mean(axis=1, keepdims=True)
        ends = np.linspace(0, len(error), STRETCHES + 1).astype(int)
        scores = [moves[:, a:b] @ error[a:b] for a, b in itertools.pairwise(ends)]
        spread += np.sum([np.outer(g, g) for g in scores], axis=0)
    related = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
    return np.asarray(np.maximum(related, point.errors))


def _excited(task: AxisTask, point: Point) -> bool:
    """Whether the model has more power near its resonance than it leaves there."""
    path = partial(task.path, point.x)
    hz = math.exp(point.x[0])
    said = left = 0.0
    for record, error in zip(task.records, residuals(task, path, point.slopes), strict=True):
        read = record.y_um[task.output, -len(error) :]
        # Differences leave nothing of slow motion to leak into the band, and keep ringing at the very start.
        spectra = [np.fft.rfft(np.diff(x)) for x in (read - error, error)]
        frequency_hz = np.fft.rfftfreq(len(error) - 1, record.sample_time_s)
        near = (frequency_hz > hz / NEAR) & (frequency_hz < hz * NEAR)
        said += float(np.sum(np.abs(spectra[0][near]) ** 2))
        left += float(np.sum(np.abs(spectra[1][near]) ** 2))
    return said > EXCITED**2 * left


def _first_creep(task: AxisTask) -> Array:
    """Gains and time constants to begin with: spread over what the longest record shows of slow modes."""
    span = duration_s(task.records)
    times = span * np.geomspace(0.02, 0.5, task.shape.creep_modes + 2)[1:-1]
    return np.column_stack([np.full(len(times), 0.02), np.log(times)]).ravel()


@dataclass(frozen=True, eq=False)
class FirstGuess:
    """Axes near the best ones, found quickly.

    Parameters
    ----------
    shapes : what each axis consists of
    parameters : of each axis, see ``AxisShape``
    delay_samples : samples by which the outputs come late
    delay_rms_um : (delay, output) rms of what is left for every delay tried; empty if it was given
    """

    shapes: tuple[AxisShape, ...]
    parameters: tuple[Array, ...]
    delay_samples: float
    delay_rms_um: Array

    def dynamics(self) -> AxesDynamics:
        """Give the axes, without delay."""
        return AxesDynamics(axes=tuple(map(axis_of, self.shapes, self.parameters)))

    @property
    def settle_s(self) -> float:
        """Time in which the slowest axis rings down to a thousandth [s]."""
        rates = [2.0 * math.pi * math.exp(x[0] + x[1]) for s, x in self._each() if s.resonance]
        rates += [math.exp(-x[s.slow - 1]) for s, x in self._each() if s.lag]
        return math.log(1e3) / min(rates) if rates else 0.0

    def _each(self) -> list[tuple[AxisShape, Array]]:
        return list(zip(self.shapes, self.parameters, strict=True))


def search_axes(
    records: Sequence[Record],
    starts: Sequence[Start],
    *,
    grids: Sequence[Array] | None = None,
    delay_samples: int | None = 0,
    most_delay: int = MOST_DELAY,
    sensor_bandwidth_hz: float | None = None,
    lag: bool = False,
    resonance: bool = True,
    progress: Progress | None = None,
) -> FirstGuess:
    """Resonance, damping and lag of every axis, and the delay, from the beginnings of the records.

    Parameters
    ----------
    records : all with the same axes
    starts : what went before each record
    grids : thresholds of each input [V]; uniform in voltage if not given
    delay_samples : whole samples by which the outputs come late; None: found, up to ``most_delay``, if all
        records have one sample time
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz], from its data sheet; none if not given
    lag, resonance : what each axis consists of
    progress : told what is being done
    """
    tell = progress or (lambda _: None)

    quick, begun = shortened(records, starts, GUESS_SAMPLES)
    every = thinning(quick)
    plays = _uniform(quick, GUESS_OPERATORS) if grids is None else tuple(grids)
    tasks, begins = [], []
    for o, name in enumerate(records[0].outputs):
        tell(f"searching the {'resonance' if resonance else 'lag'} of {name}")
        shape = AxisShape(resonance, lag)
        full = AxisTask(quick, begun, plays, o, shape, delay_samples or 0, sensor_bandwidth_hz, every)
        task, x = _searched(full, closely=grids is not None)
        tasks.append(task)
        begins.append(x)
    shapes = tuple(one.shape for one in tasks)
    if delay_samples is not None or len({record.sample_time_s for record in records}) > 1:
        return FirstGuess(shapes, tuple(begins), delay_samples or 0, np.empty((0, len(tasks))))
    tell("searching the delay")
    points = _delay_search(tasks, begins, most_delay)
    rms = np.array([[point.rms for point in row] for row in points])
    found = shortest_delay(rms)
    return FirstGuess(shapes, tuple(point.x for point in points[found]), found, rms)


def _searched(full: AxisTask, closely: bool) -> tuple[AxisTask, Array]:
    """Axis near the best one, and the task with few columns that it was found with."""
    shape = full.shape
    task = full.mixed(_alone(full, full.sensor)[0])
    x = np.empty(0)
    for turn in range(SEARCH_TURNS):
        if shape.resonance:
            alone = replace(task, shape=AxisShape())
            x = refine(alone, x[:2]).x if turn else search(alone, replace(full, shape=alone.shape), closely)
        if shape.lag:
            x = search_lag(task, x[: 2 * shape.resonance]).x
        task = full.mixed(_alone(full, partial(full.path, x))[0])
    return task, refine(task, x).x


def thinning(records: Sequence[Record]) -> int:
    """Every how many samples are counted in the sums of a search."""
    return max(sum(record.samples for record in records) // COUNTED_SAMPLES, 1)


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


@dataclass(frozen=True, eq=False)
class AxesFit:
    """Dynamics of all axes and the delay of the inputs."""

    axes: tuple[AxisFit, ...]
    delay_samples: float

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
    creep_modes: int | None = 0,
    sensor_bandwidth_hz: float | None = None,
    every: int = 1,
    progress: Progress | None = None,
) -> AxesFit:
    """Parameters of every axis, each with its own static block in front.

    Parameters
    ----------
    records : all with the same axes; sample times may differ where there is no delay
    grids : thresholds of each input [V]
    starts : what went before each record
    guess : where to begin
    creep_modes : slow modes of each axis; None: as many as the guess has
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz]
    every : samples of which one is counted in the sums
    progress : told what is being done
    """
    tell = progress or (lambda _: None)
    fits = []
    for o, (shape, begin) in enumerate(zip(guess.shapes, guess.parameters, strict=True)):
        tell(f"fitting the axis {records[0].outputs[o]}")
        task = AxisTask(
            tuple(records),
            tuple(starts),
            tuple(grids),
            o,
            shape if creep_modes is None else replace(shape, creep_modes=creep_modes),
            guess.delay_samples,
            sensor_bandwidth_hz,
            every,
        )
        fits.append(fit_axis(task, begin))
    return AxesFit(tuple(fits), guess.delay_samples)


def parameters_of(axis: Axis) -> tuple[AxisShape, Array]:
    """Shape and parameters of an axis, creep included."""
    x: list[float] = []
    if axis.resonance_hz is not None and axis.damping_ratio is not None:
        x += [math.log(axis.resonance_hz), math.log(axis.damping_ratio)]
    if axis.lag_s is not None:
        x.append(math.log(axis.lag_s))
    for mode in axis.creep:
        x += [mode.gain, math.log(mode.time_constant_s)]
    shape = AxisShape(axis.resonance_hz is not None, axis.lag_s is not None, len(axis.creep))
    return shape, np.array(x)

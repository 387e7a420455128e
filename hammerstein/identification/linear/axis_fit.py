"""Resonance, damping, lag and creep of each axis from records, with standard errors.

They are found together with the static block. Once the linear block is fixed, its slopes c enter linearly,

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
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import Axis, LinearBlock
from hammerstein.identification.excitation import drive_hz, lowest_hz, several_rates
from hammerstein.identification.linear.axis_task import (
    AxisShape,
    AxisTask,
    ByColumn,
    OfSum,
    axis_of,
)
from hammerstein.identification.model_selection import FELT, IMPROVED, lowers
from hammerstein.identification.search import Damping, damped_change, steps
from hammerstein.identification.static.normal_equations import coefficients, squares_left
from hammerstein.identification.static.regressors import Filter, SideBySide
from hammerstein.identification.static.static_block import input_grids
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


COUNTED_SAMPLES = 15_000
"""Samples that are counted in the sums of a search; more than so many are thinned out evenly."""
SEARCH_BEGINS = 3  # best places from which a search starts
TRIED, FAR = 4, 1.5
"""Steps after which a search is abandoned if its error exceeds this multiple of the best one."""
SAME, SAME_ERROR = 0.2, 1e-3
"""Change of a parameter, and part of the error, within which two searches are at one place."""
PEAK_DAMPING = 0.03  # of a peak that the residual shows
LEAST_WINDOW, WINDOW = 256, 4096  # samples of a spectrum
PROMINENT = 0.7
"""Logarithm of the ratio by which an amplitude must stand out."""
LAG_SAMPLES = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
"""Time constants of a low-pass to begin with, in samples."""
CREEP_SPANS = (0.003, 0.03, 0.3)
"""Time constants of a creep mode to begin with, in parts of the longest record."""
SEARCH_GRID = 1.3, 0.15
"""Ratio of neighbouring frequencies tried, and their damping: within reach of the Gauss-Newton steps."""


def refined_late(
    tasks: Sequence[AxisTask], delay: float, begins: Sequence[Array], enough: float = ROUGHLY
) -> tuple[list[float], list[Array]]:
    """Prediction error of each output with a delay, and the parameters of its axis near given ones."""
    late = [replace(task, delay_samples=delay) for task in tasks]
    points = [refine(task, x, enough) if len(x) else None for task, x in zip(late, begins, strict=True)]
    each = list(zip(late, begins, points, strict=True))
    rms = [point.rms if point else rms_behind(task, x) for task, x, point in each]
    return rms, [point.x if point else x for _, x, point in each]


def thinning(records: Sequence[Record]) -> int:
    """Stride of the samples in the sums of a search."""
    return max(sum(record.samples for record in records) // COUNTED_SAMPLES, 1)


def resonances(lower: Array, upper: Array) -> list[Array]:
    """Coarse grid of resonances (ln frequency, ln damping) between the limits of their frequency."""
    ratio, damping = SEARCH_GRID
    frequencies = np.arange(math.log(10.0) + lower[0], upper[0], math.log(ratio))
    return [np.array([f, math.log(damping)]) for f in frequencies]


def arrived(near: Callable[[Array], AxisTask], begins: Sequence[Array], enough: float) -> list[Point]:
    """Where searches arrive, each place once; ``near`` gives the task of a search from where it begins.

    One is given up where it comes to what an earlier one has found, or where it is still far from the best.
    """
    found: list[Point] = []
    for x in begins:
        reach = FAR * min((point.rms for point in found), default=math.inf)
        task = near(x)
        for number, here in enumerate(refined(task, x, enough)):
            known = any(_is_at(task.shape, here, point) for point in found)
            if known or (number >= TRIED and here.rms > reach):
                break
        else:
            found.append(here)
    return found


def _is_at(shape: AxisShape, here: Point, found: Point) -> bool:
    """Whether a search has come to a place that is known, to a resonance nearer than half its width."""
    apart = np.abs(here.x - found.x)
    reach = min(SAME, 0.5 * math.exp(found.x[1])) if shape.resonance else SAME
    near = apart[0] < reach and apart.max() < SAME
    return bool(near and abs(here.rms - found.rms) < SAME_ERROR * found.rms)


def ringing_hz(task: AxisTask, x: Array) -> list[float]:
    """Frequencies at which the error of an axis rises above its neighbourhood, clearest first."""
    from scipy.signal import find_peaks, welch

    path = partial(task.path, x)
    slopes, _ = fit_slopes(task, path)
    found: list[tuple[float, float]] = []
    for record, left in zip(task.records, residuals(task, path, slopes), strict=True):
        if len(left) < 2 * LEAST_WINDOW:
            continue
        frequency_hz, power = welch(left, 1.0 / record.sample_time_s, nperseg=min(len(left), WINDOW))
        level = 0.5 * np.log(np.maximum(power[1:], np.finfo(float).tiny))
        peaks, shape = find_peaks(level, prominence=PROMINENT)
        found += [
            (-float(p), float(frequency_hz[1:][i])) for p, i in zip(shape["prominences"], peaks, strict=True)
        ]
    return [f for _, f in sorted(found)[:SEARCH_BEGINS]]


UNSURE_PERCENT = 5.0  # standard error of a resonance from which the records do not identify it
UNSURE_LAG_PERCENT = 30.0  # the same of a low-pass
APART = 2.0
"""Ratio of the time constants of two slow modes from which they are two."""
SURE_CREEP = 3.0
"""Significance, in standard errors, that the gain of a creep mode needs unless it is requested."""
CREEP_OPERATORS = 6  # few: creep is slower than any loop
FEW = 40
"""Columns with which a fit begins where more are kept: those of the largest power, which come last."""
PARTS = 16
"""Parts of a record within which residuals may be correlated."""
NEAR = 1.15
"""Ratio of frequencies that belong to a resonance."""
SETTLED_CYCLES = 4.0
"""Cycles of a record from which its spectrum has lines."""
EXCITED = 2.0
"""Amplitude near a resonance, relative to the residual there, from which it counts as excited."""


@dataclass(frozen=True)
class AxisFit:
    """One axis and the accuracy of its parameters.

    Parameters
    ----------
    axis : resonance, damping, lag, creep
    resonance_error_percent, damping_error_percent : standard errors, in percent of the value; None without a
        resonance
    creep_gain_errors : standard errors of the creep gains
    rms_um : rms of the prediction error [um]
    static_rms_um : the same without dynamics [um]
    lag_error_percent : standard error of the time constant, in percent of it; None without a lag
    excited : whether the records excite the resonance: near it, the model has more power than its error
    one_rate : whether hysteresis could have the same effect, because the records have one rate only: a lag
        widens the loops, and the resonance is among the first harmonics
    unsure : the same fit with slow modes, which were omitted because the records do not determine their gains
    """

    axis: Axis
    resonance_error_percent: float | None
    damping_error_percent: float | None
    creep_gain_errors: tuple[float, ...]
    rms_um: float
    static_rms_um: float
    lag_error_percent: float | None = None
    excited: bool = True
    one_rate: bool = False
    unsure: AxisFit | None = None

    @property
    def lowers_the_error(self) -> bool:
        """Whether the dynamics lower the error significantly.

        A resonance outside the excited band must lower it as much as any block that improves the model: below
        it, it only bends the response, as drift and creep do.
        """
        return lowers(self.rms_um, self.static_rms_um, FELT if self.excited else IMPROVED)

    @property
    def identified(self) -> bool:
        """Whether the records identify the dynamics.

        At a single rate, a lag and a resonance among the first harmonics may be hysteresis.
        """
        if self.one_rate or not self.lowers_the_error:
            return False
        known = self.resonance_error_percent is None or self.resonance_error_percent <= UNSURE_PERCENT
        return known and (self.lag_error_percent is None or self.lag_error_percent <= UNSURE_LAG_PERCENT)

    def creep_identified(self, records: Sequence[Record]) -> bool:
        """Whether the records identify the creep: slow modes of significant size that decay within a record.

        A mode that follows the drive within a radian of its fastest record cannot be separated from the gain,
        nor a mode slower than the longest record from drift. Two modes with nearly the same time constant
        count as one.
        """
        longest = max(record.sample_time_s * record.samples for record in records)
        shortest = 0.5 / np.pi / max(drive_hz(record) for record in records)
        times = sorted(mode.time_constant_s for mode in self.axis.creep)
        if any(slower < APART * faster for faster, slower in itertools.pairwise(times)):
            return False
        return all(
            shortest <= mode.time_constant_s <= longest and abs(mode.gain) >= SURE_CREEP * error
            for mode, error in zip(self.axis.creep, self.creep_gain_errors, strict=True)
        )

    def with_errors(self, errors: Array) -> AxisFit:
        """Return the same with the standard errors of ``axis.free`` (number,)."""
        known = iter((100.0 * errors).tolist())
        resonance, lag = self.axis.resonance_hz is not None, self.axis.lag_s is not None
        return replace(
            self,
            resonance_error_percent=next(known) if resonance else None,
            damping_error_percent=next(known) if resonance else None,
            lag_error_percent=next(known) if lag else None,
            creep_gain_errors=tuple(0.01 * gain for gain in list(known)[::2]),
        )


def fit_axis(task: AxisTask, begin: Array) -> AxisFit:
    """Fit one axis, starting from parameters near the best ones."""
    shape = task.shape
    static = fit_slopes(task, task.sensor_path)[1]
    if not shape.parameters:
        return AxisFit(Axis(), None, None, (), static, static)
    quick = _with_few_columns(task)
    point = refine(task, refine(quick, begin).x if quick else begin)
    found = AxisFit(
        axis=axis_of(shape, point.x),
        resonance_error_percent=None,
        damping_error_percent=None,
        creep_gain_errors=(),
        rms_um=point.rms,
        static_rms_um=static,
        excited=not shape.resonance or _excited(task, point),
        one_rate=_at_one_rate(task) and (shape.lag or (shape.resonance and _among_harmonics(task, point))),
    )
    return found.with_errors(standard_errors(task, point))


def _with_few_columns(task: AxisTask) -> AxisTask | None:
    """The same task for steps that cost less, where there may be many of them; None where it is small."""
    if task.kept:
        few = tuple(replace(one, values=one.values[-FEW:], held=one.held[-FEW:]) for one in task.kept)
        return replace(task, kept=few) if task.columns > FEW else None
    if not task.shape.creep_modes or task.columns <= len(task.grids):
        return None
    return replace(task, grids=tuple(input_grids(task.records, CREEP_OPERATORS, "voltage")))


def standard_errors(task: AxisTask, point: Point) -> Array:
    """Standard errors of the parameters, model error included.

    The larger of two estimates: for errors that are independent from sample to sample, and

        (H^-1 (sum over parts of g g^T) H^-1)_ii,    g = sum over the part of psi e

    with the derivatives psi of the output behind the slopes, and H = psi^T psi: errors may be correlated
    within a part (White, Econometrica 48 (1980) 817-838; Liang and Zeger, Biometrika 73 (1986) 13-22). The
    slopes are free; delay and thresholds are taken as known.
    """
    n = task.columns
    inverse = np.linalg.pinv(point.curvature, rcond=1e-14, hermitian=True)
    spread = np.zeros_like(inverse)
    path = partial(task.path, point.x)
    left = residuals(task, path, point.slopes)
    for i, (record, error) in enumerate(zip(task.records, left, strict=True)):
        time = record.sample_time_s
        filters: list[Filter] = [
            SideBySide(path(time)),
            task.derivatives(point.x, point.slopes, time),
        ]
        moves = np.hstack([x[n:] - point.drag.T @ x[:n] for _, x in task.blocks(i, filters)])
        moves -= moves.mean(axis=1, keepdims=True)
        ends = np.linspace(0, len(error), PARTS + 1).astype(int)
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


def _at_one_rate(task: AxisTask) -> bool:
    """Whether all records are driven at one rate, and long enough for a spectrum of lines.

    A record of few cycles rings from its start.
    """
    cycles = [drive_hz(record) * record.samples * record.sample_time_s for record in task.records]
    return not several_rates(task.records) and max(cycles) >= SETTLED_CYCLES


def _among_harmonics(task: AxisTask, point: Point) -> bool:
    """Whether fewer than two multiples of the lowest frequency of the drive are near the resonance.

    One line of a spectrum is two numbers, as many as a resonance has: it explains any harmonic there.
    """
    width_hz = math.exp(point.x[0]) * (NEAR - 1.0 / NEAR)
    return width_hz < 2.0 * min(lowest_hz(record) for record in task.records)

"""Steps of the search for resonance, damping, lag and creep of an axis, together with the static block.

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
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.linear.axis_task import (
    AxisShape,
    AxisTask,
    ByColumn,
    OfSum,
)
from hammerstein.identification.search import Damping, damped_change, steps
from hammerstein.identification.static.normal_equations import coefficients, squares_left
from hammerstein.identification.static.regressors import SideBySide
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

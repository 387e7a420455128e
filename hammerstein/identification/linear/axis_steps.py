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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.linear.axis_task import AxisTask, ByColumn, OfSum
from hammerstein.identification.static.damped_search import Damping, damped_change, steps
from hammerstein.identification.static.normal_equations import coefficients, squares_left
from hammerstein.identification.static.regressors import SideBySide

SMALLEST_CHANGE = 1e-6  # of a logarithm, below which a search stands
MOST_STEPS = 25  # a search that has not arrived is given up
ENOUGH = 1e-7
"""Relative gain of a step under which the search has arrived."""
ROUGHLY = 1e-5
"""The same where places are compared that are refined further afterwards."""


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
    """The best place known after each step of ``refine``; who takes them may give the search up."""
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
    """Rms error with given parameters and the best slopes [um]."""
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

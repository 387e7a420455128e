"""Lag, resonance, creep and delay behind hysteresis of any kind, estimated together with its weights.

Every kind is linear in its weights. Its response to each weight alone is a column; once they have passed the
axis, the weights are linear unknowns as slopes of plays are, and the search is that of ``axis_steps``.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, Axis
from hammerstein.hysteresis import Hysteresis
from hammerstein.identification.fit import Task
from hammerstein.identification.linear.axis_fit import (
    CREEP_SPANS,
    LAG_SAMPLES,
    PEAK_DAMPING,
    AxisFit,
    arrived,
    fit_axis,
    fit_slopes,
    refine,
    refined_late,
    resonances,
    ringing_hz,
    rms_behind,
    thinning,
)
from hammerstein.identification.linear.axis_task import (
    LARGEST_CREEP,
    AxisShape,
    AxisTask,
    axis_of,
    duration_s,
    parameters_of,
)
from hammerstein.identification.model_selection import FELT, lowers
from hammerstein.identification.score import columns_of
from hammerstein.identification.search import TINY, best_delay
from hammerstein.identification.static.regressors import Regressors

MOST_CREEP = 3
"""Largest number of slow modes of an axis with ``auto``."""
TOLD = 1e-9
"""Power of a combination of columns, in parts of the largest, from which the records tell it."""
REFINED = 3
"""Number of valleys of a coarse grid from which a search begins."""
SEARCHED = 1e-3
"""Gain of a step, in parts of the error, below which a search has converged; decisions need two percent."""
FEW, MANY = 7, 39
"""Combinations of columns of largest power, in addition to the response of the block, at the start of a
search and for its decision; plus 1, multiples of 4 for the compiled loop. The last fit uses all columns."""


class OutputDynamics(NamedTuple):
    """Axes behind a block, the delay [samples], and the fit of each axis."""

    axes: tuple[Axis, ...]
    delay_samples: float
    fits: tuple[AxisFit, ...] = ()

    @property
    def dynamics(self) -> AxesDynamics:
        """Linear block of the axes."""
        return AxesDynamics(axes=self.axes)

    @property
    def is_static(self) -> bool:
        """Whether there are no dynamics behind the block."""
        return all(axis == Axis() for axis in self.axes)


class Grown(NamedTuple):
    """An axis with one thing more: its shape and parameters, and the rms error of one output [um]."""

    shape: AxisShape
    x: Array
    rms: float


def search_output_dynamics(
    task: Task,
    hysteresis: Hysteresis[Any],
    begin: OutputDynamics,
    free_delay: bool = False,
    *,
    one_fast: bool = False,
) -> OutputDynamics:
    """Axes behind a block whose weights are free.

    A low-pass, a resonance and slow modes are added to an axis one after the other: each time the one that
    lowers the error most, or the simplest that comes within two percent of it, as long as the error falls by
    two percent.

    Parameters
    ----------
    task : records, starts, settings
    hysteresis : the block; only its weights are refitted
    begin : initial axes, if any, and initial delay
    free_delay : whether the delay is fitted, too
    one_fast : whether each axis has either a low-pass or a resonance, even if it does not lower the error:
        both together look like a delay
    """
    late = replace(task, delay_samples=begin.delay_samples)
    every = [len(weights) for weights in hysteresis.weights]
    tasks = [_axis_tasks(late, hysteresis, o, (number, MANY)) for o, number in enumerate(every)]
    near = begin.axes or (Axis(),) * task.outputs
    selected = [
        _forward_selection(task, one, axis, one_fast) for (_, one), axis in zip(tasks, near, strict=True)
    ]
    shapes, begins = [shape for shape, _ in selected], [x for _, x in selected]
    whole, many = (
        [replace(one, shape=shape) for one, shape in zip(row, shapes, strict=True)]
        for row in zip(*tasks, strict=True)
    )
    delay = begin.delay_samples
    if free_delay:
        task.progress("estimating the delay")
        delay, begins = _delay(many, delay, begins)
    return OutputDynamics(tuple(_nearer(one, x, delay) for one, x in zip(whole, begins, strict=True)), delay)


def _nearer(one: AxisTask, x: Array, delay: float) -> Axis:
    """The axis nearer to its best."""
    return axis_of(one.shape, refine(replace(one, delay_samples=delay), x, SEARCHED).x if len(x) else x)


def _delay(many: Sequence[AxisTask], first: float, begins: Sequence[Array]) -> tuple[float, list[Array]]:
    """Delay that leaves the least, and parameters of all axes with it.

    Where few columns ask for another delay than the first one, many decide which.
    """
    few = [_with_few_columns(one, x) for one, x in zip(many, begins, strict=True)]
    near, found = best_delay(
        partial(refined_late, few, enough=SEARCHED), list(begins), first=first, parts=True
    )
    if near == first:
        return first, list(begins)
    attempt = partial(refined_late, many, enough=SEARCHED)
    return best_delay(attempt, found, first=float(round(near)), parts=True)


def sure_output_dynamics(task: Task, hysteresis: Hysteresis[Any], found: OutputDynamics) -> OutputDynamics:
    """The fitted axes behind the same block, without the parts that the records do not identify."""
    late = replace(task, delay_samples=found.delay_samples)
    fits = []
    for o, axis in enumerate(found.axes):
        shape, x = parameters_of(axis)
        task.progress(f"fitting the dynamics from the hysteresis to {task.records[0].outputs[o]}")
        [one] = _axis_tasks(late, hysteresis, o, (len(hysteresis.weights[o]),))
        one = replace(one, shape=shape)
        fit = found.fits[o] if found.fits else fit_axis(one, x)
        fits.append(sure_axis(one, fit, asked=task.settings.creep_modes != "auto"))
    return OutputDynamics(tuple(fit.axis for fit in fits), found.delay_samples, tuple(fits))


def sure_axis(one: AxisTask, fit: AxisFit, asked: bool) -> AxisFit:
    """The axis without slow modes and resonances that the records do not identify, removed one by one.

    asked : whether a number of slow modes was requested; these stay, identified or not
    """
    whole = fit
    while fit.axis.creep and not ((asked or fit.creep_identified(one.records)) and _physical(fit.axis)):
        shape, x = parameters_of(fit.axis)
        sizes = zip(fit.axis.creep, fit.creep_gain_errors, strict=True)
        least = int(np.argmin([abs(mode.gain) / max(error, TINY) for mode, error in sizes]))
        at = shape.slow + 2 * least
        one = replace(one, shape=replace(shape, creep_modes=shape.creep_modes - 1))
        fit = fit_axis(one, np.delete(x, [at, at + 1]))
    if fit.axis.resonance_hz is not None and not fit.identified:
        return _with_one_fast(one, fit)
    return fit if fit is whole or not _physical(whole.axis) else replace(fit, unsure=whole)


def _with_one_fast(one: AxisTask, fit: AxisFit) -> AxisFit:
    """The axis with a low-pass in place of its resonance, or without either where that is not told.

    Where it has both, the low-pass may be what is not told, and the resonance stays alone.
    """
    shape, x = parameters_of(fit.axis)
    without = replace(shape, resonance=False)
    plain = fit_axis(replace(one, shape=without), x[2:])
    if shape.lag:
        resonant = fit_axis(replace(one, shape=replace(shape, lag=False)), np.delete(x, 2))
        return resonant if resonant.identified and lowers(resonant.rms_um, plain.rms_um) else plain
    found = with_step(one, without, x[2:], "lag")
    if found is None:
        return plain
    lagging = fit_axis(replace(one, shape=found.shape), found.x)
    return lagging if lagging.identified and lowers(lagging.rms_um, plain.rms_um) else plain


def _physical(axis: Axis) -> bool:
    """Whether every slow mode goes on the way of the fast displacement, and no farther than that."""
    return all(0.0 < mode.gain <= LARGEST_CREEP for mode in axis.creep)


def _axis_tasks(task: Task, hysteresis: Hysteresis[Any], o: int, numbers: Sequence[int]) -> list[AxisTask]:
    """What stays fixed while the axis of output o is fitted: with all columns, or so many combinations."""
    every = thinning(task.records)
    each = zip(task.records, task.starts, strict=True)
    raw = [columns_of(hysteresis, record, start, o) for record, start in each]
    told = _told(raw, every)
    sensor = task.settings.sensor

    def with_columns(number: int) -> AxisTask:
        mix = told if len(told) <= number else np.vstack([hysteresis.weights[o], told[-number:]])
        kept = tuple(Regressors(mix @ one.values, mix @ one.held) for one in raw)
        shape, delay = AxisShape(False), task.delay_samples
        return AxisTask(task.records, task.starts, (), o, shape, delay, sensor, every, kept)

    return [with_columns(number) for number in numbers]


def _told(columns: Sequence[Regressors], every: int) -> Array:
    """Combinations (row, column) that the records tell, of equal power and without correlation."""
    gram = np.zeros((len(columns[0].values),) * 2)
    for one in columns:
        x = one.values[:, ::every]
        x = x - x.mean(axis=1, keepdims=True)
        gram += x @ x.T
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    power, directions = np.linalg.eigh(gram / np.outer(size, size))
    kept = power > TOLD * power[-1]
    return np.asarray((directions[:, kept] / np.sqrt(power[kept])).T / size)


def _forward_selection(task: Task, one: AxisTask, begin: Axis, one_fast: bool) -> tuple[AxisShape, Array]:
    """Shape and parameters of one axis, found by adding what lowers the error most.

    one : with many columns, which decide
    """
    settings, name = task.settings, task.records[0].outputs[one.output]
    fast = settings.fast
    asks = settings.creep_modes != "auto"
    most = int(settings.creep_modes) if asks else MOST_CREEP
    shape, x = parameters_of(begin)
    here = refine(replace(one, shape=shape), x, SEARCHED) if shape.parameters else None
    x, error = (here.x, here.rms) if here else (x, rms_behind(replace(one, shape=shape), x))
    while True:
        task.progress(f"trying dynamics from the hysteresis to {name}: {shape.name} so far")
        fast = () if one_fast and shape.slow else fast
        steps = [step for step in fast if not getattr(shape, step)]
        steps += ["creep"] if shape.creep_modes < most else []
        tried = [with_step(one, shape, x, step) for step in steps]
        if "lag" in steps and shape.resonance:  # a damped resonance may have taken the place of a low-pass
            tried.append(_with_both(one, shape, x))
        trials = [trial for trial in tried if trial is not None and _physical(axis_of(trial.shape, trial.x))]
        if not trials:
            return shape, x
        best = _simplest_near(trials)
        asked = [trial for trial in trials if asks and trial.shape.creep_modes > shape.creep_modes]
        if one_fast and fast:
            asked.insert(0, _simplest_near([trial for trial in trials if trial.shape.slow > shape.slow]))
        for trial, most_rms in ((best, (1.0 - FELT) * error), *((t, math.inf) for t in asked)):
            point = refine(replace(one, shape=trial.shape), trial.x, SEARCHED)
            if point.rms <= most_rms and _physical(axis_of(trial.shape, point.x)):
                shape, x, error = trial.shape, point.x, point.rms
                break
        else:
            return shape, x


def _simplest_near(trials: Sequence[Grown]) -> Grown:
    """Of the axes within two percent of the least error, the one with the fewest parameters.

    An overdamped resonance follows as closely as the low-pass that it stands for.
    """
    most = min(trial.rms for trial in trials) / (1.0 - FELT)
    near = [trial for trial in trials if trial.rms <= most]
    return min(near, key=lambda trial: (trial.shape.parameters, trial.rms))


def _valleys(errors: Sequence[float]) -> list[int]:
    """Places of a grid with no lower neighbour, the lowest first.

    With few columns, errors may fall from one end of the grid to the other, past a resonance.

    >>> _valleys([3.0, 2.0, 2.5, 1.5, 1.0]), _valleys([])
    ([4, 1], [])
    """
    padded = [math.inf, *errors, math.inf]
    low = [i for i, error in enumerate(errors) if error <= min(padded[i], padded[i + 2])]
    return sorted(low, key=lambda i: errors[i])


def _with_few_columns(one: AxisTask, x: Array) -> AxisTask:
    """The same for searches near x: its columns are the response that is best there, and those of most power.

    With the response that is best elsewhere, a resonance may be hidden that all columns show.
    """
    if one.columns <= FEW + 1 or not one.kept:
        return one
    slopes, _ = fit_slopes(one, partial(one.path, x))
    mix = np.vstack([slopes, np.eye(one.columns)[-FEW:]])
    return replace(one, kept=tuple(Regressors(mix @ each.values, mix @ each.held) for each in one.kept))


def _with_both(one: AxisTask, shape: AxisShape, x: Array) -> Grown | None:
    """An axis with a low-pass, and a resonance that is found behind it."""
    lagging = with_step(one, replace(shape, resonance=False), x[2:], "lag")
    return None if lagging is None else with_step(one, lagging.shape, lagging.x, "resonance")


def with_step(one: AxisTask, shape: AxisShape, x: Array, step: str) -> Grown | None:
    """An axis with one thing more, near the best place; None where the records are too short for any.

    Few columns search, and all those of the task choose where it has arrived: with few, an axis could hide an
    error that thresholds can remove.
    """
    here = _with_few_columns(replace(one, shape=shape), x)
    if step == "creep":
        larger, at = replace(shape, creep_modes=shape.creep_modes + 1), shape.parameters
        spans = np.log(duration_s(one.records) * np.array(CREEP_SPANS))
        added = [np.array([0.02, t]) for t in spans]
    elif step == "lag":
        larger, at = replace(shape, lag=True), shape.slow
        times = np.log(min(r.sample_time_s for r in one.records) * np.array(LAG_SAMPLES))
        added = [np.array([t]) for t in times]
    else:
        larger, at = replace(shape, resonance=True), 0
        added = resonances(*replace(one, shape=AxisShape()).limits)
    whole = replace(one, shape=larger)
    lower, upper = whole.limits

    def begun(added: Sequence[Array]) -> list[Array]:
        begins = [np.insert(x, at, more) for more in added]
        return [x for x in begins if (lower <= x).all() and (x <= upper).all()]

    begins = begun(added)
    nearest = [
        begins[i] for i in _valleys([rms_behind(replace(here, shape=larger), x) for x in begins])[:REFINED]
    ]
    if step == "resonance":
        nearest += begun([np.log([hz, PEAK_DAMPING]) for hz in ringing_hz(here, x)])
    points = arrived(partial(_with_few_columns, whole), nearest, SEARCHED)
    found = [Grown(larger, point.x, rms_behind(whole, point.x)) for point in points]
    return min(found, key=lambda one: one.rms) if found else None

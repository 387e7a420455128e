"""Candidate models with and without a resonance, a low-pass or creep on each axis."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, Axis
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.columns import driven_of
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.axis_fit import AxesFit, AxisFit, fit_axes, fit_axis
from hammerstein.identification.linear.axis_search import (
    FirstGuess,
    checked_delay,
    rms_behind,
    search_axes,
    search_creep,
    search_lag,
    thinning,
)
from hammerstein.identification.linear.axis_task import (
    AxisShape,
    AxisTask,
    parameters_of as axis_parameters,
)
from hammerstein.identification.linear.delay import TINY
from hammerstein.identification.model_selection import FELT, lowers
from hammerstein.identification.output_dynamics import MOST_CREEP, OutputDynamics
from hammerstein.identification.projection import fit_block
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import SlopeColumns, StaticFit, Thresholds, half_swing
from hammerstein.identification.static.threshold_search import criterion, gained
from hammerstein.identification.static_candidates import (
    KEPT,
    begun_static,
    finished_static,
    fitted_thresholds,
    lost_inverse,
    of_fitted,
    static_blocks,
    without_dynamics,
)
from hammerstein.identification.task import (
    CandidateSet,
    FittedModel,
    Progress,
    Task,
    WeightFits,
    thresholds_of,
)
from hammerstein.records.record import Record

GROWN_SAMPLES = 200_000
"""Samples for the search of an additional low-pass or creep mode."""
MOST_TURNS = 8
"""Largest number of joint fits of exchanged thresholds and axes; each must lower the criterion by one."""
WORTHWHILE = 5e-3
"""Relative gain that a turn needs if the records are so long that samples are skipped."""
CONVERGED = 1e-9
"""Gain of a step, in parts of the error, under which thresholds and axes have arrived: with 1e-6, other
versions of SciPy ended 3e-5 of the error away, and what is left of a cross-coupling moved by a half."""
CLEARLY_FELT = 0.5
"""Remaining part of the error with dynamics, below which thresholds are not fitted without them, too."""


def build_axes(task: Task, guesses: Sequence[FirstGuess]) -> CandidateSet:
    """All four kinds of model, without a delay unless a delay lowers the final error by two percent.

    Coarse thresholds look like a delay, and so does an axis before its fit has converged. The delay found
    with them is compared with no delay; for both, thresholds and axes are fitted to convergence.
    """
    built = _built_with(task, guesses)
    late = [guess for guess in guesses if guess.delay_samples > 0.0]
    if not late or task.settings.delay_samples is not None:
        return built
    task.progress("trying the model without delay")
    settings = task.settings.changed(delay_samples=0)
    prompt = [replace(guess, delay_samples=0, free_delay=False) for guess in guesses]
    other = _built_with(replace(task, settings=settings, delay_samples=0), prompt)
    rms = [np.maximum(one.best.blocks.chosen.rms_um, TINY) for one in (built, other)]
    left, without = (float(np.log(one).sum()) for one in rms)  # multiplied over the outputs
    return built if left < without + task.outputs * math.log(1.0 - FELT) else other


def _built_with(task: Task, guesses: Sequence[FirstGuess]) -> CandidateSet:
    """All four kinds of model with axes of the guessed shapes; outputs keep the simplest that fits as well.

    The best one is fitted to all records, together with the thresholds if the settings ask for that. Then a
    low-pass beside a resonance and creep modes are tried.
    """
    settings = task.settings
    static = begun_static(without_dynamics(task))
    task, guess, axes, others = _first_axes(task, guesses)
    blocks = static_blocks(task, task.thresholds_v, dynamics_of(axes), settings.solver)
    if settings.creep_modes == 0 and not _felt(static.best.blocks.chosen, blocks.chosen):
        unfelt = [replace(axis, rms_um=axis.static_rms_um) if axis.identified else axis for axis in axes]
        return replace(finished_static(without_dynamics(task), static), axes=tuple(unfelt), others=others)
    notes: tuple[str, ...] = ()
    if not np.all(blocks.chosen.rms_um <= CLEARLY_FELT * static.best.blocks.chosen.rms_um):
        static = finished_static(without_dynamics(task), static)
    if settings.fits_thresholds and any(axis.identified for axis in axes):
        begun = blocks
        axes, blocks = _thresholds_and_axes(task, guess, axes, begun)
        notes = (KEPT,) if blocks is begun and settings.partition == "fitted" else ()
    before = axes
    axes, blocks, tried = _with_lag_and_creep(task, axes, blocks)
    if axes is not before and settings.fits_thresholds:
        axes, blocks = _thresholds_and_axes(task, _guess_of(guess, dynamics_of(axes)), axes, blocks)
    if not any(axis.identified for axis in axes):
        return replace(static, axes=axes, others=(*others, *tried))
    dynamics = dynamics_of(axes)
    linear = _axes(task, task.linear_thresholds(), _guess_of(guess, dynamics), thinning(task.records))
    alone = _as_found(linear.axes)
    gains = static_blocks(task, task.linear_thresholds(), alone, "least_squares")
    found: dict[Kind, FittedModel] = {
        **static.found,
        "linear_dynamics": FittedModel(task.candidate(gains.chosen.hysteresis, alone), gains, linear.axes),
        "hammerstein": FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks, axes),
    }
    return CandidateSet(found, "hammerstein", axes, notes, (*others, *tried))


def _first_axes(
    task: Task, guesses: Sequence[FirstGuess]
) -> tuple[Task, FirstGuess, tuple[AxisFit, ...], tuple[tuple[str, FittedModel], ...]]:
    """Of the shapes guessed the best, fitted with all records, the task with its delay, and all as models."""
    guess = guesses[0]
    others: tuple[tuple[str, FittedModel], ...] = ()
    if len(guesses) > 1:
        fits = [_axes(task, task.thresholds_v, guess, thinning(task.records)) for guess in guesses]
        guess, others = _best_shapes(guesses, fits), _others(task, guesses, fits)
    task = replace(task, delay_samples=guess.delay_samples)
    return task, guess, _axes(task, task.thresholds_v, guess, 1).axes, others


def guesses_of(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    settings: Settings,
    tell: Progress,
) -> tuple[FirstGuess, ...]:
    """First guesses of the axes, for every shape that is tried."""
    late = settings.delay_samples
    search = partial(search_axes, records, starts, sensor=settings.sensor, progress=tell)
    return tuple(search(delay_samples=late, resonance=fast, lag=lag) for fast, lag in settings.shapes)


def with_checked_delay(task: Task, guess: FirstGuess) -> FirstGuess:
    """Axes with the best delay for the thresholds of the task."""
    task.progress("checking the delay")
    grids = SlopeColumns.of(task.thresholds_v).grids
    return checked_delay(task.records, task.starts, grids, guess, sensor=task.settings.sensor)


def _guess_of(guess: FirstGuess, behind: AxesDynamics) -> FirstGuess:
    """Initial guess from axes; one that passes its input unchanged keeps what was guessed."""
    each = [
        (shape, x) if axis == Axis() else axis_parameters(axis)
        for axis, shape, x in zip(behind.axes, guess.shapes, guess.parameters, strict=True)
    ]
    return replace(guess, shapes=tuple(s for s, _ in each), parameters=tuple(x for _, x in each))


def _axes(task: Task, thresholds_v: Thresholds, guess: FirstGuess, every: int) -> AxesFit:
    grids = SlopeColumns.of(thresholds_v).grids
    known = task.records, grids, task.starts, guess
    return fit_axes(*known, sensor=task.settings.sensor, every=every, progress=task.progress)


def _best_shapes(guesses: Sequence[FirstGuess], fits: Sequence[AxesFit]) -> FirstGuess:
    """Of each output the simplest shape whose error is within two percent of the least, and one delay."""
    shapes, parameters = [], []
    for o in range(len(guesses[0].shapes)):
        rms = [fit.axes[o].rms_um if fit.axes[o].identified else math.inf for fit in fits]
        least = min(rms)
        order = sorted(range(len(fits)), key=lambda i: guesses[i].shapes[o].parameters)
        i = next((i for i in order if rms[i] <= least / (1.0 - FELT)), order[0])
        shapes.append(guesses[i].shapes[o])
        parameters.append(axis_parameters(fits[i].axes[o].axis)[1][: shapes[-1].slow])
    totals = [sum(math.log(max(axis.rms_um, TINY)) for axis in fit.axes) for fit in fits]
    delay = guesses[int(np.argmin(totals))].delay_samples
    return FirstGuess(tuple(shapes), tuple(parameters), delay, guesses[0].free_delay)


def _others(
    task: Task, guesses: Sequence[FirstGuess], fits: Sequence[AxesFit]
) -> tuple[tuple[str, FittedModel], ...]:
    """The shapes that were tried with the thresholds begun with, as models."""
    found = []
    for guess, fit in zip(guesses, fits, strict=True):
        late = replace(task, delay_samples=guess.delay_samples)
        blocks = static_blocks(late, task.thresholds_v, _as_found(fit.axes), task.settings.solver)
        name = f"initial thresholds, {guess.shapes[0].name}"
        model = late.candidate(blocks.chosen.hysteresis, _as_found(fit.axes))
        found.append((name, FittedModel(model, blocks, fit.axes)))
    return tuple(found)


def _with_lag_and_creep(
    task: Task, axes: tuple[AxisFit, ...], blocks: WeightFits
) -> tuple[tuple[AxisFit, ...], WeightFits, list[tuple[str, FittedModel]]]:
    """Axes with a low-pass beside the resonance, then with creep modes, each only if it lowers the error.

    Creep modes that are asked for stay anyway. All outputs take a step together. The refitted static block
    decides whether it is kept: thresholds of plays and axes are fitted in turn here. Behind a block with
    fixed shapes, axes grow one by one instead; see ``output_dynamics``.
    """
    settings = task.settings
    tried: list[tuple[str, FittedModel]] = []
    grids = SlopeColumns.of(thresholds_of(blocks)).grids
    asked = settings.creep_modes != "auto"
    steps = ["lag"] * (settings.dynamics == "auto") + ["creep"] * (int(settings.creep_modes) if asked else 1)
    while steps:
        step = steps.pop(0)
        task.progress(f"trying an additional {('low-pass' if step == 'lag' else 'creep mode')}")
        found = tuple(_with(task, grids, blocks, o, fit, step) for o, fit in enumerate(axes))
        if all(new.axis is old.axis for new, old in zip(found, axes, strict=True)):
            axes = found
            continue
        trial = static_blocks(task, thresholds_of(blocks), dynamics_of(found), settings.solver)
        trial = replace(trial, fitted=blocks.fitted)
        with_it = FittedModel(task.candidate(trial.chosen.hysteresis, dynamics_of(found)), trial, found)
        modes = max(len(axis.axis.creep) for axis in found)
        name = "a low-pass" if step == "lag" else f"creep mode {modes}"
        if (asked and step == "creep") or _felt(blocks.chosen, trial.chosen):
            without = task.candidate(blocks.chosen.hysteresis, dynamics_of(axes))
            tried.append((f"without {name}", FittedModel(without, blocks, axes)))
            axes, blocks = found, trial
            steps += ["creep"] * (step == "creep" and not asked and modes < MOST_CREEP)
        else:
            tried.append((f"with {name}", with_it))
    return axes, blocks, tried


def _with(
    task: Task, grids: tuple[Array, ...], blocks: WeightFits, o: int, old: AxisFit, step: str
) -> AxisFit:
    """One axis with one more low-pass or creep mode; unchanged where the records do not identify it.

    A mode that is asked for is added anyway.
    """
    shape, x = axis_parameters(old.axis)
    if not old.identified:
        shape, x = AxisShape(False), np.empty(0)
    if step == "lag" and (shape.lag or not shape.resonance):
        return old
    full = AxisTask(task.records, task.starts, grids, o, shape, task.delay_samples, task.settings.sensor)
    row = blocks.chosen.hysteresis.pairs[o]
    slopes = SlopeColumns.of(thresholds_of(blocks)).merge[o] @ np.concatenate([pair.slopes for pair in row])
    few, begun = shortened(task.records, task.starts, GROWN_SAMPLES)
    quick = replace(full, records=few, starts=begun, every=thinning(few)).mixed(slopes)
    larger = replace(shape, lag=True) if step == "lag" else replace(shape, creep_modes=shape.creep_modes + 1)
    point = (search_lag if step == "lag" else search_creep)(replace(quick, shape=larger), x)
    asked = step == "creep" and task.settings.creep_modes != "auto"
    if not asked and not lowers(point.rms, rms_behind(quick, x)):
        return old
    fit = fit_axis(replace(full, shape=larger), point.x)
    if asked or (fit.identified and (step == "lag" or fit.creep_identified(task.records))):
        return fit
    return replace(old, unsure=fit) if step == "creep" else old


def _thresholds_and_axes(
    task: Task, guess: FirstGuess, axes: tuple[AxisFit, ...], blocks: WeightFits
) -> tuple[tuple[AxisFit, ...], WeightFits]:
    """Axes and static block with thresholds and axes fitted together; as they were if nothing is gained.

    Between, thresholds are exchanged, and those not worth their price leave.
    """
    free, every = 1 + task.outputs, thinning(task.records)
    best: tuple[tuple[AxisFit, ...], WeightFits] | None = None
    behind, thresholds_v = dynamics_of(axes), thresholds_of(blocks)
    need = 1.0 if every == 1 else WORTHWHILE * 2.0 * task.outputs * blocks.chosen.samples
    for turn in range(MOST_TURNS):
        task.progress("fitting the thresholds")
        thresholds_v = fitted_thresholds(task, thresholds_v, behind, rounds=1)
        begin = _guess_of(guess, behind)
        if turn:  # behind the first axes, more thresholds stay than are told: they would wander
            thresholds_v, begin = _together(task, thresholds_v, guess, behind)
        near = _axes(task, thresholds_v, begin, every).axes
        if not any(axis.identified for axis in near):
            break
        behind = dynamics_of(near)
        trial = of_fitted(task, thresholds_v, behind)
        least = criterion(best[1].chosen, free) if best else math.inf
        now = math.inf if lost_inverse(task, blocks, trial) else criterion(trial.chosen, free)
        best = (near, trial) if now < least else best
        if turn and now >= least - need:
            break
    if best is None or not gained(blocks.chosen, best[1].chosen):
        return axes, blocks
    if every == 1:
        return best
    found = thresholds_of(best[1])
    whole = _axes(task, found, _guess_of(guess, dynamics_of(best[0])), 1).axes
    return whole, of_fitted(task, found, dynamics_of(whole))


def _together(
    task: Task, thresholds_v: Thresholds, guess: FirstGuess, behind: AxesDynamics
) -> tuple[list[list[Array]], FirstGuess]:
    """Thresholds and axes by the one fit: in turn, each would make up for what the other one lacks."""
    driven, found = driven_of(task, thresholds_v), OutputDynamics(behind.axes, task.delay_samples)
    middle, reach = 0.5 * (driven.low_v + driven.high_v), half_swing(task.records)
    driven = replace(driven, low_v=middle - reach, high_v=middle + reach)  # a play engages within one record
    joint = fit_block(task, PrandtlIshlinskii.first_guesses(driven), driven, found, enough=CONVERGED)
    pairs = cast(PrandtlIshlinskii, joint.hysteresis).pairs
    return [[pair.thresholds_v for pair in row] for row in pairs], _guess_of(guess, joint.behind.dynamics)


def _felt(without: StaticFit, with_dynamics: StaticFit) -> bool:
    """Whether dynamics lower the error of a static block that is bound to have an inverse."""
    return any(map(lowers, with_dynamics.rms_um.tolist(), without.rms_um.tolist()))


def dynamics_of(axes: Sequence[AxisFit]) -> AxesDynamics:
    """Linear block of the axes; unidentified ones pass their input unchanged."""
    return AxesDynamics(axes=tuple(fit.axis if fit.identified else Axis() for fit in axes))


def _as_found(axes: Sequence[AxisFit]) -> AxesDynamics:
    """Linear block of the axes whether the records tell them or not, to compare with."""
    return AxesDynamics(axes=tuple(fit.axis for fit in axes))

"""Candidate models with plays: linear gain and static hysteresis, alone and in front of fitted axes."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, Axis, Dynamics, StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.columns import driven_of
from hammerstein.identification.fit import (
    CandidateSet,
    FittedModel,
    Kind,
    Progress,
    Task,
    WeightFits,
    thresholds_of,
)
from hammerstein.identification.linear.axis_fit import AxisFit, fit_axis, thinning
from hammerstein.identification.linear.axis_task import AxisTask, axis_of, parameters_of
from hammerstein.identification.model_selection import CURVE_SAMPLES, FELT, lowers
from hammerstein.identification.output_dynamics import (
    OutputDynamics,
    search_output_dynamics,
    sure_axis,
    sure_output_dynamics,
)
from hammerstein.identification.projection import fit_block
from hammerstein.identification.score import SensorModel, invertibility_of
from hammerstein.identification.search import TINY, alike_clocks, best_delay
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.closed_form import closed_form_model
from hammerstein.identification.static.initial_state import closed, most_dynamic_segment, shortened
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import (
    SlopeColumns,
    SquaresSolver,
    StaticFit,
    Thresholds,
    fit_static,
    half_swing,
    input_grids,
    refuse_unreached,
    solve_static,
    static_moments,
)
from hammerstein.identification.static.threshold_search import (
    ThresholdTask,
    criterion,
    fit_thresholds,
    gained,
)
from hammerstein.records.record import Record

MOST_ROUNDS = 8
"""Most rounds of a fit of thresholds."""
KEPT = "fitted thresholds do not lower the error: they are uniform in time"


def build_static(task: Task) -> CandidateSet:
    """Linear gain and static hysteresis, the latter with fitted thresholds if requested and better."""
    return finished_static(task, begun_static(task))


def begun_static(task: Task) -> CandidateSet:
    """Linear gain and static hysteresis with the thresholds of the task."""
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the static block")
    starts = (InitialState("rest"),) * len(task.records)
    # its own delay, the same beside hysteresis of any kind, and all samples
    gain = late_static(replace(task, thresholds_v=task.linear_thresholds(), starts=starts))
    linear = static_blocks(gain, gain.thresholds_v, dynamics, "least_squares")
    blocks = static_blocks(task, task.thresholds_v, dynamics, task.settings.solver)
    found: dict[Kind, FittedModel] = {
        "linear": FittedModel(gain.candidate(linear.chosen.hysteresis, dynamics), linear),
        "static_hysteresis": FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks),
    }
    return CandidateSet(found, "static_hysteresis")


def finished_static(task: Task, built: CandidateSet) -> CandidateSet:
    """Static hysteresis with fitted thresholds, if requested and better; otherwise unchanged."""
    if not task.settings.fits_thresholds:
        return built
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the thresholds")
    thresholds_v, prompt = fitted_thresholds(task, task.thresholds_v, dynamics), task
    late = late_static(replace(task, thresholds_v=thresholds_v))
    if late.delay_samples != task.delay_samples:
        prompt, task = replace(task, delay_samples=0.0), replace(task, delay_samples=late.delay_samples)
        thresholds_v = fitted_thresholds(task, thresholds_v, dynamics)
    blocks = of_fitted(task, thresholds_v, dynamics)
    if prompt is not task:  # on a ramp, wrong thresholds make up for a wrong delay: neither search sees it
        other = of_fitted(prompt, fitted_thresholds(prompt, task.thresholds_v, dynamics), dynamics)
        if lowers(*(float(one.chosen.rms_um.mean()) for one in (other, blocks))):
            task, blocks = prompt, other
    begun = built.best.blocks
    if not gained(begun.chosen, blocks.chosen) or lost_inverse(task, begun, blocks):
        return replace(built, notes=(KEPT,) if task.settings.partition == "fitted" else ())
    found = FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks)
    return replace(built, found={**built.found, built.kind: found})


def late_static(task: Task) -> Task:
    """The task with the best delay for its thresholds without dynamics, if none was given.

    Single loops cannot tell it from hysteresis, and coarse thresholds look like a delay.
    """
    if task.settings.delay_samples is not None or all(closed(record) for record in task.records):
        return task
    few, begun = shortened(task.records, task.starts, CURVE_SAMPLES)
    sensor = replace(task, records=few).paths(StaticDynamics(n_outputs=task.outputs))

    def attempt(delay: float, _: None) -> tuple[list[float], None]:
        known: dict[str, Any] = {"starts": begun, "delay_samples": round(delay), "through": sensor}
        return fit_static(few, task.thresholds_v, solver="least_squares", **known).rms_um.tolist(), None

    return replace(task, delay_samples=best_delay(attempt, None)[0])


def static_blocks(task: Task, thresholds_v: Thresholds, dynamics: Dynamics, solver: str) -> WeightFits:
    """Weights by the requested solver, and by two others for comparison."""
    layout = SlopeColumns.of(thresholds_v)
    refuse_unreached(task.records, layout.grids)
    moments = static_moments(task.records, layout.grids, task.starts, task.whole_delay, task.paths(dynamics))

    def solved(how: SquaresSolver) -> StaticFit:
        return solve_static(task.records, thresholds_v, layout, moments, how, task.settings.ridge)

    free = solved("least_squares")
    if solver == "closed_form":
        return WeightFits(_closed_form(task, free), free, solved("nonnegative"))
    chosen = {"least_squares": free, "nonnegative": solved("nonnegative"), "invertible": solved("invertible")}
    return WeightFits(chosen[solver], free, chosen["nonnegative"])


def _closed_form(task: Task, free: StaticFit) -> StaticFit:
    """Closed form on the settled loops, brought forward by the delay."""
    d = task.whole_delay
    prompt = [SensorModel(delay_s=d * record.sample_time_s).prompt(record) for record in task.records]
    placed = task.settings.thresholds_v is not None or task.settings.partition == "voltage"
    given = task.thresholds_v if placed else None
    counts = {len(r) for row in task.thresholds_v for r in row}
    if given is None and len(counts) > 1:
        raise IdentificationError("the closed form places one number of thresholds; give one, or thresholds")
    return replace(free, hysteresis=closed_form_model(prompt, max(counts), given), bounded=(), open=())


def without_dynamics(task: Task) -> Task:
    """The task with the best delay for a model without dynamics."""
    own = task.static_delay_samples
    return task if own is None else replace(task, delay_samples=own)


def of_fitted(task: Task, thresholds_v: Thresholds, dynamics: AxesDynamics | StaticDynamics) -> WeightFits:
    """Weights for fitted thresholds."""
    return replace(static_blocks(task, thresholds_v, dynamics, task.settings.solver), fitted=True)


def lost_inverse(task: Task, start: WeightFits, found: WeightFits) -> bool:
    """Whether fitting the thresholds made the static block non-invertible."""
    amplitude, record = float(half_swing(task.records).max()), task.records[0]
    told = StaticDynamics(n_outputs=task.outputs)
    before, now = (
        invertibility_of(b.chosen.hysteresis, told, amplitude, record.sample_time_s, record.inputs)[0]
        for b in (start, found)
    )
    return before and not now


def fitted_thresholds(
    task: Task, thresholds_v: Thresholds, dynamics: Dynamics, rounds: int = MOST_ROUNDS
) -> list[list[Array]]:
    """Thresholds fitted in front of given dynamics, the same for all outputs."""
    known = task.starts, task.whole_delay, task.paths(dynamics)
    fitting = ThresholdTask(task.records, *known, thinning(task.records))
    return [list(fit_thresholds(fitting, thresholds_v[0], rounds))] * task.outputs


GUESS_SAMPLES = 60_000  # of the liveliest part, for the first guess
GUESS_OPERATORS = 20  # of the hysteresis beside that guess
GUESSED_DIGITS = 3
"""Decimals of the logarithms of a guess: what other versions of SciPy change in the ninth one decided whether
a fourteenth threshold was worth its price."""
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


def build_axes(task: Task, guess: OutputDynamics) -> CandidateSet:
    """All four kinds of model, without a delay unless a delay lowers the final error by two percent.

    Coarse thresholds look like a delay, and so does an axis before its fit has converged. The delay found
    with them is compared with no delay; for both, thresholds and axes are fitted to convergence.
    """
    built = _built_with(task, guess)
    if guess.delay_samples == 0.0 or task.settings.delay_samples is not None:
        return built
    task.progress("trying the model without delay")
    settings = task.settings.changed(delay_samples=0)
    other = _built_with(replace(task, settings=settings), guess._replace(delay_samples=0.0))
    rms = [one.best.blocks.chosen.rms_um for one in (built, other)]
    return built if _is_late(*rms) else other


def _built_with(task: Task, guess: OutputDynamics) -> CandidateSet:
    """All four kinds of model with axes near the guessed ones.

    They are fitted to all records, together with the thresholds if the settings ask for that. Then more is
    tried behind these thresholds: a low-pass beside a resonance, creep modes.
    """
    settings = task.settings
    static = begun_static(without_dynamics(task))
    task = replace(task, delay_samples=guess.delay_samples)
    axes = fit_axes(task, task.thresholds_v, guess.axes)
    first = _as_found(task, axes)
    blocks = static_blocks(task, task.thresholds_v, dynamics_of(axes), settings.solver)
    if settings.creep_modes == 0 and not _felt(static.best.blocks.chosen, blocks.chosen):
        unfelt = [replace(axis, rms_um=axis.static_rms_um) if axis.identified else axis for axis in axes]
        return replace(finished_static(without_dynamics(task), static), axes=tuple(unfelt), others=(first,))
    notes: tuple[str, ...] = ()
    if not np.all(blocks.chosen.rms_um <= CLEARLY_FELT * static.best.blocks.chosen.rms_um):
        static = finished_static(without_dynamics(task), static)
    if settings.fits_thresholds and any(axis.identified for axis in axes):
        begun = blocks
        axes, blocks = _thresholds_and_axes(task, guess.axes, axes, begun)
        notes = (KEPT,) if blocks is begun and settings.partition == "fitted" else ()
    before = axes
    axes, blocks, tried = _grown(task, axes, blocks)
    if axes is not before and settings.fits_thresholds:
        axes, blocks = _thresholds_and_axes(task, _kept_from(guess.axes, axes), axes, blocks)
    if not any(axis.identified for axis in axes):
        return replace(static, axes=axes, others=(first, *tried))
    dynamics = dynamics_of(axes)
    linear = fit_axes(task, task.linear_thresholds(), _kept_from(guess.axes, axes), thinning(task.records))
    alone = AxesDynamics(axes=tuple(fit.axis for fit in linear))
    gains = static_blocks(task, task.linear_thresholds(), alone, "least_squares")
    found: dict[Kind, FittedModel] = {
        **static.found,
        "linear_dynamics": FittedModel(task.candidate(gains.chosen.hysteresis, alone), gains, linear),
        "hammerstein": FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks, axes),
    }
    return CandidateSet(found, "hammerstein", axes, notes, (first, *tried))


def guess_of(
    records: Sequence[Record], starts: Sequence[InitialState], settings: Settings, tell: Progress
) -> OutputDynamics:
    """Axes near the best ones, and the delay, from the liveliest parts of the records.

    A low-pass beside a resonance looks like a delay. It is tried in place of one that was found.
    """
    quick, begun = most_dynamic_segment(records, starts, GUESS_SAMPLES)
    row = input_grids(quick, GUESS_OPERATORS, "voltage")
    thresholds_v = [list(row) for _ in quick[0].y_um]
    late, asked = settings.delay_samples or 0, settings.changed(creep_modes=0)
    task = Task(quick, begun, thresholds_v, late, asked, tell)
    plays = fit_static(quick, thresholds_v, solver="least_squares", starts=begun, delay_samples=late)
    free = settings.delay_samples is None and alike_clocks(records)
    begin = OutputDynamics((), late)

    def sure(guess: OutputDynamics) -> OutputDynamics:
        """The guess with a low-pass where it has a resonance that the records do not tell, rounded."""
        told = sure_output_dynamics(task, plays.hysteresis, guess)
        axes = (old if new == Axis() else new for old, new in zip(guess.axes, told.axes, strict=True))
        return told._replace(axes=tuple(map(_rounded, axes)))

    found = sure(search_output_dynamics(task, plays.hysteresis, begin, free, one_fast=True))
    if not free or found.delay_samples == 0.0:
        return found
    prompt = sure(search_output_dynamics(task, plays.hysteresis, found._replace(delay_samples=0.0)))
    rms = [[fit.rms_um for fit in one.fits] for one in (found, prompt)]
    return prompt if _is_late(*reversed(rms)) else found


def _rounded(axis: Axis) -> Axis:
    """The axis with parameters of few digits."""
    shape, x = parameters_of(axis)
    return axis_of(shape, np.round(x, GUESSED_DIGITS))


def _is_late(rms_um: ArrayLike, prompt_um: ArrayLike) -> bool:
    """Whether a delay lowers the rms errors, in their geometric mean, by two percent."""
    ratio = np.maximum(rms_um, TINY) / np.maximum(prompt_um, TINY)
    return bool(np.log(ratio).mean() < math.log(1.0 - FELT))


def _kept_from(guess: Sequence[Axis], axes: Sequence[AxisFit]) -> tuple[Axis, ...]:
    """The fitted axes; one that passes its input unchanged keeps what was guessed."""
    each = zip(guess, dynamics_of(axes).axes, strict=True)
    return tuple(first if axis == Axis() else axis for first, axis in each)


def fit_axes(
    task: Task, thresholds_v: Thresholds, near: Sequence[Axis], every: int = 1
) -> tuple[AxisFit, ...]:
    """Every axis near a given one, each with its own static block in front."""
    grids, fits = SlopeColumns.of(thresholds_v).grids, []
    for o, axis in enumerate(near):
        task.progress(f"fitting the axis {task.records[0].outputs[o]}")
        shape, x = parameters_of(axis)
        fixed = task.records, task.starts, grids, o, shape, task.delay_samples, task.settings.sensor, every
        fits.append(fit_axis(AxisTask(*fixed), x))
    return tuple(fits)


def _grown(
    task: Task, axes: tuple[AxisFit, ...], blocks: WeightFits
) -> tuple[tuple[AxisFit, ...], WeightFits, tuple[tuple[str, FittedModel], ...]]:
    """Axes with more behind the fitted thresholds, if that lowers the error of the refitted static block.

    Creep modes that are asked for stay anyway.
    """
    asked = task.settings.creep_modes not in (0, "auto")
    few, begun = shortened(task.records, task.starts, GROWN_SAMPLES)
    near = OutputDynamics(dynamics_of(axes).axes, task.delay_samples)
    quick = replace(task, records=few, starts=begun)
    found = search_output_dynamics(quick, blocks.chosen.hysteresis, near)
    grids, fits = SlopeColumns.of(thresholds_of(blocks)).grids, []
    for o, (old, axis) in enumerate(zip(axes, found.axes, strict=True)):
        shape, x = parameters_of(axis)
        if shape == parameters_of(old.axis)[0]:
            fits.append(old)
            continue
        one = AxisTask(task.records, task.starts, grids, o, shape, task.delay_samples, task.settings.sensor)
        fits.append(sure_axis(one, fit_axis(one, x), asked))
    more = tuple(fits)
    if all(new is old for new, old in zip(more, axes, strict=True)):
        return axes, blocks, ()
    trial = static_blocks(task, thresholds_of(blocks), dynamics_of(more), task.settings.solver)
    trial = replace(trial, fitted=blocks.fitted)
    without = FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics_of(axes)), blocks, axes)
    with_it = FittedModel(task.candidate(trial.chosen.hysteresis, dynamics_of(more)), trial, more)
    if asked or _felt(blocks.chosen, trial.chosen):
        return more, trial, ((f"with {_named(axes)}", without),)
    return axes, blocks, ((f"with {_named(more)}", with_it),)


def _as_found(task: Task, axes: tuple[AxisFit, ...]) -> tuple[str, FittedModel]:
    """Axes behind the thresholds begun with as a model, whether the records identify them or not."""
    dynamics = AxesDynamics(axes=tuple(fit.axis for fit in axes))
    blocks = static_blocks(task, task.thresholds_v, dynamics, task.settings.solver)
    found = FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks, axes)
    return f"initial thresholds, {_named(axes)}", found


def _named(axes: Sequence[AxisFit]) -> str:
    """Shapes of axes for a table."""
    return ", ".join(dict.fromkeys(parameters_of(fit.axis)[0].name for fit in axes))


def _thresholds_and_axes(
    task: Task, guess: tuple[Axis, ...], axes: tuple[AxisFit, ...], blocks: WeightFits
) -> tuple[tuple[AxisFit, ...], WeightFits]:
    """Axes and static block with thresholds and axes fitted together; as they were if nothing is gained.

    Between, thresholds are exchanged, and those not worth their price leave.
    """
    free, every = 1 + task.outputs, thinning(task.records)
    best: tuple[tuple[AxisFit, ...], WeightFits] | None = None
    fits, thresholds_v = axes, thresholds_of(blocks)
    need = 1.0 if every == 1 else WORTHWHILE * 2.0 * task.outputs * blocks.chosen.samples
    for turn in range(MOST_TURNS):
        task.progress("fitting the thresholds")
        thresholds_v = fitted_thresholds(task, thresholds_v, dynamics_of(fits), rounds=1)
        begin = _kept_from(guess, fits)
        if turn:  # behind the first axes, more thresholds stay than are told: they would wander
            thresholds_v, begin = _together(task, thresholds_v, guess, fits)
        near = fit_axes(task, thresholds_v, begin, every)
        if not any(axis.identified for axis in near):
            break
        fits = near
        trial = of_fitted(task, thresholds_v, dynamics_of(near))
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
    whole = fit_axes(task, found, _kept_from(guess, best[0]))
    return whole, of_fitted(task, found, dynamics_of(whole))


def _together(
    task: Task, thresholds_v: Thresholds, guess: tuple[Axis, ...], fits: Sequence[AxisFit]
) -> tuple[list[list[Array]], tuple[Axis, ...]]:
    """Thresholds and axes by the one fit: in turn, each would make up for what the other one lacks."""
    driven = driven_of(task, thresholds_v)
    found = OutputDynamics(dynamics_of(fits).axes, task.delay_samples)
    middle, reach = 0.5 * (driven.low_v + driven.high_v), half_swing(task.records)
    driven = replace(driven, low_v=middle - reach, high_v=middle + reach)  # a play engages within one record
    joint = fit_block(task, PrandtlIshlinskii.first_guesses(driven), driven, found, enough=CONVERGED)
    pairs = cast(PrandtlIshlinskii, joint.hysteresis).pairs
    near = tuple(g if axis == Axis() else axis for g, axis in zip(guess, joint.behind.axes, strict=True))
    return [[pair.thresholds_v for pair in row] for row in pairs], near


def _felt(without: StaticFit, with_dynamics: StaticFit) -> bool:
    """Whether dynamics lower the error of a static block that is bound to have an inverse."""
    return any(map(lowers, with_dynamics.rms_um.tolist(), without.rms_um.tolist()))


def dynamics_of(axes: Sequence[AxisFit]) -> AxesDynamics:
    """Linear block of the axes; unidentified ones pass their input unchanged."""
    return AxesDynamics(axes=tuple(fit.axis if fit.identified else Axis() for fit in axes))

"""The kinds of model that are fitted beside each other, so that each block is seen to improve the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    LinearBlock,
    StateSpaceDynamics,
    StaticDynamics,
    discretise,
)
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Hysteresis, PrandtlIshlinskii
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.axis_delay import checked_delay
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask
from hammerstein.identification.linear.coupled import fit_linear, fit_static_coupled, refit_linear
from hammerstein.identification.linear.delay import delay_in_samples, static_delay
from hammerstein.identification.linear.second_order import (
    TINY,
    AxesFit,
    AxisFit,
    FirstGuess,
    fit_axes,
    fit_axis,
    parameters_of as axis_parameters,
    rms_behind,
    search_axes,
    search_creep,
    search_lag,
    thinning,
)
from hammerstein.identification.operators import CURVE_SAMPLES
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.fitted_thresholds import criterion, fit_thresholds, gained
from hammerstein.identification.static.history import closed, shortened
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.settled_loops import closed_form_model
from hammerstein.identification.static.static_block import (
    Layout,
    StaticFit,
    Thresholds,
    Weighting,
    half_swing,
    refuse_unreached,
    solve_static,
    static_moments,
)
from hammerstein.identification.static.threshold_errors import with_threshold_errors
from hammerstein.identification.static.threshold_search import ThresholdTask
from hammerstein.identification.verdict import FELT, axis_identified, creep_identified, invertibility_of
from hammerstein.records.record import Record

MOST_ROUNDS = 8
"""Most times that the two blocks are fitted in turn; each must gain a fiftieth."""
GROWN_SAMPLES = 200_000
"""Samples with which a low-pass or a creep mode more is searched."""
MOST_TURNS = 8
"""Most times that thresholds and axes are fitted in turn; each must lower the criterion by one."""
WORTHWHILE = 5e-3
"""Part of the error that a turn must gain where the records are so long that samples are left out."""
CLEARLY_FELT = 0.5
"""Part of the error that dynamics leave, below which thresholds are not fitted without them, too."""
PATIENCE = 2
"""Turns in a row without that, after which they end; and orders in a row that lower the error no more."""
FEWER = (0.75, 0.5)
"""Parts of the number of thresholds with which their fit is tried again."""
ORDERS = (1, 2, 3, 4, 6, 8, 12)
"""States for each output that are tried where no order is given."""
KEPT = "fitting the thresholds gains nothing: they are uniform in time"

Array = NDArray[np.float64]
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """Records with all that is known before the candidates are fitted.

    ``static_delay_samples`` is the delay that suits a model without dynamics, where it is another.
    """

    records: tuple[Record, ...]
    starts: tuple[Start, ...]
    thresholds_v: Thresholds
    delay_samples: float
    settings: Settings
    progress: Progress
    static_delay_samples: int | None = None

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.records[0].y_um)

    @property
    def delay_s(self) -> float:
        """Delay of the inputs [s]."""
        return self.delay_samples * self.records[0].sample_time_s

    def linear_thresholds(self) -> list[list[Array]]:
        """Give a single threshold of 0 to every pair: a linear gain."""
        return [[np.zeros(min(len(r), 1)) for r in row] for row in self.thresholds_v]

    @property
    def whole_delay(self) -> int:
        """Whole samples of the delay, by which the plays are shifted; what is left belongs to the path."""
        return math.floor(self.delay_samples)

    def delayed_as(self, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics) -> Task:
        """Give the task with the delay of a linear block."""
        delay = delay_in_samples(dynamics.input_delay_s, self.records[0].sample_time_s)
        return replace(self, delay_samples=delay)

    def paths(self, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics) -> list[LinearBlock]:
        """Discrete path of each record from the static block to the reading, with the part of a sample."""
        part_s = (self.delay_samples - self.whole_delay) * self.records[0].sample_time_s
        prompt = dynamics.model_copy(update={"input_delay_s": part_s})
        sensor = self.settings.sensor_bandwidth_hz
        if isinstance(prompt, StaticDynamics) and sensor is None:
            return []
        return [discretise(prompt, record.sample_time_s, sensor) for record in self.records]

    def candidate(
        self,
        hysteresis: Hysteresis[Any],
        dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    ) -> Candidate:
        """Static block and linear block as a model with the delay of the task."""
        late = dynamics.model_copy(update={"input_delay_s": self.delay_s})
        return Candidate(hysteresis, late, self.settings.sensor_bandwidth_hz)


@dataclass(frozen=True, eq=False)
class Blocks:
    """A static block under several methods, behind one and the same linear block.

    ``chosen`` is by the method that was asked for; ``free`` and ``one_sign`` serve for comparison; ``fitted``
    says whether the thresholds were.
    """

    chosen: StaticFit
    free: StaticFit
    one_sign: StaticFit | None
    fitted: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """One model that was fitted, with what tells how."""

    candidate: Candidate
    blocks: Blocks
    axes: tuple[AxisFit, ...] = ()


@dataclass(frozen=True, eq=False)
class Built:
    """All models that were fitted: the best of each kind, and others by name.

    ``axes`` is what the records say about the axes, also where the model has none.
    """

    found: dict[Kind, Found]
    kind: Kind
    axes: tuple[AxisFit, ...] = ()
    notes: tuple[str, ...] = ()
    others: tuple[tuple[str, Found], ...] = ()

    @property
    def best(self) -> Found:
        """The largest model that was kept so far."""
        return self.found[self.kind]

    @property
    def candidates(self) -> dict[Kind, Candidate]:
        """The models by kind."""
        return {kind: found.candidate for kind, found in self.found.items()}


def build_static(task: Task) -> Built:
    """Linear gain and static hysteresis, the latter with fitted thresholds if they are asked for and gain."""
    return _finished(task, _begun_static(task))


def _begun_static(task: Task) -> Built:
    """Linear gain and static hysteresis with the thresholds of the task."""
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the static block")
    linear = static_blocks(task, task.linear_thresholds(), dynamics, "least_squares")
    blocks = static_blocks(task, task.thresholds_v, dynamics, task.settings.method)
    found: dict[Kind, Found] = {
        "linear": Found(task.candidate(linear.chosen.hysteresis, dynamics), linear),
        "static_hysteresis": Found(task.candidate(blocks.chosen.hysteresis, dynamics), blocks),
    }
    return Built(found, "static_hysteresis")


def _finished(task: Task, built: Built) -> Built:
    """Static hysteresis with fitted thresholds if they are asked for; as it was if nothing is gained."""
    if not task.settings.fits_thresholds:
        return built
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the thresholds")
    thresholds_v = _fitted(task, task.thresholds_v, dynamics)
    late = late_static(replace(task, thresholds_v=thresholds_v))
    if late.delay_samples != task.delay_samples:
        task, thresholds_v = late, _fitted(late, thresholds_v, dynamics)
    blocks = _of_fitted(task, thresholds_v, dynamics)
    begun = built.best.blocks
    if not gained(begun.chosen, blocks.chosen) or _lost_inverse(task, begun, blocks):
        return replace(built, notes=(KEPT,) if task.settings.partition == "fitted" else ())
    found = Found(task.candidate(blocks.chosen.hysteresis, dynamics), blocks)
    return replace(built, found={**built.found, built.kind: found})


def late_static(task: Task) -> Task:
    """The task with the delay that suits its thresholds without dynamics, if none was given.

    Single loops cannot tell it from hysteresis, and coarse thresholds look like a delay.
    """
    if task.settings.delay_samples is not None or all(closed(record) for record in task.records):
        return task
    few, begun = shortened(task.records, task.starts, CURVE_SAMPLES)
    sensor = replace(task, records=few).paths(StaticDynamics(n_outputs=task.outputs))
    return replace(task, delay_samples=static_delay(few, task.thresholds_v, begun, through=sensor or None)[0])


def static_blocks(
    task: Task,
    thresholds_v: Thresholds,
    dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    method: str,
) -> Blocks:
    """Weights by the method asked for, and by the two that it is compared with."""
    layout = Layout.of(thresholds_v)
    refuse_unreached(task.records, layout.grids)
    moments = static_moments(
        task.records, layout.grids, task.starts, task.whole_delay, task.paths(dynamics) or None
    )

    def solved(how: Weighting) -> StaticFit:
        return solve_static(task.records, thresholds_v, layout, moments, how, task.settings.ridge)

    free = solved("least_squares")
    if method == "closed_form":
        return Blocks(_closed_form(task, free), free, solved("nonnegative"))
    chosen = {
        "least_squares": free,
        "nonnegative": solved("nonnegative"),
        "invertible": solved("invertible"),
    }
    return Blocks(chosen[method], free, chosen["nonnegative"])


def _closed_form(task: Task, free: StaticFit) -> StaticFit:
    """Closed form on the settled loops, brought forward by the delay."""
    settings = task.settings
    d = task.whole_delay
    prompt = [
        Record(
            record.u_v[:, : record.samples - d],
            record.y_um[:, d:],
            record.sample_time_s,
            record.inputs,
            record.outputs,
            record.source,
            verified=True,
        )
        for record in task.records
    ]
    placed = settings.thresholds_v is not None or settings.partition == "voltage"
    given = task.thresholds_v if placed else None
    counts = {len(r) for row in task.thresholds_v for r in row}
    if given is None and len(counts) > 1:
        raise IdentificationError("the closed form places one number of thresholds; give one, or thresholds")
    hysteresis = closed_form_model(prompt, max(counts), given)
    return replace(free, hysteresis=hysteresis, bounded=(), open=())


def build_axes(task: Task, guesses: Sequence[FirstGuess]) -> Built:
    """All four kinds, with axes of the shapes guessed: of each output the simplest that does as well.

    The best is fitted with all records; the thresholds are fitted with it where that is asked for. Then a
    low-pass beside a resonance and a creep mode are tried.
    """
    settings, may_creep = task.settings, task.settings.creep_modes == "auto"
    static = _begun_static(_late(task))
    task, guess, axes, others = _first_axes(task, guesses)
    blocks = static_blocks(task, task.thresholds_v, dynamics_of(axes), settings.method)
    if not may_creep and not _felt(static.best.blocks.chosen, blocks.chosen):
        unfelt = [
            replace(axis, rms_um=axis.static_rms_um) if axis_identified(axis) else axis for axis in axes
        ]
        return replace(_finished(_late(task), static), axes=tuple(unfelt), others=others)
    notes: tuple[str, ...] = ()
    if not np.all(blocks.chosen.rms_um <= CLEARLY_FELT * static.best.blocks.chosen.rms_um):
        coarse, static = static, _finished(_late(task), static)
        if static.best is not coarse.best:
            task, guess, axes, blocks = _behind_fitted(task, guess, axes, blocks, static.best.blocks)
    if settings.fits_thresholds and any(axis_identified(axis) for axis in axes):
        begun = blocks
        axes, blocks = _with_fewer_if_needed(task, guess, axes, begun)
        notes = (KEPT,) if blocks is begun and settings.partition == "fitted" else ()
    before = axes
    axes, blocks, tried = _grown(task, axes, blocks)
    if axes is not before and settings.fits_thresholds:
        axes, blocks = _thresholds_and_axes(task, _guess_of(guess, axes), axes, blocks)
    if not any(axis_identified(axis) for axis in axes):
        return replace(static, axes=axes, others=(*others, *tried))
    dynamics = dynamics_of(axes)
    linear = _axes(task, task.linear_thresholds(), _guess_of(guess, axes), thinning(task.records))
    alone = _as_found(linear.axes)
    gains = static_blocks(task, task.linear_thresholds(), alone, "least_squares")
    found: dict[Kind, Found] = {
        **static.found,
        "linear_dynamics": Found(task.candidate(gains.chosen.hysteresis, alone), gains),
        "hammerstein": Found(task.candidate(blocks.chosen.hysteresis, dynamics), blocks, axes),
    }
    return Built(found, "hammerstein", axes, notes, (*others, *tried))


def _first_axes(
    task: Task, guesses: Sequence[FirstGuess]
) -> tuple[Task, FirstGuess, tuple[AxisFit, ...], tuple[tuple[str, Found], ...]]:
    """Of the shapes guessed the best, fitted with all records, the task with its delay, and all as models."""
    guess = guesses[0]
    others: tuple[tuple[str, Found], ...] = ()
    if len(guesses) > 1:
        fits = [_axes(task, task.thresholds_v, guess, thinning(task.records)) for guess in guesses]
        guess, others = _best_shapes(guesses, fits), _others(task, guesses, fits)
    task = replace(task, delay_samples=guess.delay_samples)
    return task, guess, _axes(task, task.thresholds_v, guess, 1).axes, others


def _behind_fitted(
    task: Task, guess: FirstGuess, axes: tuple[AxisFit, ...], blocks: Blocks, static: Blocks
) -> tuple[Task, FirstGuess, tuple[AxisFit, ...], Blocks]:
    """Axes behind the thresholds that were fitted without any, if those leave less than the ones begun with.

    What coarse thresholds miss of the hysteresis would pass for a delay, dynamics or creep otherwise, or hide
    a resonance: axes that were not seen are searched anew.
    """
    behind = replace(task, thresholds_v=_thresholds_of(static))
    guesses: Sequence[FirstGuess] = (guess,)
    if not all(axis_identified(axis) and axis.excited for axis in axes):
        grids = Layout.of(behind.thresholds_v).grids
        guesses = guesses_of(task.records, task.starts, task.settings, task.progress, grids)
    late, near, found, _ = _first_axes(behind, [with_checked_delay(behind, one) for one in guesses])
    trial = _of_fitted(late, behind.thresholds_v, dynamics_of(found))
    late = replace(late, thresholds_v=task.thresholds_v)
    return (late, near, found, trial) if gained(blocks.chosen, trial.chosen) else (task, guess, axes, blocks)


def guesses_of(
    records: Sequence[Record],
    starts: Sequence[Start],
    settings: Settings,
    tell: Progress,
    grids: Sequence[Array] | None = None,
) -> tuple[FirstGuess, ...]:
    """Quick axes of every shape that is tried, behind plays with given thresholds if any."""
    return tuple(
        search_axes(
            records,
            starts,
            grids=grids,
            delay_samples=settings.delay_samples,
            sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
            resonance=resonance,
            lag=lag,
            progress=tell,
        )
        for resonance, lag in settings.shapes
    )


def with_checked_delay(task: Task, guess: FirstGuess) -> FirstGuess:
    """Axes with the delay that is best with the thresholds of the task."""
    task.progress("checking the delay")
    return checked_delay(
        task.records,
        task.starts,
        Layout.of(task.thresholds_v).grids,
        guess,
        sensor_bandwidth_hz=task.settings.sensor_bandwidth_hz,
    )


def _guess_of(guess: FirstGuess, axes: Sequence[AxisFit]) -> FirstGuess:
    """The axes found as what is begun with."""
    each = [
        axis_parameters(fit.axis) if axis_identified(fit) else (shape, x)
        for fit, shape, x in zip(axes, guess.shapes, guess.parameters, strict=True)
    ]
    return replace(guess, shapes=tuple(s for s, _ in each), parameters=tuple(x for _, x in each))


def _late(task: Task) -> Task:
    """The task with the delay that suits a model without dynamics."""
    own = task.static_delay_samples
    return task if own is None else replace(task, delay_samples=own)


def _axes(task: Task, thresholds_v: Thresholds, guess: FirstGuess, every: int) -> AxesFit:
    settings = task.settings
    return fit_axes(
        task.records,
        Layout.of(thresholds_v).grids,
        task.starts,
        guess,
        creep_modes=settings.creep_modes if isinstance(settings.creep_modes, int) else None,
        sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
        every=every,
        progress=task.progress,
    )


def _best_shapes(guesses: Sequence[FirstGuess], fits: Sequence[AxesFit]) -> FirstGuess:
    """Of each output the simplest shape whose error is within two percent of the least, and one delay."""
    shapes, parameters = [], []
    for o in range(len(guesses[0].shapes)):
        rms = [fit.axes[o].rms_um if axis_identified(fit.axes[o]) else math.inf for fit in fits]
        least = min(rms)
        order = sorted(range(len(fits)), key=lambda i: guesses[i].shapes[o].parameters)
        i = next((i for i in order if rms[i] <= least / (1.0 - FELT)), order[0])
        shapes.append(guesses[i].shapes[o])
        parameters.append(axis_parameters(fits[i].axes[o].axis)[1][: shapes[-1].slow])
    totals = [sum(math.log(max(axis.rms_um, TINY)) for axis in fit.axes) for fit in fits]
    delay = guesses[int(np.argmin(totals))].delay_samples
    return FirstGuess(tuple(shapes), tuple(parameters), delay, guesses[0].delay_rms_um)


def _others(
    task: Task, guesses: Sequence[FirstGuess], fits: Sequence[AxesFit]
) -> tuple[tuple[str, Found], ...]:
    """The shapes that were tried with the thresholds begun with, as models."""
    found = []
    for guess, fit in zip(guesses, fits, strict=True):
        late = replace(task, delay_samples=guess.delay_samples)
        blocks = static_blocks(late, task.thresholds_v, _as_found(fit.axes), task.settings.method)
        name = f"plays as begun with, {guess.shapes[0].name}"
        model = late.candidate(blocks.chosen.hysteresis, _as_found(fit.axes))
        found.append((name, Found(model, blocks, fit.axes)))
    return tuple(found)


def _grown(
    task: Task, axes: tuple[AxisFit, ...], blocks: Blocks
) -> tuple[tuple[AxisFit, ...], Blocks, list[tuple[str, Found]]]:
    """Axes with what else lowers the error: a low-pass beside the resonance, a creep mode."""
    settings = task.settings
    tried: list[tuple[str, Found]] = []
    grids = Layout.of(_thresholds_of(blocks)).grids
    steps: list[str] = (["lag"] if settings.dynamics == "auto" else []) + (
        ["creep"] if settings.creep_modes == "auto" else []
    )
    for step in steps:
        task.progress(f"trying a {'low-pass' if step == 'lag' else 'creep mode'} beside it")
        found = tuple(_with(task, grids, blocks, o, fit, step) for o, fit in enumerate(axes))
        if all(new is old for new, old in zip(found, axes, strict=True)):
            continue
        trial = static_blocks(task, _thresholds_of(blocks), dynamics_of(found), settings.method)
        trial = replace(trial, fitted=blocks.fitted)
        with_it = Found(task.candidate(trial.chosen.hysteresis, dynamics_of(found)), trial, found)
        name = {"lag": "a low-pass", "creep": "a creep mode"}[step]
        if np.any(trial.chosen.rms_um <= (1.0 - FELT) * blocks.chosen.rms_um):
            without = task.candidate(blocks.chosen.hysteresis, dynamics_of(axes))
            tried.append((f"without {name}", Found(without, blocks, axes)))
            axes, blocks = found, trial
        else:
            tried.append((f"with {name}", with_it))
    return axes, blocks, tried


def _thresholds_of(blocks: Blocks) -> list[list[Array]]:
    return [[pair.thresholds_v for pair in row] for row in blocks.chosen.hysteresis.pairs]


def _with(task: Task, grids: tuple[Array, ...], blocks: Blocks, o: int, old: AxisFit, step: str) -> AxisFit:
    """One axis with a low-pass or a creep mode more; as it was if a quick search gains nothing."""
    shape, x = axis_parameters(old.axis)
    if not axis_identified(old):
        shape, x = AxisShape(False), np.empty(0)
    if step == "lag" and (shape.lag or not shape.resonance):
        return old
    full = AxisTask(
        task.records, task.starts, grids, o, shape, task.delay_samples, task.settings.sensor_bandwidth_hz
    )
    row = blocks.chosen.hysteresis.pairs[o]
    slopes = Layout.of(_thresholds_of(blocks)).merge[o] @ np.concatenate([pair.slopes for pair in row])
    few, begun = shortened(task.records, task.starts, GROWN_SAMPLES)
    quick = replace(full, records=few, starts=begun, every=thinning(few)).mixed(slopes)
    larger = replace(shape, lag=True) if step == "lag" else replace(shape, creep_modes=shape.creep_modes + 1)
    point = (search_lag if step == "lag" else search_creep)(replace(quick, shape=larger), x)
    if point.rms > (1.0 - FELT) * rms_behind(quick, x):
        return old
    fit = fit_axis(replace(full, shape=larger), point.x)
    told = axis_identified(fit) and (step == "lag" or creep_identified(fit, task.records))
    return fit if told else old


def _with_fewer_if_needed(
    task: Task, guess: FirstGuess, axes: tuple[AxisFit, ...], begun: Blocks
) -> tuple[tuple[AxisFit, ...], Blocks]:
    """Thresholds and axes fitted, with fewer thresholds than begun with where so many lead to no inverse."""
    found = _thresholds_and_axes(task, guess, axes, begun)
    settings, number = task.settings, max(map(len, task.thresholds_v[0]))
    free = settings.operators == "auto" and settings.thresholds_v is None
    for part in FEWER:
        if found[1] is not begun or not free:
            break
        fewer = replace(task, thresholds_v=settings.thresholds(task.records, math.ceil(part * number)))
        blocks = static_blocks(fewer, fewer.thresholds_v, dynamics_of(axes), settings.method)
        trial = _thresholds_and_axes(fewer, guess, axes, blocks)
        if trial[1] is not blocks and gained(begun.chosen, trial[1].chosen):
            found = trial
    return found


def _thresholds_and_axes(
    task: Task, guess: FirstGuess, axes: tuple[AxisFit, ...], blocks: Blocks
) -> tuple[tuple[AxisFit, ...], Blocks]:
    """Axes and static block with thresholds and axes fitted in turn; as they were if nothing is gained."""
    free, every = 1 + task.outputs, thinning(task.records)
    best: tuple[tuple[AxisFit, ...], Blocks] | None = None
    near, thresholds_v, idle = axes, _thresholds_of(blocks), 0
    need = 1.0 if every == 1 else WORTHWHILE * 2.0 * task.outputs * blocks.chosen.samples
    for _ in range(MOST_TURNS):
        task.progress("fitting the thresholds")
        thresholds_v = _fitted(task, thresholds_v, dynamics_of(near), rounds=1)
        begin = tuple(
            axis_parameters(fit.axis)[1] if axis_identified(fit) else x
            for fit, x in zip(near, guess.parameters, strict=True)
        )
        near = _axes(task, thresholds_v, replace(guess, parameters=begin), every).axes
        if not any(axis_identified(axis) for axis in near):
            break
        trial = _of_fitted(task, thresholds_v, dynamics_of(near))
        least = criterion(best[1].chosen, free) if best else math.inf
        worse = criterion(trial.chosen, free) >= least - need or _lost_inverse(task, blocks, trial)
        idle = idle + 1 if worse else 0
        if idle >= (PATIENCE if every == 1 else 1):
            break
        best = best if idle else (near, trial)
    if best is None or not gained(blocks.chosen, best[1].chosen):
        return axes, blocks
    if every == 1:
        return best
    found = _thresholds_of(best[1])
    begin = tuple(axis_parameters(fit.axis)[1] for fit in best[0])
    whole = _axes(task, found, replace(guess, parameters=begin), 1).axes
    return whole, _of_fitted(task, found, dynamics_of(whole))


def _of_fitted(task: Task, thresholds_v: Thresholds, dynamics: AxesDynamics | StaticDynamics) -> Blocks:
    """Weights of thresholds that were fitted."""
    return replace(static_blocks(task, thresholds_v, dynamics, task.settings.method), fitted=True)


def _lost_inverse(task: Task, start: Blocks, found: Blocks) -> bool:
    """Whether the static block had an inverse with the thresholds begun with, and has none any more."""
    amplitude, record = float(half_swing(task.records).max()), task.records[0]
    told = StaticDynamics(n_outputs=task.outputs)
    before, now = (
        invertibility_of(b.chosen.hysteresis, told, amplitude, record.sample_time_s, record.inputs)[0]
        for b in (start, found)
    )
    return before and not now


def _fitted(
    task: Task,
    thresholds_v: Thresholds,
    dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    rounds: int = MOST_ROUNDS,
) -> list[list[Array]]:
    """Thresholds fitted in front of given dynamics, the same for all outputs."""
    fitting = _fitting(task, dynamics, thinning(task.records))
    row = list(fit_thresholds(fitting, thresholds_v[0], rounds))
    return [row] * task.outputs


def with_errors(task: Task, found: Found) -> Found:
    """Give a model the errors of its thresholds, if they were fitted."""
    if not found.blocks.fitted:
        return found
    dynamics = found.candidate.dynamics
    chosen = with_threshold_errors(_fitting(task.delayed_as(dynamics), dynamics), found.blocks.chosen)
    candidate = replace(found.candidate, hysteresis=chosen.hysteresis)
    return replace(found, candidate=candidate, blocks=replace(found.blocks, chosen=chosen))


def _fitting(
    task: Task, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics, every: int = 1
) -> ThresholdTask:
    """What stays fixed while thresholds are fitted in front of given dynamics."""
    return ThresholdTask(task.records, task.starts, task.whole_delay, task.paths(dynamics), every)


def _felt(without: StaticFit, with_dynamics: StaticFit) -> bool:
    """Whether dynamics lower the error of a static block that is bound to have an inverse."""
    return bool(np.any(with_dynamics.rms_um <= (1.0 - FELT) * without.rms_um))


def dynamics_of(axes: Sequence[AxisFit]) -> AxesDynamics:
    """Linear block of the axes; those that the records do not tell pass their input unchanged."""
    return AxesDynamics(axes=tuple(fit.axis if axis_identified(fit) else Axis() for fit in axes))


def _as_found(axes: Sequence[AxisFit]) -> AxesDynamics:
    """Linear block of the axes whether the records tell them or not, to compare with."""
    return AxesDynamics(axes=tuple(fit.axis for fit in axes))


@dataclass(frozen=True, eq=False)
class StateSpaceTrial:
    """A state-space model of some order: alone, and behind a static block."""

    order: int
    alone: Candidate
    blocks: Blocks
    best: Candidate
    error: float


def build_state_space(task: Task) -> Built:
    """All four kinds, with a state-space model of the order asked for, or of the fewest states that do."""
    static = build_static(_late(task))
    trials = _orders_tried(task)
    least = min(trial.error for trial in trials)
    begun = next(trial for trial in trials if trial.error <= least / (1.0 - FELT))
    blocks, best = _in_turn(task, begun)
    found: dict[Kind, Found] = {
        **static.found,
        "linear_dynamics": Found(begun.alone, static.found["linear"].blocks),
        "hammerstein": Found(best, blocks),
    }
    rest = [trial for trial in trials if trial is not begun]
    others = tuple((f"state space of order {one.order}", Found(one.best, one.blocks)) for one in rest)
    return Built(found, "hammerstein", others=others)


def _orders_tried(task: Task) -> list[StateSpaceTrial]:
    """Models of the order asked for, or of growing orders until two in a row lower the error no more."""
    order = task.settings.order
    if order is not None:
        return [_of_order(task, order)]
    trials: list[StateSpaceTrial] = []
    for states in ORDERS:
        try:
            trials.append(_of_order(task, states * task.outputs))
        except IdentificationError:  # more states than the lines of the response can tell
            if not trials:
                raise
            break
        errors = [trial.error for trial in trials]
        if len(errors) - 1 - int(np.argmin(errors)) >= PATIENCE:
            break
    return trials


def _of_order(task: Task, order: int) -> StateSpaceTrial:
    task.progress(f"fitting linear dynamics of order {order}")
    block, gain = fit_linear(task.records, order, task.progress)
    task.progress("fitting the static block in front of them")
    blocks, best = _hammerstein(task, block)
    alone = task.candidate(_gain_model(gain), _state_space(block))
    return StateSpaceTrial(order, alone, blocks, best, _error(task, best))


def _in_turn(task: Task, begun: StateSpaceTrial) -> tuple[Blocks, Candidate]:
    """Linear dynamics and static block fitted in turn, as long as that lowers the error."""
    blocks, best, error, before = begun.blocks, begun.best, begun.error, _error(task, begun.alone)
    told = len(task.records[0].u_v) == task.outputs  # or the outputs of the static block move together
    for _ in range(MOST_ROUNDS if told else 0):
        if error > (1.0 - FELT) * before:
            break
        task.progress("fitting the linear dynamics behind the static block")
        hysteresis = blocks.chosen.hysteresis
        again = refit_linear(task.records, task.starts, hysteresis, begun.order, task.progress)
        trial = _hammerstein(task, again)
        before, now = error, _error(task, trial[1])
        if now < error:
            (blocks, best), error = trial, now
    return blocks, best


def _error(task: Task, candidate: Candidate) -> float:
    return score(candidate, task.records, task.starts).mean_percent


def _hammerstein(task: Task, block: LinearBlock) -> tuple[Blocks, Candidate]:
    """Static block in front of a linear one."""
    blocks = _coupled(task, block)
    return blocks, task.candidate(blocks.chosen.hysteresis, _state_space(block))


def _coupled(task: Task, block: LinearBlock) -> Blocks:
    method = task.settings.method
    weighting: Weighting = "invertible" if method == "closed_form" else method
    found = fit_static_coupled(
        task.records, task.thresholds_v, block, task.starts, method=weighting, ridge=task.settings.ridge
    )
    return Blocks(found, found, None)


def _gain_model(gain: Array) -> PrandtlIshlinskii:
    return PrandtlIshlinskii.from_arrays(np.zeros(1), gain[:, :, None])


def _state_space(block: LinearBlock) -> StateSpaceDynamics:
    rows = {name: tuple(map(tuple, getattr(block, name).tolist())) for name in "ABCD"}
    return StateSpaceDynamics(**rows, sample_time_s=block.sample_time_s)

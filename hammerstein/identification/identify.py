"""From records to a model and an account of how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import StateSpaceDynamics, StaticDynamics
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.axes_candidates import build_axes, guesses_of, with_checked_delay
from hammerstein.identification.choice import Trial, chosen, crossed_squares, judged_squares, parameters_of
from hammerstein.identification.excitation import answers, excitation_statements, refuse_noise, refuse_one_way
from hammerstein.identification.fit import KIND_NAMES, Fit, Kind
from hammerstein.identification.kinds import with_hysteresis
from hammerstein.identification.leftover import faults_left, leftover_statements
from hammerstein.identification.linear.delay import delay_in_samples
from hammerstein.identification.linear.second_order import FirstGuess
from hammerstein.identification.operators import (
    CURVE_SAMPLES,
    CurvePoint,
    enough_operators,
    error_curve,
    input_grids,
)
from hammerstein.identification.recorded import counted, voltages_of
from hammerstein.identification.score import Candidate, Score, ranges, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.state_space_candidates import build_state_space
from hammerstein.identification.static.history import (
    StartMode,
    found_starts,
    judged_starts,
    shortened,
)
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import direct_pairs, fit_static, half_swing
from hammerstein.identification.static_candidates import build_static, late_static, with_errors
from hammerstein.identification.task import Built, Found, Task
from hammerstein.identification.verdict import (
    axis_identified,
    axis_statements,
    bound_notes,
    butterfly_flags,
    invertibility_of,
    record_flags,
    shape_flags,
    verdict,
)
from hammerstein.instruments import Instruments
from hammerstein.model import HammersteinModel
from hammerstein.records.faults import Fault
from hammerstein.records.preparation import FEWEST_AT_REST, dead_start, refuse_swapped
from hammerstein.records.record import Record
from hammerstein.voltages import Verdict, Voltages

Array = NDArray[np.float64]
Progress = Callable[[str], None]
P = ParamSpec("P")
T = TypeVar("T")

DELAY_OPERATORS = 15
"""Operators with which the delay is found where their number is still open."""
DEFAULT_OPERATORS, MOST_FITTED = 15, 20
"""Operators where no number is asked for nor tried, and the most of an input whose thresholds are fitted."""
FIRST_OPERATORS = 20
FIRST_SAMPLES = 50_000
"""Operators and samples of the first model, which only tells how the records begin."""


class Judgement(NamedTuple):
    """Errors of every kind of model on the records fitted and held back, and how far each input is heard."""

    fitted: dict[Kind, Score]
    judged: dict[Kind, Score]
    held: tuple[Record, ...]
    held_starts: tuple[Start, ...]
    answer: Array
    trials: tuple[Trial, ...]


def _told(work: Callable[P, T]) -> Callable[P, T]:
    """Turn equations that cannot be solved, whichever they are, into what a person can do about them."""

    @wraps(work)
    def identified(*args: P.args, **options: P.kwargs) -> T:
        try:
            return work(*args, **options)
        except np.linalg.LinAlgError as error:
            raise IdentificationError(
                f"the records do not determine what was asked for: its equations cannot be solved ({error}). "
                "Record longer, or ask for less: fewer operators, another partition, no dynamics"
            ) from None

    return identified


@_told
def identify(
    records: Sequence[Record],
    settings: Settings | None = None,
    *,
    validation: Sequence[Record] = (),
    name: str = "identified",
    instruments: Instruments | None = None,
    progress: Progress | None = None,
) -> tuple[HammersteinModel, Fit]:
    """Identify a model from measured records, and say how good it is.

    Linear gain, static Prandtl-Ishlinskii block, linear dynamics alone and the Hammerstein model are fitted
    beside each other, each as far as it was asked for. The model with the fewest parameters that is as good
    as the best on the records held back is returned (see ``choice.chosen``); without such records, it is
    judged on stretches that are left out. The verdict says what each block is worth, and what no model
    explains.

    Parameters
    ----------
    records : experiments on one actuator, with any inputs driven in each
    settings : how it is done; if not given, thresholds, their number and the dynamics are found
    validation : records that are held back and only judged
    name : of the model
    instruments : drive and sensor for the model file; ideal ones on the records' sample time if not given
    progress : told what is being done

    Returns
    -------
    model : the actuator's model; its file holds the voltages as recorded and the verdict
    fit : errors, offsets, standard errors, statements

    Raises
    ------
    InputError : records that do not fit together, swapped columns
    IdentificationError : records that do not determine the model

    Examples
    --------
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> u = 4.0 * np.sin(2.0 * np.pi * np.arange(1200) / 300) * np.linspace(1.0, 0.5, 1200)
    >>> truth = PrandtlIshlinskii([[Pair([0.0, 1.0, 2.0], [3.0, 1.0, 1.0])]])
    >>> record = Record([u], truth.respond([u])[0], 1e-3)
    >>> model, fit = identify([record], Settings(thresholds_v=[0.0, 1.0, 2.0], dynamics="none"))
    >>> model.hysteresis.pairs[0][0].weights_um_per_v.round(6), fit.invertible
    (array([3., 1., 1.]), True)
    """
    asked = settings or Settings()
    plain = asked.hysteresis == "prandtl_ishlinskii"
    settings = asked if plain else asked.without_auto()
    if settings.hysteresis == "rate_dependent" and settings.delay_samples is None:
        settings = replace(settings, delay_samples=0)  # plays alone would take widening loops for a delay
    tell = progress or (lambda _: None)
    ready = prepared(records)
    held = prepared(validation) if validation else ()
    _refuse_mixed([*ready, *held])
    if not settings.shapes and settings.dynamics != "state_space":
        refuse_one_way(ready)
    task, guesses, curve = _task(ready, settings, tell)
    built = _build(task, guesses)
    largest = built.best.candidate
    answer = answers(largest, ready, task.starts)
    refuse_noise(ready, answer)
    simpler = [candidate.predict for candidate in built.candidates.values() if candidate is not largest]
    held_starts = judged_starts(held, largest.predict, _settle_s(guesses), _start_mode(settings), simpler)
    tell("judging the models")
    built, trials = _kept(task, built, held, held_starts)
    if not plain:
        task, built = with_hysteresis(replace(task, settings=asked), built, held)
        held_starts = judged_starts(
            held, built.best.candidate.predict, _settle_s(guesses), _start_mode(settings)
        )
    fitted = {kind: score(c, ready, task.starts) for kind, c in built.candidates.items()}
    judged = {kind: score(c, held, held_starts) for kind, c in built.candidates.items()} if held else {}
    errors = Judgement(fitted, judged, held, held_starts, answer, trials)
    fit = _account(task, built, curve, errors, voltages_of(records, ready, task.starts))
    return _model(task, fit, built.best.candidate, name, instruments), fit


def _kept(
    task: Task, built: Built, held: tuple[Record, ...], held_starts: tuple[Start, ...]
) -> tuple[Built, tuple[Trial, ...]]:
    """The model that is as good as the best with the fewest parameters, and all that were tried."""
    named: list[tuple[str, Kind, Found]] = [
        *((KIND_NAMES[kind], kind, found) for kind, found in built.found.items()),
        *((name, "hammerstein", found) for name, found in built.others),
    ]
    trials = []
    for name, _, found in named:
        candidate = found.candidate
        if held:
            squares = judged_squares(candidate, held, held_starts)
        else:
            squares = crossed_squares(candidate, task.records, task.starts)
        swing, record = float(half_swing(task.records).max()), task.records[0]
        told = invertibility_of(
            candidate.hysteresis, candidate.dynamics, swing, record.sample_time_s, record.inputs
        )
        dynamics = not found.axes or any(axis_identified(axis) for axis in found.axes)
        trials.append(Trial(name, parameters_of(candidate), squares, told[0], dynamics))
    i = chosen(trials)
    _, kind, found = named[i]
    marked = tuple(replace(trial, kept=k == i) for k, trial in enumerate(trials))
    return replace(built, kind=kind, found={**built.found, kind: with_errors(task, found)}), marked


def prepared(records: Sequence[Record]) -> tuple[Record, ...]:
    """Records from where they last rested, with their voltages counted from there."""
    if not records:
        raise InputError("records", "none was given")
    _refuse_mixed(records)
    refuse_swapped(records)
    return tuple(counted(_from_last_rest(record)) for record in records)


def _from_last_rest(record: Record) -> Record:
    """The record without what it shows at rest: voltages and readings that stand still tell nothing."""
    dead = dead_start(record)
    return record.part(dead, record.samples) if dead + 1 >= FEWEST_AT_REST else record


def _left_out(records: Sequence[Record]) -> list[str]:
    """Outliers that the records were read without."""
    return [
        f"{record.source}: outliers of {found.column} are left out: {found.describe()}"
        for record in records
        for found in record.outliers
    ]


def _refuse_mixed(records: Sequence[Record]) -> None:
    shapes = {(len(record.u_v), len(record.y_um)) for record in records}
    if len(shapes) > 1:
        listed = ", ".join(f"{m} inputs and {p} outputs" for m, p in sorted(shapes))
        raise InputError("records", f"do not have the same axes: {listed}")


def _start_mode(settings: Settings) -> StartMode:
    """Without a model of how it rings, a start from rest cannot be told from the records."""
    return "repeated" if settings.dynamics == "state_space" and settings.start == "auto" else settings.start


def _settle_s(guesses: Sequence[FirstGuess]) -> float:
    return max((guess.settle_s for guess in guesses), default=0.0)


def _first_starts(
    records: tuple[Record, ...], settings: Settings, guess: FirstGuess | None = None
) -> tuple[Start, ...]:
    """How the records begin, with quick models of the static block behind the axes guessed so far."""
    mode = _start_mode(settings)
    if mode == "rest":
        return (Start("rest"),) * len(records)

    def fit(starts: Sequence[Start]) -> Callable[[Record, Start], Array]:
        return _first_model(records, starts, guess, settings).predict

    return found_starts(records, fit, guess.settle_s if guess else 0.0, mode)


def _first_model(
    records: tuple[Record, ...], starts: Sequence[Start], guess: FirstGuess | None, settings: Settings
) -> Candidate:
    """A quick model that tells how the records begin, with axes guessed, if there are any."""
    quick, begun = shortened(records, starts, FIRST_SAMPLES)
    delay = guess.delay_samples if guess else settings.delay_samples or 0
    row = input_grids(quick, FIRST_OPERATORS, "voltage")
    task = Task(quick, begun, [list(row) for _ in quick[0].y_um], delay, settings, lambda _: None)
    dynamics = guess.dynamics() if guess else StaticDynamics(n_outputs=task.outputs)
    found = fit_static(
        quick,
        task.thresholds_v,
        method="least_squares",
        starts=begun,
        delay_samples=task.whole_delay,
        through=task.paths(dynamics) or None,
    )
    return task.candidate(found.hysteresis, dynamics)


def _task(
    records: tuple[Record, ...], settings: Settings, tell: Progress
) -> tuple[Task, tuple[FirstGuess, ...], tuple[CurvePoint, ...]]:
    """Starts, delays and thresholds of the records, and axes near the best ones."""
    tell("looking at how the records begin")
    begun = _first_starts(records, settings)
    guesses = guesses_of(records, begun, settings, tell)
    last = guesses[-1] if guesses else None
    starts = _first_starts(records, settings, last) if last else begun
    if starts != begun:
        guesses = guesses_of(records, starts, settings, tell)
        last = guesses[-1]
    first = _first_model(records, starts, last, settings)
    starts = judged_starts(records, first.predict, _settle_s(guesses), _start_mode(settings))
    static = _static_delay(records, starts, settings, tell)
    delay = guesses[-1].delay_samples if guesses else static
    task = Task(records, starts, (), delay, settings, tell, static)
    if guesses:
        fine = replace(task, thresholds_v=_fine(settings).thresholds(records, DELAY_OPERATORS))
        guesses = tuple(with_checked_delay(fine, guess) for guess in guesses)
        task = replace(task, delay_samples=guesses[-1].delay_samples)
    curve: tuple[CurvePoint, ...] = ()
    wanted = settings.error_curve or (settings.operators == "auto" and settings.thresholds_v is None)
    if wanted and settings.uses_axes:
        tell("trying numbers of operators")
        paths = task.paths(guesses[-1].dynamics() if guesses else first.dynamics)
        place, whole = settings.begun_with, task.whole_delay
        curve = error_curve(records, starts, partition=place, delay_samples=whole, through=paths)
    chosen = enough_operators(curve) if curve else DEFAULT_OPERATORS
    if settings.fits_thresholds and settings.operators == "auto":
        chosen = min(chosen, MOST_FITTED)
    return replace(task, thresholds_v=settings.thresholds(records, chosen)), guesses, curve


def _static_delay(
    records: tuple[Record, ...], starts: tuple[Start, ...], settings: Settings, tell: Progress
) -> int:
    """Delay that suits a model without dynamics, with thresholds that are not fitted yet."""
    if settings.dynamics == "state_space":
        return settings.delay_samples or 0
    tell("searching the delay")
    few, begun = shortened(records, starts, CURVE_SAMPLES)
    thresholds_v = _fine(settings).thresholds(few, DELAY_OPERATORS)
    return late_static(
        Task(few, begun, thresholds_v, settings.delay_samples or 0, settings, tell)
    ).whole_delay


def _fine(settings: Settings) -> Settings:
    """Settings with so many operators that a delay does not stand in for thresholds that are missing."""
    few = isinstance(settings.operators, int) and settings.operators < DELAY_OPERATORS
    return replace(settings, operators=DELAY_OPERATORS) if few else settings


def _build(task: Task, guesses: Sequence[FirstGuess]) -> Built:
    if guesses:
        return build_axes(task, guesses)
    return build_state_space(task) if task.settings.dynamics == "state_space" else build_static(task)


def _account(
    task: Task,
    built: Built,
    curve: tuple[CurvePoint, ...],
    errors: Judgement,
    voltages: Voltages,
) -> Fit:
    """Everything that is said about the model."""
    fitted, judged, held, held_starts, answer, trials = errors
    record, settings, best = task.records[0], task.settings, built.best.candidate
    named = faults_left(best, task.records, task.starts)
    flags = _flags(task, built, named)
    where = (held, held_starts) if held else (task.records, task.starts)
    leftover = leftover_statements(best, *where, settings)
    swing = half_swing(task.records)
    invertible, sentence = _invertible(task, best, voltages)
    return Fit(
        inputs=record.inputs,
        outputs=record.outputs,
        kind=built.kind,
        fit=fitted,
        validation=judged,
        method=settings.method,
        operators=best.hysteresis.operators,
        amplitude_v=float(swing.max()),
        amplitudes_v=tuple(swing.tolist()),
        voltages=voltages,
        delay_samples=delay_in_samples(best.dynamics.input_delay_s, record.sample_time_s),
        sample_time_s=record.sample_time_s,
        sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
        offsets_um=tuple(tuple(row) for row in _offsets(best, task).tolist()),
        starts=task.starts,
        held_starts=held_starts,
        axes=built.best.axes,
        trials=trials,
        order=len(best.dynamics.A) if isinstance(best.dynamics, StateSpaceDynamics) else None,
        error_curve=curve,
        not_identifiable=tuple(_unknown(task, built, answer)),
        flags=tuple(flags),
        notes=(*_left_out([*task.records, *held]), *built.notes, *_bounds(task, built, named)),
        invertible=invertible,
        invertibility=sentence,
        verdict=verdict(judged or fitted, bool(judged), flags, settings.dynamics, built.kind, leftover),
        candidates=built.candidates,
        records=task.records,
        held=held,
    )


def _bounds(task: Task, built: Built, named: Sequence[Fault]) -> list[str]:
    """Slopes that the inverse needs and the records would have otherwise."""
    settings, blocks = task.settings, built.best.blocks
    if settings.method != "invertible" or settings.hysteresis != "prandtl_ishlinskii":
        return []
    spoiled = {name for fault in named for name in fault.outputs}
    return bound_notes(task.records, blocks.chosen, blocks.free, built.kind == "hammerstein", spoiled)


def _invertible(task: Task, best: Candidate, voltages: Voltages) -> tuple[bool, str]:
    """Whether the model has an inverse over what was recorded, and the same as a sentence."""
    record, block = task.records[0], best.hysteresis
    reached: float | Array = float(half_swing(task.records).max())
    if task.settings.hysteresis != "prandtl_ishlinskii":
        rest = np.array(voltages.working_point_v)
        block, reached = block.counted_from(rest), np.array([voltages.lowest_v, voltages.highest_v]) - rest
    return invertibility_of(block, best.dynamics, reached, record.sample_time_s, record.inputs)


def _flags(task: Task, built: Built, named: Sequence[Fault]) -> list[str]:
    """What spoils the records, and what a model of this kind cannot represent."""
    blocks, outputs = built.best.blocks, task.records[0].outputs
    spoiled = {(fault.source, name) for fault in named for name in fault.outputs}
    direct = [
        (o, k)
        for o, k in direct_pairs(blocks.free.hysteresis.gain(float(half_swing(task.records).max())))
        if outputs[o] not in {name for _, name in spoiled}
    ]
    flags = [fault.text for fault in named]
    flags += record_flags(built.best.candidate, task.records, task.starts, spoiled)
    if built.kind in ("linear", "static_hysteresis"):
        flags += butterfly_flags(task.records, direct)
    if blocks.one_sign is not None and task.settings.hysteresis == "prandtl_ishlinskii":
        spans = ranges(task.records, task.starts)
        flags += shape_flags(task.records, blocks.free, blocks.one_sign, spans, direct)
    return flags


def _unknown(task: Task, built: Built, answer: Array) -> list[str]:
    """What the excitation cannot tell."""
    record = task.records[0]
    sums = [
        f"single weights between {record.inputs[k]} and {record.outputs[o]}: only sums of them are told"
        for o, k in built.best.blocks.chosen.open
    ]
    axes = axis_statements(record.outputs, built.axes) if built.axes else []
    return [*axes, *sums, *_open_places(task, built), *excitation_statements(task.records, answer)]


def _open_places(task: Task, built: Built) -> list[str]:
    """Fitted thresholds whose place the records leave open."""
    block = built.best.blocks.chosen.hysteresis
    if block.threshold_covariance is None:
        return []
    grids = [pair.thresholds_v for pair in block.pairs[0]]
    places = [(name, r) for name, grid in zip(task.records[0].inputs, grids, strict=True) for r in grid]
    found: dict[str, list[str]] = {}
    for i in block.threshold_covariance.open:
        found.setdefault(places[i][0], []).append(f"{places[i][1]:.3g}")
    return [
        f"the place of {len(own)} of the thresholds of input {name} ({', '.join(own)} V): its standard error "
        "is more than half of the way to a neighbour. The errors of the others hold with these where they are"
        for name, own in found.items()
    ]


def _offsets(best: Candidate, task: Task) -> Array:
    """Reading (record, output) that belongs to an output of zero [um]."""
    return np.array(
        [
            (record.y_um - best.predict(record, start))[:, start.first :].mean(axis=1)
            for record, start in zip(task.records, task.starts, strict=True)
        ]
    )


def _model(
    task: Task, fit: Fit, best: Candidate, name: str, instruments: Instruments | None
) -> HammersteinModel:
    record = task.records[0]
    bandwidth = fit.sensor_bandwidth_hz
    if instruments is None:
        instruments = Instruments.ideal(record.sample_time_s)
        if bandwidth is not None:
            sensor = instruments.sensor.model_copy(update={"bandwidth_hz": bandwidth})
            instruments = instruments.model_copy(update={"sensor": sensor})
    return HammersteinModel(
        name=name,
        hysteresis=best.hysteresis,
        dynamics=best.dynamics,
        amplitude_v=fit.amplitude_v,
        inputs=record.inputs,
        outputs=record.outputs,
        instruments=instruments,
        provenance={
            "records": [Path(r.source).name for r in task.records],
            "method": fit.method,
            "amplitudes_v": list(fit.amplitudes_v),
            "delay_samples": fit.delay_samples,
            "invertible": fit.invertible,
            "invertibility": fit.invertibility,
        },
        voltages=fit.voltages,
        verdict=Verdict(
            flagged=bool(fit.flags),
            statements=fit.flags,
            held_out=bool(fit.held),
            sentence=fit.verdict,
            nrmse_percent=fit.judged[fit.kind].nrmse_percent,
        ),
    )

"""From records to a model and an account of how far it can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.candidates import (
    Built,
    Task,
    build_second_order,
    build_state_space,
    build_static,
)
from hammerstein.identification.excitation import answers, excitation_statements, refuse_noise, refuse_one_way
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.kinds import with_hysteresis
from hammerstein.identification.linear.delay import static_delay
from hammerstein.identification.linear.second_order import FirstGuess, checked_delay, search_axes
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
from hammerstein.identification.static.history import (
    StartMode,
    cautious_start,
    closed,
    judged_starts,
    shortened,
)
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import Layout, direct_pairs, fit_static, half_swing
from hammerstein.identification.verdict import (
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
from hammerstein.records.faults import Fault, faults
from hammerstein.records.preparation import prepare, refuse_swapped
from hammerstein.records.record import Record
from hammerstein.voltages import Verdict, Voltages

Array = NDArray[np.float64]
Progress = Callable[[str], None]
P = ParamSpec("P")
T = TypeVar("T")

DELAY_OPERATORS = 15
"""Operators with which the delay is found where their number is still open."""
FIRST_OPERATORS = 8
FIRST_SAMPLES = 50_000
"""Operators and samples of the first model, which only tells how the records begin."""


class Judgement(NamedTuple):
    """Errors of every kind of model on the records fitted and held back, and how far each input is heard."""

    fitted: dict[Kind, Score]
    judged: dict[Kind, Score]
    held: tuple[Record, ...]
    held_starts: tuple[Start, ...]
    answer: Array


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

    Four kinds of model are fitted beside each other where dynamics are asked for, two without: linear gain,
    static Prandtl-Ishlinskii block, linear dynamics alone, and the Hammerstein model. The largest is
    returned; the verdict says whether its blocks earn their place.

    Parameters
    ----------
    records : experiments on one actuator, with any inputs driven in each
    settings : how it is done; least squares with 15 operators and no dynamics if not given
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
    >>> model, fit = identify([record], Settings(thresholds_v=[0.0, 1.0, 2.0], error_curve=False))
    >>> model.hysteresis.pairs[0][0].weights_um_per_v.round(6), fit.invertible
    (array([3., 1., 1.]), True)
    """
    settings = settings or Settings()
    if settings.hysteresis == "rate_dependent" and settings.delay_samples is None:
        settings = replace(settings, delay_samples=0)  # plays alone would take widening loops for a delay
    tell = progress or (lambda _: None)
    ready, notes = _ready(records)
    held, held_notes = _ready(validation) if validation else ((), [])
    _refuse_mixed([*ready, *held])
    if settings.dynamics == "none":
        refuse_one_way(ready)
    tell("looking at how the records begin")
    guess, first = _first_model(ready, settings, tell)
    task, curve = _task(ready, settings, guess, first, tell)
    task, guess = _with_checked_delay(task, guess)
    built = with_hysteresis(task, _build(task, guess))
    best = built.candidates[built.kind]
    answer = answers(best, ready, task.starts)
    refuse_noise(ready, answer)
    held_starts = judged_starts(held, best.predict, _settle_s(guess), _start_mode(settings))
    tell("judging the models")
    fitted = {kind: score(c, ready, task.starts) for kind, c in built.candidates.items()}
    judged = {kind: score(c, held, held_starts) for kind, c in built.candidates.items()} if held else {}
    errors = Judgement(fitted, judged, held, held_starts, answer)
    voltages = voltages_of(records, ready, task.starts)
    fit = _account(task, built, curve, errors, voltages, [*notes, *held_notes])
    return _model(task, fit, best, name, instruments), fit


def _ready(records: Sequence[Record]) -> tuple[tuple[Record, ...], list[str]]:
    """Records without their dead start, counted from where they began, and what was done to them."""
    if not records:
        raise InputError("records", "none was given")
    _refuse_mixed(records)
    refuse_swapped(records)
    ready, notes = [], []
    for record in records:
        notes += [
            f"{record.source}: outliers of {found.column} are left out: {found.describe()}"
            for found in record.outliers
        ]
        prepared = prepare(record)
        if prepared.dead_start_samples and prepared.at_rest:
            ready.append(prepared.record)
            offsets = ", ".join(f"{v:.4g}" for v in prepared.offset_v)
            notes.append(
                f"{record.source}: a dead start of {prepared.dead_start_samples} samples was cut off; "
                f"voltages count from their values at rest ({offsets} V)"
            )
        else:
            ready.append(counted(record))
    return tuple(ready), notes


def _refuse_mixed(records: Sequence[Record]) -> None:
    shapes = {(len(record.u_v), len(record.y_um)) for record in records}
    if len(shapes) > 1:
        listed = ", ".join(f"{m} inputs and {p} outputs" for m, p in sorted(shapes))
        raise InputError("records", f"do not have the same axes: {listed}")


def _start_mode(settings: Settings) -> StartMode:
    """Without a model of how it rings, a start from rest cannot be told from the records."""
    return "repeated" if settings.dynamics == "state_space" and settings.start == "auto" else settings.start


def _settle_s(guess: FirstGuess | None) -> float:
    return 0.0 if guess is None else guess.settle_s


def _first_model(
    records: tuple[Record, ...], settings: Settings, tell: Progress
) -> tuple[FirstGuess | None, Candidate]:
    """A quick model that tells how the records begin, and the resonances it was found with."""
    cautious = [cautious_start(record) for record in records]
    guess = None
    if settings.dynamics == "second_order":
        guess = search_axes(
            records,
            cautious,
            delay_samples=settings.delay_samples,
            sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
            progress=tell,
        )
    quick, begun = shortened(records, cautious, FIRST_SAMPLES)
    delay = guess.delay_samples if guess else settings.delay_samples or 0
    row = input_grids(quick, FIRST_OPERATORS, "voltage")
    task = Task(quick, begun, [list(row) for _ in quick[0].y_um], delay, settings, tell)
    dynamics = guess.dynamics() if guess else StaticDynamics(n_outputs=task.outputs)
    found = fit_static(
        quick,
        task.thresholds_v,
        method="least_squares",
        starts=begun,
        delay_samples=delay,
        through=task.paths(dynamics) or None,
    )
    return guess, task.candidate(found.hysteresis, dynamics)


def _task(
    records: tuple[Record, ...],
    settings: Settings,
    guess: FirstGuess | None,
    first: Candidate,
    tell: Progress,
) -> tuple[Task, tuple[CurvePoint, ...]]:
    """Starts, delay and thresholds of the records."""
    starts = judged_starts(records, first.predict, _settle_s(guess), _start_mode(settings))
    few, begun = shortened(records, starts, CURVE_SAMPLES)
    delay = guess.delay_samples if guess else settings.delay_samples
    if delay is None:
        delay = 0
        if settings.dynamics == "none" and not all(closed(record) for record in records):
            tell("searching the delay")  # single loops cannot tell it from hysteresis
            delay, _ = static_delay(few, _fine(settings).thresholds(few, DELAY_OPERATORS), begun)
    task = Task(records, starts, (), delay, settings, tell)
    curve: tuple[CurvePoint, ...] = ()
    wanted = settings.error_curve or settings.operators == "auto"
    if wanted and settings.dynamics != "state_space":
        tell("trying numbers of operators")
        paths = task.paths(first.dynamics)
        curve = error_curve(records, starts, partition=settings.partition, delay_samples=delay, through=paths)
    chosen = enough_operators(curve) if curve else 15
    return Task(records, starts, settings.thresholds(records, chosen), delay, settings, tell), curve


def _fine(settings: Settings) -> Settings:
    """Settings with so many operators that a delay does not stand in for thresholds that are missing."""
    few = isinstance(settings.operators, int) and settings.operators < DELAY_OPERATORS
    return replace(settings, operators=DELAY_OPERATORS) if few else settings


def _with_checked_delay(task: Task, guess: FirstGuess | None) -> tuple[Task, FirstGuess | None]:
    """Task and resonances with the delay that is best with the thresholds of the task."""
    if guess is None:
        return task, None
    task.progress("checking the delay")
    checked = checked_delay(
        task.records,
        task.starts,
        Layout.of(task.thresholds_v).grids,
        guess,
        sensor_bandwidth_hz=task.settings.sensor_bandwidth_hz,
    )
    return replace(task, delay_samples=checked.delay_samples), checked


def _build(task: Task, guess: FirstGuess | None) -> Built:
    if guess is not None:
        return build_second_order(task, guess)
    return build_state_space(task) if task.settings.dynamics == "state_space" else build_static(task)


def _account(
    task: Task,
    built: Built,
    curve: tuple[CurvePoint, ...],
    errors: Judgement,
    voltages: Voltages,
    notes: list[str],
) -> Fit:
    """Everything that is said about the model."""
    fitted, judged, held, held_starts, answer = errors
    record, settings, best = task.records[0], task.settings, built.candidates[built.kind]
    named = [fault for one in task.records for fault in faults(one)]
    flags, bounds = _flags(task, built, named), []
    if settings.method == "invertible" and settings.hysteresis == "prandtl_ishlinskii":
        spoiled = {name for fault in named for name in fault.outputs}
        bounds = bound_notes(
            task.records, built.blocks.chosen, built.blocks.free, built.kind == "hammerstein", spoiled
        )
    swing = half_swing(task.records)
    amplitude = float(swing.max())
    block, reached = best.hysteresis, amplitude
    if settings.hysteresis != "prandtl_ishlinskii":
        rest = np.array(voltages.working_point_v)
        block, reached = block.counted_from(rest), np.array([voltages.lowest_v, voltages.highest_v]) - rest
    invertible, sentence = invertibility_of(
        block, best.dynamics, reached, record.sample_time_s, record.inputs
    )
    return Fit(
        inputs=record.inputs,
        outputs=record.outputs,
        kind=built.kind,
        fit=fitted,
        validation=judged,
        method=settings.method,
        operators=best.hysteresis.operators,
        amplitude_v=amplitude,
        amplitudes_v=tuple(swing.tolist()),
        voltages=voltages,
        delay_samples=task.delay_samples,
        sample_time_s=record.sample_time_s,
        sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
        offsets_um=tuple(tuple(row) for row in _offsets(best, task).tolist()),
        starts=task.starts,
        held_starts=held_starts,
        axes=built.axes,
        order=settings.order,
        error_curve=curve,
        not_identifiable=tuple(_unknown(task, built, answer)),
        flags=tuple(flags),
        notes=(*notes, *built.notes, *bounds),
        invertible=invertible,
        invertibility=sentence,
        verdict=verdict(judged or fitted, bool(judged), flags, settings.dynamics),
        candidates=built.candidates,
        records=task.records,
        held=held,
    )


def _flags(task: Task, built: Built, named: Sequence[Fault]) -> list[str]:
    """What spoils the records, and what a model of this kind cannot represent."""
    blocks, outputs = built.blocks, task.records[0].outputs
    spoiled = {(fault.source, name) for fault in named for name in fault.outputs}
    direct = [
        (o, k)
        for o, k in direct_pairs(blocks.free.hysteresis.gain(float(half_swing(task.records).max())))
        if outputs[o] not in {name for _, name in spoiled}
    ]
    flags = [fault.text for fault in named]
    flags += record_flags(built.candidates[built.kind], task.records, task.starts, spoiled)
    if task.settings.dynamics == "none":
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
        for o, k in built.blocks.chosen.open
    ]
    axes = axis_statements(record.outputs, built.axes) if built.axes else []
    return [*axes, *sums, *_open_places(task, built), *excitation_statements(task.records, answer)]


def _open_places(task: Task, built: Built) -> list[str]:
    """Fitted thresholds whose place the records leave open."""
    block = built.blocks.chosen.hysteresis
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

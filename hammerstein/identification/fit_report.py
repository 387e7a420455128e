"""Statements about an identified model, and its file."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.dynamics import AxesDynamics, StateSpaceDynamics
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.hysteresis.asymmetric import PLAYS_ALONE
from hammerstein.identification.excitation import excitation_statements
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.linear.axis_fit import AxisFit
from hammerstein.identification.linear.delay import delay_in_samples
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.operators import CurvePoint
from hammerstein.identification.residual_analysis import (
    butterfly_flags,
    faults_left,
    is_flag,
    record_flags,
    residual_statements,
    shape_flags,
    state_flags,
    stated_errors,
    turning_back_flags,
    untried,
)
from hammerstein.identification.score import Candidate, Score, invertibility_of, ranges, rest_errors
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import direct_pairs, half_swing
from hammerstein.identification.task import CandidateSet, FittedModel, Task
from hammerstein.identification.verdict import axis_statements, bound_notes, verdict
from hammerstein.model import HammersteinModel
from hammerstein.model.covariance import ParameterCovariance
from hammerstein.quantities import by_key
from hammerstein.records.faults import Fault
from hammerstein.records.record import Record
from hammerstein.signals.units import spoken

NIL_THRESHOLD = 1e-3
"""Part of the half swing up to which a threshold is as good as 0, so that its place limits nothing."""


class Errors(NamedTuple):
    """Errors of every kind of model on the records fitted and held back, and the response to each input.

    given : the fitted records as they were given
    """

    fitted: dict[Kind, Score]
    judged: dict[Kind, Score]
    held: tuple[Record, ...]
    held_starts: tuple[InitialState, ...]
    response: Array
    trials: tuple[Trial, ...]
    given: tuple[Record, ...]


def left_out(records: Sequence[Record]) -> list[str]:
    """Outliers that the records were read without."""
    return [
        f"{record.source}: excluded outliers of {found.column}: {found.describe()}"
        for record in records
        for found in record.outliers
    ]


def fit_of(
    task: Task,
    built: CandidateSet,
    curve: tuple[CurvePoint, ...],
    errors: Errors,
    voltages: Voltages,
    known: ParameterCovariance | None,
) -> Fit:
    """Everything that is said about the model."""
    fitted, judged, held, held_starts, response, trials, given = errors
    record, settings, best = task.records[0], task.settings, built.best.candidate
    named = faults_left(best, task.records, task.starts)
    flags, plain = _flags(task, built, named), PLAYS_ALONE in built.notes
    zeros_um = offsets(best, task.records, task.starts)
    flags += state_flags(given, np.array(zeros_um), np.array(fitted[built.kind].rms_um))
    where = (held, held_starts) if held else (task.records, task.starts)
    residual = [*residual_statements(best, *where, settings)]
    swing = half_swing(task.records)
    invertible, sentence = _invertible(task, best, voltages)
    return Fit(
        inputs=record.inputs,
        outputs=record.outputs,
        kind=built.kind,
        fit=fitted,
        validation=judged,
        solver=settings.solver,
        operators=best.hysteresis.operators,
        amplitude_v=float(swing.max()),
        amplitudes_v=tuple(swing.tolist()),
        voltages=voltages,
        delay_samples=delay_in_samples(best.dynamics.input_delay_s, record.sample_time_s),
        sample_time_s=record.sample_time_s,
        sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
        sensor_delay_s=settings.sensor_delay_s,
        offsets_um=zeros_um,
        starts=task.starts,
        held_starts=held_starts,
        axes=_sure_axes(built.best, known),
        trials=trials,
        order=len(best.dynamics.A) if isinstance(best.dynamics, StateSpaceDynamics) else None,
        error_curve=curve,
        not_identifiable=tuple(_unknown(task, built, response, known)),
        flags=tuple(flags),
        notes=(
            *left_out([*task.records, *held]),
            *(fault.text for fault in named if not is_flag(fault, task.records)),
            *built.notes,
            *_bounds(task, built, named),
        ),
        invertible=invertible,
        invertibility=sentence,
        verdict=verdict(
            judged or fitted, bool(judged), flags, settings.dynamics, built.kind, residual, plain
        ),
        candidates=built.candidates,
        alone=built.alone,
        other_kinds=bool(residual) and settings.hysteresis == "prandtl_ishlinskii" and not untried(settings),
        covariance=known,
        records=task.records,
        held=held,
    )


def _bounds(task: Task, built: CandidateSet, named: Sequence[Fault]) -> Iterator[str]:
    """Slopes that the inverse needs and the records would have otherwise."""
    settings, blocks = task.settings, built.best.blocks
    if settings.solver == "invertible" and settings.hysteresis == "prandtl_ishlinskii":
        spoiled, dynamic = {name for fault in named for name in fault.outputs}, built.kind == "hammerstein"
        yield from bound_notes(task.records, blocks.chosen, blocks.free, dynamic, spoiled)


def _invertible(task: Task, best: Candidate, voltages: Voltages) -> tuple[bool, str]:
    """Whether the model has an inverse over the recorded range, and a sentence that says so."""
    record, block = task.records[0], best.hysteresis
    reached: float | Array = float(half_swing(task.records).max())
    if task.settings.hysteresis != "prandtl_ishlinskii":
        rest = np.array(voltages.working_point_v)
        block, reached = block.counted_from(rest), np.array([voltages.lowest_v, voltages.highest_v]) - rest
    return invertibility_of(block, best.dynamics, reached, record.sample_time_s, record.inputs)


def _flags(task: Task, built: CandidateSet, named: Sequence[Fault]) -> list[str]:
    """What spoils the records, and what a model of this kind cannot represent."""
    blocks, outputs = built.best.blocks, task.records[0].outputs
    spoiled = {(fault.source, name) for fault in named for name in fault.outputs}
    pairs = direct_pairs(blocks.free.hysteresis.gain(float(half_swing(task.records).max())))
    direct = [(o, k) for o, k in pairs if outputs[o] not in {name for _, name in spoiled}]
    flags = [fault.text for fault in named if is_flag(fault, task.records)]
    flags += record_flags(built.best.candidate, task.records, task.starts, spoiled)
    if built.kind in ("linear", "static_hysteresis"):
        flags += butterfly_flags(task.records, direct)
    if not any("no rising loop" in flag for flag in flags):
        flags += turning_back_flags(built.best.candidate, task.records, task.starts, pairs)
    if blocks.one_sign is not None and task.settings.hysteresis == "prandtl_ishlinskii":
        spans = ranges(task.records, task.starts)
        flags += shape_flags(task.records, blocks.free, blocks.one_sign, spans, direct)
    return flags


def _unknown(
    task: Task, built: CandidateSet, response: Array, known: ParameterCovariance | None
) -> list[str]:
    """Parameters that the excitation cannot identify."""
    record = task.records[0]
    sums = [
        (
            f"individual weights from {record.inputs[k]} to {record.outputs[o]}: the records only "
            "determine sums of them"
        )
        for o, k in built.best.blocks.chosen.open
    ]
    own = _sure_axes(built.best, known) if built.best.axes else built.axes
    axes = axis_statements([*map(spoken, record.outputs)], own) if own else []
    return [*axes, *sums, *_open_places(task, built, known), *excitation_statements(task.records, response)]


def _sure_axes(best: FittedModel, known: ParameterCovariance | None) -> tuple[AxisFit, ...]:
    """The axes with their errors beside all other parameters."""
    dynamics = best.candidate.dynamics
    if known is None or not isinstance(dynamics, AxesDynamics) or len(best.axes) != len(dynamics.axes):
        return best.axes
    first = len(known.factor) - len(dynamics.free)
    ends = first + np.cumsum([len(axis.free) for axis in dynamics.axes])[:-1]
    errors = np.split(known.errors, [first, *ends])[1:]
    alike = zip(best.axes, dynamics.axes, errors, strict=True)
    return tuple(fit.with_errors(own) if fit.axis == axis else fit for fit, axis, own in alike)


def _open_places(task: Task, built: CandidateSet, known: ParameterCovariance | None) -> list[str]:
    """Fitted thresholds whose place the records leave open."""
    block = built.best.candidate.hysteresis
    if known is None or not isinstance(block, PrandtlIshlinskii):
        return []
    least_v = NIL_THRESHOLD * half_swing(task.records)
    places = [(k, r) for k, n in enumerate(block.bank.n) for r in block.bank.r[k, :n]]
    far = [(task.records[0].inputs[k], r) for k, r in (places[i] for i in known.open) if r > least_v[k]]
    return [
        f"threshold{'s' * (len(own) > 1)} {', '.join(f'{r:.3g}' for _, r in own)} V of input {name}: the "
        "records hardly determine the distance to the next ones"
        for name, own in by_key(far, lambda place: place[0]).items()
    ]


def offsets(
    best: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> tuple[tuple[float, ...], ...]:
    """Reading (record, output) that belongs to an output of zero [um]."""
    return tuple(
        tuple((record.y_um - best.predict(record, start))[:, start.first :].mean(axis=1).tolist())
        for record, start in zip(records, starts, strict=True)
    )


def _rest_um(fit: Fit, best: Candidate) -> tuple[float, ...]:
    """Error of each output at rest, on validation records that begin there, else on fitted ones [um]."""
    for records, starts in ((fit.held, fit.held_starts), (fit.records, fit.starts)):
        if (found := rest_errors(best, records, starts)) is not None:
            return tuple(found.tolist())
    return ()


def model_of(fit: Fit, best: Candidate, name: str, instruments: Instruments | None) -> HammersteinModel:
    """What the model file holds: blocks, voltages as recorded, instruments and verdict."""
    record = fit.records[0]
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
            "records": [Path(r.source).name for r in fit.records],
            "solver": fit.solver,
            "amplitudes_v": list(fit.amplitudes_v),
            "delay_samples": fit.delay_samples,
            "invertible": fit.invertible,
            "invertibility": fit.invertibility,
        },
        voltages=fit.voltages,
        covariance=fit.covariance,
        verdict=Verdict(
            flagged=bool(fit.flags),
            statements=fit.flags,
            held_out=bool(fit.held),
            sentence=fit.verdict,
            **stated_errors(fit.judged[fit.kind], fit.held or fit.records),
            rest_um=_rest_um(fit, best),
        ),
    )

"""Statements about an identified model: verdict, unidentified parameters, and its file."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.dynamics import AxesDynamics, StateSpaceDynamics
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.hysteresis.asymmetric import PLAYS_ALONE
from hammerstein.identification.excitation import excitation_statements
from hammerstein.identification.fit import KIND_NAMES, CandidateSet, Fit, FittedModel, Kind, Task
from hammerstein.identification.linear.axis_fit import SURE_CREEP, UNSURE_LAG_PERCENT, AxisFit
from hammerstein.identification.model_selection import IMPROVED, NO_BETTER, CurvePoint, Trial, lowers
from hammerstein.identification.options import PLAYS
from hammerstein.identification.residual_analysis import (
    faults_left,
    flags_of,
    is_flag,
    residual_statements,
    state_flags,
    stated_errors,
    untried_thresholds,
)
from hammerstein.identification.score import Candidate, Score, invertibility_of, rest_errors
from hammerstein.identification.search import delay_in_samples
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import half_swing
from hammerstein.model import HammersteinModel
from hammerstein.model.covariance import ParameterCovariance
from hammerstein.quantities import by_key, interval
from hammerstein.records.faults import Fault
from hammerstein.records.loops import pair_loops
from hammerstein.records.record import Record, driven_inputs
from hammerstein.signals.units import spoken

NIL_THRESHOLD = 1e-3
"""Threshold, in parts of the half swing, that counts as 0."""
ALIKE = 0.05
"""Part by which the amplitudes of two loops may differ for their widths to be compared."""
FASTER, WIDER, WIDER_PERCENT = 1.5, 1.15, 1.0
"""Rates that are two, and what makes a loop the wider one: parts of the other, and percent of the height."""
UNSURE_DAMPING_PERCENT = 30.0  # standard error of a damping ratio from which it is named
LASTING = 10.0
"""Time constants for which a step must be held to tell a slow mode from an offset."""
NO_CREEP = 1e-3
"""Standard error of a gain of creep below which a gain of none means that there is no creep to speak of."""
UNTOLD = (
    "You asked for dynamics, but the records do not identify any: THIS MODEL IS STATIC. Add records "
    "nearer to the resonance, such as faster sines, steps or a multisine."
)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Records with fitted play and linear models, the start of a fit of any kind.

    given : the fitted records as they were given; held : the validation records
    response : to each input, see ``responses``
    """

    given: tuple[Record, ...]
    task: Task
    built: CandidateSet
    curve: tuple[CurvePoint, ...]
    held: tuple[Record, ...]
    held_starts: tuple[InitialState, ...]
    response: Array
    trials: tuple[Trial, ...]


def left_out(records: Sequence[Record]) -> list[str]:
    """Outliers excluded from the records."""
    return [
        f"{record.source}: excluded outliers of {found.column}: {found.describe()}"
        for record in records
        for found in record.outliers
    ]


def fit_of(
    prepared: Prepared,
    fitted: dict[Kind, Score],
    judged: dict[Kind, Score],
    voltages: Voltages,
    known: ParameterCovariance | None,
) -> Fit:
    """Fit report of the model.

    fitted, judged : errors of every kind of model on the records fitted and held back
    """
    task, built, held, held_starts = prepared.task, prepared.built, prepared.held, prepared.held_starts
    record, settings, best = task.records[0], task.settings, built.best.candidate
    named = faults_left(best, task.records, task.starts)
    flags, plain = flags_of(task, built, named), PLAYS_ALONE in built.notes
    zeros_um = offsets(best, task.records, task.starts)
    rms_um, asked = np.array(fitted[built.kind].rms_um), settings.start_mode != "auto"
    flags += state_flags(prepared.given, np.array(zeros_um), rms_um, chosen=not asked)
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
        trials=prepared.trials,
        order=len(best.dynamics.A) if isinstance(best.dynamics, StateSpaceDynamics) else None,
        error_curve=prepared.curve,
        not_identifiable=tuple(_unknown(task, built, prepared.response, known)),
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
        other_kinds=bool(residual) and settings.hysteresis == PLAYS and not untried_thresholds(settings),
        covariance=known,
        records=task.records,
        held=held,
    )


def _invertible(task: Task, best: Candidate, voltages: Voltages) -> tuple[bool, str]:
    """Whether the model has an inverse over the recorded range, and a sentence that says so."""
    record, block = task.records[0], best.hysteresis
    reached: float | Array = float(half_swing(task.records).max())
    if task.settings.hysteresis != PLAYS:
        rest = np.array(voltages.working_point_v)
        block, reached = block.counted_from(rest), np.array([voltages.lowest_v, voltages.highest_v]) - rest
    return invertibility_of(block, best.dynamics, reached, record.sample_time_s, record.inputs)


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
    """Model for the file: blocks, recorded voltages, instruments and verdict."""
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


def verdict(
    scores: Mapping[Kind, Score],
    held_back: bool,
    flags: Sequence[str],
    dynamics: str = "none",
    kept: Kind | None = None,
    residual: Sequence[str] = (),
    plain: bool = False,
) -> str:
    """Sentences on the blocks that improve the model, from the mean errors of the kinds of model.

    Errors beyond noise come first. ``dynamics`` is the requested option: if the records do not identify any,
    the verdict says so. ``kept`` is the kind in the model file; if not given, the largest. ``plain``: it has
    plays alone, although another hysteresis was requested, so that nothing is said of what lies beyond plays.

    Examples
    --------
    >>> scores = {
    ...     "linear": Score((7.4,), (3.0,), (20.0,)),
    ...     "static_hysteresis": Score((0.8,), (0.3,), (2.0,)),
    ... }
    >>> print(verdict(scores, True, ()))
    On validation records: linear gain 7.4 %, static hysteresis 0.8 % of the range. Hysteresis improves \
the model: it lowers the error from 7.4 to 0.8 %.
    """
    errors = {kind: score.mean_percent for kind, score in scores.items()}
    where = "On validation records" if held_back else "On the fitted records (no validation record)"
    if any(len(score.nrmse_percent) > 1 for score in scores.values()):
        where += ", mean of the outputs"
    listed = ", ".join(f"{KIND_NAMES[kind]} {error:.3g} %" for kind, error in errors.items())
    sentences = [f"{where}: {listed} of the range."]
    if {"linear_dynamics", "hammerstein"} <= errors.keys() and kept != "static_hysteresis":
        sentences.append(_improves("The hysteresis block", errors["linear_dynamics"], errors["hammerstein"]))
        sentences.append(_improves("The linear dynamics", errors["static_hysteresis"], errors["hammerstein"]))
    elif "in_loop" in errors:
        sentences.append(_improves("Hysteresis in the loop", errors["linear_dynamics"], errors["in_loop"]))
    elif {"classical", "hammerstein"} <= errors.keys() and lowers(
        errors["classical"], errors["static_hysteresis"], IMPROVED
    ):  # plays that were fitted anew may be no better than static ones with thresholds of their own
        sentences.append(_improves("The linear dynamics", errors["static_hysteresis"], errors["classical"]))
    else:
        sentences.append(_improves("Hysteresis", errors["linear"], errors["static_hysteresis"]))
    if "classical" in errors and not plain:
        best = errors.get("hammerstein", errors["static_hysteresis"])
        sentences.append(_improves("Hysteresis beyond plays", errors["classical"], best))
    static = kept in ("linear", "static_hysteresis") or "hammerstein" not in errors
    if dynamics not in ("none", "auto") and static:
        sentences.insert(0, UNTOLD)
    largest = next(reversed([kind for kind in KIND_NAMES if kind in errors and kind != "classical"]))
    if kept is not None and kept != largest:
        sentences.append(
            f"The chosen model is {KIND_NAMES[kept]}: {KIND_NAMES[largest]} has more parameters and "
            f"is {NO_BETTER}."
        )
    sentences[:0] = residual
    if flags:
        model = "model" if {"classical", "in_loop"} & errors.keys() else "classical model"
        sentences.append(f"The {model} cannot represent these records: " + "; ".join(flags) + ".")
    return " ".join(sentences)


def _improves(block: str, without: float, with_it: float) -> str:
    plural = block.endswith("dynamics")
    improve, it, lower = ("improve", "they", "lower") if plural else ("improves", "it", "lowers")
    if lowers(with_it, without, IMPROVED):
        return f"{block} {improve} the model: {it} {lower} the error from {without:.3g} to {with_it:.3g} %."
    do, it = ("do", "them") if plural else ("does", "it")
    errors = f"{without:.3g} % without and {with_it:.3g} % with {it}"
    return f"{block} {do} not improve the model: the error is {errors}."


def axis_statements(outputs: Sequence[str], axes: Sequence[AxisFit]) -> Iterator[str]:
    """Parameters of each axis that the excitation does not identify."""
    for name, fit in zip(outputs, axes, strict=True):
        if fit.one_rate and fit.axis.lag_s is not None:
            yield (
                f"lag of {name}: at the only rate in the records, hysteresis looks like a lag; "
                "record another rate"
            )
        elif fit.one_rate and fit.axis.resonance_hz is not None:
            yield (
                f"resonance and damping of {name}: {fit.axis.resonance_hz:.4g} Hz is among the first "
                "harmonics of the only rate in the records, which hysteresis makes, too; record another rate"
            )
        elif not fit.identified:
            yield (
                f"resonance and damping of {name}: dynamics {_how_much_better(fit)} ({fit.rms_um:.4g} "
                f"um with, {fit.static_rms_um:.4g} um without, both with the initial thresholds); excite the "
                "axis nearer to its resonance"
            )
        elif fit.axis.resonance_hz is None:
            yield f"resonance and damping of {name}: a low-pass fits the records equally well"
        elif not fit.excited:
            yield (
                f"resonance and damping of {name}: {fit.axis.resonance_hz:.4g} Hz is outside the "
                "excited band; the value only represents the lag below it"
            )
        elif fit.damping_error_percent is not None and fit.damping_error_percent > UNSURE_DAMPING_PERCENT:
            yield f"damping of {name}: standard error {fit.damping_error_percent:.0f} %"
        if fit.lag_error_percent is not None and fit.lag_error_percent > UNSURE_LAG_PERCENT:
            error_s = 0.01 * fit.lag_error_percent * (fit.axis.lag_s or 0.0)
            known = f"{interval(fit.axis.lag_s or 0.0)} ± {interval(error_s)}"
            none = f"not identifiable from the records (best fit: {interval(fit.axis.lag_s or 0.0)})"
            yield f"lag of {name}: {none if fit.lag_error_percent > 100.0 else known}"
        for mode, error in zip(fit.axis.creep, fit.creep_gain_errors, strict=True):
            if abs(mode.gain) < 2.0 * error:
                small = error < NO_CREEP
                longer = f"record a step that is held for {interval(LASTING * mode.time_constant_s)}"
                remedy = "the records show none; ask for fewer modes" if small else longer
                yield (
                    f"creep of {name} with a time constant of {mode.time_constant_s:.3g} s: gain "
                    f"{mode.gain:.2g} ± {error:.2g}; {remedy}"
                )
        yield from _unsure_creep(name, fit)


def _unsure_creep(name: str, fit: AxisFit) -> Iterator[str]:
    """Slow modes that were left out although they lower the error."""
    larger = fit.unsure
    if larger is None or not lowers(larger.rms_um, fit.rms_um, IMPROVED):
        return
    mode, error = larger.axis.creep[-1], larger.creep_gain_errors[-1]
    size = f"{mode.gain:.2g} ± {error:.2g}"
    told = abs(mode.gain) >= SURE_CREEP * error
    why = f"{'the records are too short or too slow for it' if told else 'its gain is uncertain'} ({size})"
    yield (
        f"creep of {name}: a slow mode with a time constant of {mode.time_constant_s:.3g} s would "
        f"lower the error from {fit.rms_um:.3g} to {larger.rms_um:.3g} um, but {why}; record a step "
        f"that is held for {interval(LASTING * mode.time_constant_s)}, or keep the mode with "
        f"--creep-modes {len(larger.axis.creep)}"
    )


def _how_much_better(fit: AxisFit) -> str:
    if not lowers(fit.rms_um, fit.static_rms_um):
        return "do not lower the error"
    if fit.lowers_the_error:
        return "lower the error, but the records do not determine them"
    return "hardly lower the error"


def _bounds(task: Task, built: CandidateSet, named: Sequence[Fault]) -> Iterator[str]:
    """Slopes of direct pairs that the inverse needs, and that the records would place below their bound.

    Slopes that the records do not determine are ignored, and so are outputs with a known fault. The note
    names phase lag as a cause only if the loops widen with the rate.
    """
    settings, records = task.settings, task.records
    if settings.solver != "invertible" or settings.hysteresis != PLAYS:
        return
    fit, free = built.best.blocks.chosen, built.best.blocks.free
    spoiled = {name for fault in named for name in fault.outputs}
    for o, k in sorted({(o, k) for o, k, _ in fit.bounded} - set(free.open)):
        name, driven = records[0].outputs[o], records[0].inputs[k]
        if name in spoiled:
            continue
        wider = "" if built.kind == "hammerstein" else widening(records, k, o)
        remedy = (
            f"{wider}: phase lag looks like hysteresis; fit the dynamics too, or record more slowly"
            if wider
            else "use fewer thresholds, or a ridge penalty"
        )
        slopes, pair = [j for oo, kk, j in fit.bounded if (oo, kk) == (o, k)], free.hysteresis.pairs[o][k]
        lowest = min(slopes, key=lambda j: float(pair.slopes[j]))
        count = "1 slope" if len(slopes) == 1 else f"{len(slopes)} slopes"
        yield (
            f"{count} from {driven} to {name} held at the lower bound so that the model stays "
            "invertible; unconstrained, the slope with thresholds up to "
            f"{pair.thresholds_v[lowest]:.3g} V would be {pair.slopes[lowest]:.3g} um/V; {remedy}"
        )


def widening(records: Sequence[Record], k: int, o: int) -> str:
    """Growth of the loop width from the slowest to the fastest rate of an amplitude, in words, if any.

    Examples
    --------
    >>> import numpy as np
    >>> n = np.arange(4000)
    >>> records = []
    >>> for period, lag in ((1000, 0.02), (200, 0.1)):
    ...     phase = 2.0 * np.pi * n / period
    ...     records.append(Record([np.sin(phase)], [50.0 * np.sin(phase - lag)], 1e-3))
    >>> widening(records, 0, 0)
    'its loop is 2 % wide at 1 Hz and 10 % at 5 Hz'
    """
    seen = [
        (loop.amplitude_v, 1.0 / (loop.samples * record.sample_time_s), loop.width_percent)
        for record in records
        if driven_inputs(record) == (k,)
        for loop in pair_loops(record, k, o)
        if not loop.minor
    ]
    for largest, _, _ in sorted(seen, reverse=True):
        alike = sorted((rate, width) for size, rate, width in seen if abs(size - largest) < ALIKE * largest)
        (slow, narrow), (fast, wide) = alike[0], alike[-1]
        if fast > FASTER * slow and wide > WIDER * narrow and wide > narrow + WIDER_PERCENT:
            return f"its loop is {narrow:.2g} % wide at {slow:.3g} Hz and {wide:.2g} % at {fast:.3g} Hz"
    return ""

"""Residual analysis: whether the prediction error is noise, or an effect that the model lacks."""

import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from pathlib import PurePath

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, StaticDynamics
from hammerstein.identification.excitation import is_noise
from hammerstein.identification.fit import CandidateSet, Task
from hammerstein.identification.options import PLAYS
from hammerstein.identification.score import AT_REST, Candidate, Score, ranges
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit, direct_pairs, half_swing
from hammerstein.records.faults import BENT_EXPLAINS, Fault, faults, hump
from hammerstein.records.record import Record, begins_at_rest, dead_start, driven_inputs
from hammerstein.records.turning_points import noise_rms, turning_points

FAR = 3.0
"""Residual rms, in parts of the noise, from which it is stated first."""
LEAST_PART = 5e-4
"""Residual rms, in parts of the range, below which it does not matter."""
STILL_DRIFTS = 0.25
"""Trend of the residual, in parts of the observed drift, from which it is drift and not creep."""
STILL_HUMP = 0.5
"""Residual part of a hump from which the reading is clipped; a model with resonance predicts ringing."""
MOST_DRIFT = 0.1
"""Largest drift of an output for a usable model, in parts of its range; 0.29 of it is in the rms error."""
UNREPRESENTED_PERCENT = 10.0  # error of an output, of its range, from which the model is no picture of it
SATURATING_PERCENT = 2.0  # of the range
SATURATING_RATIO = 3.0
"""Weights of one sign must miss the record by this much, absolutely and against free weights."""
FLATTENED = 0.6
"""Last slope, in parts of the steepest, below which a branch flattens towards its tip."""
BUTTERFLY = 0.5
"""Distance of the outputs at the tips, in parts of the range, below which a loop is no rising one."""
TIP = 0.05  # part of the range about an end of the swing
RETURNED, WHOLE_SWING = 0.05, 0.5
"""Return of an output, in parts of its range, during a monotonic voltage; smallest tested relative swing."""
OTHER_STATE = 5.0
"""Distance of the initial states of two records, in parts of the model error, from which they differ."""
OF_A_CREEPING_MODEL = (
    ". The model has creep, but some creep remains in the prediction error, perhaps because of the "
    "kind of model: hammerstein compare tries the others"
)
BELIEVED = 1.5
"""Noise, in parts of the error, from which it is none: fast motion has large differences, too."""
NOISE_ERROR = 2.6
"""Standard error of a squared rms value of white noise less that of ``noise_rms``, in parts of it, times the
root of the number of samples: that of 300 drawn signals of 400, 2,000 and 20,000 samples."""


def residual_statements(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState], settings: Settings
) -> Iterator[str]:
    """A sentence about outputs with errors far above the noise, with a proposal; none if all is well.

    Parameters
    ----------
    candidate : model
    records, starts : records for the errors, and their initial states
    settings : of the identification; only untried options are proposed
    """
    left = [candidate.residual(record, start) for record, start in zip(records, starts, strict=True)]
    samples = sum(error.shape[1] for error in left)
    rms = np.sqrt(np.sum([(error**2).sum(axis=1) for error in left], axis=0) / samples)
    noise, span = noise_um(records), ranges(records, starts)
    far = []
    for o in np.flatnonzero((rms > FAR * noise) & (rms > LEAST_PART * span)):
        hz = _strongest(records, [error[o] for error in left])
        above = float(f"{rms[o] / noise[o]:.2g}") if noise[o] > 0.0 else 0.0  # two digits, and no exponent
        times = f"{above:g} times the noise" if above else "far above the noise"
        size = f"{times} ({noise[o]:.2g} um), mostly near {hz:.3g} Hz"
        far.append(f"of {records[0].outputs[o]} ({rms[o]:.3g} um rms) is {size}")
    if far:
        yield (
            f"The prediction error {', and that '.join(far)}: the records contain an effect that the "
            f"model lacks. {_proposal(settings, len(records[0].inputs))}."
        )


def noise_um(records: Sequence[Record]) -> Array:
    """Rms white noise of each output (output,) in the median of the records [um]."""
    return np.median([[noise_rms(row) for row in record.y_um] for record in records], axis=0)


def noise_within(records: Sequence[Record], rms_um: Sequence[float]) -> Array:
    """White noise of each output (output,) that is part of an error on the records [um].

    0 for all where it is far above an error: a model cannot miss by less than noise.
    """
    noise = noise_um(records)
    return np.minimum(noise, rms_um) if (noise < BELIEVED * np.array(rms_um)).all() else 0.0 * noise


def certain_noise(records: Sequence[Record], rms_um: Sequence[float]) -> Array:
    """The same without the standard error of the difference: no model is known to be better than that."""
    certain = 1.0 - NOISE_ERROR / np.sqrt(sum(record.samples for record in records))
    most = np.sqrt(max(certain, 0.0)) * np.array(rms_um)
    return np.asarray(np.minimum(noise_within(records, rms_um), most))


def stated_errors(found: Score, records: Sequence[Record]) -> dict[str, tuple[float, ...]]:
    """Errors on records as a model file states them, with the part of them that is noise."""
    return {
        "nrmse_percent": found.nrmse_percent,
        "rms_um": found.rms_um,
        "noise_um": tuple(certain_noise(records, found.rms_um).tolist()),
        "largest_um": found.largest_um,
    }


def faults_left(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> list[Fault]:
    """Faults of the records; those that a model can explain count only if they remain in its residual."""
    named = [fault for record in records for fault in faults(record)]
    left = [fault for fault in named if _is_left(fault, candidate, records, starts)]
    dynamics = candidate.dynamics
    creeps = isinstance(dynamics, AxesDynamics) and any(axis.creep for axis in dynamics.axes)
    more = OF_A_CREEPING_MODEL if creeps else ""
    return [f._replace(text=f.text + more) if f.drift_um else f for f in left]


def is_flag(fault: Fault, records: Sequence[Record]) -> bool:
    """Whether a fault makes a model of its record unusable: the stated error includes a slow drift."""
    span = max(float(np.ptp(r.y_um[r.outputs.index(fault.outputs[0])])) for r in records)
    return not 0.0 < fault.drift_um <= MOST_DRIFT * span


def _is_left(
    fault: Fault, candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> bool:
    """Whether a fault of a record remains in the residual of the model.

    To plays alone, creep looks like drift, the bend of dead-zones like saturation, and ringing like a clipped
    voltage; a model that includes the effect leaves none of it. Plays alone never explain drift, even where
    their weights can mimic it, because it was detected beside plays.
    """
    plain = candidate.hysteresis.kind == PLAYS and isinstance(candidate.dynamics, StaticDynamics)
    if not (fault.drift_um or fault.bent_um or fault.hump_um) or (plain and fault.drift_um):
        return True
    for record, start in zip(records, starts, strict=True):
        if record.source == fault.source and fault.outputs[0] in record.outputs:
            left = candidate.residual(record, start)[record.outputs.index(fault.outputs[0])]
            if fault.hump_um:
                first, last = (i - start.first for i in fault.held)
                if first < 0:
                    return True
                rise = float(hump(math.copysign(1.0, fault.hump_um) * left[None, first : last + 1])[0])
                return rise > STILL_HUMP * abs(fault.hump_um)
            if fault.bent_um:
                return float(left.std()) >= BENT_EXPLAINS * fault.bent_um
            time = np.linspace(-1.0, 1.0, len(left))
            trend = np.polynomial.Polynomial.fit(time, left, 2)(time)
            return float(np.ptp(trend)) > STILL_DRIFTS * fault.drift_um
    return True


def _strongest(records: Sequence[Record], left: Sequence[Array]) -> float:
    """Frequency at which most is left [Hz]."""
    best = (0.0, 0.0)
    for record, error in zip(records, left, strict=True):
        power = np.abs(np.fft.rfft(np.hanning(len(error)) * error)) ** 2 / len(error)
        line = int(np.argmax(power[1:])) + 1
        best = max(best, (float(power[line]), line / (len(error) * record.sample_time_s)))
    return best[1]


def untried_thresholds(settings: Settings) -> list[str]:
    """Options for more or better thresholds that were not tried."""
    if not settings.fits_thresholds:
        return ["--operators auto --partition auto"]
    return [] if settings.operators == "auto" else ["more --operators"]


def _untried(settings: Settings) -> list[str]:
    """Options that were not tried and that add a block only if it lowers the error."""
    lag = {"second_order": ["--dynamics auto, which adds a low-pass"]}.get(settings.dynamics, [])
    first = ["--dynamics auto"] if settings.dynamics in ("none", "lag") else []
    return [*first, *untried_thresholds(settings), *lag]


def _proposal(settings: Settings, inputs: int) -> str:
    """What to try against an error far above the noise: no promise that it helps."""
    if tried := _untried(settings):
        return f"Not tried: {'; or '.join(tried)}"
    axes = inputs > 1
    fewer = f"record more slowly{', one axis at a time' * axes}"
    if settings.hysteresis == PLAYS:
        both = "model neither saturation nor coupled resonances"
        lacks = f"plays {both if axes else 'do not model saturation'}"
        return f"hammerstein compare tries every kind on these records; or {fewer}: {lacks}"
    return fewer.capitalize() + ": the model has no coupled resonances" * axes


def flags_of(task: Task, built: CandidateSet, named: Sequence[Fault]) -> list[str]:
    """Faults of the records, and effects that a model of this kind cannot represent."""
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
    if blocks.one_sign is not None and task.settings.hysteresis == PLAYS:
        flags += shape_flags(task, blocks.free, blocks.one_sign, direct)
    return flags


def record_flags(
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    explained: Collection[tuple[str, str]] = (),
) -> Iterator[str]:
    """Records with an error above ten percent of their range.

    White noise is left out, unless an output is nothing else. ``explained`` are records and outputs of which
    the cause is known.
    """
    moves = [not all(is_noise(record.y_um[o]) for record in records) for o in range(len(records[0].y_um))]
    for record, start in zip(records, starts, strict=True):
        power = np.mean(candidate.residual(record, start) ** 2, axis=1)
        rms = np.sqrt(np.maximum(power - moves * noise_um([record]) ** 2, 0.0))
        span = np.ptp(record.y_um[:, start.first :], axis=1)
        moved = span >= 0.1 * np.ptp(record.y_um, axis=1).max()
        percent = 100.0 * rms / np.where(moved, span, np.inf)
        for o in np.flatnonzero((percent > UNREPRESENTED_PERCENT) & moved):
            if (record.source, record.outputs[o]) in explained:
                continue
            yield (
                f"the error of {record.outputs[o]} in {PurePath(record.source).name} is "
                f"{percent[o]:.1f} % of its range"
            )


def state_flags(
    given: Sequence[Record], offsets_um: Array, rms_um: Array, *, chosen: bool = True
) -> Iterator[str]:
    """Records that begin at rest at equal voltages and positions, but in different states of the model.

    Of the same state, the reading that belongs to an output of zero is the same. Only records that drive the
    same inputs are compared: in what state an input is that a record holds still, it does not show.

    Parameters
    ----------
    given : records as they were given
    offsets_um : (record, output) that reading [um]; rms_um : (output,) error of the model [um]
    chosen : whether the initial states were chosen by the identification, not given
    """
    rested = [i for i, record in enumerate(given) if begins_at_rest(record)]
    still = [given[i].y_um[:, : dead_start(given[i]) + 1].mean(axis=1) for i in rested]
    swing_v = np.max([np.ptp(record.u_v, axis=1) for record in given], axis=0)
    found = []
    for (i, one), (j, other) in itertools.combinations(zip(rested, still, strict=True), 2):
        moved_v = np.abs(given[i].u_v[:, 0] - given[j].u_v[:, 0])
        driven = [np.ptp(given[k].u_v, axis=1) > AT_REST * swing_v for k in (i, j)]
        comparable = bool((driven[0] == driven[1]).all() and (moved_v <= AT_REST * swing_v).all())
        alike = (np.abs(one - other) <= rms_um) & comparable
        apart = np.abs(offsets_um[i] - offsets_um[j]) * alike / np.maximum(rms_um, np.finfo(float).tiny)
        o = int(np.argmax(apart))
        found.append((float(apart[o]), i, j, o))
    worst, i, j, o = max(found, default=(0.0, 0, 0, 0))
    if worst > OTHER_STATE:
        names = [PurePath(given[k].source).name for k in (i, j)]
        apart_um = abs(offsets_um[i, o] - offsets_um[j, o])
        remedy = ". If the actuator was never driven before, use --start rest" if chosen else ""
        yield (
            f"{names[0]} and {names[1]} begin at rest at the same voltages and positions, but the model "
            f"assumes initial states that differ by {apart_um:.3g} um of {given[0].outputs[o]}: one of them "
            f"is wrong, unless the sensor was set to zero in between{remedy}"
        )


def shape_flags(
    task: Task, free: StaticFit, one_sign: StaticFit, direct: Sequence[tuple[int, int]]
) -> Iterator[str]:
    """Saturating loops: weights of one sign do not fit them, and the branches flatten towards the tips.

    Parameters
    ----------
    task : with the fitted records
    free, one_sign : fits with free weights, and with weights of the sign of the gain
    direct : pairs (output, input) to be judged
    """
    spans_um = ranges(task.records, task.starts)
    for o, k in direct:
        missed = 100.0 * one_sign.rms_um[o] / spans_um[o]
        needed = max(SATURATING_PERCENT, SATURATING_RATIO * 100.0 * free.rms_um[o] / spans_um[o])
        slopes = np.abs(free.hysteresis.pairs[o][k].slopes)
        if missed > needed and slopes[-1] < FLATTENED * slopes.max():
            yield (
                f"{task.records[0].outputs[o]} saturates: towards the tips, the slope of its branches "
                f"falls to {100 * slopes[-1] / slopes.max():.0f} % of the steepest slope, weights of "
                f"one sign have an error of {missed:.1f} % of the range, and minor loops will be wrong"
            )


def butterfly_flags(records: Sequence[Record], direct: Sequence[tuple[int, int]]) -> Iterator[str]:
    """Butterfly loops: the output is equal at both tips of the voltage, but moves in between."""
    for o, k in direct:
        for record in records:
            u, y = record.u_v[k], record.y_um[o]
            margin = TIP * float(np.ptp(u))
            if margin == 0.0:
                continue
            rise = abs(float(y[u >= u.max() - margin].mean() - y[u <= u.min() + margin].mean()))
            if rise < BUTTERFLY * float(np.ptp(y)):
                yield (
                    f"{record.outputs[o]} of {PurePath(record.source).name} has no rising loop (a butterfly "
                    "loop or a strong lag): its tips differ by only "
                    f"{100 * rise / float(np.ptp(y)):.0f} % of the range"
                )


def turning_back_flags(
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    direct: Sequence[tuple[int, int]],
) -> Iterator[str]:
    """Loops that turn back: an output returns while its voltage keeps its direction, and the model does not.

    The return is measured up to the turn of the voltage, so that a lag, which continues after a turn, does
    not count.
    """
    for o, k in direct:
        for record, start in zip(records, starts, strict=True):
            if driven_inputs(record) != (k,):
                continue
            u, y = record.u_v[k, start.first :], record.y_um[o, start.first :]
            by_noise = math.sqrt(2.0 * math.log(len(y))) * noise_rms(y)  # largest of so many samples of noise
            said = candidate.predict(record, start)[o, start.first :]
            returned = _returned(u, y) - _returned(u, said) - by_noise
            if returned > RETURNED * float(np.ptp(y)):
                yield (
                    f"{record.outputs[o]} of {PurePath(record.source).name} turns back: it returns by "
                    f"{100.0 * returned / float(np.ptp(y)):.0f} % of its range while "
                    f"{record.inputs[k]} keeps its direction; lower the amplitude, or use one "
                    "polarity only"
                )


def _returned(u: Array, y: Array) -> float:
    """How far an output returns until the voltage turns: median of the whole rises, or of the falls [um]."""
    points = turning_points(u, WHOLE_SWING * float(np.ptp(u)))
    gain = 1.0 if np.cov(u, y)[0, 1] >= 0.0 else -1.0
    returns: dict[bool, list[float]] = {True: [], False: []}
    for a, b in itertools.pairwise(points.tolist()):
        rises = bool(u[b] > u[a])
        moved = (gain if rises else -gain) * y[a : b + 1]
        returns[rises].append(float(moved.max() - moved[-1]))
    return max(float(np.median(one)) for one in returns.values() if one) if len(points) > 1 else 0.0

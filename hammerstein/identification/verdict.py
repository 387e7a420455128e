"""Sentences about a fit: blocks that improve the model, and effects that it cannot represent."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.dynamics import Dynamics, StateSpaceDynamics, discretise
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Hysteresis
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.identification.fit import KIND_NAMES, Kind
from hammerstein.identification.linear.axis_fit import AxisFit
from hammerstein.identification.model_selection import FELT, NO_BETTER
from hammerstein.identification.rates import drive_hz
from hammerstein.identification.score import Candidate, Score
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit
from hammerstein.records.excitation import driven_inputs
from hammerstein.records.loops import pair_loops
from hammerstein.records.record import Record
from hammerstein.records.turning_points import turning_points

IMPROVED = 0.1
"""Part by which a block must lower the error to improve the model."""
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
"""Part of its range by which an output returns while the voltage goes on, from which a loop turns back on
itself; swing, in parts of the largest, of which it is asked."""
ALIKE = 0.05
"""Part by which the amplitudes of two loops may differ for their widths to be compared."""
FASTER, WIDER, WIDER_PERCENT = 1.5, 1.15, 1.0
"""Rates that are two, and what makes a loop the wider one: parts of the other, and percent of the height."""
UNSURE_PERCENT = 5.0  # standard error of a resonance from which it is named
UNSURE_DAMPING_PERCENT = 30.0  # the same of a damping ratio
UNSURE_LAG_PERCENT = 30.0  # the same of a low-pass
APART = 2.0
"""Ratio of the time constants of two slow modes from which they are two."""
SURE_CREEP = 3.0
"""Standard errors that the gain of a creep mode must have, if it was not asked for."""
LOST = 1e-3
"""Smallest gain, in parts of the largest at low frequency, that can be inverted."""
LINES = 400
"""Frequencies up to Nyquist at which the gain is looked at."""
UNTOLD = (
    "You asked for dynamics, but the records do not identify any: THIS MODEL IS STATIC. Add records "
    "nearer to the resonance, such as faster sines, steps or a multisine."
)


def verdict(
    scores: Mapping[Kind, Score],
    held_back: bool,
    flags: Sequence[str],
    dynamics: str = "none",
    kept: Kind | None = None,
    residual: Sequence[str] = (),
) -> str:
    """Sentences on the blocks that improve the model, from the mean errors of the kinds of model.

    Errors beyond noise come first. ``dynamics`` is the requested option: if the records do not identify any,
    the verdict says so. ``kept`` is the kind in the model file; if not given, the largest.

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
    listed = ", ".join(f"{KIND_NAMES[kind]} {error:.3g} %" for kind, error in errors.items())
    sentences = [f"{where}: {listed} of the range."]
    if {"linear_dynamics", "hammerstein"} <= errors.keys():
        sentences.append(_improves("The hysteresis block", errors["linear_dynamics"], errors["hammerstein"]))
        sentences.append(_improves("The linear dynamics", errors["static_hysteresis"], errors["hammerstein"]))
    elif "in_loop" in errors:
        sentences.append(_improves("Hysteresis in the loop", errors["linear_dynamics"], errors["in_loop"]))
    elif {"classical", "hammerstein"} <= errors.keys():
        sentences.append(_improves("The linear dynamics", errors["static_hysteresis"], errors["classical"]))
    else:
        sentences.append(_improves("Hysteresis", errors["linear"], errors["static_hysteresis"]))
    if "classical" in errors:
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
    if with_it <= (1.0 - IMPROVED) * without:
        return f"{block} {improve} the model: {it} {lower} the error from {without:.3g} to {with_it:.3g} %."
    do, it = ("do", "them") if plural else ("does", "it")
    errors = f"{without:.3g} % without and {with_it:.3g} % with {it}"
    return f"{block} {do} not improve the model: the error is {errors}."


def record_flags(
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    explained: Collection[tuple[str, str]] = (),
) -> list[str]:
    """Records that the model misses by more than ten percent of their range.

    ``explained`` are records and outputs of which the cause is known.
    """
    found = []
    for record, start in zip(records, starts, strict=True):
        rms = np.sqrt(np.mean(candidate.residual(record, start) ** 2, axis=1))
        span = np.ptp(record.y_um[:, start.first :], axis=1)
        moved = span >= 0.1 * np.ptp(record.y_um, axis=1).max()
        percent = 100.0 * rms / np.where(moved, span, np.inf)
        for o in np.flatnonzero((percent > UNREPRESENTED_PERCENT) & moved):
            if (record.source, record.outputs[o]) in explained:
                continue
            found.append(
                f"the error of {record.outputs[o]} in {record.source} is {percent[o]:.1f} % of its range"
            )
    return found


def shape_flags(
    records: Sequence[Record],
    free: StaticFit,
    one_sign: StaticFit,
    spans_um: Array,
    direct: Sequence[tuple[int, int]],
) -> list[str]:
    """Saturating loops: weights of one sign miss them, and the branches flatten towards the tips.

    Parameters
    ----------
    records : fitted records
    free, one_sign : fits with free weights, and with weights of the sign of the gain
    spans_um : (output,) ranges of the outputs [um]
    direct : pairs (output, input) to be judged
    """
    found = []
    for o, k in direct:
        missed = 100.0 * one_sign.rms_um[o] / spans_um[o]
        needed = max(SATURATING_PERCENT, SATURATING_RATIO * 100.0 * free.rms_um[o] / spans_um[o])
        slopes = np.abs(free.hysteresis.pairs[o][k].slopes)
        if missed > needed and slopes[-1] < FLATTENED * slopes.max():
            found.append(
                f"{records[0].outputs[o]} saturates: towards the tips, the slope of its branches "
                f"falls to {100 * slopes[-1] / slopes.max():.0f} % of the steepest slope, weights of "
                f"one sign have an error of {missed:.1f} % of the range, and minor loops will be wrong"
            )
    return found


def butterfly_flags(records: Sequence[Record], direct: Sequence[tuple[int, int]]) -> list[str]:
    """Butterfly loops: the output is alike at both tips of the voltage, though it moves in between."""
    found = []
    for o, k in direct:
        for record in records:
            u, y = record.u_v[k], record.y_um[o]
            margin = TIP * float(np.ptp(u))
            if margin == 0.0:
                continue
            rise = abs(float(y[u >= u.max() - margin].mean() - y[u <= u.min() + margin].mean()))
            if rise < BUTTERFLY * float(np.ptp(y)):
                found.append(
                    f"{record.outputs[o]} of {record.source} has no rising loop (a butterfly loop or "
                    f"a strong lag): its tips differ by only {100 * rise / float(np.ptp(y)):.0f} % of "
                    "the range"
                )
    return found


def turning_back_flags(
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    direct: Sequence[tuple[int, int]],
) -> list[str]:
    """Loops that turn back: an output returns while its voltage keeps its direction, and the model does not.

    The return is measured up to the turn of the voltage, so that a lag, which continues after a turn, does
    not count.
    """
    found = []
    for o, k in direct:
        for record, start in zip(records, starts, strict=True):
            if driven_inputs(record) != (k,):
                continue
            u, y = record.u_v[k, start.first :], record.y_um[o, start.first :]
            returned = _returned(u, y) - _returned(u, candidate.predict(record, start)[o, start.first :])
            if returned > RETURNED * float(np.ptp(y)):
                found.append(
                    f"{record.outputs[o]} of {record.source} turns back: it returns by "
                    f"{100.0 * returned / float(np.ptp(y)):.0f} % of its range while "
                    f"{record.inputs[k]} keeps its direction; lower the amplitude, or use one "
                    "polarity only"
                )
    return found


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


def axis_statements(outputs: Sequence[str], axes: Sequence[AxisFit]) -> list[str]:
    """Parameters of each axis that the excitation does not identify."""
    found = []
    for name, fit in zip(outputs, axes, strict=True):
        if fit.one_rate and fit.axis.lag_s is not None:
            found.append(
                f"lag of {name}: at the only rate in the records, hysteresis looks like a lag; "
                "record another rate"
            )
        elif fit.one_rate and fit.axis.resonance_hz is not None:
            found.append(
                f"resonance and damping of {name}: {fit.axis.resonance_hz:.4g} Hz is among the first "
                "harmonics of the only rate in the records, which hysteresis makes, too; record another rate"
            )
        elif not axis_identified(fit):
            found.append(
                f"resonance and damping of {name}: dynamics {_how_much_better(fit)} ({fit.rms_um:.4g} "
                f"um with, {fit.static_rms_um:.4g} um without); excite the axis nearer to its "
                "resonance"
            )
        elif fit.axis.resonance_hz is None:
            found.append(f"resonance and damping of {name}: a low-pass fits the records equally well")
        elif not fit.excited:
            found.append(
                f"resonance and damping of {name}: {fit.axis.resonance_hz:.4g} Hz is outside the "
                "excited band; the value only represents the lag below it"
            )
        elif fit.damping_error_percent is not None and fit.damping_error_percent > UNSURE_DAMPING_PERCENT:
            found.append(f"damping of {name}: standard error {fit.damping_error_percent:.0f} %")
        if fit.lag_error_percent is not None and fit.lag_error_percent > UNSURE_LAG_PERCENT:
            error_s = 0.01 * fit.lag_error_percent * (fit.axis.lag_s or 0.0)
            found.append(f"lag of {name}: {fit.axis.lag_s:.3g} +- {error_s:.2g} s")
        for mode, error in zip(fit.axis.creep, fit.creep_gain_errors, strict=True):
            if abs(mode.gain) < 2.0 * error:
                found.append(
                    f"creep of {name} with a time constant of {mode.time_constant_s:.3g} s: gain "
                    f"{mode.gain:.2g} +- {error:.2g}; use a record several times longer"
                )
        found += _unsure_creep(name, fit)
    return found


def _unsure_creep(name: str, fit: AxisFit) -> Iterator[str]:
    """Slow modes that were left out although they lower the error."""
    larger = fit.unsure
    if larger is None or larger.rms_um > (1.0 - IMPROVED) * fit.rms_um:
        return
    mode, error = larger.axis.creep[-1], larger.creep_gain_errors[-1]
    size = f"{mode.gain:.2g} +- {error:.2g}"
    told = abs(mode.gain) >= SURE_CREEP * error
    why = f"no record is long enough ({size})" if told else f"its gain is uncertain ({size})"
    yield (
        f"creep of {name}: a slow mode with a time constant of {mode.time_constant_s:.3g} s would "
        f"lower the error from {fit.rms_um:.3g} to {larger.rms_um:.3g} um, but {why}; record a step "
        f"that is constant for minutes, or keep the mode with --creep-modes {len(larger.axis.creep)}"
    )


def _how_much_better(fit: AxisFit) -> str:
    if fit.rms_um > (1.0 - FELT) * fit.static_rms_um:
        return "do not lower the error"
    if _lowers_the_error(fit):
        return "lower the error, but the records do not determine them"
    return "hardly lower the error"


def _lowers_the_error(fit: AxisFit) -> bool:
    return fit.rms_um <= (1.0 - (FELT if fit.excited else IMPROVED)) * fit.static_rms_um


def axis_identified(fit: AxisFit) -> bool:
    """Whether the records identify the dynamics of an axis.

    A resonance outside the excited band must lower the error as much as any block that improves the model:
    below it, it only bends the response, as drift and creep do. At a single rate, a lag and a resonance among
    the first harmonics may be hysteresis.
    """
    if fit.one_rate or not _lowers_the_error(fit):
        return False
    known = fit.resonance_error_percent is None or fit.resonance_error_percent <= UNSURE_PERCENT
    return known and (fit.lag_error_percent is None or fit.lag_error_percent <= UNSURE_LAG_PERCENT)


def creep_identified(fit: AxisFit, records: Sequence[Record]) -> bool:
    """Whether the records identify the creep of an axis: slow modes of clear size that end within a record.

    A mode that follows the drive within a radian of its slowest record cannot be separated from the gain, nor
    a mode slower than the longest record from drift. Two modes with nearly the same time constant count as
    one.
    """
    longest = max(record.sample_time_s * record.samples for record in records)
    shortest = 0.5 / np.pi / min(drive_hz(record) for record in records)
    times = sorted(mode.time_constant_s for mode in fit.axis.creep)
    if any(slower < APART * faster for faster, slower in itertools.pairwise(times)):
        return False
    return all(
        shortest <= mode.time_constant_s <= longest and abs(mode.gain) >= SURE_CREEP * error
        for mode, error in zip(fit.axis.creep, fit.creep_gain_errors, strict=True)
    )


def bound_notes(
    records: Sequence[Record],
    fit: StaticFit,
    free: StaticFit,
    dynamic: bool,
    explained: Collection[str] = (),
) -> list[str]:
    """Slopes of direct pairs that the records would place below their bound.

    Slopes that the records do not determine are ignored, and so are outputs with a known fault. The note
    names phase lag as a cause only if the loops widen with the rate.
    """
    found = []
    for o, k in sorted({(o, k) for o, k, _ in fit.bounded} - set(free.open)):
        name, driven = records[0].outputs[o], records[0].inputs[k]
        if name in explained:
            continue
        wider = "" if dynamic else widening(records, k, o)
        remedy = (
            f"{wider}: phase lag looks like hysteresis; fit the dynamics too, or record more slowly"
            if wider
            else "use fewer thresholds, or a ridge penalty"
        )
        slopes, pair = [j for oo, kk, j in fit.bounded if (oo, kk) == (o, k)], free.hysteresis.pairs[o][k]
        lowest = min(slopes, key=lambda j: float(pair.slopes[j]))
        count = "1 slope" if len(slopes) == 1 else f"{len(slopes)} slopes"
        found.append(
            f"{count} from {driven} to {name} held at the lower bound so that the model stays "
            "invertible; unconstrained, the slope with thresholds up to "
            f"{pair.thresholds_v[lowest]:.3g} V would be {pair.slopes[lowest]:.3g} um/V; {remedy}"
        )
    return found


def widening(records: Sequence[Record], k: int, o: int) -> str:
    """How much wider a loop is at the fastest rate than at the slowest one of its amplitude; empty if not.

    Examples
    --------
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


def invertibility_of(
    hysteresis: Hysteresis[Any],
    dynamics: Dynamics,
    range_v: ArrayLike,
    sample_time_s: float,
    inputs: Sequence[str],
) -> tuple[bool, str]:
    """Whether a model has an inverse, and a sentence that names the slope or the frequency to blame.

    range_v : as ``invertibility`` takes it [V]
    """
    try:
        static = replace(invertibility(hysteresis, range_v), inputs=tuple(inputs))
        static_ok, sentence = static.invertible, static.statement()
    except (InputError, SimulationError) as error:
        static_ok, sentence = False, f"The hysteresis has no inverse: {error}"
    if not isinstance(dynamics, StateSpaceDynamics):
        return static_ok, sentence
    frequency_hz = np.linspace(0.0, 0.5 / sample_time_s, LINES + 1)[:-1]
    response = discretise(dynamics, sample_time_s).response(frequency_hz)
    singular = np.linalg.svd(response, compute_uv=False)
    weakest = int(np.argmin(singular[:, -1]))
    if singular[weakest, -1] >= LOST * singular[0, 0]:
        return static_ok, sentence
    return False, (
        f"{sentence} The linear block has no usable inverse at {frequency_hz[weakest]:.4g} Hz: in one "
        f"direction of the outputs, the gain is only {singular[weakest, -1] / singular[0, 0]:.1e} of "
        "the static gain."
    )

"""Residual analysis: whether the prediction error is noise, or an effect that the model lacks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, StaticDynamics
from hammerstein.identification.options import PLAYS
from hammerstein.identification.score import Candidate, ranges
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.faults import BENT_EXPLAINS, Fault, faults, hump
from hammerstein.records.noise import noise_rms
from hammerstein.records.record import Record

FAR = 3.0
"""Rms of what is left, in parts of the noise, from which it is said first."""
LEAST_PART = 5e-4
"""Rms of what is left, in parts of the range, below which it does not matter."""
STILL_DRIFTS = 0.25
"""Trend of what is left, in parts of the drift that was seen, from which it is drift and not creep."""
STILL_HUMP = 0.5
"""Part of a hump that must be left for a reading to be clipped: a resonance can swing on while a voltage is
constant, and a model that has it predicts the hump."""
MOST_DRIFT = 0.1
"""Drift of an output, in parts of its range, up to which a model is fit for use: evenly spread it adds 0.29
of itself to the rms error, which is stated."""
OF_A_CREEPING_MODEL = (
    ". The model has creep, but some creep remains in the prediction error, perhaps because of the "
    "kind of model: hammerstein compare tries the others"
)


def residual_statements(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState], settings: Settings
) -> list[str]:
    """Sentences about outputs with errors far above the noise, with proposals; none if all is well.

    Parameters
    ----------
    candidate : model
    records, starts : records for the errors, and their initial states
    settings : of the identification; only untried options are proposed
    """
    left = [candidate.residual(record, start) for record, start in zip(records, starts, strict=True)]
    samples = sum(error.shape[1] for error in left)
    rms = np.sqrt(np.sum([(error**2).sum(axis=1) for error in left], axis=0) / samples)
    noise = np.array([np.median([noise_rms(r.y_um[o]) for r in records]) for o in range(len(rms))])
    span = ranges(records, starts)
    found = []
    for o in np.flatnonzero((rms > FAR * noise) & (rms > LEAST_PART * span)):
        hz = _strongest(records, [error[o] for error in left])
        above = float(f"{rms[o] / noise[o]:.2g}") if noise[o] > 0.0 else 0.0  # two digits, and no exponent
        times = f"{above:g} times the noise" if above else "far above the noise"
        found.append(
            f"The prediction error of {records[0].outputs[o]} ({rms[o]:.3g} um rms) is {times} "
            f"({noise[o]:.2g} um), mostly near {hz:.3g} Hz: the records contain an effect that the "
            f"model lacks. {_proposal(settings)}."
        )
    return found


def faults_left(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> list[Fault]:
    """Faults of the records; faults that a model can explain count only if they remain in its residual."""
    named = [fault for record in records for fault in faults(record)]
    left = [fault for fault in named if _is_left(fault, candidate, records, starts)]
    dynamics = candidate.dynamics
    creeps = isinstance(dynamics, AxesDynamics) and any(axis.creep for axis in dynamics.axes)
    more = OF_A_CREEPING_MODEL if creeps else ""
    return [f._replace(text=f.text + more) if f.drift_um else f for f in left]


def is_flag(fault: Fault, records: Sequence[Record]) -> bool:
    """Whether a fault makes a model of its record unfit: a slow drift is in the error that is stated."""
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
        hz = line / (len(error) * record.sample_time_s)
        best = max(best, (float(power[line]), hz))
    return best[1]


def _proposal(settings: Settings) -> str:
    """What was not tried, of what keeps itself only where it lowers the error: no promise that it does."""
    tried = []
    if settings.dynamics in ("none", "lag"):
        tried.append("--dynamics auto")
    if not settings.fits_thresholds:
        tried.append("--operators auto --partition auto")
    elif settings.operators != "auto":
        tried.append("more --operators")
    if settings.dynamics == "second_order":
        tried.append("--dynamics auto, which adds a low-pass")
    if tried:
        return f"Not tried: {'; or '.join(tried)}"
    kinds = "hammerstein compare tries every kind on these records; " if settings.hysteresis == PLAYS else ""
    return (
        f"{kinds}use records with fewer effects at once (slower, one axis at a time): this kind of "
        "model has no saturation and no coupled resonances"
    )

"""Recorded voltages: excitation of each input, and working point for the model file.

A single rate does not separate lag from hysteresis, and a voltage that never turns shows none.

A record may begin at any voltage. The plays of a model that rests do not know where zero is, so that every
record is counted from the voltage at which it began; the model's working point is that of the first record
that began at rest.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import WithLoop
from hammerstein.errors import IdentificationError
from hammerstein.identification.score import Candidate, begun
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import half_swing
from hammerstein.records.record import Record, begins_at_rest, driven_inputs
from hammerstein.records.turning_points import noise_rms, quantum, turning_points

TWO_RATES = 1.5
"""Ratio of the fastest to the slowest rate from which they count as two."""
SWING, SWINGS, MOST_SWINGS = 0.05, 2, 500
"""Smallest swing that counts, in parts of the whole; how many must be shorter and faster than as many others;
how many are compared, spread over the record."""
LOWEST = 0.05
"""Part of the power of a drive below its lowest frequency; transients and drift have less."""
PARTS = 8
"""Number of parts of a record for the fastest rate."""
AT_AN_END = 0.01
"""Distance from an end, in parts of the range, within which a voltage begins at that end."""


def several_rates(records: Sequence[Record]) -> bool:
    """Whether the records include rates different enough to separate a lag from hysteresis."""
    return any(rates_of_input(records))


def rates_of_input(records: Sequence[Record]) -> tuple[bool, ...]:
    """Whether each input is driven at several rates, in different records or within one."""
    found = []
    for k in range(len(records[0].u_v)):
        own = [record for record in records if k in driven_inputs(record)]
        rates = [drive_hz(record, k) for record in own]
        between = bool(rates) and max(rates) > TWO_RATES * min(rates)
        found.append(between or any(_fast_and_slow(record.u_v[k]) for record in own))
    return tuple(found)


def lowest_hz(record: Record) -> float:
    """Lowest frequency of the drive of a record [Hz]: a twentieth of its power is below.

    Hysteresis answers at sums and differences of the frequencies of its drive, so the lines of its spectrum
    are about as far apart: of one sine by its frequency, of several by much less.

    Examples
    --------
    >>> t = np.arange(2000) / 1000.0
    >>> u = np.sin(2.0 * np.pi * 50.0 * t)
    >>> round(lowest_hz(Record([u], [u], 1e-3)), 1)
    50.0
    >>> u += 0.5 * np.sin(2.0 * np.pi * 15.0 * t)
    >>> round(lowest_hz(Record([u], [u], 1e-3)), 1)
    15.0
    """
    return quantile_hz(record, LOWEST)


def quantile_hz(record: Record, share: float) -> float:
    """Frequency below which a share of the drive's power lies [Hz]; 0 without drive.

    Examples
    --------
    >>> time_s = 1e-3 * np.arange(1000)
    >>> u = (1.0 + time_s) * np.sin(2.0 * np.pi * 5.0 * time_s)
    >>> quantile_hz(Record([u], [u], 1e-3), 0.5)
    5.0
    """
    frequency_hz, power = _drive_spectrum(record.u_v, record.sample_time_s)
    below = np.cumsum(power)
    return float(frequency_hz[np.searchsorted(below, share * below[-1])])


def drive_hz(record: Record, input_: int | None = None) -> float:
    """Power-weighted mean frequency of the drive of a record [Hz], for all inputs or one.

    Examples
    --------
    >>> u = np.sin(2.0 * np.pi * 5.0 * np.arange(1000) / 1000.0)
    >>> round(drive_hz(Record([u], [u], 1e-3)), 3)
    5.0
    """
    u = record.u_v if input_ is None else record.u_v[[input_]]
    frequency_hz, power = _drive_spectrum(u, record.sample_time_s)
    return float(power @ frequency_hz / power.sum())


def _drive_spectrum(u: Array, sample_time_s: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and the power of all voltages about their means."""
    lines = np.fft.rfft(u - u.mean(axis=1, keepdims=True), axis=1)
    return np.fft.rfftfreq(u.shape[1], sample_time_s), np.sum(np.abs(lines) ** 2, axis=0)


def _fast_and_slow(u: Array) -> bool:
    """Whether one voltage has swings that are both shorter and faster than others of it.

    At one speed a lag looks like a play, at one frequency like hysteresis. Any of the swings count: the
    shortest of a multisine are seldom its fastest.
    """
    points = turning_points(u, SWING * float(np.ptp(u)))
    samples, volts = np.diff(points)[1:-1], np.abs(np.diff(u[points]))[1:-1]  # the ends are parts of swings
    some = np.unique(np.linspace(0, len(samples) - 1, min(len(samples), MOST_SWINGS)).astype(np.intp))
    samples, speeds = samples[some], (volts / samples)[some]
    above = (TWO_RATES * samples < samples[:, None]) & (speeds > TWO_RATES * speeds[:, None])
    return bool(min(above.any(axis=0).sum(), above.any(axis=1).sum()) >= SWINGS)


def fastest_rad_per_s(records: Sequence[Record]) -> Array:
    """Largest rms rate of a part of a record over half the swing of each input (input,) [rad/s]."""
    fastest = np.zeros(len(records[0].u_v))
    half = 0.5 * np.max([np.ptp(record.u_v, axis=1) for record in records], axis=0)
    for record in records:
        rate = np.diff(record.u_v, axis=1) / record.sample_time_s
        parts = [np.sqrt(np.mean(part**2, axis=1)) for part in np.array_split(rate, PARTS, axis=1)]
        fastest = np.maximum(fastest, np.max(parts, axis=0) / np.where(half > 0.0, half, np.inf))
    return fastest


RESPONDED = 1.0
"""Response of an output to an input, relative to the prediction error, below which there is none."""
TOLD = 10.0
"""The same, below which the single weights of an input are guesses, where it was driven but little."""
SMALL = 0.1
"""Part of the largest half swing below which an input was driven but little."""
ROUGH = 1.3
"""Standard deviation of a signal over its rms noise, up to which it is noise alone."""


def responses(candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]) -> Array:
    """Largest rms response of an output to each input alone (input,), relative to the prediction error.

    Parameters
    ----------
    candidate : model fitted to the records
    records, starts : fitted records and their initial states
    """
    power = np.zeros((len(records[0].u_v), len(records[0].y_um)))
    left = np.zeros(len(records[0].y_um))
    for record, start in zip(records, starts, strict=True):
        left += (candidate.residual(record, start) ** 2).sum(axis=1)
        for k in range(len(power)):
            u = np.zeros_like(record.u_v)  # the effects of the inputs add up
            u[k] = record.u_v[k]
            alone = replace(record, u_v=u, verified=True)
            response = candidate.predict(alone, start)[:, start.first :]
            power[k] += response.var(axis=1) * response.shape[1]
    return np.asarray(np.sqrt((power / np.maximum(left, np.finfo(float).tiny)).max(axis=1)))


def refuse_noise(records: Sequence[Record], response: Array) -> None:
    """Refuse outputs that contain only noise, and inputs that move only such outputs.

    A record that the model cannot represent, such as a butterfly loop, is not noise, although no response to
    the input is found.

    Parameters
    ----------
    records : fitted records
    response : result of ``responses``

    Raises
    ------
    IdentificationError : names every such input, how far it moved, and what to do
    """
    if all(is_noise(y) for record in records for y in record.y_um):
        raise IdentificationError(
            "no output responds to a voltage: the readings are noise; check the columns, the wiring "
            "and the sensor"
        )
    silent = response < RESPONDED
    names, swing = records[0].inputs, half_swing(records)
    for k in np.flatnonzero(silent & (swing < SMALL * swing.max())):
        if all(is_noise(record.u_v[k]) for record in records):
            raise IdentificationError(
                f"input {names[k]} is never driven: it only has {2.0 * swing[k]:.3g} V of noise, and "
                "no output responds; drive it in a record of its own, or remove it from the inputs"
            )


def is_noise(x: Array) -> bool:
    """Whether a signal is constant or white noise."""
    return float(np.std(x)) <= ROUGH * noise_rms(x) or float(np.ptp(x)) <= 1.5 * quantum(x)


def refuse_one_way(records: Sequence[Record]) -> None:
    """Refuse records in which no voltage ever turns.

    Raises
    ------
    IdentificationError : they cannot tell hysteresis from curvature
    """
    if not any(_turns(record, k) for record in records for k in range(len(record.u_v))):
        raise IdentificationError(
            "no voltage turns in any record, so hysteresis and curvature cannot be separated; record "
            "a full cycle or more"
        )


def excitation_statements(records: Sequence[Record], response: Array) -> list[str]:
    """Parameters that the voltages cannot identify, because they were too small or never turned."""
    names, swing = records[0].inputs, half_swing(records)
    found = [
        f"individual weights of {names[k]}: its {2.0 * swing[k]:.3g} V move the outputs by only "
        f"{response[k]:.2g} times the prediction error; use a larger voltage"
        for k in range(len(names))
        if response[k] < TOLD and swing[k] < SMALL * swing.max()
    ]
    return found + [
        f"hysteresis of {name}: its voltage never turns, so lag and curvature cannot be separated; "
        "record a full cycle or more"
        for k, name in enumerate(names)
        if not any(_turns(record, k) for record in records)
    ]


def _turns(record: Record, k: int) -> bool:
    """Whether a voltage comes back; the ends of the record are no turns."""
    return len(turning_points(record.u_v[k])) > 2


def counted(record: Record) -> Record:
    """The same record with voltages relative to their first values.

    >>> u = 90.0 * np.sin(np.linspace(0.0, 12.0, 300)) - 90.0
    >>> begun = counted(Record([u], [5.0 * u], 1e-3))
    >>> begun.rest_v, float(begun.u_v[0, 0])
    (array([-90.]), 0.0)
    """
    first = record.u_v[:, 0]
    if not first.any():
        return record
    return replace(record, u_v=record.u_v - first[:, None], rest_v=record.rest_v + first, verified=True)


def voltages_of(
    records: Sequence[Record], ready: Sequence[Record], starts: Sequence[InitialState], best: Candidate
) -> Voltages:
    """Working point, range, history and fastest change of every input over the records.

    The working point is where the first record began that drives the input and began at rest: with a dead
    start, at an end of its range, or so judged. Where all began in motion it is the middle of the range.

    Parameters
    ----------
    records : as they were read
    ready : the same without their dead start, counted from where they began
    starts : what went before each of them, for the model
    """
    low: Array = np.array([record.u_v.min(axis=1) for record in records]).min(axis=0)
    high: Array = np.array([record.u_v.max(axis=1) for record in records]).max(axis=0)
    rest = [_middle(*ends) for ends in zip(low.tolist(), high.tolist(), strict=True)]
    for record, counted, start in reversed(list(zip(records, ready, starts, strict=True))):
        for k in driven_inputs(record):
            if start.kind == "rest" or _began_at_rest(record, k):
                rest[k] = float(counted.rest_v[k])
    conditioned = _began_conditioned(ready, starts, best, low, high)
    fastest = np.max([np.abs(np.diff(one.u_v)).max(axis=1) / one.sample_time_s for one in records], axis=0)
    more = {"conditioned": conditioned, "fastest_v_per_s": tuple(fastest.tolist())}
    return Voltages.of(rest, low, high).model_copy(update=more)


def _began_conditioned(
    ready: Sequence[Record], starts: Sequence[InitialState], best: Candidate, low: Array, high: Array
) -> bool:
    """Whether every record that does not begin in motion began near the outputs to which a drive to the
    highest, then to the lowest voltage leads, and away from those of an actuator that was never driven.
    """
    found = []
    for record, start in zip(ready, starts, strict=True):
        if start.first or record.period_samples is not None or isinstance(best.dynamics, WithLoop):
            continue
        hysteresis = best.hysteresis.counted_from(record.rest_v).on_grid(record.sample_time_s)
        memory = begun(hysteresis, record, start)
        if start.kind == "repeated":
            memory = hysteresis.respond(record.u_v, memory)[1]
        stands = np.zeros((len(low), 1))
        history = np.hstack([stands, np.stack([high, low], axis=1) - record.rest_v[:, None], stands])
        history[np.ptp(record.u_v, axis=1) == 0.0] = 0.0
        here, virgin = (hysteresis.respond(stands, one)[0][:, 0] for one in (memory, hysteresis.rest()))
        driven = hysteresis.standing(history)[0]
        found.append(bool(np.abs(here - driven).sum() < np.abs(here - virgin).sum()))
    return bool(found) and all(found)


def _began_at_rest(record: Record, k: int) -> bool:
    u = record.u_v[k]
    margin = AT_AN_END * float(np.ptp(u))
    return bool(u[0] <= u.min() + margin or u[0] >= u.max() - margin) or begins_at_rest(record)


def _middle(low: float, high: float) -> float:
    """Middle of a range, to a thousandth of it: it was never measured."""
    step = 10.0 ** (math.floor(math.log10(high - low)) - 3) if high > low else 1.0
    return round(0.5 * (low + high) / step) * step

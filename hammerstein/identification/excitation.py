"""Excitation of each input: whether an output responds to it, and whether its voltage turns.

Rates at which records drive their inputs: a single rate does not separate lag from hysteresis.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import half_swing
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import noise_rms, quantum, turning_points

TWO_RATES = 1.5
"""Ratio of the fastest to the slowest from which rates are two."""
SWING, SWINGS, MOST_SWINGS = 0.05, 2, 500
"""Smallest swing that counts, in parts of the whole; how many must be shorter and faster than as many others;
how many are compared, spread over the record."""
LOWEST = 0.05
"""Part of the power of a drive below its lowest frequency: a beginning or a drift has less."""
PARTS = 8
"""Parts of a record of which the fastest rate is taken."""


def several_rates(records: Sequence[Record]) -> bool:
    """Whether records are driven so fast and so slowly that they tell a lag from hysteresis."""
    return any(rates_of_input(records))


def rates_of_input(records: Sequence[Record]) -> tuple[bool, ...]:
    """Whether each input is driven at several rates: in different records, or within one."""
    found = []
    for k in range(len(records[0].u_v)):
        own = [record for record in records if k in driven_inputs(record)]
        rates = [drive_hz(record, k) for record in own]
        between = bool(rates) and max(rates) > TWO_RATES * min(rates)
        found.append(between or any(_fast_and_slow(record.u_v[k]) for record in own))
    return tuple(found)


def lowest_hz(record: Record) -> float:
    """Lowest frequency of what a record is driven with [Hz]: a twentieth of its power is slower.

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
    frequency_hz, power = _drive_spectrum(record.u_v, record.sample_time_s)
    return float(frequency_hz[np.searchsorted(np.cumsum(power), LOWEST * power.sum())])


def drive_hz(record: Record, input_: int | None = None) -> float:
    """Mean frequency of what a record is driven with, weighted with its power [Hz]; of all inputs, or of one.

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
"""Response of an output to an input, in parts of what the fit leaves, below which there is none."""
TOLD = 10.0
"""The same, below which the single weights of an input are guesses, where it was driven but little."""
SMALL = 0.1
"""Part of the largest half swing below which an input was driven but little."""
ROUGH = 1.3
"""Standard deviation of a signal, in parts of the rms noise found in it, up to which it is noise alone."""


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
    """Whether a signal stands still or is as rough as white noise."""
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

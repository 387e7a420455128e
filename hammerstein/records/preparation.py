"""What is asked of a record before a model is fitted: driven axes, dead start, run-in, direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.errors import InputError, Mistake
from hammerstein.records.checks import where
from hammerstein.records.noise import dead_band, noise_rms, quantum
from hammerstein.records.record import Record

DRIVEN_SHARE = 0.01
"""An input that moves by less than this part of the largest one is held, not driven."""
FEWEST_AT_REST = 3
RESTING = 1e-4
"""Part of its range by which an output at rest may move."""
TREND_PARTS = 4
ALIKE = 0.5
"""Correlation of output and input from which a lead has a meaning."""
VISITED = 0.05
"""An extreme counts as visited from this part of the range on."""
COHERENT = 1e3
"""Condition of the inputs' power from which they are one and the same."""
LEAD_RAD = -0.03
FARTHEST_LEAD_RAD = -0.8
"""A lead beyond this is no swapped loop but a lag of more than half a turn."""


def driven_inputs(record: Record) -> tuple[int, ...]:
    """Inputs that were driven, counted from 0; the others were held and may carry noise.

    Parameters
    ----------
    record : voltages and displacements

    Examples
    --------
    >>> u = np.sin(np.linspace(0.0, 12.0, 300))
    >>> driven_inputs(Record([u, 0.0 * u + 0.2], [5.0 * u], 1e-3))
    (0,)
    """
    spans = np.ptp(record.u_v, axis=1)
    return tuple(int(k) for k in np.flatnonzero(spans > DRIVEN_SHARE * spans.max()))


def driven_alone(record: Record, k: int, start: int, stop: int) -> bool:
    """Whether the other inputs rest between two samples, both included.

    Parameters
    ----------
    record : voltages and displacements
    k : input, from 0
    start, stop : samples
    """
    spans = np.ptp(record.u_v[:, start : stop + 1], axis=1)
    others = np.delete(spans, k)
    return bool((others <= DRIVEN_SHARE * np.ptp(record.u_v, axis=1).max()).all())


def dead_start(record: Record) -> int:
    """Samples before the last one at which every driven voltage still stands at its first value.

    None where an output moves on under the held voltage: how it rings and creeps tells its dynamics.

    Parameters
    ----------
    record : voltages and displacements
    """
    held = _held(record)
    return 0 if moves_while_held(record) else held


def moves_while_held(record: Record) -> bool:
    """Whether an output rings or creeps at the beginning, while every driven voltage stands still."""
    held = _held(record)
    return not all(_rests(y[: held + 1], y) for y in record.y_um)


def _held(record: Record) -> int:
    return min(_last_still(record.u_v[k]) for k in driven_inputs(record))


def _rests(still: Array, whole: Array) -> bool:
    """Whether an output shows no more than its noise while the voltage stands still."""
    if len(still) < FEWEST_AT_REST:
        return True
    noise = max(noise_rms(whole), quantum(whole), RESTING * float(np.ptp(whole)))
    trend = np.array_split(still, min(TREND_PARTS, len(still)))
    allowed = 4.0 * noise / np.sqrt(len(trend[0]))
    return (
        float(still.std()) <= 2.0 * noise and float(np.ptp([part.mean() for part in trend])) <= 2.0 * allowed
    )


def run_in(record: Record) -> int:
    """Samples until every driven voltage has been near both its extremes: earlier history is forgotten."""
    last = 0
    for k in driven_inputs(record):
        u = record.u_v[k]
        margin = VISITED * float(np.ptp(u))
        low, high = np.argmax(u <= u.min() + margin), np.argmax(u >= u.max() - margin)
        last = max(last, int(low), int(high))
    return last


def _last_still(u: Array) -> int:
    """Last sample before the motion; the ramp inside the dead band belongs to the motion."""
    away = np.abs(u - u[0])
    first = int(np.argmax(away > min(dead_band(u), 0.05 * float(np.ptp(u)))))
    flicker = float(away[: max(first // 2, 1)].max())
    return int(np.flatnonzero(away[:first] <= flicker)[-1])


def lag_rad(records: Sequence[Record]) -> Array:
    """Phase by which each output lags each input [rad], over the slower half of the excitation.

    The angle of the response S_yu S_uu^-1 with both spectra summed over all records and over the lines that
    hold the slower half of the inputs' power, for a gain of either sign: between -pi/2 and pi/2. A
    hysteresis loop of 15 percent width lags by about 0.15 rad; an output that *leads* by as much is a
    voltage in truth. Solving for all inputs at once takes each one for what it does itself.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Returns
    -------
    (output, input) phases [rad]; 0 for inputs that are driven in no record
    """
    response, _ = _slow_response(records)
    sign = np.where(response.real < 0, -1.0, 1.0)
    return np.asarray(np.arctan2(-sign * response.imag, np.abs(response.real)))


def _slow_response(records: Sequence[Record]) -> tuple[Complex, bool]:
    """Response (output, input) over the slower half of the power; whether inputs can be told apart."""
    driven = sorted({k for record in records for k in driven_inputs(record)})
    size = np.sqrt(sum(record.u_v[driven].var(axis=1) * record.samples for record in records))
    p = len(records[0].y_um)
    power = np.zeros((len(driven), len(driven)), dtype=np.complex128)
    cross = np.zeros((p, len(driven)), dtype=np.complex128)
    for record in records:
        u = _spectra(record.u_v[driven]) / size[:, None]
        energy = np.cumsum((np.abs(u) ** 2).sum(axis=0))
        lines = slice(0, int(np.searchsorted(energy, 0.5 * energy[-1])) + 2)
        power += u[:, lines] @ u[:, lines].conj().T
        cross += _spectra(record.y_um)[:, lines] @ u[:, lines].conj().T
    response = np.zeros((p, len(records[0].u_v)), dtype=np.complex128)
    response[:, driven] = cross @ np.linalg.pinv(power, rcond=1.0 / COHERENT, hermitian=True) / size
    return response, bool(np.linalg.cond(power) < COHERENT)


def _spectra(signals: Array) -> Complex:
    window = np.hanning(signals.shape[1])
    return np.asarray(np.fft.rfft(window * (signals - signals.mean(axis=1, keepdims=True))))


def _unit(signals: Array) -> Array:
    """Signals (axis, sample) about their means, of length 1; zero where one stands still."""
    centred = signals - signals.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-300))


def leads(records: Sequence[Record]) -> tuple[tuple[int, int], ...]:
    """Pairs (output, input) in which the output runs ahead of the input, as in swapped columns.

    Only the output that answers an input most is judged, and only a lead of 0.03 to 0.8 rad at a positive
    gain: beyond that, a lead cannot be told from the lag of a resonance. Nor is an output judged that hardly
    looks like the input, such as a butterfly. Where the inputs cannot be told apart (one circle), a
    cross-coupling looks like a lead on one axis, so that all must lead.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Examples
    --------
    >>> from hammerstein.hysteresis import play
    >>> u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    >>> x = 5.0 * play(u, [2.0])
    >>> leads([Record([u], x, 5e-5)]), leads([Record(x, [u], 5e-5)])
    ((), ((0, 0),))
    """
    (response, apart), lag = _slow_response(records), lag_rad(records)
    driven = [driven_inputs(record) for record in records]
    alike = [np.abs(_unit(record.y_um) @ _unit(record.u_v).T) for record in records]
    moved = np.sqrt(sum(record.y_um.var(axis=1) * record.samples for record in records))
    strongest = []
    for k in sorted({k for inputs in driven for k in inputs}):
        o = int(np.argmax(np.abs(response[:, k]) / np.maximum(moved, np.finfo(float).tiny)))
        answer = max(float(a[o, k]) for a, inputs in zip(alike, driven, strict=True) if k in inputs)
        strongest.append((o, k, answer))
    found = tuple(
        (o, k)
        for o, k, answer in strongest
        if FARTHEST_LEAD_RAD < lag[o, k] < LEAD_RAD and response[o, k].real > 0 and answer > ALIKE
    )
    return found if apart or len(found) == len(strongest) else ()


def refuse_swapped(records: Sequence[Record]) -> None:
    """Refuse records whose outputs run ahead of their inputs.

    Raises
    ------
    InputError : naming the columns that seem to be swapped
    """
    lag, first = lag_rad(records), records[0]
    mistakes = [
        Mistake(
            where(first.outputs[o], first.rows, 0, first.samples - 1),
            f"leads {first.inputs[k]} by {-np.degrees(lag[o, k]):.1f} degrees, which no actuator can; "
            "are input and output columns swapped?",
        )
        for o, k in leads(records)
    ]
    if mistakes:
        raise InputError(first.source if len(records) == 1 else f"{len(records)} records", mistakes)

"""Outputs that run ahead of their inputs: columns of a record that are swapped."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.errors import InputError, Mistake
from hammerstein.records.excitation import driven_inputs
from hammerstein.records.record import Record
from hammerstein.signals.text_tables import where

ALIKE = 0.5
"""Correlation of output and input from which a lead has a meaning."""
COHERENT = 1e3
"""Condition of the inputs' power from which they are one and the same."""
LEAD_RAD = -0.03  # an output that leads by more is a voltage, or its columns are swapped
FARTHEST_LEAD_RAD = -0.8
"""A lead beyond this is no swapped loop but a lag of more than half a turn."""


def lag_rad(records: Sequence[Record]) -> Array:
    """Phase by which each output lags each input [rad], over the slower half of the excitation.

    The angle of the response S_yu S_uu^-1, for a gain of either sign: between -pi/2 and pi/2. Both spectra
    are summed over all records, and over the lines with the slower half of the inputs' power. A hysteresis
    loop of 15 percent width lags by about 0.15 rad; an output that *leads* by as much is really a voltage.
    Solving for all inputs at once separates their contributions.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Returns
    -------
    (output, input) phases [rad]; 0 for inputs that are driven in no record
    """
    response, _ = _response(records)
    sign = np.where(response.real < 0, -1.0, 1.0)
    return np.asarray(np.arctan2(-sign * response.imag, np.abs(response.real)))


def _response(records: Sequence[Record], share: float = 0.5) -> tuple[Complex, bool]:
    """Response (output, input) over the slower lines that hold a share of the inputs' power.

    Also whether inputs can be told apart.
    """
    driven = sorted({k for record in records for k in driven_inputs(record)})
    size = np.sqrt(sum(record.u_v[driven].var(axis=1) * record.samples for record in records))
    p = len(records[0].y_um)
    power = np.zeros((len(driven), len(driven)), dtype=np.complex128)
    cross = np.zeros((p, len(driven)), dtype=np.complex128)
    for record in records:
        u = _spectra(record.u_v[driven]) / size[:, None]
        energy = np.cumsum((np.abs(u) ** 2).sum(axis=0))
        lines = slice(0, int(np.searchsorted(energy, share * energy[-1])) + 2)
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

    Only the output that responds most to an input counts, and only a lead of 0.03 to 0.8 rad at a positive
    gain: a larger lead looks like the lag of a resonance. The output must also lead over the whole excited
    band, weighted by power, so that a weak slow line does not outweigh a strong line that lags. An output
    that hardly resembles the input, such as a butterfly, does not count. If the inputs cannot be separated
    (one circle), a cross-coupling looks like a lead on one axis; then all outputs must lead.

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
    (response, apart), lag = _response(records), lag_rad(records)
    driven = [driven_inputs(record) for record in records]
    alike = [np.abs(_unit(record.y_um) @ _unit(record.u_v).T) for record in records]
    moved = np.sqrt(sum(record.y_um.var(axis=1) * record.samples for record in records))
    strongest = []
    for k in sorted({k for inputs in driven for k in inputs}):
        o = int(np.argmax(np.abs(response[:, k]) / np.maximum(moved, np.finfo(float).tiny)))
        correlation = max(float(a[o, k]) for a, inputs in zip(alike, driven, strict=True) if k in inputs)
        strongest.append((o, k, correlation))
    whole, _ = _response(records, 1.0)
    found = tuple(
        (o, k)
        for o, k, correlation in strongest
        if whole[o, k].imag > 0.0
        if FARTHEST_LEAD_RAD < lag[o, k] < LEAD_RAD and response[o, k].real > 0 and correlation > ALIKE
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
            f"leads {first.inputs[k]} by {-np.degrees(lag[o, k]):.1f} degrees, which is impossible "
            "for an actuator; are input and output columns swapped? If they are not, give "
            "--accept-order",
        )
        for o, k in leads(records)
    ]
    if mistakes:
        raise InputError(first.source if len(records) == 1 else f"{len(records)} records", mistakes)

"""Excitation of each input: whether an output responds to it, and whether its voltage turns."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import half_swing
from hammerstein.records.record import Record
from hammerstein.records.turning_points import noise_rms, quantum, turning_points

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

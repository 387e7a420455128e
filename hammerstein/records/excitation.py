"""How the inputs of a record were driven: which ones, from when on, and until the history is forgotten."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array
from hammerstein.records.record import Record
from hammerstein.records.turning_points import dead_band, noise_rms, quantum

DRIVEN_SHARE = 0.01
"""An input that moves by less than this part of the largest one is held, not driven."""
FEWEST_AT_REST = 3  # samples, before a drift at rest is spoken of
RESTING = 1e-4
"""Part of its range by which an output at rest may move."""
TREND_PARTS = 4  # of the time at rest, whose means show a trend
VISITED = 0.05
"""An extreme counts as visited from this part of the range on."""


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
    """Samples before the last one at which every driven voltage still has its first value.

    Zero if an output still moves at the constant voltage, because ringing and creep show its dynamics.

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
    """Whether an output shows only noise while the voltage is constant."""
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

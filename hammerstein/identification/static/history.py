"""What was before the first sample of a record: rest, the record itself, or nobody knows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hammerstein.identification.static.regressors import Start
from hammerstein.records.preparation import driven_inputs
from hammerstein.records.record import Record

Array = NDArray[np.float64]
StartMode = Literal["auto", "rest", "repeated"]

CLOSED_V = 0.01
CLOSED_UM = 0.02
"""Parts of the range by which the ends of a closed record may differ."""
VISITED = 0.05
"""An extreme counts as visited from this part of the range on."""
KEPT_SHARE = 0.5
"""Part of a record that must remain for the rest to be spent on forgetting."""
CAUTION = 0.25
"""Part of the remaining record that is left out as well until the dynamics are known."""
FEWEST = 500
"""Samples of a record that are always kept."""
ALIKE = 2.0
ALIKE_FLOOR = 0.002
"""A start from rest is believed if it explains the beginning as well as the model explains the rest."""


def cautious_start(record: Record) -> Start:
    """Start that is safe before anything is known: periodic records as such, others without their beginning.

    Examples
    --------
    >>> u = np.sin(2.0 * np.pi * np.arange(400) / 100)
    >>> cautious_start(Record([u], [5.0 * u], 1e-3))
    Start(kind='repeated', first=151)
    """
    if record.period_samples is not None or closed(record):
        return Start("repeated")
    first = run_in(record)
    if first > KEPT_SHARE * record.samples:
        return Start("rest")
    return Start("repeated", first + round(CAUTION * (record.samples - first)))


def closed(record: Record) -> bool:
    """Whether a record ends where it began, at a tip of the voltage: a loop that can be repeated for ever."""
    u, y = record.u_v[list(driven_inputs(record))], record.y_um
    span_v, span_um = np.ptp(u, axis=1), np.maximum(np.ptp(y, axis=1), np.finfo(float).tiny)
    gap_v, gap_um = np.abs(u[:, -1] - u[:, 0]) / span_v, np.abs(y[:, -1] - y[:, 0]) / span_um
    to_tip = np.minimum(u.max(axis=1) - u[:, 0], u[:, 0] - u.min(axis=1)) / span_v
    return bool((gap_v < CLOSED_V).all() and (gap_um < CLOSED_UM).all() and (to_tip < CLOSED_V).all())


def run_in(record: Record) -> int:
    """Samples until every driven voltage has been near both its extremes: earlier history is forgotten."""
    last = 0
    for k in driven_inputs(record):
        u = record.u_v[k]
        margin = VISITED * float(np.ptp(u))
        low, high = np.argmax(u <= u.min() + margin), np.argmax(u >= u.max() - margin)
        last = max(last, int(low), int(high))
    return last


def judged_starts(
    records: Sequence[Record],
    predict: Callable[[Record, Start], Array],
    settle_s: float,
    mode: StartMode = "auto",
) -> tuple[Start, ...]:
    """Start of each record, with a first model at hand.

    Parameters
    ----------
    records : voltages and displacements
    predict : readings (output, sample) of the model to a record [um]
    settle_s : time in which the dynamics forget [s]
    mode : ``auto``; ``rest`` or ``repeated`` if it is known
    """
    if mode == "rest":
        return (Start("rest"),) * len(records)
    return tuple(_judged(record, predict, settle_s, mode) for record in records)


def _judged(
    record: Record, predict: Callable[[Record, Start], Array], settle_s: float, mode: StartMode
) -> Start:
    cautious = cautious_start(record)
    if cautious.first == 0:
        return cautious
    begun = run_in(record)
    ring = min(round(settle_s / record.sample_time_s), cautious.first - begun)
    forgotten = replace(cautious, first=begun + ring)
    if mode == "repeated":
        return forgotten
    error = record.y_um - predict(record, Start("rest"))
    error -= error[:, cautious.first :].mean(axis=1, keepdims=True)
    before = np.sqrt(np.mean(error[:, : max(begun, 1)] ** 2, axis=1))
    after = np.sqrt(np.mean(error[:, cautious.first :] ** 2, axis=1))
    allowed = ALIKE * after + ALIKE_FLOOR * np.ptp(record.y_um, axis=1)
    return Start("rest") if bool((before <= allowed).all()) else forgotten


def shortened(
    records: Sequence[Record], starts: Sequence[Start], samples: int
) -> tuple[tuple[Record, ...], tuple[Start, ...]]:
    """Beginnings of the records with a given number of samples in all, for what must be quick."""
    most = max(samples // len(records), FEWEST)
    pairs = [_cut(record, start, most) for record, start in zip(records, starts, strict=True)]
    return tuple(record for record, _ in pairs), tuple(start for _, start in pairs)


def _cut(record: Record, start: Start, most: int) -> tuple[Record, Start]:
    if record.samples <= most:
        return record, start
    part = record.part(0, most)
    if start.kind == "rest":
        return part, start
    return part, Start("repeated", min(run_in(part), most // 2))

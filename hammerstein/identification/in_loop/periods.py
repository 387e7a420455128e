"""Records as experiments of a search for hysteresis in a loop: settled periods, or whole from rest."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.identification.in_loop.search import SettledPeriod
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

Respond = Callable[[Array], tuple[Array, Any]]
"""Outputs (p, sample) from rest to inputs (m, sample), and the state after."""
SETTLED = 1e-3
"""Part of an output by which two periods may differ that count as settled: a fifth of a noise of 0.5 %."""
SMALLEST = 0.02
"""Part of the largest record, below which a record counts no more: it holds noise."""
MOST_BEFORE = 8
"""Periods that a simulation runs through at most before the one that counts."""


def from_one_point(
    records: Sequence[Record], held: Sequence[Record]
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Count all settled periods from one voltage: where a record began at rest, or 0 V without one.

    A settled period began anywhere, so that its first voltage says nothing.
    """
    begun = [record.rest_v for record in records if not _period(record)]
    point_v = begun[0] if begun else np.zeros(len(records[0].u_v))

    def moved(record: Record) -> Record:
        if not _period(record):
            return record
        u = record.u_v + (record.rest_v - point_v)[:, None]
        return replace(record, u_v=u, rest_v=point_v, verified=True)

    return tuple(map(moved, records)), tuple(map(moved, held))


def start_of(record: Record) -> InitialState:
    """State before a record: at rest, or the same periods before."""
    return InitialState("repeated" if _period(record) else "rest")


def settled_periods(records: Sequence[Record], respond: Respond) -> list[SettledPeriod]:
    """Settled periods, or whole records that began at rest; an error counts by the size of its record.

    Otherwise slow paths and small loops, which move little, would hardly be fitted beside a resonance.

    respond : of a model that settles as the actuator does
    """
    found = []
    for record in records:
        n = _period(record)
        one = SettledPeriod(record.u_v, record.y_um, 1.0, 0)
        if n:
            count = record.samples // n
            first = record.samples - max(count - 1, 1) * n
            y = record.y_um[:, first:].reshape(len(record.y_um), -1, n).mean(axis=1)
            one = SettledPeriod(record.u_v[:, -n:], y, 1.0, 0)
            one = one._replace(warm=n * _periods_before(respond, one))
        found.append(one)
    sizes = np.array([one.y.std(axis=1) for one in found])
    each = np.sqrt(np.mean(sizes**2, axis=0))
    whole = np.sqrt(np.mean((sizes / each) ** 2, axis=1))
    whole = np.maximum(whole, SMALLEST * whole.max())
    return [p._replace(weight=1.0 / (each * size)[:, None]) for p, size in zip(found, whole, strict=True)]


def _period(record: Record) -> int:
    """Samples of its settled period; 0 for a record from rest."""
    n = record.period_samples or 0
    return n if record.samples >= n else 0


def _periods_before(respond: Respond, period: SettledPeriod) -> int:
    """Whole periods after which a block repeats itself: plays remember the largest turns of one."""
    y = respond(np.tile(period.u, MOST_BEFORE + 1))[0].reshape(len(period.y), -1, period.u.shape[1])
    moved = np.abs(y[:, 1:] - y[:, :-1]).max(axis=2) / np.abs(y[:, -1]).max(axis=1, keepdims=True)
    settled = np.flatnonzero((moved < SETTLED).all(axis=0))
    return int(settled[0]) + 1 if len(settled) else MOST_BEFORE

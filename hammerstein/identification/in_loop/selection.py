"""Selection experiments for the structure of a loop, and the errors of any model on them.

Records as experiments of a search for hysteresis in a loop: settled periods, or whole from rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.search import SettledPeriod
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record, driven_inputs

Respond = Callable[[Array], tuple[Array, Any]]
"""Outputs (p, sample) from rest to inputs (m, sample), and the state after."""
SETTLED = 1e-3
"""Relative difference of two settled periods: a fifth of a noise of 0.5 %."""
SMALLEST = 0.02
"""Size relative to the largest record, below which a record is ignored as noise."""
MOST_BEFORE = 8
"""Largest number of settling periods of a simulation."""
REPEATED = 1e-3
"""Allowed difference of a voltage after a period, in parts of its range: measured ones differ by 2e-4."""
PARTS, CHANCE, LARGEST = 8, 3.0, 0.03
"""In the first of so many parts of a period, settled outputs differ by at most so many times what they differ
by elsewhere, and by at most this part of their range. What differs everywhere is noise, whose colour is that
of the resonances, and drift; what differs at first alone began at rest."""


def with_period(record: Record) -> Record:
    """Set the period of a record without stated period, if it contains settled periods.

    Its voltages repeat, two periods or more, and already its first period of the outputs is as the second
    one but for noise. From rest it is not.
    """
    n = 0 if record.period_samples else _repeats_after(record.u_v[list(driven_inputs(record))])
    if not n:
        return record
    moved = record.y_um[:, n : 2 * n] - record.y_um[:, :n]
    parts = np.sqrt([np.mean(part**2, axis=1) for part in np.array_split(moved, PARTS, axis=1)])
    most, least = (part * np.ptp(record.y_um, axis=1) for part in (LARGEST, SETTLED))
    settled = parts[0] <= np.clip(CHANCE * np.median(parts, axis=0), least, most)
    return replace(record, period_samples=n, verified=True) if settled.all() else record


def _repeats_after(u: Array) -> int:
    """Samples after which voltages (m, sample) repeat through all of a record; 0 if they do not."""
    u = (u - u.mean(axis=1, keepdims=True)) / np.ptp(u, axis=1, keepdims=True)
    count = u.shape[1]
    lags = np.arange(count // 2 + 1)
    alike = np.fft.irfft((np.abs(np.fft.rfft(u, 2 * count)) ** 2).sum(axis=0))[lags]
    power = np.concatenate([[0.0], np.cumsum((u * u).sum(axis=0))])
    left = power[count - lags] + power[-1] - power[lags] - 2.0 * alike  # sum of (u[t + lag] - u[t])^2
    close = left <= REPEATED**2 * (count - lags)
    close[: np.argmin(close)] = False  # a slow voltage is close to itself after a few samples
    near = np.flatnonzero(close)
    if not len(near):
        return 0
    near = near[near - near[0] == np.arange(len(near))]  # around one period: whole multiples repeat, too
    n = int(near[np.argmin(left[near])])
    return n if np.abs(u[:, n:] - u[:, :-n]).max() <= 3.0 * REPEATED else 0


def from_one_point(
    records: Sequence[Record], held: Sequence[Record]
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Refer all settled periods to one voltage: that of a record that began at rest, else 0 V.

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
    """State before a record: at rest, or periodic."""
    return InitialState("repeated" if _period(record) else "rest")


def settled_periods(records: Sequence[Record], respond: Respond) -> list[SettledPeriod]:
    """Settled periods, or whole records that began at rest; errors are weighted by the record's size.

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


HELD = 3
"""One of this many experiments selects the structure."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Fitted experiments, and the selection experiments that choose the structure."""

    seen: Sequence[SettledPeriod]
    held: Sequence[SettledPeriod]

    @classmethod
    def of(cls, periods: Sequence[SettledPeriod]) -> Selection:
        """Reserve one of ``HELD`` experiments for selection, in the order of their amplitudes.

        Without the largest amplitudes, the others do not determine what the hysteresis does there.
        """
        order = np.argsort([period.u.std() for period in periods], kind="stable").tolist()
        back = sorted(order[HELD // 2 :: HELD])
        seen = [period for i, period in enumerate(periods) if i not in back]
        return cls(seen, [periods[i] for i in back])

    def of_linear(self, block: LinearBlock) -> Trial:
        """Error of linear dynamics on the selection experiments."""
        errors = [p.left(block.respond(p.sent)[0][:, p.warm :]) for p in self.held]
        n, (p, m) = len(block.A), block.D.shape
        return Trial(f"linear dynamics, order {n}", 2 * n + n * m + p * n + p * m, self._squares(errors))

    def of_loop(self, found: LoopParameters, pool: Executor) -> Trial:
        """Error of a loop on the selection experiments."""
        errors = pool.map(lambda p: p.left(found.simulate(p.u, p.warm)), self.held)
        return Trial(found.describe(), len(found.vector()), self._squares(list(errors)))

    def of_model(self, candidate: Candidate, trial: Trial, record: Record) -> Trial:
        """Error of any model on the selection experiments.

        record : one of the experiments, with their sample time and the voltage from which they count
        """
        errors = []
        for p in self.held:
            none, rows = np.zeros((len(p.y), p.sent.shape[1])), np.empty(0, dtype=np.int64)
            sent = replace(record, u_v=p.sent, y_um=none, rows=rows, verified=True)
            with np.errstate(all="ignore"):  # of a model that diverges
                errors.append(p.left(candidate.predict(sent, InitialState("rest"))[:, p.warm :]))
        return replace(trial, squares=self._squares(errors))

    def _squares(self, errors: Sequence[Array]) -> Array:
        """Mean squares (experiment,) of weighted errors in parts of the ranges of the weighted outputs."""
        ranges = np.max([np.ptp(period.weight * period.y, axis=1) for period in self.held], axis=0)
        with np.errstate(all="ignore"):  # of a simulation that diverged
            return np.array([np.mean((error / ranges[:, None]) ** 2) for error in errors])

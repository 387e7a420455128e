"""Search of all parameters at once: Levenberg-Marquardt steps on the simulated output of some experiments.

Other experiments select the structure of a loop, by the errors of any model on them. An experiment is a
settled period of a record, or a whole record from rest. Hysteresis of any kind in the loop is searched, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import FeedbackBlock, LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.identification.in_loop.kernels import WIDTH, differentiate
from hammerstein.identification.in_loop.parameters import LoopParameters, SettledPeriod
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record, driven_inputs

LARGEST_TURN = 0.5
"""Largest change of the logarithm of a threshold in one step."""
TRIES = 10
"""Number of dampings tried before a search ends."""
PENALTY = 1e3
"""Penalty of a pole beyond the bound by 1, relative to the root of the sum of squares."""


class Progress(NamedTuple):
    """State of a search: number of steps, and rms error of each period."""

    step: int
    rms: Array
    found: LoopParameters


@dataclass(frozen=True)
class Search:
    """Levenberg-Marquardt with exact derivatives of the simulated output.

    Every step solves (H + mu diag H) d = g, H and g the sums over all records. A pole of the loop beyond
    1 - margin is one more error.

    steps : most of them
    enough : smallest part of the cost that a step must gain
    """

    steps: int = 100
    enough: float = 2e-4
    margin: float = 5e-4
    damping: float = 1e-2

    def run(
        self,
        start: LoopParameters,
        periods: Sequence[SettledPeriod],
        pool: Executor,
        tell: Callable[[Progress], bool] = lambda progress: False,
    ) -> LoopParameters:
        """Return the best parameters; ``tell`` can end the search early."""
        found, mu = start, self.damping
        errors = self._errors(found, periods, pool)
        scale = PENALTY * np.sqrt(sum(float((e * e).sum()) for e in errors))
        cost = self._cost(found, errors, scale)
        for step in range(self.steps):
            hessian, gradient = self._normal(found, periods, pool, scale)
            if not np.isfinite(hessian).all():
                return found  # derivatives diverge where outputs do not: no step leads on
            size = np.sqrt(np.diag(hessian)) + 1e-9
            for _ in range(TRIES):
                trial = found.at(found.vector() + self._step(hessian, gradient, size, mu, found.r.size))
                errors = self._errors(trial, periods, pool)
                now = self._cost(trial, errors, scale)
                if np.isfinite(now) and now < cost:
                    break
                mu *= 4.0
            else:
                return found
            gained, found, cost, mu = (cost - now) / cost, trial, now, max(mu / 5.0, 1e-9)
            rms = [np.sqrt(np.mean((e / p.weight) ** 2)) for e, p in zip(errors, periods, strict=True)]
            if tell(Progress(step, np.array(rms), found)) or gained < self.enough:
                break
        return found

    def _step(self, hessian: Array, gradient: Array, size: Array, mu: float, thresholds: int) -> Array:
        damped = hessian / np.outer(size, size) + mu * np.eye(len(size))
        step = np.asarray(np.linalg.solve(damped, gradient / size) / size)
        step[-thresholds:] = np.clip(step[-thresholds:], -LARGEST_TURN, LARGEST_TURN)
        return step

    def _errors(self, found: LoopParameters, periods: Sequence[SettledPeriod], pool: Executor) -> list[Array]:
        return list(pool.map(lambda period: period.left(found.simulate(period.u, period.warm)), periods))

    def _cost(self, found: LoopParameters, errors: Sequence[Array], scale: float) -> float:
        with np.errstate(all="ignore"):  # of a trial that diverged
            total = sum(float((e * e).sum()) for e in errors)
        if not np.isfinite(total):
            return total
        return total + float(((scale * found.fastest(self.margin)[0]) ** 2).sum())

    @np.errstate(all="ignore")  # derivatives may diverge
    def _normal(
        self, found: LoopParameters, periods: Sequence[SettledPeriod], pool: Executor, scale: float
    ) -> tuple[Array, Array]:
        beyond, moved = found.fastest(self.margin)
        hessian, gradient = scale**2 * moved.T @ moved, -(scale**2) * moved.T @ beyond
        for h, g in pool.map(lambda period: self._of_period(found, period), periods):
            hessian, gradient = hessian + h, gradient + g
        return hessian, gradient

    @np.errstate(all="ignore")
    def _of_period(self, found: LoopParameters, period: SettledPeriod) -> tuple[Array, Array]:
        """Parts of the normal equations of one record."""
        path, hits = found.path(period.u, period.warm)
        source, target = found.tables()
        n = len(found.B)
        error = period.left(found.C @ path[period.warm :, :n].T + found.D @ period.u)
        names = ("A", "C", "E", "F", "H", "c", "K", "beta", "r", "limit")
        numbers = [np.ascontiguousarray(getattr(found, name), dtype=np.float32) for name in names]
        slopes = np.empty((len(found.C), period.u.shape[1], len(source)), dtype=np.float32)
        single = path.astype(np.float32)
        for first in range(0, len(source), WIDTH):
            differentiate(*numbers, found.factors, single, hits, source, target, first, period.warm, slopes)
        slopes -= slopes.mean(axis=1, keepdims=True)
        slopes *= np.reshape(period.weight, (-1, 1, 1)).astype(np.float32)
        flat = slopes.reshape(-1, len(source))
        right = flat.T @ error.ravel().astype(np.float32)
        return (flat.T @ flat).astype(np.float64), right.astype(np.float64)


FAR = 1e3
"""Error of a diverged simulation, in parts of the largest position."""
ROUNDS = 60
"""Largest number of steps of a search: no trial gained from more."""
GAINED = 1e-5
"""Relative decrease of the sum of squares that a step needs; less is rounding."""


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """Feedback block with the fitted entries of its matrices.

    block : its hysteresis has ``free`` numbers, scaled so that 1 is a large change, and is the same ``at``
        others; the weights stay fixed, because E scales their output
    entries : matrix names, A to G, and the free entries of each
    """

    block: FeedbackBlock
    entries: Mapping[str, Flags]

    def vector(self) -> Array:
        """Return all free parameters (number,): entries, then those of the kind."""
        own = [getattr(self.block, name)[free] for name, free in self.entries.items()]
        return np.concatenate([*own, cast(Any, self.block.hysteresis).free])

    def at(self, vector: Array) -> OpenLoop:
        """Return the block with this ``vector``."""
        found, first = {}, 0
        for name, free in self.entries.items():
            matrix = getattr(self.block, name).copy()
            matrix[free] = vector[first : (first := first + int(free.sum()))]
            found[name] = matrix
        gamma = cast(Any, self.block.hysteresis).at(vector[first:])
        return replace(self, block=replace(self.block, hysteresis=gamma, **found))

    def error(self, period: SettledPeriod) -> Array:
        """Weighted prediction error of a period (p, N); large where the simulation diverges."""
        with np.errstate(all="ignore"):
            simulated = self.block.respond(period.sent)[0][:, period.warm :]
        most = FAR * np.abs(period.y).max()
        return period.left(np.clip(np.nan_to_num(simulated, nan=most), -most, most))


def fit_loop(
    start: OpenLoop, periods: Sequence[SettledPeriod], tell: Callable[[float], None] = lambda rms: None
) -> OpenLoop:
    """Fit all free parameters at once to the simulated outputs, by Gauss-Newton steps in a trust region.

    Derivatives are finite differences, because a kind has no derivatives of its own: a period of 4096 samples
    costs about 10 ms per parameter and step.

    Parameters
    ----------
    start : parameters close enough for the outputs to be in phase with the records
    periods : settled periods at several amplitudes
    tell : takes the rms of all weighted errors after every evaluation

    Raises
    ------
    IdentificationError : fewer samples than numbers

    Source: J. J. More, "The Levenberg-Marquardt algorithm", Lecture Notes in Mathematics 630 (1978).
    """
    from scipy.optimize import least_squares

    if sum(period.y.size for period in periods) < len(start.vector()):
        raise IdentificationError("the records have fewer samples than the loop has numbers; record longer")

    def left(vector: Array) -> Array:
        trial = start.at(vector)
        errors = np.concatenate([trial.error(period).ravel() for period in periods])
        tell(float(np.sqrt(np.mean(errors * errors))))
        return errors

    found = least_squares(left, start.vector(), x_scale="jac", max_nfev=ROUNDS, ftol=GAINED)
    return start.at(np.asarray(found.x))


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

"""Search of all parameters at once: Levenberg-Marquardt steps on the simulated output.

Hysteresis of any kind in the loop: all numbers at once, from simulated outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import FeedbackBlock
from hammerstein.errors import IdentificationError
from hammerstein.identification.in_loop.kernels import WIDTH, differentiate
from hammerstein.identification.in_loop.parameters import LoopParameters

LARGEST_TURN = 0.5
"""Largest change of the logarithm of a threshold in one step."""
TRIES = 10
"""Number of dampings tried before a search ends."""
PENALTY = 1e3
"""Penalty of a pole beyond the bound by 1, relative to the root of the sum of squares."""


class SettledPeriod(NamedTuple):
    """One settled period of a record: voltages (m, N) and positions (p, N).

    weight : what an error of it counts, a number or (p, 1)
    warm : samples of the same voltages that a simulation runs through before; 0 for a record from rest
    """

    u: Array
    y: Array
    weight: float | Array
    warm: int = 1500

    @property
    def sent(self) -> Array:
        """Voltages (m, warm + N) from the start of a simulation."""
        return np.take(self.u, np.arange(-self.warm, self.u.shape[1]), axis=1, mode="wrap")

    def left(self, simulated: Array) -> Array:
        """Weighted error (p, N) of a simulation about its mean: the history of a record adds an offset."""
        with np.errstate(all="ignore"):  # a simulation may diverge, and its error is then not finite
            error = self.y - simulated
            return np.asarray(self.weight * (error - error.mean(axis=1, keepdims=True)))


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


class Adjustable(Protocol):
    """Kind of hysteresis with free parameters, scaled so that 1 is a large change."""

    @property
    def free(self) -> Array:
        """Free parameters (number,)."""
        ...

    def at(self, free: Array) -> Any:
        """Return the kind with other parameters."""
        ...


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """Feedback block with the fitted entries of its matrices.

    block : its hysteresis is ``Adjustable``; the weights stay fixed, because E scales their output
    entries : matrix names, A to G, and the free entries of each
    """

    block: FeedbackBlock
    entries: Mapping[str, Flags]

    def vector(self) -> Array:
        """Return all free parameters (number,): entries, then those of the kind."""
        own = [getattr(self.block, name)[free] for name, free in self.entries.items()]
        return np.concatenate([*own, cast(Adjustable, self.block.hysteresis).free])

    def at(self, vector: Array) -> OpenLoop:
        """Return the block with this ``vector``."""
        found, first = {}, 0
        for name, free in self.entries.items():
            matrix = getattr(self.block, name).copy()
            matrix[free] = vector[first : (first := first + int(free.sum()))]
            found[name] = matrix
        gamma = cast(Adjustable, self.block.hysteresis).at(vector[first:])
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

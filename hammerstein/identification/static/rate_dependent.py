"""Rate-dependent plays from records at several rates: two numbers searched, weights projected out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import RateDependent, RatePlays
from hammerstein.identification.score import path_before
from hammerstein.identification.static.history import shortened
from hammerstein.identification.static.normal_equations import (
    Bounds,
    Moments,
    Solution,
    moments_of,
    pooled,
    solve,
)
from hammerstein.identification.static.regressors import Start, delayed
from hammerstein.identification.static.static_block import (
    LEAST_SLOPE,
    direct_pairs,
    half_swing,
    path_filters,
    refuse_unreached,
)
from hammerstein.records.record import Record

SEARCH_SAMPLES = 50_000
"""Samples with which growth and bandwidth are searched."""
BLOCK = 8192
PARTS = 8
TWO_RATES = 1.5
"""Ratio of the fastest to the slowest part from which records have two rates."""
FIRST_SHARES = (0.01, 0.03, 0.1, 0.25)
"""Growth tried first: parts of half the swing by which a threshold grows at the fastest rate."""
FIRST_BANDWIDTHS = (0.5, 2.0, 8.0)
"""Bandwidth tried first, in parts of the fastest rate of the records."""
STABLE = 0.95
"""Largest loop gain of the inverse that a fit may have."""
MOST_EVALUATIONS = 160


@dataclass(frozen=True, eq=False)
class RateFit:
    """Rate-dependent plays found by regression, and what is left (output,) [um]."""

    hysteresis: RateDependent
    rms_um: Array


def fit_rate_dependent(
    records: Sequence[Record],
    grids: Sequence[Array],
    *,
    invertible: bool = True,
    starts: Sequence[Start] = (),
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
    like: RateDependent | None = None,
) -> RateFit:
    """Growth b of each input, bandwidth f of the rate, and weights of all pairs.

        R_i = r_i + b |rho|  for all plays but play(0), whose threshold stays 0

    Only b and f are searched, the weights follow by least squares (variable projection: Golub and Pereyra,
    SIAM J. Numer. Anal. 10 (1973) 413-432). With ``invertible`` the weights of the direct pairs keep the sign
    of the gain, so that every set of plays that can move together has an inverse, and the loop gain of the
    inverse stays below 0.95.

    Parameters
    ----------
    records : at two rates at least, all with the same axes and sample time
    grids : thresholds of each input at rest [V], from 0; the outputs share them
    invertible, starts, delay_samples, through : as for ``fit_static``
    like : block whose growth and bandwidth are taken as known

    Raises
    ------
    IdentificationError : records at one rate only, at several sample times, or a smallest threshold above 0
    """
    if any(grid.size == 0 or grid[0] != 0.0 for grid in grids):
        raise IdentificationError("rate-dependent plays need a smallest threshold of 0 on every input")
    refuse_unreached(records, grids)
    if len({record.sample_time_s for record in records}) > 1:
        raise IdentificationError("rate-dependent plays are fitted to records at one sample time; resample")
    fastest = _refuse_one_rate(records)
    begun = tuple(starts) or (Start("rest"),) * len(records)
    whole = _Task(records, begun, tuple(grids), delay_samples, tuple(through), invertible)
    if like is None:
        few, first = shortened(records, begun, SEARCH_SAMPLES)
        growth, bandwidth_hz = _searched(whole._replace(records=few, starts=first), fastest)
    else:
        growth = np.array([plays.growth_s[-1] for plays in like.inputs])
        bandwidth_hz = like.inputs[0].bandwidth_hz
    solutions = whole.solutions(growth, bandwidth_hz)
    ends = np.cumsum([len(grid) for grid in grids])[:-1]
    weights = tuple(tuple(np.split(whole.slopes.weights(s.coefficients), ends)) for s in solutions)
    plays = whole.plays(growth, bandwidth_hz)
    return RateFit(RateDependent(plays, weights), np.array([s.residual_rms for s in solutions]))


def _refuse_one_rate(records: Sequence[Record]) -> Array:
    """Fastest rate of each input over swing, an angular frequency (input,) [rad/s], where there are two."""
    fastest = []
    for k, name in enumerate(records[0].inputs):
        rates = []
        swing = max(float(np.ptp(record.u_v[k])) for record in records)
        for record in records:
            for part in np.array_split(record.u_v[k], PARTS):
                if len(part) > 2 and np.ptp(part) > 0.05 * swing:
                    slope = np.diff(part) / record.sample_time_s
                    rates.append(float(np.sqrt(np.mean(slope**2))) / (0.5 * swing))
        if not rates or max(rates) < TWO_RATES * min(rates):
            raise IdentificationError(
                f"input {name} is driven at one rate, which cannot tell how its thresholds grow; add one "
                "that is at least half as fast again, or use hysteresis prandtl_ishlinskii"
            )
        fastest.append(max(rates))
    return np.array(fastest)


def _searched(task: _Task, fastest: Array) -> tuple[Array, float]:
    """Growth of each input (input,) [s] and bandwidth of the rate [Hz] with the least error."""
    from scipy.optimize import minimize

    reach = half_swing(task.records)

    def cost(logs: Array) -> float:
        growth, bandwidth_hz = np.exp(logs[:-1]), float(np.exp(logs[-1]))
        block = RateDependent(task.plays(growth, bandwidth_hz), task.no_weights())
        gain = float(block.on_grid(task.records[0].sample_time_s).loop_gain().max())
        if task.invertible and gain >= STABLE:
            return 1e3 * gain
        return float(
            np.sum([np.log(max(s.residual_rms, 1e-300)) for s in task.solutions(growth, bandwidth_hz)])
        )

    grid = [
        np.append(np.log(share * reach / (fastest * reach)), np.log(part * fastest.max() / (2.0 * np.pi)))
        for share in FIRST_SHARES
        for part in FIRST_BANDWIDTHS
    ]
    start = min(grid, key=cost)
    simplex = np.vstack([start, start + 0.4 * np.eye(len(start))])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": MOST_EVALUATIONS, "xatol": 1e-4, "fatol": 1e-7},
    ).x
    return np.exp(found[:-1]), float(np.exp(found[-1]))


class Slopes(NamedTuple):
    """How slopes of one output follow from moments: those of differences of neighbouring plays.

    grids : thresholds of each input [V]; reach : half swing of each input (input,) [V]
    invertible : whether the weights of the direct pairs keep the sign of the gain
    """

    grids: tuple[Array, ...]
    reach: Array
    invertible: bool

    def solved(self, moments: Sequence[Moments]) -> list[tuple[Solution, Array]]:
        """Slopes of each output, and the directions (slope, free) in which no weight stands at zero."""
        found = [solve(m.gram, m.cross[:, 0], float(m.power[0]), m.freedom) for m in moments]
        ways = [np.eye(len(m.gram)) for m in moments]
        for o, bounds in self._bounds(found).items():
            m = moments[o]
            found[o] = solve(m.gram, m.cross[:, 0], float(m.power[0]), m.freedom, bounds=bounds)
            ways[o] = bounds.basis[:, ~found[o].at_bound | (bounds.bound != 0.0)]
        return list(zip(found, ways, strict=True))

    def weights(self, slopes: Array) -> Array:
        """Weights of all plays of one output from its slopes."""
        return np.concatenate([np.diff(part, prepend=0.0) for part in np.split(slopes, self._ends)])

    @property
    def _ends(self) -> Array:
        return np.cumsum([len(grid) for grid in self.grids])[:-1]

    def _gains(self, slopes: Array) -> Array:
        """Gain of every input (input,) at the swing of the records [um/V]."""
        parts = zip(np.split(self.weights(slopes), self._ends), self.grids, self.reach, strict=True)
        return np.array([float(w @ (reach - r)) / reach for w, r, reach in parts])

    def _bounds(self, free: Sequence[Solution]) -> dict[int, Bounds]:
        """Bounds of each output that has a direct pair: weights keep the sign of the gain, others are free.

        The weight of play(0) keeps a share of the gain.
        """
        if not self.invertible:
            return {}
        gains = np.array([self._gains(s.coefficients) for s in free])
        sizes, found = [len(grid) for grid in self.grids], {}
        for o, k in direct_pairs(gains):
            first = sum(sizes[:k])
            own = slice(first, first + sizes[k])
            basis, side, bound = np.eye(sum(sizes)), np.zeros(sum(sizes)), np.zeros(sum(sizes))
            basis[own, own] = np.tri(sizes[k])
            side[own], bound[first] = np.sign(gains[o, k]), LEAST_SLOPE * float(gains[o, k])
            found[o] = Bounds(basis, side, bound)
        return found


class _Task(NamedTuple):
    """What stays fixed while growth and bandwidth are searched."""

    records: Sequence[Record]
    starts: Sequence[Start]
    grids: tuple[Array, ...]
    delay_samples: int
    through: tuple[LinearBlock, ...]
    invertible: bool

    def plays(self, growth_s: Array, bandwidth_hz: float) -> tuple[RatePlays, ...]:
        """Plays of each input with one growth for all but play(0)."""
        return tuple(
            RatePlays(r, np.append(0.0, np.full(len(r) - 1, b)), bandwidth_hz)
            for r, b in zip(self.grids, growth_s.tolist(), strict=True)
        )

    def no_weights(self) -> tuple[tuple[Array, ...], ...]:
        """Weights of nothing."""
        return (tuple(np.zeros(len(r)) for r in self.grids),)

    def solutions(self, growth_s: Array, bandwidth_hz: float) -> list[Solution]:
        """Slopes of each output with given growth and bandwidth."""
        p, every = len(self.records[0].y_um), range(len(self.records))
        plays = self.plays(growth_s, bandwidth_hz)
        if self.through:
            moments = [pooled([self._moments(i, [o], plays) for i in every]) for o in range(p)]
        else:
            parts = pooled([self._moments(i, range(p), plays) for i in every])
            moments = [parts.of_output(o) for o in range(p)]
        return [solution for solution, _ in self.slopes.solved(moments)]

    @property
    def slopes(self) -> Slopes:
        """How they are found."""
        return Slopes(self.grids, half_swing(self.records), self.invertible)

    def _moments(self, i: int, outputs: Sequence[int], plays: Sequence[RatePlays]) -> Moments:
        record, start = self.records[i], self.starts[i]
        u, y = delayed(record, start, self.delay_samples), record.y_um[list(outputs)]
        before = path_before(record, start)[:, -1]
        x = differences(u, plays, record.sample_time_s, start, before)
        if self.through:
            [path] = path_filters(self.through, i, outputs[0], len(x), len(record.y_um))
            held = differences(before[:, None], plays, record.sample_time_s, start, before)[:, 0]
            passed, state = path.respond(x, path.settled(held))
            x = path.respond(x, state)[0] if start.kind == "repeated" else passed
        parts = range(start.first, x.shape[1], BLOCK)
        return moments_of(((x[:, k : k + BLOCK], y[:, k : k + BLOCK]) for k in parts), len(x), len(y))


def differences(
    u_v: Array, plays: Sequence[RatePlays], sample_time_s: float, start: Start, before_v: Array
) -> Array:
    """Differences of neighbouring plays (column, sample), input by input, held at ``before_v`` (input,)."""
    from hammerstein.hysteresis.rate_dependent_kernels import play_outputs

    rows = []
    for k, (u, own) in enumerate(zip(u_v, plays, strict=True)):
        pole = np.array([np.exp(-2.0 * np.pi * own.bandwidth_hz * sample_time_s)])
        grid = (
            own.thresholds_v[None, :].copy(),
            own.growth_s[None, :].copy(),
            np.array([own.lambda_s_per_v]),
        )
        held = start.plays_v(float(before_v[k]), own.thresholds_v, k)
        memory = (held[None, :].copy(), np.full((1, 2), before_v[k]), np.zeros(1))
        outputs = np.empty((len(own.thresholds_v), len(u)))
        for _ in range(2 if start.kind == "repeated" else 1):
            play_outputs(np.ascontiguousarray(u[None, :]), sample_time_s, pole, *grid, *memory, outputs)
        outputs[:-1] -= outputs[1:].copy()
        rows.append(outputs)
    return np.vstack(rows)

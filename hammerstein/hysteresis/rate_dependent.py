"""Rate-dependent hysteresis: play operators whose thresholds grow with the rate of the voltage."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, ByValue, Indices, filled, freeze_fields, frozen
from hammerstein.blocks import Memory
from hammerstein.errors import IdentificationError, InputError, Mistake, refuse
from hammerstein.hysteresis.identifiable import Bounds, Driven, Identifiable, Limits
from hammerstein.hysteresis.kind import (
    CovarianceFile,
    Hysteresis,
    HysteresisFile,
    PartFile,
    refuse_not_finite,
)
from hammerstein.hysteresis.pair import WeightCovariance, played
from hammerstein.hysteresis.rate_dependent_kernels import play_outputs, respond_rate_dependent
from hammerstein.quantities import Bandwidth, Delay, Threshold, Weight

FIRST_SHARES = (0.01, 0.03, 0.1, 0.25)
"""Initial growth of a fit: increase of a threshold at the fastest rate, in parts of half the swing."""
FIRST_BANDWIDTHS = (0.5, 2.0, 8.0)
"""Initial bandwidth, in parts of the fastest rate of the records."""
LEAST_GAIN, STABLE, MOST_GAIN = 1e-6, 0.95, 100.0
"""Loop gain of the inverse on a fine grid: what is no growth at all, what leaves it stable, and any."""


@dataclass(frozen=True, eq=False)
class RatePlays(ByValue):
    """Plays of one input whose thresholds grow with its rate.

        R_i[k] = r_i + b_i g(rho[k]),   g(rho) = |rho|   or   log(1 + lambda |rho|) / lambda

    Parameters
    ----------
    thresholds_v : (operator,) thresholds r at rest [V], not negative, strictly increasing
    growth_s : (operator,) growth b [s]: volts for each V/s; not negative and not decreasing, so that plays
        keep their order
    bandwidth_hz : of the low-pass of the rate [Hz]
    lambda_s_per_v : lambda [s/V], rate constant at which the growth flattens; 0: linear growth

    Raises
    ------
    InputError : thresholds or growth out of order, or lengths that differ
    """

    thresholds_v: Array
    growth_s: Array
    bandwidth_hz: float = 500.0
    lambda_s_per_v: float = 0.0

    def __post_init__(self) -> None:
        freeze_fields(self, "thresholds_v", "growth_s")
        refuse("rate-dependent plays", list(self._mistakes()))

    def _mistakes(self) -> Iterator[Mistake]:
        """What is wrong with the numbers given."""
        r, b = self.thresholds_v, self.growth_s
        if r.ndim != 1 or not r.size or b.shape != r.shape:
            what = f"has shape {b.shape}, the thresholds {r.shape}; they must be equally many"
            yield Mistake("growth_s", what)
        elif not (np.isfinite(r).all() and np.isfinite(b).all()):
            yield Mistake("thresholds_v", "and growth_s must be finite")
        else:
            if (r < 0.0).any() or (np.diff(r) <= 0.0).any():
                yield Mistake("thresholds_v", "must be 0 or more and strictly increasing")
            if (b < 0.0).any() or (np.diff(b) < 0.0).any():
                what = "must be 0 or more and not decrease, so that the plays keep their order"
                yield Mistake("growth_s", what)
        if not (self.bandwidth_hz > 0.0 and 0.0 <= self.lambda_s_per_v < math.inf):
            yield Mistake("bandwidth_hz", "must be above 0, and lambda_s_per_v 0 or more")


@dataclass(frozen=True, eq=False)
class RateState(Memory):
    """Memory: outputs of the plays (m, n_max), last two voltages (m, 2) [V], filtered rates (m,) [V/s]."""

    plays_v: Array
    last_v: Array
    rate_v_per_s: Array


class RateBank(NamedTuple):
    """All plays of every input, for the kernels: n (m,), r and b (m, n_max), w (m, n_max, p)."""

    n: Indices
    r: Array
    b: Array
    lam: Array
    w: Array


@dataclass(frozen=True, eq=False, repr=False)
class RateDependent(Hysteresis[RateState], Identifiable):
    """Hysteresis of m inputs and p outputs that widens with the rate of its voltages.

        v_l[k] = sum over inputs j and operators i of  w_lji p_ji[k]
        p_i[k] = max(u[k] - R_i[k], min(u[k] + R_i[k], p_i[k-1])),   R_i[k] = r_i + b_i g(rho[k])
        rho[k] = a rho[k-1] + (1 - a) (u[k-1] - u[k-2]) / T,         a = exp(-2 pi f T)

    The rate is strictly causal: it uses voltages up to the previous sample. In each sample the thresholds are
    therefore known, and the model has the exact inverse of plays; with the rate of the same sample the
    inverse would chatter for b / T near 1. ``loop_gain`` states the stability of the loop from rate to
    voltage.

    Parameters
    ----------
    inputs : plays of each input, shared by all outputs
    weights_um_per_v : (output, input) arrays of weights (operator,) [um/V]
    sample_time_s : of its sample grid [s]; None: no grid yet, see ``on_grid``
    weight_covariance : (output,) covariance of the weights, if it is known

    Raises
    ------
    InputError : weights of other plays, or a response without a sample time

    Source: Ang, Garmon, Khosla and Riviere (IROS 2003), Al Janaideh and Krejci (IEEE/ASME Trans. Mechatronics
    18 (2013) 1498-1507); the causal rate and the multivariable inverse are this work's.

    Examples
    --------
    >>> plays = RatePlays([0.0, 1.0], [0.0, 1e-3])
    >>> model = RateDependent((plays,), (([1.0, 1.0],),)).on_grid(1e-3)
    >>> model.respond([[0.0, 2.0, 4.0]])[0].round(3)
    array([[0.   , 3.   , 5.086]])
    """

    inputs: tuple[RatePlays, ...]
    weights_um_per_v: tuple[tuple[Array, ...], ...]
    sample_time_s: float | None = None
    weight_covariance: tuple[WeightCovariance, ...] | None = None

    kind: ClassVar[str] = "rate_dependent"
    passes_for_delay: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", tuple(self.inputs))
        rows = tuple(tuple(frozen(w) for w in row) for row in self.weights_um_per_v)
        object.__setattr__(self, "weights_um_per_v", rows)
        counts = [len(plays.thresholds_v) for plays in self.inputs]
        for o, row in enumerate(rows):
            if [w.shape for w in row] != [(n,) for n in counts] or not all(np.isfinite(w).all() for w in row):
                message = f"row {o + 1} must hold {counts} finite weights, one for each play of each input"
                raise InputError("weights_um_per_v", message)
        if not rows:
            raise InputError("weights_um_per_v", "must have a row for each output")

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of plays of every pair (output, input)."""
        return tuple(tuple(len(w) for w in row) for row in self.weights_um_per_v)

    def describe(self) -> str:
        """Short description."""
        counts = sorted({len(plays.thresholds_v) for plays in self.inputs})
        most = max(float(plays.growth_s.max()) for plays in self.inputs)
        operators = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
        return (
            f"{self.ports}, {operators} plays for each input, "
            f"thresholds grow by up to {most:.3g} V for each V/s"
        )

    @cached_property
    def bank(self) -> RateBank:
        """All plays of every input."""
        n = np.array([len(plays.thresholds_v) for plays in self.inputs], dtype=np.int64)
        r, b = np.zeros((2, self.n_inputs, int(n.max())))
        w = np.zeros((*r.shape, self.n_outputs))
        for k, plays in enumerate(self.inputs):
            r[k, : n[k]], b[k, : n[k]] = plays.thresholds_v, plays.growth_s
            for o, row in enumerate(self.weights_um_per_v):
                w[k, : n[k], o] = row[k]
        return RateBank(n, r, b, np.array([plays.lambda_s_per_v for plays in self.inputs]), w)

    def on_grid(self, sample_time_s: float) -> RateDependent:
        """Return the block on a sample grid."""
        return self if sample_time_s == self.sample_time_s else replace(self, sample_time_s=sample_time_s)

    @property
    def grid_s(self) -> float:
        """Sample time [s]; InputError without a grid."""
        if self.sample_time_s is None:
            raise InputError("rate-dependent hysteresis", "needs a sample time; take its on_grid(T)")
        return self.sample_time_s

    @cached_property
    def poles(self) -> Array:
        """Poles a of the low-passes (m,)."""
        cut = np.array([plays.bandwidth_hz for plays in self.inputs])
        return np.exp(-2.0 * np.pi * cut * self.grid_s)

    @property
    def n_beside_weights(self) -> int:
        """Per input: thresholds, the shared growth of its plays, and the bandwidth of the rate."""
        return sum(len(plays.thresholds_v) + 2 for plays in self.inputs)

    def loop_gain(self) -> Array:
        """Loop gain of the inverse of a square model, by input (m,): stable below 1.

        See ``stability_gain``.
        """
        return stability_gain(self.bank.w, self.bank.b, self.poles, self.grid_s)

    def rest(self) -> RateState:
        """Memory at rest."""
        return RateState(np.zeros(self.bank.r.shape), np.zeros((self.n_inputs, 2)), np.zeros(self.n_inputs))

    def after(self, path_v: Array) -> RateState:
        """Memory after a path; see ``Hysteresis.after``."""
        plays = np.zeros(self.bank.r.shape)
        for k, n in enumerate(self.bank.n):
            plays[k, :n] = played(path_v[k], self.bank.r[k, :n])
        return RateState(plays, np.repeat(path_v[:, -1:], 2, axis=1), np.zeros(self.n_inputs))

    def standing(self, path_v: Array) -> tuple[Array, RateState]:
        """Outputs and memory at the end of a slow path, without the growth that jumps would cause."""
        state = self.after(path_v)
        return np.einsum("kio,ki->o", self.bank.w, state.plays_v), state

    def _respond(self, u_v: Array, start: RateState) -> tuple[Array, RateState]:
        refuse_not_finite(u_v)
        state, products = start.copy(), 8 * self.bank.w.size
        given, shape = (u_v, *self._numbers(state)), (self.n_outputs, u_v.shape[1])
        return filled(respond_rate_dependent, *given, shape=shape, products=products), state

    def _numbers(self, memory: RateState) -> tuple[Any, ...]:
        """What the kernel takes beside voltages and outputs."""
        return (self.grid_s, self.poles, *self.bank, memory.plays_v, memory.last_v, memory.rate_v_per_s)

    def in_loop(self, memory: RateState) -> tuple[Any, ...]:
        """Parameters and memory; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Rates

        return Rates(self._numbers(memory), np.empty((self.n_outputs, 1)))

    def amplitude(self, amplitude_v: ArrayLike) -> Array:
        """Half heights of the settled loops driven slowly (output, input) [um], in closed form."""
        sizes = np.broadcast_to(np.asarray(amplitude_v, dtype=np.float64), self.n_inputs)
        reach = [np.maximum(a - plays.thresholds_v, 0.0) for a, plays in zip(sizes, self.inputs, strict=True)]
        return np.array(
            [[float(w @ x) for w, x in zip(row, reach, strict=True)] for row in self.weights_um_per_v]
        )

    def slope_columns(self, k: int) -> Array:
        """Slopes (number, output) [um/V] while the first 1, 2, ... plays of input k move."""
        return np.cumsum(self.bank.w[k, : self.bank.n[k]], axis=0)

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, input after input [um/V]."""
        return tuple(np.concatenate(row) for row in self.weights_um_per_v)

    def with_weights(self, weights: Sequence[ArrayLike]) -> RateDependent:
        """Return the same plays with other weights."""
        rows = tuple(map(tuple, self._by_pair(weights)))
        return replace(self, weights_um_per_v=rows, weight_covariance=None)

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[RateDependent]:
        """Blocks with one growth for all plays but play(0); see ``Identifiable``."""
        for name, several in zip(driven.inputs, driven.several_rates, strict=True):
            if not several:
                raise IdentificationError(
                    f"input {name} was driven at one rate only, so the growth of its thresholds cannot be "
                    "identified; add a record at least 1.5 times as fast, or use hysteresis "
                    "prandtl_ishlinskii"
                )
        found = []
        grids = [np.append(0.0, r[r > 0.0]) for r in driven.thresholds_v]
        weights = ((tuple(np.ones(len(r)) for r in grids)),) * driven.outputs
        for share, part in itertools.product(FIRST_SHARES, FIRST_BANDWIDTHS):
            hz = part * float(driven.fastest_rad_per_s.max()) / (2.0 * math.pi)
            growth = [share / max(float(rate), 1e-12) for rate in driven.fastest_rad_per_s]
            plays = (_grown_alike(r, b, hz) for r, b in zip(grids, growth, strict=True))
            found.append(cls(tuple(plays), weights))
        return found

    @property
    def places(self) -> tuple[Array, ...]:
        """Thresholds of each input [V]."""
        return tuple(plays.thresholds_v for plays in self.inputs)

    def at_places(self, places: Sequence[Array]) -> RateDependent:
        """Return plays with other thresholds; negative ones are mirrored."""
        each = zip(self.inputs, places, strict=True)
        plays = tuple(replace(own, thresholds_v=np.sort(np.abs(r))) for own, r in each)
        return replace(self, inputs=plays, weight_covariance=None)

    @property
    def free(self) -> Array:
        """Logarithms of 2 pi f b of each input, the loop gain of the inverse on a fine grid, and of f."""
        hz = self.inputs[0].bandwidth_hz
        growth = [max(float(plays.growth_s[-1]), 1e-300) for plays in self.inputs]
        return np.array([*(math.log(2.0 * math.pi * hz * b) for b in growth), math.log(hz)])

    def at(self, free: Array) -> RateDependent:
        """Return the same plays with other growth, alike for all but play(0), and another bandwidth."""
        *gains, hz = np.exp(free).tolist()
        each = zip(self.inputs, gains, strict=True)
        plays = tuple(_grown_alike(own.thresholds_v, g / (2.0 * math.pi * hz), hz) for own, g in each)
        return replace(self, inputs=plays, weight_covariance=None)

    def limits(self, driven: Driven) -> Limits:
        """Bandwidth from one over the record to half its rate, and a stable inverse."""
        most = STABLE if driven.invertible else MOST_GAIN
        ends = ((LEAST_GAIN, 1.0 / driven.duration_s), (most, 0.5 / driven.sample_time_s))
        lower, upper = (np.log([*((gain,) * self.n_inputs), hz]) for gain, hz in ends)
        return Limits(lower, upper)

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Outputs of the plays; see ``Identifiable``."""
        stood, values = self.after(before_v), []
        for k, plays in enumerate(self.inputs):
            n = len(plays.thresholds_v)
            own = (plays.thresholds_v[None].copy(), plays.growth_s[None].copy(), self.bank.lam[[k]])
            memory = (stood.plays_v[[k], :n].copy(), stood.last_v[[k]].copy(), np.zeros(1))
            outputs, u = np.empty((n, u_v.shape[1])), np.ascontiguousarray(u_v[[k]])
            for _ in range(passes):
                play_outputs(u, self.grid_s, self.poles[[k]], *own, *memory, outputs)
            values.append(outputs)
        held = [stood.plays_v[k, : len(plays.thresholds_v)] for k, plays in enumerate(self.inputs)]
        return np.vstack(values), np.concatenate(held)

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """Weights keep the sign of the gain, and play(0) a share: then all that can move together has one."""
        sizes = [len(plays.thresholds_v) for plays in self.inputs]
        first = sum(sizes[:input_])
        side, bound = np.zeros(sum(sizes)), np.zeros(sum(sizes))
        side[first : first + sizes[input_]], bound[first] = np.sign(least), least
        return Bounds(np.eye(len(side)), side, bound)

    def without_own(self) -> tuple[RateDependent, str]:
        """Plays whose thresholds do not grow."""
        still = tuple(replace(plays, growth_s=np.zeros(len(plays.growth_s))) for plays in self.inputs)
        return replace(self, inputs=still, weight_covariance=None), "growth of the thresholds with the rate"

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Return the growth of every input."""
        return [
            f"thresholds of {name} grow by {float(plays.growth_s[-1]):.3g} V for each V/s, for a rate "
            f"with a bandwidth of {plays.bandwidth_hz:.3g} Hz"
            for name, plays in zip(inputs, self.inputs, strict=True)
        ]


def _grown_alike(thresholds_v: Array, growth_s: float, bandwidth_hz: float) -> RatePlays:
    """Plays with one growth for all but play(0)."""
    return RatePlays(thresholds_v, np.where(thresholds_v > 0.0, growth_s, 0.0), bandwidth_hz)


class RatePlaysFile(PartFile):
    """Plays of one input in a model file."""

    describes: ClassVar = RatePlays
    thresholds_v: tuple[Threshold, ...]
    growth_s: tuple[Delay, ...] = Field(description="growth of a threshold in V for each V/s")
    bandwidth_hz: Bandwidth = 500.0
    lambda_s_per_v: Delay = Field(
        default=0.0, description="rate constant at which the growth flattens; 0: linear growth"
    )


class RateDependentFile(HysteresisFile):
    """Plays whose thresholds grow with the rate: those of each input, and their weights for each output."""

    kind: Literal["rate_dependent"] = "rate_dependent"
    describes: ClassVar = RateDependent
    inputs: Annotated[tuple[RatePlaysFile, ...], Field(min_length=1)]
    weights_um_per_v: Annotated[tuple[tuple[tuple[Weight, ...], ...], ...], Field(min_length=1)]
    weight_covariance: tuple[CovarianceFile, ...] | None = None


def stability_gain(weights: Array, growth_s: Array, poles: Array, sample_time_s: float) -> Array:
    """Loop gain of each input (m,): stable below 1; inf if unknown.

    On a branch the inverse gives ``u[k] = ... + B rho[k]`` with ``B = J^-1 N``; column k of J sums the
    weights of the plays of input k that move, that of N the weights times their growth. Any plays may move
    together with the first. With one input the closed loop has the poles of

        z^2 - (a + beta) z + beta = 0,      beta = b (1 - a) / T,   b = sum of w_i b_i / sum of w_i,

    stable while ``-(1 + a) / 2 < beta < 1``. With weights of both signs b leaves the range of the b_i. With
    several inputs, ``B = diag(b) + E``; a column of E of size e (1 - a) / T = eps moves an eigenvalue by no
    more, and a disc of radius eps about beta lies in the stable region while ``beta + 2 eps / (1 + a) < 1``
    and ``eps - beta < (1 + a) / 2``.

    Parameters
    ----------
    weights : (input, play, output) [um/V] of a square model, which has an inverse
    growth_s : (input, play) growth, not falling [s]
    poles : (input,) a of the low-passes of the rate
    sample_time_s : T [s]

    Source: Gershgorin's discs in the coordinates of the mean slopes; this work's.
    """
    mean = 0.5 * (weights[:, 0].T + weights.sum(axis=1).T)
    ends, across, kept = [], [], []
    for k, own_weights in enumerate(weights):
        shares = np.linalg.solve(mean, own_weights.T)
        own, others = shares[k], np.delete(shares, k, axis=0)
        low, high = _mean_growth(own, growth_s[k])
        off = np.maximum(np.abs(growth_s[k] - low), np.abs(growth_s[k] - high))
        across.append(float((np.abs(others) * off).sum()))
        least, most = worst_shares(own, others)
        kept.append(least - most)
        ends.append((min(low, 0.0), max(high, 0.0)))
    if min(kept) <= 0.0:
        return np.full(len(weights), np.inf)
    scale, half = (1.0 - poles) / sample_time_s, 0.5 * (1.0 + poles)
    (low, high), around = scale * np.array(ends).T, scale * np.array(across) / min(kept)
    return np.asarray(np.maximum(high + around / half, (around - low) / half))


def worst_shares(own: Array, others: Array) -> tuple[float, float]:
    """Least share of its own mean slope that an input keeps, and the most that it moves all others by.

    own, others : (play,) and (other, play) shares of its plays, of which any may move with the first
    """
    highest = others[:, 0] + np.maximum(others[:, 1:], 0.0).sum(axis=1)
    lowest = others[:, 0] + np.minimum(others[:, 1:], 0.0).sum(axis=1)
    return own[0] + np.minimum(own[1:], 0.0).sum(), float(np.maximum(highest, -lowest).sum())


def _mean_growth(weights: Array, growth_s: Array) -> tuple[float, float]:
    """Least and greatest weighted mean growth over all plays that may move with the first.

    Where the mean is greatest, plays of positive weight move that grow more than it does, and of negative
    weight that grow less; where it is least, the others.
    """
    if weights[0] + np.minimum(weights[1:], 0.0).sum() <= 0.0:
        return -np.inf, np.inf
    number = np.arange(len(weights))
    last = number >= np.arange(1, len(weights) + 1)[:, None]  # (split, play): those that grow most
    means = []
    for moving in (last == (weights > 0.0), last == (weights <= 0.0)):
        moving[:, 0] = True
        means.append((moving @ (weights * growth_s)) / (moving @ weights))
    return float(np.min(means)), float(np.max(means))

"""The multivariable classical Bouc-Wen model: a line minus a hysteretic signal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, filled, frozen
from hammerstein.blocks import Memory
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.hysteresis.bouc_wen_kernels import lagging, respond_bouc_wen
from hammerstein.hysteresis.identifiable import Bounds, Driven, Identifiable, Limits
from hammerstein.hysteresis.kind import (
    CovarianceFile,
    HysteresisFile,
    OfPairs,
    PartFile,
    refuse_not_finite,
)
from hammerstein.hysteresis.pair import WeightCovariance, refuse_other_sizes
from hammerstein.quantities import PerVolt, Weight

FIRST_RATES, FIRST_SHARES = (0.5, 2.0, 8.0), (0.35, 1.0, 2.5)
"""Initial beta + gamma of a fit, in parts of one over half the swing, and the share of beta in it."""
RATES, SHARES = (1e-2, 1e3), (1e-3, 1e3)
"""Least and largest of both: beyond, the loop is a line, or it bends within a thousandth of the swing."""


LEAST_LOAD = 1e-12  # of beta: a smaller beta + gamma is rounding


@dataclass(frozen=True)
class BoucWenPair:
    """Response of one output to one input.

        v = d u - a z,    dz/dt = du/dt - beta |du/dt| z - gamma du/dt |z|

    With h = a z this is the usual dh/dt = a du/dt - B |du/dt| h - C du/dt |h| with B = beta, C = gamma sgn a.

    Parameters
    ----------
    direct_um_per_v : d, the slope when z is at its limit 1 / (beta + gamma) [um/V]
    hysteretic_um_per_v : a, gain of z [um/V], of either sign; 0: a linear gain
    beta_per_v : mean rate at which z relaxes [1/V], 0 or more: a negative one would generate energy
    gamma_per_v : difference of this rate between growing and falling z [1/V], above -beta, or z would grow
        without limit; both 0: a line

    Raises
    ------
    InputError : numbers beyond that, or not finite
    """

    direct_um_per_v: float
    hysteretic_um_per_v: float = 0.0
    beta_per_v: float = 0.0
    gamma_per_v: float = 0.0

    def __post_init__(self) -> None:
        mistakes = []
        numbers = (self.direct_um_per_v, self.hysteretic_um_per_v, self.beta_per_v, self.gamma_per_v)
        if not np.isfinite(numbers).all():
            mistakes.append(Mistake("direct_um_per_v", "and the others must be finite"))
        if self.beta_per_v < 0.0:
            mistakes.append(Mistake("beta_per_v", f"is {self.beta_per_v:g}; it must be 0 or more"))
        elif self.load_per_v < LEAST_LOAD * self.beta_per_v or self.load_per_v < 0.0:
            what = f"is {self.gamma_per_v:g}; at -beta and below the hysteretic part grows without limit"
            mistakes.append(Mistake("gamma_per_v", what))
        refuse("Bouc-Wen pair", mistakes)

    @property
    def load_per_v(self) -> float:
        """Rate at which z relaxes while it grows, beta + gamma [1/V]."""
        return self.beta_per_v + self.gamma_per_v

    @property
    def unload_per_v(self) -> float:
        """Rate at which z relaxes while it falls, beta - gamma [1/V]."""
        return self.beta_per_v - self.gamma_per_v

    @property
    def slopes_um_per_v(self) -> tuple[float, float]:
        """Extreme slopes [um/V]: with z at its limit d, and the farthest from that.

        dz/du reaches from 0 to 1 while z grows, and to 1 + (beta - gamma) |z| while it falls, which is
        2 beta / (beta + gamma) at most.
        """
        steepest = max(1.0, 2.0 * self.beta_per_v / self.load_per_v) if self.load_per_v > 0.0 else 1.0
        return self.direct_um_per_v, self.direct_um_per_v - self.hysteretic_um_per_v * steepest

    def amplitude(self, amplitude_v: float) -> float:
        """Half height of the settled loop [um] from tip to tip: d A - a z."""
        return self.direct_um_per_v * amplitude_v - self.hysteretic_um_per_v * self.tip_v(amplitude_v)

    def tip_v(self, amplitude_v: float) -> float:
        """Value of z at the tip of the settled loop of an amplitude A [V].

        With c = beta + gamma and e = beta - gamma the tip solves

            ln(1 + e z) / e - ln(1 - c z) / c = 2 A        (z / 1 for each logarithm whose rate is 0)
        """
        from scipy.optimize import brentq

        c, e = self.load_per_v, self.unload_per_v

        def left(z: float) -> float:
            fallen = np.log1p(e * z) / e if e else z
            return float(fallen - (np.log1p(-c * z) / c if c else -z) - 2.0 * amplitude_v)

        if not c:
            return amplitude_v if not e else float(brentq(left, 0.0, 2.0 * amplitude_v, xtol=1e-15))
        limit = 1.0 / c
        last = np.nextafter(limit, 0.0)
        if not self.beta_per_v:  # no loop: z is a function of the voltage
            return float(-np.expm1(-c * amplitude_v) / c)
        return float(last if left(last) <= 0.0 else brentq(left, 0.0, last, xtol=1e-15 * limit))


@dataclass(frozen=True, eq=False)
class BoucWenState(Memory):
    """Memory: the hysteretic part z of each pair (p, m) [V], and the last voltages (m,) [V]."""

    z_v: Array
    last_v: Array


@dataclass(frozen=True, eq=False, repr=False)
class BoucWen(OfPairs[BoucWenState], Identifiable):
    """Bouc-Wen hysteresis with exponent 1; each of p outputs is a sum over m inputs.

        v_l = sum over inputs k of  d_lk u_k - a_lk z_lk
        dz_lk/dt = du_k/dt - beta_lk |du_k/dt| z_lk - gamma_lk du_k/dt |z_lk|

    z depends on the path of the voltage, not on its rate. Between two samples the voltage is linear, and z is
    integrated by the midpoint rule in steps of at most 1/64 of the relaxation voltage. The error is below
    2e-4 of the limit of z, for any voltage step.

    Minor loops do not close (no wiping-out) and depend on their position (no congruency).

    Parameters
    ----------
    pairs : (output, input) nested sequence of ``BoucWenPair``
    weight_covariance : (output,) covariance of d and a, pair after pair, if it is known; it holds for the
        beta and gamma of the model

    Raises
    ------
    InputError : rows of different lengths, or none

    Source: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249-263; Ikhouane and Rodellar, Systems with Hysteresis
    (Wiley 2007) for what bounds it; Habineza, Rakotondrabe and Le Gorrec, IEEE Trans. Control Syst. Technol.
    23 (2015) 1797-1806 for several axes.

    Examples
    --------
    >>> model = BoucWen([[BoucWenPair(2.0, 1.0, beta_per_v=0.5)]])
    >>> model.respond([[0.0, 4.0, 0.0]])[0].round(2)
    array([[0.  , 6.27, 1.5 ]])
    """

    pairs: tuple[tuple[BoucWenPair, ...], ...]
    weight_covariance: tuple[WeightCovariance, ...] | None = None

    kind: ClassVar[str] = "bouc_wen"

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple(tuple(row) for row in self.pairs))
        if not self.pairs or not self.pairs[0] or len({len(row) for row in self.pairs}) > 1:
            raise InputError("Bouc-Wen model", "must have a row for each output, with a pair for each input")
        refuse_other_sizes(self.operators, self.weight_covariance)

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of weights of every pair (output, input): d and a."""
        return tuple((2,) * len(row) for row in self.pairs)

    @property
    def n_beside_weights(self) -> int:
        """Beta and gamma of each pair."""
        return 2 * self.n_inputs * self.n_outputs

    def describe(self) -> str:
        """Short description."""
        rates = sorted(pair.load_per_v for row in self.pairs for pair in row if pair.hysteretic_um_per_v)
        knees = " to ".join(dict.fromkeys(f"{1.0 / c:.3g}" for c in (*rates[-1:], *rates[:1]) if c))
        way = f", relaxing within {knees} V" if knees else ""
        return f"Bouc-Wen of {self.ports}{way}"

    @cached_property
    def bank(self) -> Array:
        """Parameters of all pairs (4, p, m): d, a, and the rates of growing and of falling z."""
        names = ("direct_um_per_v", "hysteretic_um_per_v", "load_per_v", "unload_per_v")
        return frozen([[[getattr(pair, name) for pair in row] for row in self.pairs] for name in names])

    def rest(self) -> BoucWenState:
        """Memory at rest."""
        return BoucWenState(np.zeros((self.n_outputs, self.n_inputs)), np.zeros(self.n_inputs))

    def after(self, path_v: Array) -> BoucWenState:
        """Memory after a path; see ``Hysteresis.after``."""
        return self.respond(path_v, BoucWenState(self.rest().z_v, path_v[:, 0].copy()))[1]

    def _respond(self, u_v: Array, start: BoucWenState) -> tuple[Array, BoucWenState]:
        refuse_not_finite(u_v)
        state, shape, products = start.copy(), (self.n_outputs, u_v.shape[1]), 64 * self.bank[0].size
        given = (u_v, *self.bank, state.z_v, state.last_v)
        return filled(respond_bouc_wen, *given, shape=shape, products=products), state

    def in_loop(self, memory: BoucWenState) -> tuple[Any, ...]:
        """Parameters and memory; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Lags

        return Lags((*self.bank, memory.z_v, memory.last_v), np.empty((self.n_outputs, 1)))

    def slope_columns(self, k: int) -> Array:
        """Extreme slopes of input k (number, output) [um/V], in all combinations; d comes last.

        Every slope lies between them. A function that is linear in each slope, such as a determinant, is
        therefore largest and smallest at one of these combinations.
        """
        return np.array(list(itertools.product(*[row[k].slopes_um_per_v[::-1] for row in self.pairs])))

    @property
    def weights(self) -> tuple[Array, ...]:
        """Slopes d and a of each pair of each output, pair after pair [um/V]."""
        return tuple(
            np.array([w for pair in row for w in (pair.direct_um_per_v, pair.hysteretic_um_per_v)])
            for row in self.pairs
        )

    def with_weights(self, weights: Sequence[ArrayLike]) -> BoucWen:
        """Return the same beta and gamma with other d and a."""
        rows = []
        for row, own in zip(self.pairs, self._by_pair(weights), strict=True):
            each = zip(row, np.array(own, dtype=np.float64).tolist(), strict=True)
            rows.append(tuple(replace(p, direct_um_per_v=d, hysteretic_um_per_v=a) for p, (d, a) in each))
        return BoucWen(tuple(rows))

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[BoucWen]:
        """Blocks whose pairs all have the same bend relative to the swing; see ``Identifiable``."""
        driven.refuse_still()
        found = []
        for rate, share in itertools.product(FIRST_RATES, FIRST_SHARES):
            load = rate / driven.half_swing_v
            row = tuple(BoucWenPair(1.0, 1.0, share * c, (1.0 - share) * c) for c in load.tolist())
            found.append(cls((row,) * driven.outputs))
        return found

    @property
    def free(self) -> Array:
        """Logarithms of beta + gamma [1/V] and of the share of beta in it, pair after pair."""
        pairs = [(pair.load_per_v, pair.beta_per_v) for row in self.pairs for pair in row]
        return np.array([x for load, beta in pairs for x in (math.log(load), math.log(beta / load))])

    def at(self, free: Array) -> BoucWen:
        """Return the same d and a with other beta and gamma."""
        numbers = iter(np.exp(free.reshape(-1, 2)).tolist())

        def bent(pair: BoucWenPair) -> BoucWenPair:
            load, share = next(numbers)
            return replace(pair, beta_per_v=share * load, gamma_per_v=(1.0 - share) * load)

        return BoucWen(tuple(tuple(bent(pair) for pair in row) for row in self.pairs))

    def limits(self, driven: Driven) -> Limits:
        """Range of bends that the swing can identify."""
        each = np.log([[RATES[0], SHARES[0]], [RATES[1], SHARES[1]]])
        scale = np.stack([np.log(driven.half_swing_v), np.zeros(self.n_inputs)], axis=1).ravel()
        lower, upper = (np.tile(end, self.n_inputs) - scale for end in each)
        return Limits(np.tile(lower, self.n_outputs), np.tile(upper, self.n_outputs))

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Voltage and -z of each input; see ``Identifiable``."""
        values, held = np.empty((2 * self.n_inputs, u_v.shape[1])), np.empty(2 * self.n_inputs)
        for k, pair in enumerate(self.pairs[output]):
            rates, u, turns = (pair.load_per_v, pair.unload_per_v), u_v[k], before_v[k].copy()
            z, last = np.empty(u.shape), float(turns[-1])
            end = lagging(turns, *rates, 0.0, turns[0], np.empty(turns.shape))
            held[2 * k : 2 * k + 2] = last, -end
            for _ in range(passes):
                end, last = lagging(np.ascontiguousarray(u), *rates, end, last, z), float(u[-1])
            values[2 * k], values[2 * k + 1] = u, -z
        return values, held

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """Both extreme slopes of the pair stay above the minimum."""
        size, own = 2 * self.n_inputs, slice(2 * input_, 2 * input_ + 2)
        pair = self.pairs[output][input_]
        steepest = max(1.0, 2.0 * pair.beta_per_v / pair.load_per_v)
        basis, side, bound = np.eye(size), np.zeros(size), np.zeros(size)
        basis[own, own] = [[1.0, 0.0], [1.0 / steepest, -1.0 / steepest]]  # of d and d - steepest a
        side[own], bound[own] = np.sign(least), least
        return Bounds(basis, side, bound)

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Return beta and gamma of every pair."""
        return [
            f"from {name} to {output}: beta {pair.beta_per_v:.3g}, gamma {pair.gamma_per_v:.3g} 1/V"
            for output, row in zip(outputs, self.pairs, strict=True)
            for name, pair in zip(inputs, row, strict=True)
        ]


class BoucWenPairFile(PartFile):
    """One pair in a model file."""

    describes: ClassVar = BoucWenPair
    direct_um_per_v: Weight = Field(description="slope at the limit of the hysteretic part")
    hysteretic_um_per_v: Weight = Field(default=0.0, description="gain of the hysteretic part")
    beta_per_v: PerVolt = Field(default=0.0, description="rate at which it forgets; 0 or more")
    gamma_per_v: PerVolt = Field(
        default=0.0, description="difference of this rate between growing and falling z"
    )


class BoucWenFile(HysteresisFile):
    """The Bouc-Wen model: four numbers of every pair (output, input)."""

    kind: Literal["bouc_wen"] = "bouc_wen"
    describes: ClassVar = BoucWen
    pairs: Annotated[tuple[tuple[BoucWenPairFile, ...], ...], Field(min_length=1)]
    weight_covariance: tuple[CovarianceFile, ...] | None = None

"""Generalised Prandtl-Ishlinskii hysteresis: play operators behind an increasing envelope of each voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, ByValue, freeze_fields, frozen, padded
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.hysteresis.identifiable import (
    LEAST_ENGAGED,
    Bounds,
    Driven,
    Identifiable,
    Limits,
    kept_apart,
    within_gaps,
)
from hammerstein.hysteresis.kind import (
    CovarianceFile,
    Describable,
    Hysteresis,
    HysteresisFile,
    PairFile,
    PartFile,
    described,
    refuse_not_finite,
    working_point,
)
from hammerstein.hysteresis.pair import Pair, PlayState, WeightCovariance, play_bends
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hammerstein.hysteresis.shape_kernels import bent_at, tanh_by_doubling
from hammerstein.quantities import Offset, PerVolt

FIRST_KNOTS = (0.25, 0.5, 0.75)
"""Where the slope of the first envelopes changes, in parts of the range."""
FIRST_SLOPES = ((1.0, 1.1, 1.2, 1.3), (1.3, 1.2, 1.1, 1.0), (1.0, 1.2, 1.2, 1.0))
"""Slopes of the first envelopes: stiffening, softening, saturating at both ends. A bend of exactly 0 would
leave its place open."""
FIRST_SHARE, FIRST_STEEPNESS = 0.3, 4.0
"""Share of the hyperbolic tangent in the swing of a first envelope, and its steepness over the range."""
KNOTS, SLOPES = (0.02, 0.98), 50.0
"""Where knots may stand, in parts of the range, and the largest ratio of two slopes."""
SHARES, STEEPNESSES, CENTRES = (1e-3, 0.98), (0.3, 10.0), (-0.2, 1.2)
"""The same of the tangent: its share of the swing, steepness over the range, and centre."""
BEYOND = 0.01
"""By how much a number may pass its upper limit, so that it has a derivative there."""
SMALL = 1e-6
"""Change of a number of an envelope for its derivative."""
APART = 1e-9
"""Distance, in parts of the range, by which knots are kept in order."""


@dataclass(frozen=True, eq=False)
class Envelope(ByValue):
    """An increasing function of one voltage: straight lines through points, and a hyperbolic tangent.

        g(u) = line(u) + a tanh(b (u - c))

    Beyond the outer points, the outer lines continue.

    Parameters
    ----------
    voltages_v : (point,) two voltages or more, as they are sent [V], strictly increasing
    values_v : (point,) values of the lines there [V], strictly increasing
    saturating_v : a, half of the range of the tangent [V], 0 or more
    steepness_per_v : b [1/V], 0 or more
    centre_v : c, an absolute voltage [V]

    Raises
    ------
    InputError : points out of order, lengths that differ, numbers beyond that

    Examples
    --------
    >>> Envelope([0.0, 10.0, 20.0], [0.0, 10.0, 15.0]).of([5.0, 16.0, 22.0])
    array([ 5., 13., 16.])
    """

    voltages_v: Array
    values_v: Array
    saturating_v: float = 0.0
    steepness_per_v: float = 0.0
    centre_v: float = 0.0

    def __post_init__(self) -> None:
        freeze_fields(self, "voltages_v", "values_v")
        u, g, mistakes = self.voltages_v, self.values_v, []
        if u.ndim != 1 or u.shape != g.shape or len(u) < 2:
            what = f"has shape {g.shape}, the voltages {u.shape}; give two points or more, one value each"
            mistakes.append(Mistake("values_v", what))
        elif not (np.isfinite(u).all() and np.isfinite(g).all()):
            mistakes.append(Mistake("voltages_v", "and values_v must be finite"))
        elif (np.diff(u) <= 0.0).any() or (np.diff(g) <= 0.0).any():
            what = "and values_v must be strictly increasing, or the envelope has no inverse"
            mistakes.append(Mistake("voltages_v", what))
        a, b = self.saturating_v, self.steepness_per_v
        if not (0.0 <= a < np.inf and 0.0 <= b < np.inf and np.isfinite(self.centre_v)):
            mistakes.append(Mistake("saturating_v", "and steepness_per_v must be 0 or more, and all finite"))
        refuse("envelope", mistakes)

    @cached_property
    def slopes(self) -> Array:
        """Slope of each line (point - 1,)."""
        return frozen(np.diff(self.values_v) / np.diff(self.voltages_v))

    @cached_property
    def intercepts(self) -> Array:
        """Value of each line at 0 V (point - 1,) [V]."""
        return frozen(self.values_v[:-1] - self.slopes * self.voltages_v[:-1])

    @property
    def bent(self) -> bool:
        """Whether it has a hyperbolic tangent."""
        return self.saturating_v > 0.0 and self.steepness_per_v > 0.0

    def of(self, u_v: ArrayLike) -> Array:
        """Values at absolute voltages [V]."""
        u = np.asarray(u_v, dtype=np.float64)
        line = np.searchsorted(self.voltages_v[1:-1], u)
        straight = self.intercepts[line] + self.slopes[line] * u
        return np.asarray(straight + self._tangent(u) if self.bent else straight)

    def at(self, values_v: ArrayLike) -> Array:
        """Inverse: absolute voltages for given values [V]."""
        g = np.asarray(values_v, dtype=np.float64)
        if not self.bent:
            return self._straight_at(g)
        low, high = (self._straight_at(g + side * self.saturating_v) for side in (-1.0, 1.0))
        lines = self.voltages_v[1:-1], self.intercepts, self.slopes
        bend = self.saturating_v, self.steepness_per_v, self.centre_v
        return bent_at(g.flatten(), low.flatten(), high.flatten(), lines, bend).reshape(g.shape)  # type: ignore[no-any-return]

    def _straight_at(self, g: Array) -> Array:
        """Inverse of the lines alone."""
        line = np.searchsorted(self.values_v[1:-1], g)
        return np.asarray((g - self.intercepts[line]) / self.slopes[line])

    def _tangent(self, u: Array) -> Array:
        return np.asarray(self.saturating_v * tanh_by_doubling(self.steepness_per_v * (u - self.centre_v)))

    @property
    def all_slopes(self) -> Array:
        """Possible slopes: every one lies between the smallest and the largest of these."""
        steepest = self.slopes + self.saturating_v * self.steepness_per_v
        return np.concatenate([self.slopes, steepest]) if self.bent else self.slopes

    @property
    def n_free(self) -> int:
        """Number of ``free`` parameters."""
        return 2 * (len(self.voltages_v) - 2) + 3 * self.bent

    @property
    def free(self) -> Array:
        """Positions of the knots in parts of the range, logarithms of slopes; share, steepness and centre."""
        low, span = float(self.voltages_v[0]), float(np.ptp(self.voltages_v))
        knots = (self.voltages_v[1:-1] - low) / span
        numbers = [knots, np.log(self.slopes[1:] / self.slopes[0])]
        if self.bent:
            added = float(np.ptp(self._tangent(self.voltages_v[[0, -1]])))
            steep, centre = self.steepness_per_v * span, (self.centre_v - low) / span
            numbers.append(np.array([added / (added + float(np.ptp(self.values_v))), np.log(steep), centre]))
        return np.concatenate(numbers)

    def with_free(self, free: Array) -> Envelope:
        """Return the envelope with other ``free`` numbers; it rises by the distance of its outer points.

        Numbers beyond their limits count as these: a draw of uncertain numbers can be anywhere.
        """
        least, most = self.limits()
        free = np.clip(free, least, most + BEYOND)
        low, span, n = float(self.voltages_v[0]), float(np.ptp(self.voltages_v)), len(self.voltages_v) - 2
        order = np.sort(free[:n]) + APART * np.arange(1, n + 1)
        knots = np.concatenate([[0.0], order, [1.0]])
        slopes = np.exp(np.concatenate([[0.0], free[n : 2 * n]]))
        rises = np.concatenate([[0.0], np.cumsum(slopes * np.diff(knots))])
        share = float(free[2 * n]) if self.bent else 0.0
        values = low + (1.0 - share) * span * rises / rises[-1]
        if not self.bent:
            return Envelope(low + span * knots, values)
        steep, centre = float(np.exp(free[2 * n + 1])) / span, low + span * float(free[2 * n + 2])
        ends = np.tanh(steep * (low + span * np.array([0.0, 1.0]) - centre))
        return Envelope(low + span * knots, values, share * span / float(np.ptp(ends)), steep, centre)

    def limits(self) -> Limits:
        """Box of the ``free`` numbers."""
        n = len(self.voltages_v) - 2
        ends = []
        for i, sign in ((0, -1.0), (1, 1.0)):
            own = [KNOTS[i]] * n + [sign * np.log(SLOPES)] * n
            own += [SHARES[i], np.log(STEEPNESSES[i]), CENTRES[i]] if self.bent else []
            ends.append(np.array(own))
        return Limits(*ends)


@dataclass(frozen=True, eq=False, repr=False)
class Generalised(Hysteresis[PlayState], Identifiable, Describable):
    """Prandtl-Ishlinskii hysteresis behind an envelope of each voltage, for m inputs and p outputs.

        v_l = sum over inputs j and operators i of  w_lji play(g_j(u_j); r_lji)

    Each input has one envelope for all outputs. The inverse of the plays, then of the envelope, is therefore
    exact, with cross-coupling. Loops bend and saturate, differently at both ends; rising and falling branches
    are related as those of plays. Envelopes take absolute voltages; the inputs of the plays are relative to
    the working point.

    Parameters
    ----------
    envelopes : of each input
    plays : the play operators; their thresholds are in the unit of the envelopes
    working_point_v : (m,) voltage from which the model counts [V]; zeros if not given
    weight_covariance : (output,) covariance of the weights, if it is known

    Raises
    ------
    InputError : another number of envelopes than of inputs

    Source: Al Janaideh, Rakheja and Su, IEEE/ASME Trans. Mechatronics 16 (2011) 734-744, with one envelope
    for both directions; the multivariable form is this work's.

    Examples
    --------
    >>> plays = PrandtlIshlinskii([[Pair([0.0, 1.0], [2.0, 1.0])]])
    >>> model = Generalised((Envelope([-5.0, 2.0, 5.0], [-5.0, 2.0, 3.5]),), plays)
    >>> model.respond([[0.0, 2.0, 4.0, 2.0]])[0]
    array([[0., 5., 8., 6.]])
    """

    envelopes: tuple[Envelope, ...]
    plays: PrandtlIshlinskii = field()
    working_point_v: Array | None = None
    weight_covariance: tuple[WeightCovariance, ...] | None = None

    kind: ClassVar[str] = "generalised"
    wipes_out: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "envelopes", tuple(self.envelopes))
        m = self.plays.n_inputs
        if len(self.envelopes) != m:
            raise InputError("envelopes", f"are {len(self.envelopes)}; give {m}, one for each input")
        object.__setattr__(self, "working_point_v", working_point(self.working_point_v, m, self.kind))
        replace(self.plays, weight_covariance=self.weight_covariance)  # refuses a covariance of others

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of plays of every pair (output, input)."""
        return self.plays.operators

    def describe(self) -> str:
        """Short description."""
        shapes = dict.fromkeys(
            "with a hyperbolic tangent" if one.bent else f"of {len(one.slopes)} lines"
            for one in self.envelopes
        )
        return f"{self.plays.describe()} of an envelope {' and '.join(shapes)}"

    def counted_from(self, working_point_v: ArrayLike) -> Generalised:
        """Return the hysteresis relative to another working point (m,) [V]."""
        return replace(self, working_point_v=np.asarray(working_point_v, dtype=np.float64))

    @cached_property
    def home_v(self) -> Array:
        """Values of the envelopes at the working point (m,) [V]."""
        rest = np.asarray(self.working_point_v)
        return frozen([g.of(u).item() for g, u in zip(self.envelopes, rest, strict=True)])

    def inner(self, u_v: Array) -> Array:
        """Inputs of the plays (m, N) for voltages (m, N), both relative to the working point [V]."""
        each = zip(self.envelopes, u_v, np.asarray(self.working_point_v), self.home_v, strict=True)
        return np.stack([g.of(u + rest) - home for g, u, rest, home in each])

    def outer(self, x_v: Array) -> Array:
        """Voltages (m, N) for inputs x (m, N) of the plays, both relative to the working point [V]."""
        each = zip(self.envelopes, x_v, np.asarray(self.working_point_v), self.home_v, strict=True)
        return np.stack([g.at(x + home) - rest for g, x, rest, home in each])

    def rest(self) -> PlayState:
        """Memory at rest."""
        return self.plays.rest()

    def after(self, path_v: Array) -> PlayState:
        """Memory after a path; see ``Hysteresis.after``."""
        return self.plays.after(self.inner(path_v))

    def _respond(self, u_v: Array, start: PlayState) -> tuple[Array, PlayState]:
        refuse_not_finite(u_v)
        return self.plays.respond(self.inner(u_v), start)

    def in_loop(self, memory: PlayState) -> tuple[Any, ...]:
        """Envelopes and plays; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Envelopes

        lines = (np.asarray(self.working_point_v), self.home_v, *self.lines)
        return Envelopes(self.plays.in_loop(memory), lines, self.tangents, np.zeros((self.n_inputs, 1)))

    @cached_property
    def lines(self) -> tuple[Array, Array, Array]:
        """Upper end, value at 0 V and slope of each line of each envelope (m, line), filled up."""
        each, most = self.envelopes, max(len(one.slopes) for one in self.envelopes)
        ends = padded([one.voltages_v[1:-1] for one in each], most, np.inf)
        starts = padded([one.intercepts for one in each], most, 0.0)
        return ends, starts, padded([one.slopes for one in each], most, 1.0)

    @cached_property
    def tangents(self) -> tuple[Array, Array, Array]:
        """Size, 0 where there is none, steepness and centre of each tangent (m,)."""
        sizes = [one.saturating_v if one.bent else 0.0 for one in self.envelopes]
        steepnesses = [one.steepness_per_v for one in self.envelopes]
        return frozen(sizes), frozen(steepnesses), frozen([one.centre_v for one in self.envelopes])

    def slope_columns(self, k: int) -> Array:
        """Slopes (number, output) [um/V] of input k: those of the plays times those of the envelope."""
        own, steps = self.envelopes[k].all_slopes, self.plays.slope_columns(k)
        return np.asarray((own[:, None, None] * steps).reshape(-1, self.n_outputs))

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, pair after pair in the order of the inputs [um/V]."""
        return self.plays.weights

    def with_weights(self, weights: Sequence[ArrayLike]) -> Generalised:
        """Return the same envelopes and thresholds with other weights."""
        return Generalised(self.envelopes, self.plays.with_weights(weights), self.working_point_v)

    @property
    def n_beside_weights(self) -> int:
        """Thresholds of the plays, and the numbers of the envelopes."""
        return self.plays.n_beside_weights + sum(one.n_free for one in self.envelopes)

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[Generalised]:
        """Envelopes of four lines, and one with a tangent; see ``Identifiable``."""
        driven.refuse_still()
        grids = [np.append(0.0, r[r > 0.0]) for r in driven.thresholds_v]
        plays = PrandtlIshlinskii((tuple(Pair(r, np.ones(len(r))) for r in grids),) * driven.outputs)
        bends = [np.log(np.array(slopes[1:]) / slopes[0]) for slopes in FIRST_SLOPES]
        lines = [(FIRST_KNOTS, (), np.concatenate([FIRST_KNOTS, bend])) for bend in bends]
        tangent, found = np.array([FIRST_SHARE, np.log(FIRST_STEEPNESS), 0.5]), []
        for inner, bend, free in (*lines, ((), (1.0, 1.0), tangent)):
            places = np.array([0.0, *inner, 1.0])
            ends = zip(driven.low_v, 2.0 * driven.half_swing_v, strict=True)
            begun = [Envelope(low + span * places, low + span * places, *bend) for low, span in ends]
            found.append(cls(tuple(one.with_free(free) for one in begun), plays, driven.working_point_v))
        return found

    @cached_property
    def _moving(self) -> list[Array]:
        """Thresholds of each input that are fitted, above 0, in parts of half the span of its envelope."""
        halves = [0.5 * np.ptp(one.voltages_v) for one in self.envelopes]
        grids = [self.plays.bank.r[k, :n] for k, n in enumerate(self.plays.bank.n)]
        return [r[r > 0.0] / half for r, half in zip(grids, halves, strict=True)]

    @property
    def free(self) -> Array:
        """Thresholds above 0 of each input, then the numbers of its envelope, all in parts of the span."""
        each = zip(self._moving, self.envelopes, strict=True)
        return np.concatenate([part for r, one in each for part in (r, one.free)])

    @property
    def free_spread(self) -> Array:
        """Thresholds and knots stay within their gaps; see ``Identifiable``."""
        found = []
        for r, one in zip(self._moving, self.envelopes, strict=True):
            knots = len(one.voltages_v) - 2
            found += [within_gaps(r, 0.0, np.inf), within_gaps(one.free[:knots], 0.0, 1.0)]
            found.append(np.ones(one.n_free - knots))
        return np.concatenate(found)

    def at(self, free: Array) -> Generalised:
        """Return the same weights with other thresholds, which all outputs share, and envelopes."""
        envelopes, thresholds, first = [], [], 0
        for k, (r, one) in enumerate(zip(self._moving, self.envelopes, strict=True)):
            places = kept_apart(free[first : first + len(r)])
            first += len(r)
            envelopes.append(one.with_free(free[first : first + one.n_free]))
            first += one.n_free
            held = self.plays.bank.r[k, : self.plays.bank.n[k] - len(r)]
            thresholds.append(np.concatenate([held, 0.5 * np.ptp(one.voltages_v) * places]))
        return Generalised(tuple(envelopes), self.plays.at(np.concatenate(thresholds)), self.working_point_v)

    def limits(self, driven: Driven) -> Limits:
        """Thresholds that the swing engages, and envelopes that bend within it."""
        parts = []
        for r, one in zip(self._moving, self.envelopes, strict=True):
            own = one.limits()
            parts.append((np.full(len(r), LEAST_ENGAGED), np.full(len(r), 1.0 - LEAST_ENGAGED), own))
        lower = np.concatenate([part for low, _, own in parts for part in (low, own.lower)])
        return Limits(lower, np.concatenate([part for _, high, own in parts for part in (high, own.upper)]))

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Outputs of the plays; see ``Identifiable``."""
        return self.plays.columns(self.inner(u_v), self.inner(before_v), output, passes)

    def bends(self, u_v: Array, before_v: Array, passes: int = 1) -> tuple[Array, Array]:
        """Derivatives of the plays in closed form; see ``Identifiable``."""
        bank, first = self.plays.bank, 0
        values = np.zeros((len(self.free), self.n_outputs, u_v.shape[1]))
        stood = np.zeros(values.shape[:2])
        for k, n in enumerate(bank.n):
            one, begin = self.envelopes[k], first
            first += len(self._moving[k]) + one.n_free
            if not (u_v[k].any() or before_v[k].any()):
                continue  # at rest nothing changes
            before, own = self._moved(k, before_v[k]), self._moved(k, u_v[k])
            found = play_bends(before, own, bank.r[k, :n], bank.w[k, :n], passes)
            for part in found:
                part[:n] *= 0.5 * np.ptp(one.voltages_v)
            values[begin:first], stood[begin:first] = (part[n - len(self._moving[k]) :] for part in found)
        return values, stood

    def _moved(self, k: int, u: Array) -> tuple[Array, Array]:
        """Inputs (N,) of the plays of one voltage, and their derivatives (number, N) by its envelope."""
        one, rest = self.envelopes[k], np.asarray(self.working_point_v)[k]
        volts = np.append(rest, u + rest)
        changes = SMALL * np.eye(one.n_free + 1, k=-1)[:, :-1]
        now, *ahead = (one.with_free(one.free + change).of(volts) for change in changes)
        moved = (np.array(ahead).reshape(-1, len(volts)) - now) / SMALL
        return now[1:] - now[0], np.ascontiguousarray(moved[:, 1:] - moved[:, :1])

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """Every slope of the plays stays above the minimum; slopes of an envelope are positive."""
        return self.plays.weight_bounds(output, input_, least, driven)

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Return the shape of every envelope."""
        found = []
        for name, one in zip(inputs, self.envelopes, strict=True):
            least, most = one.all_slopes.min(), one.all_slopes.max()
            found.append(f"plays of {name} have an envelope with slopes from {least:.3g} to {most:.3g}")
        return found

    @property
    def reversals_v(self) -> Array:
        """Thresholds of the first pair behind its steepest envelope; see ``Describable``."""
        return self.plays.reversals_v / self.envelopes[0].all_slopes.max()

    def file(self) -> GeneralisedFile:
        """Form in a model file."""
        parts = {"envelopes": self.envelopes, "pairs": self.plays.pairs}
        return GeneralisedFile.model_validate(parts | {"weight_covariance": self.weight_covariance})


class EnvelopeFile(PartFile):
    """An envelope in a model file."""

    describes: ClassVar = Envelope
    voltages_v: tuple[Offset, ...] = Field(description="of the points, as absolute voltages")
    values_v: tuple[Offset, ...] = Field(description="at these points; linear between them")
    saturating_v: Annotated[float, Field(ge=0.0, le=1e6)] = Field(
        default=0.0, description="a in g = lines + a tanh(b (u - c))"
    )
    steepness_per_v: PerVolt = Field(default=0.0, description="b")
    centre_v: Offset = Field(default=0.0, description="c, as an absolute voltage")


class GeneralisedFile(HysteresisFile):
    """Plays of an envelope of each voltage: envelopes of the inputs, pairs (output, input)."""

    kind: Literal["generalised"] = "generalised"
    describes: ClassVar = Generalised
    envelopes: Annotated[tuple[EnvelopeFile, ...], Field(min_length=1)]
    pairs: Annotated[tuple[tuple[PairFile, ...], ...], Field(min_length=1)]
    weight_covariance: tuple[CovarianceFile, ...] | None = None

    def hysteresis(self) -> Generalised:
        """Return the hysteresis this describes."""
        plays, known = PrandtlIshlinskii(described(self.pairs)), described(self.weight_covariance)
        return Generalised(described(self.envelopes), plays, weight_covariance=known)

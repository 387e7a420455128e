"""Asymmetric hysteresis: play operators and one-sided dead-zones side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, ByValue, Flags, Indices, freeze, freeze_fields, frozen
from hammerstein.blocks import Memory
from hammerstein.errors import InputError, refuse
from hammerstein.hysteresis.identifiable import (
    LEAST_ENGAGED,
    Bounds,
    ColumnChoice,
    Driven,
    Identifiable,
    Limits,
    kept_apart,
)
from hammerstein.hysteresis.kind import (
    CovarianceFile,
    Hysteresis,
    HysteresisFile,
    PairFile,
    PartFile,
    described,
    working_point,
)
from hammerstein.hysteresis.pair import (
    Pair,
    PlayState,
    WeightCovariance,
    play,
    played,
    refuse_other_sizes,
    weighted_mistakes,
)
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hammerstein.quantities import Offset, Weight, WeightError

PLAYS = (10, 15, 20, 30, 60)
"""Numbers of plays of an input that are tried; each grid is part of the last one."""
DEAD_ZONES = (0, 1, 2, 3, 5, 7, 11, 23)
"""Numbers of dead-zones of an input that are tried; each grid is part of the last one."""
PLAYS_ALONE = "no dead-zones: this hysteresis is of plays alone"
"""Note on a block without them."""
SPREAD = ((12, 3), (16, 5))
"""Thresholds and breakpoints of an input, at equal distances, from which the search for both begins."""
SHIFT = 1e-6
"""Change of all places at once for their derivatives, in parts of their range: each moves its own column."""
BESIDE = 7
"""Number of dead-zones while the number of plays is chosen."""


@dataclass(frozen=True, eq=False)
class DeadZones(ByValue):
    """One-sided dead-zones in parallel to the plays of one pair.

        D_q(u) = max(u - q, 0)

    Parameters
    ----------
    breakpoints_v : (zone,) absolute voltages q above which a dead-zone responds to its input [V],
        strictly increasing
    weights_um_per_v : (zone,) weights [um/V], of either sign
    weight_errors_um_per_v : (zone,) standard errors of the weights [um/V], if they are known

    Raises
    ------
    InputError : non-finite or unsorted breakpoints, or lengths that differ

    Examples
    --------
    >>> DeadZones([10.0, 40.0], [0.5, -0.2]).slopes
    array([0.5, 0.3])
    """

    breakpoints_v: Array
    weights_um_per_v: Array
    weight_errors_um_per_v: Array | None = None

    def __post_init__(self) -> None:
        freeze_fields(self, "breakpoints_v", "weights_um_per_v", "weight_errors_um_per_v")
        q, v, errors = self.breakpoints_v, self.weights_um_per_v, self.weight_errors_um_per_v
        refuse("dead-zones", list(weighted_mistakes("breakpoints", q, v, errors)))

    @classmethod
    def absent(cls) -> DeadZones:
        """No dead-zone."""
        return cls(frozen([]), frozen([]))

    @property
    def slopes(self) -> Array:
        """Partial sums of the weights (zone,) [um/V]: their part of the slope above each breakpoint."""
        return np.cumsum(self.weights_um_per_v)

    def of(self, u_v: ArrayLike) -> Array:
        """Sum of the dead-zones at absolute voltages [um]."""
        beyond = np.maximum(np.subtract.outer(np.asarray(u_v, dtype=np.float64), self.breakpoints_v), 0.0)
        return np.asarray(beyond @ self.weights_um_per_v)


class ZoneLines(NamedTuple):
    """All dead-zones as lines, on one grid for each input, relative to the working point.

    n : (m,) breakpoints of each input
    ends : (m, n_max+1) upper end of each zone [V]; the last one and unused ones are infinite
    slope, intercept : (m, n_max+1, p) line of each zone; zero at the working point
    """

    n: Indices
    ends: Array
    slope: Array
    intercept: Array

    @classmethod
    def of(cls, zones: Sequence[Sequence[DeadZones]], working_point_v: Array) -> ZoneLines:
        """Merge the dead-zones (output, input) onto one grid an input."""
        p, m = len(zones), len(zones[0])
        grids = [np.unique(np.concatenate([row[k].breakpoints_v for row in zones])) for k in range(m)]
        n = np.array([len(grid) for grid in grids], dtype=np.int64)
        ends = np.full((m, int(n.max(initial=0)) + 1), np.inf)
        slope, intercept = np.zeros((2, *ends.shape, p))
        for k, grid in enumerate(grids):
            ends[k, : n[k]] = grid - working_point_v[k]
            bend = np.zeros((len(grid), p))
            for o in range(p):
                bend[np.searchsorted(grid, zones[o][k].breakpoints_v), o] = zones[o][k].weights_um_per_v
            slope[k, 1 : n[k] + 1] = np.cumsum(bend, axis=0)
            drop = np.zeros((n[k] + 1, p))
            drop[1:] = np.cumsum(bend * ends[k, : n[k], None], axis=0)
            home = int(np.searchsorted(ends[k, : n[k]], 0.0))
            intercept[k, : n[k] + 1] = drop[home] - drop
        freeze(n, ends, slope, intercept)
        return cls(n, ends, slope, intercept)

    def values(self, k: int, q_v: ArrayLike) -> Array:
        """Contribution (p, N) of the dead-zones of input k when its smallest play is at q [um]."""
        q = np.atleast_1d(np.asarray(q_v, dtype=np.float64))
        zone = np.searchsorted(self.ends[k, : self.n[k]], q)
        return np.asarray((self.intercept[k, zone] + self.slope[k, zone] * q[:, None]).T)


@dataclass(frozen=True, eq=False)
class AsymmetricState(Memory):
    """Memory of an asymmetric model: that of its plays, and the output of the smallest play per input.

    plays : memory of the play operators; smallest_v : (m,) where the dead-zones stand [V]
    """

    plays: PlayState
    smallest_v: Array


@dataclass(frozen=True, eq=False, repr=False)
class Asymmetric(Hysteresis[AsymmetricState], Identifiable):
    """Sum of plays and one-sided dead-zones, for m inputs and p outputs.

        v_l = sum over inputs j of ( sum_i w_lji play(u_j; r_lji) + sum_q v_ljq D_q(play(u_j; r_j)) )

    Plays are odd about the centre of a loop, dead-zones are not. Between two breakpoints (of a dead-zone, or
    where a play engages) the output is linear in the input.

    r_j is the smallest threshold of input j over all outputs: behind that play, which passes u unchanged
    where r_j = 0, no dead-zone moves while every play rests after a reversal.

    Any pair may lack plays, dead-zones, or both. Breakpoints are absolute voltages. The voltages of
    ``respond`` are relative to ``working_point_v``, where the output is zero at rest.

    Parameters
    ----------
    plays : the play operators of all pairs
    zones : (output, input) nested sequence of ``DeadZones``
    working_point_v : (m,) voltage from which the model counts [V]; zeros if not given
    weight_covariance : (output,) covariance of the weights, if it is known: pair after pair those of the
        plays, then those of the dead-zones
    swing_v : lowest and highest voltages (m,) [V], as they are sent, while thresholds and breakpoints are
        fitted to records; None otherwise

    Raises
    ------
    InputError : dead-zones of other pairs than the plays

    Source: Kuhnen, European Journal of Control 9 (2003) 407-418 (plays and one-sided dead-zones); side by
    side they stay linear in all weights.

    Examples
    --------
    >>> plays = PrandtlIshlinskii([[Pair([0.0, 1.0], [2.0, 1.0])]])
    >>> model = Asymmetric(plays, [[DeadZones([2.0], [0.5])]])
    >>> v, state = model.respond([[0.0, 4.0, 0.0, -4.0]])
    >>> v
    array([[  0.,  12.,   1., -11.]])
    """

    plays: PrandtlIshlinskii
    zones: tuple[tuple[DeadZones, ...], ...] = field()
    working_point_v: Array | None = None
    weight_covariance: tuple[WeightCovariance, ...] | None = None
    swing_v: tuple[Array, Array] | None = field(default=None, repr=False, compare=False)

    kind: ClassVar[str] = "asymmetric"
    wipes_out: ClassVar[bool] = True
    finest: ClassVar[int] = PLAYS[-1]

    def __post_init__(self) -> None:
        object.__setattr__(self, "zones", tuple(tuple(row) for row in self.zones))
        m, p = self.plays.n_inputs, self.plays.n_outputs
        if len(self.zones) != p or any(len(row) != m for row in self.zones):
            raise InputError(
                "asymmetric model", f"dead-zones must be {p} rows of {m}, one for each pair of the plays"
            )
        object.__setattr__(self, "working_point_v", working_point(self.working_point_v, m, self.kind))
        refuse_other_sizes(self.operators, self.weight_covariance)

    def describe(self) -> str:
        """Short description."""
        n = self.lines.n
        counts = " to ".join(str(count) for count in dict.fromkeys((int(n.min()), int(n.max()))))
        plural = "" if n.max() == 1 else "s"
        return f"{self.plays.describe()}; {counts} dead-zone{plural} for each input"

    @cached_property
    def lines(self) -> ZoneLines:
        """All dead-zones as lines, relative to the working point."""
        return ZoneLines.of(self.zones, np.asarray(self.working_point_v))

    @cached_property
    def smallest_v(self) -> Array:
        """Smallest threshold of each input (m,) [V]; 0 where an input has no play."""
        bank = self.plays.bank
        return frozen(np.where(bank.n > 0, bank.r[:, 0], 0.0))

    def counted_from(self, working_point_v: ArrayLike) -> Asymmetric:
        """Return the hysteresis relative to another working point (m,) [V]."""
        return replace(self, working_point_v=np.asarray(working_point_v, dtype=np.float64))

    @property
    def n_beside_weights(self) -> int:
        """Thresholds of the plays, and breakpoints of the dead-zones."""
        return self.plays.n_beside_weights + int(self.lines.n.sum())

    def rest(self) -> AsymmetricState:
        """State of a model that was never driven."""
        return AsymmetricState(self.plays.rest(), np.zeros(self.n_inputs))

    def after(self, path_v: Array) -> AsymmetricState:
        """Memory after a path; see ``Hysteresis.after``."""
        smallest = [played(path, [r])[0] for path, r in zip(path_v, self.smallest_v, strict=True)]
        return AsymmetricState(self.plays.after(path_v), np.array(smallest))

    def _respond(self, u_v: Array, start: AsymmetricState) -> tuple[Array, AsymmetricState]:
        from hammerstein.hysteresis.shape_kernels import add_dead_zones

        v, plays = self.plays.respond(u_v, start.plays)
        held, (_, *zones) = start.smallest_v.copy(), self.lines
        add_dead_zones(u_v, self.smallest_v, held, *zones, v, (0,) * self.n_outputs)
        return v, AsymmetricState(plays, held)

    def in_loop(self, memory: AsymmetricState) -> tuple[Any, ...]:
        """Plays and dead-zones; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Zones

        numbers = (self.smallest_v, memory.smallest_v, *self.lines[1:])
        return Zones(self.plays.in_loop(memory.plays), numbers)

    def amplitude(self, amplitude_v: ArrayLike) -> Array:
        """Half heights of the settled loops about the working point (output, input) [um], in closed form.

        That of the plays, and half of what the dead-zones add between the two ends of the smallest play.
        """
        halves = self.plays.amplitude(amplitude_v)
        sizes = np.broadcast_to(np.asarray(amplitude_v, dtype=np.float64), self.n_inputs)
        for k, (size, r) in enumerate(zip(sizes, self.smallest_v, strict=True)):
            reach = max(float(size - r), 0.0)
            ends = self.lines.values(k, [-reach, reach])
            halves[:, k] += 0.5 * (ends[:, 1] - ends[:, 0])
        return halves

    def slope_columns(self, k: int) -> Array:
        """Slopes (choice, output) [um/V] of input k with 1, 2, ... operators engaged, zone after zone."""
        steps = self.plays.slope_columns(k) if self.plays.bank.n[k] else np.zeros((1, self.n_outputs))
        zones = self.lines.slope[k, : self.lines.n[k] + 1]
        return np.asarray((zones[:, None] + steps).reshape(-1, self.n_outputs))

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of plays and dead-zones of every pair (output, input)."""
        zones = (tuple(len(zone.breakpoints_v) for zone in row) for row in self.zones)
        return tuple(
            tuple(n + k for n, k in zip(*rows, strict=True))
            for rows in zip(self.plays.operators, zones, strict=True)
        )

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output [um/V], pair after pair: those of the plays, then of the dead-zones."""
        return tuple(
            np.concatenate([part.weights_um_per_v for both in zip(*rows, strict=True) for part in both])
            for rows in zip(self.plays.pairs, self.zones, strict=True)
        )

    def with_weights(self, weights: Sequence[ArrayLike]) -> Asymmetric:
        """Return the same thresholds and breakpoints with other weights."""
        pairs, zones = [], []
        for row in self._apart(weights):
            pairs.append(tuple(Pair(p.thresholds_v, w) for p, _, w, _ in row))
            zones.append(tuple(DeadZones(z.breakpoints_v, w) for _, z, _, w in row))
        return self._with(PrandtlIshlinskii(tuple(pairs)), zones)

    def _apart(self, numbers: Sequence[ArrayLike]) -> Iterator[list[tuple[Pair, DeadZones, Array, Array]]]:
        """Plays and dead-zones of each pair of each output, with those of its numbers that belong to them."""
        for row in zip(self.plays.pairs, self.zones, self._by_pair(numbers), strict=True):
            each = zip(*row, strict=True)
            yield [(p, z, x[: len(p.thresholds_v)], x[len(p.thresholds_v) :]) for p, z, x in each]

    def _with(self, plays: PrandtlIshlinskii, zones: Sequence[Sequence[DeadZones]]) -> Asymmetric:
        """The same with other parts, of whose weights no covariance is known."""
        return replace(self, plays=plays, zones=tuple(tuple(row) for row in zones), weight_covariance=None)

    @property
    def places(self) -> tuple[Array, ...]:
        """Thresholds of each input, those of all outputs together, then the breakpoints of each pair [V]."""
        bank, zones = self.plays.bank, (zone.breakpoints_v for row in self.zones for zone in row)
        return (*(bank.r[k, :n] for k, n in enumerate(bank.n)), *zones)

    def at_places(self, places: Sequence[Array]) -> Asymmetric:
        """Return the same weights with other thresholds and breakpoints."""
        plays, points = self.plays.at(np.concatenate(places[: self.n_inputs])), iter(places[self.n_inputs :])
        zones = tuple(
            tuple(DeadZones(np.sort(next(points)), zone.weights_um_per_v) for zone in row)
            for row in self.zones
        )
        return self._with(plays, zones)

    def released(self, driven: Driven) -> Asymmetric:
        """Thresholds above 0 and breakpoints, which all outputs share, become free; see ``Identifiable``."""
        return replace(self, swing_v=(driven.low_v, driven.high_v))

    def settled(self) -> Asymmetric:
        """Return the block with thresholds and breakpoints as they are; see ``Identifiable``."""
        return replace(self, swing_v=None)

    @property
    def free(self) -> Array:
        """Thresholds above 0 of each input, in parts of half the swing, then its breakpoints within it."""
        if self.swing_v is None:
            return np.empty(0)
        parts, bank = [np.empty(0)], self.plays.bank
        for k, (low, high) in enumerate(zip(*self.swing_v, strict=True)):
            span = high - low if high > low else 1.0
            parts += [bank.r[k, 1 : bank.n[k]] / (0.5 * span), (self.zones[0][k].breakpoints_v - low) / span]
        return np.concatenate(parts)

    def at(self, free: Array) -> Asymmetric:
        """Return the same weights with other free thresholds and breakpoints."""
        if self.swing_v is None:
            return self
        bank, thresholds, points, first = self.plays.bank, [], [], 0
        for k, (low, high) in enumerate(zip(*self.swing_v, strict=True)):
            middle = first + max(bank.n[k] - 1, 0)
            last = middle + len(self.zones[0][k].slopes)
            r, q, first = kept_apart(free[first:middle]), kept_apart(free[middle:last]), last
            thresholds.append(np.append(bank.r[k, : min(bank.n[k], 1)], 0.5 * (high - low) * r))
            points.append(low + (high - low) * q)
        return self.at_places((*thresholds, *points * self.n_outputs))

    def limits(self, driven: Driven) -> Limits:
        """Within the swing; see ``Identifiable``."""
        size = len(self.free)
        return Limits(np.full(size, LEAST_ENGAGED), np.full(size, 1.0 - LEAST_ENGAGED))

    def bends(self, u_v: Array, before_v: Array, passes: int = 1) -> tuple[Array, Array]:
        """Derivatives by the free places: each moves its own column alone; see ``Identifiable``."""
        here, moved = self.at(self.free), self.at(self.free + SHIFT)
        own, each = self.roughness.any(axis=0), []
        for o, w in enumerate(self.weights):
            now, then = (np.column_stack(b.columns(u_v, before_v, o, passes)[::-1]) for b in (here, moved))
            each.append((w[:, None] * (then - now) / SHIFT)[own])
        found = np.stack(each, axis=1)
        return found[:, :, 1:], found[:, :, 0]

    @classmethod
    def spread(cls, driven: Driven) -> list[Asymmetric]:
        """Few plays and dead-zones, at equal distances, all of them free; see ``Identifiable``."""
        if driven.given or driven.dead_zones is not None:
            return []
        begun = []
        for plays, zones in SPREAD:
            shares = np.arange(plays + 1) / (plays + 1)
            grids = tuple(half * shares if half > 0.0 else np.empty(0) for half in driven.half_swing_v)
            (block,) = cls.first_guesses(replace(driven, thresholds_v=grids, dead_zones=zones))
            begun.append(block.released(driven))
        return begun

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[Asymmetric]:
        """Plays with a smallest threshold of 0, and dead-zones at equal distances; see ``Identifiable``."""
        count = DEAD_ZONES[-1] if driven.dead_zones is None else driven.dead_zones
        shares = np.arange(1, count + 1) / (count + 1)
        ends = zip(driven.low_v, driven.high_v, strict=True)
        points = [low + (high - low) * shares if high > low else np.empty(0) for low, high in ends]
        grids = [np.append(0.0, r[1:]) if r.size else r for r in driven.thresholds_v]
        plays = PrandtlIshlinskii(((*(Pair(r, np.ones(len(r))) for r in grids),),) * driven.outputs)
        zones = ((*(DeadZones(q, np.zeros(len(q))) for q in points),),) * driven.outputs
        return [cls(plays, zones, driven.working_point_v)]

    def column_choices(self, driven: Driven) -> list[ColumnChoice]:
        """Numbers of plays, then of dead-zones: coarser grids of the same columns; see ``Identifiable``."""
        counts = DEAD_ZONES if driven.dead_zones is None else (driven.dead_zones,)
        plays = [self._some(n, None) for n in (PLAYS if not driven.given else (None,))]
        zones = [self._some(None, n) for n in counts]
        return [
            ColumnChoice(plays, plays[-1]),
            ColumnChoice(zones, self._some(None, BESIDE if driven.dead_zones is None else None)),
        ]

    def _some(self, plays: int | None, zones: int | None) -> Flags:
        """Flags of so many plays and dead-zones of every input, at equal distances; None: all."""
        kept = []
        for pair, bends in zip(self.plays.pairs[0], self.zones[0], strict=True):
            n, q = len(pair.thresholds_v), len(bends.breakpoints_v)
            own, points = np.zeros(n, dtype=np.bool_), np.zeros(q, dtype=np.bool_)
            own[:: 1 if plays is None else max(n // plays, 1)] = True
            step = 1 if zones is None else (q + 1) // (zones + 1)
            points[step - 1 :: step] = True
            kept += [own, points]
        return np.concatenate(kept)

    def with_columns(self, kept: Flags) -> Asymmetric:
        """Return the block with some of its plays and dead-zones, the same of every output."""
        pairs, zones = [], []
        for row in self._apart([kept] * self.n_outputs):
            pairs.append(tuple(Pair(p.thresholds_v[m], p.weights_um_per_v[m]) for p, _, m, _ in row))
            zones.append(tuple(DeadZones(z.breakpoints_v[m], z.weights_um_per_v[m]) for _, z, _, m in row))
        return self._with(PrandtlIshlinskii(tuple(pairs)), zones)

    @property
    def roughness(self) -> Array:
        """All weights but the first play of each pair."""
        mask = np.ones(sum(self.operators[0]), dtype=np.bool_)
        ends = np.cumsum([0, *self.operators[0]])
        sizes = [len(pair.thresholds_v) for pair in self.plays.pairs[0]]
        mask[[first for first, n in zip(ends[:-1], sizes, strict=True) if n]] = False
        return np.eye(len(mask))[mask]

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Outputs of the plays and of the dead-zones behind the smallest one; see ``Identifiable``."""
        values, held = [], []
        rest = np.asarray(self.working_point_v)
        for k, (pair, bends) in enumerate(zip(self.plays.pairs[output], self.zones[output], strict=True)):
            r = np.append(self.smallest_v[k], pair.thresholds_v)
            stood = last = played(before_v[k], r)
            for _ in range(passes):
                outputs = play(u_v[k], r, last)
                last = outputs[:, -1]
            points = bends.breakpoints_v[:, None]
            zero = np.maximum(rest[k] - points, 0.0)
            values += [outputs[1:], np.maximum(rest[k] + outputs[0] - points, 0.0) - zero]
            held += [stood[1:], (np.maximum(rest[k] + stood[0] - points, 0.0) - zero)[:, 0]]
        return np.vstack(values), np.concatenate(held)

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """S_j >= t and D_m >= c - t for some t >= c: then every slope S_j + D_m is c or more."""
        n = len(self.plays.pairs[output][input_].thresholds_v)
        counts = self.operators[output]
        size, first = sum(counts), sum(counts[:input_])
        basis, side, bound = np.eye(size, size + 1), np.zeros(size + 1), np.zeros(size + 1)
        for part, way in ((slice(first, first + n), 1.0), (slice(first + n, first + counts[input_]), -1.0)):
            width = part.stop - part.start
            basis[part, part] -= np.eye(width, k=-1)  # weights are differences of slopes
            if width:
                basis[part.start, size] = way
            side[part] = np.sign(least)
            bound[part] = 0.0 if way > 0.0 else least
        side[size], bound[size] = np.sign(least), least
        return Bounds(basis, side, bound)

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Return the number of dead-zones."""
        most = self.lines.n.max(initial=0)
        return [f"dead-zones for each input beside the plays: {most}"] if most else [PLAYS_ALONE]

    def file(self) -> AsymmetricFile:
        """Form in a model file; the voltages of the file hold the working point."""
        parts = {"pairs": self.plays.pairs, "dead_zones": self.zones}
        return AsymmetricFile.model_validate(parts | {"weight_covariance": self.weight_covariance})


class DeadZonesFile(PartFile):
    """Dead-zones of one pair in a model file."""

    describes: ClassVar = DeadZones
    breakpoints_v: tuple[Offset, ...] = Field(description="absolute voltages")
    weights_um_per_v: tuple[Weight, ...]
    weight_errors_um_per_v: tuple[WeightError, ...] | None = None


class AsymmetricFile(HysteresisFile):
    """Plays and one-sided dead-zones side by side: both of every pair (output, input)."""

    kind: Literal["asymmetric"] = "asymmetric"
    describes: ClassVar = Asymmetric
    pairs: Annotated[tuple[tuple[PairFile, ...], ...], Field(min_length=1)]
    dead_zones: Annotated[tuple[tuple[DeadZonesFile, ...], ...], Field(min_length=1)]
    weight_covariance: tuple[CovarianceFile, ...] | None = None

    def hysteresis(self) -> Asymmetric:
        """Return the hysteresis this describes."""
        plays, known = PrandtlIshlinskii(described(self.pairs)), described(self.weight_covariance)
        return Asymmetric(plays, described(self.dead_zones), weight_covariance=known)

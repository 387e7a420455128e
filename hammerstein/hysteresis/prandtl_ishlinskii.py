"""The multivariable classical Prandtl-Ishlinskii model (paper, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, frozen, spans
from hammerstein.errors import InputError, Mistake, naming
from hammerstein.hysteresis.identifiable import (
    LEAST_ENGAGED,
    Bounds,
    Driven,
    Identifiable,
    Limits,
    kept_apart,
)
from hammerstein.hysteresis.kind import (
    CovarianceFile,
    Describable,
    HysteresisFile,
    OfPairs,
    PairFile,
    describing_function,
    refuse_not_finite,
)
from hammerstein.hysteresis.pair import (
    Bank,
    Pair,
    PlayState,
    WeightCovariance,
    play,
    play_bends,
    played,
    refuse_other_sizes,
)


@dataclass(frozen=True, eq=False, repr=False)
class PrandtlIshlinskii(OfPairs[PlayState], Identifiable, Describable):
    """Rate-independent hysteresis of m inputs and p outputs; each output responds to each input.

        v_l[k] = sum over inputs j and operators i of  w_lji  play(u_j; r_lji)[k]      (paper, eq. 4)

    Each pair has its own number of operators and its own thresholds. A pair may also be a linear gain or
    absent. Numbers of inputs and outputs may differ.

    Parameters
    ----------
    pairs : (output, input) nested sequence of ``Pair``
    weight_covariance : (output,) covariance of the weights, if it is known

    Raises
    ------
    InputError : rows of different lengths, no operator, or a covariance of other weights

    Examples
    --------
    >>> model = PrandtlIshlinskii([[Pair([0.5], [2.0])]])
    >>> v, state = model.respond([[0.0, 2.0, 1.0, -2.0]])
    >>> v
    array([[ 0.,  3.,  3., -3.]])
    """

    kind: ClassVar[str] = "prandtl_ishlinskii"
    wipes_out: ClassVar[bool] = True

    pairs: tuple[tuple[Pair, ...], ...] = field()
    weight_covariance: tuple[WeightCovariance, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple(tuple(row) for row in self.pairs))
        if len({len(row) for row in self.pairs}) != 1 or not self.pairs[0]:
            what = "must hold one pair for each input of each output"
            raise InputError("Prandtl-Ishlinskii model", [Mistake("pairs", what)])
        if not any(len(pair.thresholds_v) for row in self.pairs for pair in row):
            raise InputError("Prandtl-Ishlinskii model", "all pairs are absent; give at least one operator")
        refuse_other_sizes(self.operators, self.weight_covariance)

    def describe(self) -> str:
        """Short description."""
        pairs = [pair for row in self.pairs for pair in row if len(pair.thresholds_v)]
        counts = sorted({len(pair.thresholds_v) for pair in pairs})
        thresholds = np.concatenate([pair.thresholds_v for pair in pairs])
        if not thresholds.any():
            return f"{self.ports}, gains without hysteresis"
        operators = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
        plural = "" if counts[-1] == 1 else "s"
        return (
            f"{self.ports}, {operators} operator{plural} a pair, "
            f"thresholds {thresholds.min():.4g} to {thresholds.max():.4g} V"
        )

    @classmethod
    def from_arrays(cls, thresholds_v: ArrayLike, weights_um_per_v: ArrayLike) -> PrandtlIshlinskii:
        """Build a model whose pairs share one set of thresholds, like the published one (eq. 12, 13).

        thresholds_v : (operator,) [V]; weights_um_per_v : (output, input, operator) [um/V]
        """
        weights = np.asarray(weights_um_per_v, dtype=np.float64)
        if weights.ndim != 3:
            message = f"weights have shape {weights.shape}; give (output, input, operator)"
            raise InputError("Prandtl-Ishlinskii model", message)
        r = frozen(thresholds_v)
        rows: list[list[Pair]] = [[] for _ in weights]
        for o, k in np.ndindex(weights.shape[:2]):
            with naming(f"pair of output {o + 1} and input {k + 1}"):
                rows[o].append(Pair(r, weights[o, k]))
        return cls(tuple(map(tuple, rows)))

    @cached_property
    def bank(self) -> Bank:
        """All operators on one threshold grid an input."""
        return Bank.of(self.pairs)

    @property
    def n_beside_weights(self) -> int:
        """Thresholds of the inputs that have more than one."""
        return int(sum(n for n in self.bank.n if n > 1))

    def rest(self) -> PlayState:
        """State at rest: all plays at zero."""
        return self._rest

    @cached_property
    def _rest(self) -> PlayState:
        return self.state_of([np.zeros(n) for n in self.bank.n], at_rest=True)

    def state_of(self, plays_v: Sequence[ArrayLike], *, at_rest: bool = False) -> PlayState:
        """State with given play outputs, one array for each input on that input's threshold grid [V].

        Raises InputError where no history of the input leads to them: neighbours may differ by no more
        than their thresholds do.
        """
        from hammerstein.hysteresis.play_kernels import COLUMNS

        bank = self.bank
        m, width, p = bank.n.size, bank.r.shape[1] + 1, self.n_outputs
        count, end = np.zeros(m, np.int64), np.zeros((m, width), np.int64)
        x, d, below = np.zeros((m, width)), np.zeros((m, width)), np.zeros((m, width, p))
        for k in range(m):
            plays = _checked_plays(np.asarray(plays_v[k], dtype=np.float64), bank.r[k, : bank.n[k]], k)
            if at_rest:
                count[k], end[k, 0] = 1, bank.n[k]
                continue
            # One segment an operator, the last operator at the bottom of the stack.
            count[k] = len(plays)
            end[k, : len(plays)] = np.arange(len(plays), 0, -1)
            x[k, : len(plays)] = plays[::-1]
            below[k, 1 : len(plays)] = np.cumsum((bank.w[k, : len(plays)] * plays[:, None])[:0:-1], axis=0)
        return PlayState(count, end, x, d, below, np.zeros((m, COLUMNS)))

    def after(self, path_v: Array) -> PlayState:
        """Memory after a path; see ``Hysteresis.after``."""
        bank = self.bank
        grids = [r[:n] for r, n in zip(bank.r, bank.n, strict=True)]
        return self.state_of([played(path, r) for path, r in zip(path_v, grids, strict=True)])

    def plays_of(self, state: PlayState) -> list[Array]:
        """Play outputs held by a state, one array for each input on that input's threshold grid [V]."""
        bank, plays = self.bank, []
        for k, n in enumerate(bank.n):
            values, first = np.empty(n), 0
            for s in range(int(state.count[k]) - 1, -1, -1):
                last = int(state.end[k, s])
                values[first:last] = state.x[k, s] - state.d[k, s] * bank.r[k, first:last]
                first = last
            plays.append(values)
        return plays

    def _respond(self, u_v: Array, start: PlayState) -> tuple[Array, PlayState]:
        y = np.empty((self.n_outputs, u_v.shape[1]))
        return y, self.carry_on(u_v, start, 0, u_v.shape[1], y)

    def carry_on(self, u_v: Array, start: PlayState, first: int, stop: int, v_um: Array) -> PlayState:
        """Write outputs into an array without a temporary one; see ``Hysteresis.carry_on``."""
        from hammerstein.hysteresis.play_kernels import respond_turning_points

        s = start.copy()
        numbers = self._numbers(s)
        for begin, end in spans(stop - first):
            here = (first + begin, first + end)
            if respond_turning_points(u_v, *numbers, *here, v_um, (0,) * self.n_outputs) < here[1]:
                refuse_not_finite(u_v)
        return s

    def _numbers(self, memory: PlayState) -> tuple[Any, ...]:
        """What the kernel takes beside voltages and outputs."""
        b, s = self.bank, memory
        return (b.r, b.guide, b.scale, b.n, b.lines, b.w, s.count, s.end, s.x, s.d, s.below, s.window)

    def in_loop(self, memory: PlayState) -> tuple[Any, ...]:
        """Plays in their turning-point form; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Branches

        return Branches(self._numbers(memory), (0,) * self.n_outputs, np.empty((self.n_outputs, 1)))

    def slope_columns(self, k: int) -> Array:
        """Slopes (operator, output) [um/V] while the first 1, 2, ... operators of input k move."""
        return self.bank.slope[k, 1 : self.bank.n[k] + 1]

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of play operators of every pair (output, input)."""
        return tuple(tuple(len(pair.thresholds_v) for pair in row) for row in self.pairs)

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, pair after pair in the order of the inputs [um/V]."""
        return tuple(np.concatenate([pair.weights_um_per_v for pair in row]) for row in self.pairs)

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[PrandtlIshlinskii]:
        """Plays with suitable thresholds for the records; see ``Identifiable``."""
        row = tuple(Pair(r, np.ones(len(r))) for r in driven.thresholds_v)
        return [cls((row,) * driven.outputs)]

    @property
    def free(self) -> Array:
        """Thresholds of each input, those of all outputs together [V]."""
        return np.concatenate([self.bank.r[k, :n] for k, n in enumerate(self.bank.n)])

    def at(self, free: Array) -> PrandtlIshlinskii:
        """Return the same weights with other thresholds; negative ones are mirrored."""
        ends = np.cumsum(self.bank.n)[:-1]
        old, new = np.split(self.free, ends), [_apart(np.abs(part)) for part in np.split(free, ends)]

        def moved(pair: Pair, k: int) -> Pair:
            return Pair(new[k][np.searchsorted(old[k], pair.thresholds_v)], pair.weights_um_per_v)

        rows = (tuple(moved(pair, k) for k, pair in enumerate(row)) for row in self.pairs)
        return PrandtlIshlinskii(tuple(rows))

    def limits(self, driven: Driven) -> Limits:
        """From 0 to the largest threshold that the swing engages."""
        tops = np.repeat((1.0 - LEAST_ENGAGED) * driven.half_swing_v, self.bank.n)
        return Limits(np.zeros(len(tops)), tops)

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Outputs of the plays; see ``Identifiable``."""
        values, held = [], []
        for pair, u, path in zip(self.pairs[output], u_v, before_v, strict=True):
            stood = last = played(path, pair.thresholds_v)
            for _ in range(passes):
                outputs = play(u, pair.thresholds_v, last)
                last = outputs[:, -1]
            values.append(outputs)
            held.append(stood)
        return np.vstack(values), np.concatenate(held)

    def bends(self, u_v: Array, before_v: Array, passes: int = 1) -> tuple[Array, Array]:
        """Derivatives of the plays in closed form; see ``Identifiable``."""
        bank, ends = self.bank, np.cumsum(self.bank.n)
        values = np.zeros((int(ends[-1]), self.n_outputs, u_v.shape[1]))
        stood = np.zeros(values.shape[:2])
        for k, (n, end) in enumerate(zip(bank.n, ends, strict=True)):
            if u_v[k].any() or before_v[k].any():  # at rest nothing changes
                before, own = ((path[k], np.empty((0, path.shape[1]))) for path in (before_v, u_v))
                found = play_bends(before, own, bank.r[k, :n], bank.w[k, :n], passes)
                values[end - n : end], stood[end - n : end] = found
        return values, stood

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """Every slope, a partial sum of the weights, stays above the minimum."""
        counts = self.operators[output]
        own = slice(sum(counts[:input_]), sum(counts[: input_ + 1]))
        basis, side, bound = np.eye(sum(counts)), np.zeros(sum(counts)), np.zeros(sum(counts))
        basis[own, own] -= np.eye(counts[input_], k=-1)
        side[own], bound[own] = np.sign(least), least
        return Bounds(basis, side, bound)

    def with_weights(self, weights: Sequence[ArrayLike]) -> PrandtlIshlinskii:
        """Return the same thresholds with other weights."""
        rows = []
        for row, own in zip(self.pairs, self._by_pair(weights), strict=True):
            rows.append(tuple(Pair(pair.thresholds_v, w) for pair, w in zip(row, own, strict=True)))
        return PrandtlIshlinskii(tuple(rows))

    @property
    def reversals_v(self) -> Array:
        """Thresholds of the first pair; see ``Describable``."""
        return self.pairs[0][0].thresholds_v

    def first_harmonic(self, amplitude_v: float, range_v: float) -> complex:
        """Gain of the first harmonic in closed form; see ``Describable``."""
        return complex(describing_function(self.pairs[0][0], amplitude_v, range_v))


def _apart(thresholds_v: Array) -> Array:
    """Thresholds in order, apart in parts of the largest one."""
    top = float(thresholds_v.max(initial=0.0))
    return top * kept_apart(thresholds_v / top, 1.0) if top > 0.0 else thresholds_v


def _checked_plays(plays: Array, r: Array, k: int) -> Array:
    if plays.shape != r.shape or not np.isfinite(plays).all():
        message = f"give {len(r)} finite plays for input {k + 1}, one for each threshold of its grid"
        raise InputError("start", message)
    slack = 1e-12 * (1.0 + np.abs(plays).max(initial=0.0) + r.max(initial=0.0))
    if (np.abs(np.diff(plays)) > np.diff(r) + slack).any():
        i = int(np.argmax(np.abs(np.diff(plays)) - np.diff(r)))
        message = (
            f"plays {i + 1} and {i + 2} of input {k + 1} differ by more than their thresholds; no "
            "voltage leads to this state"
        )
        raise InputError("start", message)
    return plays


class PrandtlIshlinskiiFile(HysteresisFile):
    """Classical Prandtl-Ishlinskii hysteresis: pairs (output, input), and their uncertainties."""

    kind: Literal["prandtl_ishlinskii"] = "prandtl_ishlinskii"
    describes: ClassVar = PrandtlIshlinskii
    pairs: Annotated[tuple[tuple[PairFile, ...], ...], Field(min_length=1)]
    weight_covariance: tuple[CovarianceFile, ...] | None = None

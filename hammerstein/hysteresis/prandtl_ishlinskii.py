"""The multivariable classical Prandtl-Ishlinskii model (paper, section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hammerstein.errors import InputError, Mistake, SimulationError

if TYPE_CHECKING:
    from hammerstein.interop.block_system import BlockSystem
    from hammerstein.interop.limit_cycles import HysteresisNonlinearity

Array = NDArray[np.float64]
Counts = NDArray[np.int64]


def _frozen(values: ArrayLike) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def play(u: ArrayLike, r: ArrayLike, start: ArrayLike | None = None) -> Array:
    """Outputs of a bank of play (backlash) operators driven by one voltage.

        p[k] = max(u[k] - r, min(u[k] + r, p[k-1]))          (paper, eq. 1)

    Parameters
    ----------
    u : (sample,) input [V]
    r : (operator,) thresholds [V], not negative
    start : (operator,) outputs before the first sample [V]; zero if not given

    Returns
    -------
    (operator, sample) outputs [V]

    Examples
    --------
    >>> play([0.0, 2.0, 1.0, -2.0], [0.5])
    array([[ 0. ,  1.5,  1.5, -1.5]])
    """
    from hammerstein.hysteresis.play_kernels import play_bank

    thresholds = np.atleast_1d(np.asarray(r, dtype=np.float64))
    plays = np.zeros(len(thresholds)) if start is None else np.array(start, dtype=np.float64)
    outputs = np.empty((len(thresholds), np.size(u)))
    play_bank(np.ascontiguousarray(u, dtype=np.float64), thresholds, plays, outputs)
    return outputs


@dataclass(frozen=True, eq=False)
class Pair:
    """What one output hears of one input: a bank of play operators.

    A linear gain is a bank with the single threshold 0, for a play of threshold 0 passes its input
    unchanged; an absent pair is an empty bank (paper, definition 3.1).

    Parameters
    ----------
    thresholds_v : (operator,) thresholds [V], not negative, strictly increasing
    weights_um_per_v : (operator,) weights [um/V], of either sign
    weight_errors_um_per_v : (operator,) standard errors of the weights [um/V], if they are known

    Raises
    ------
    InputError : non-finite, negative or unsorted thresholds, or lengths that differ

    Examples
    --------
    >>> Pair([0.0, 1.0], [2.0, 1.0]).slopes
    array([2., 3.])
    """

    thresholds_v: Array
    weights_um_per_v: Array
    weight_errors_um_per_v: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "thresholds_v", _frozen(self.thresholds_v))
        object.__setattr__(self, "weights_um_per_v", _frozen(self.weights_um_per_v))
        if self.weight_errors_um_per_v is not None:
            object.__setattr__(self, "weight_errors_um_per_v", _frozen(self.weight_errors_um_per_v))
        mistakes = list(self._mistakes())
        if mistakes:
            raise InputError("Prandtl-Ishlinskii pair", mistakes)

    def _mistakes(self) -> Iterable[Mistake]:
        r, w, errors = self.thresholds_v, self.weights_um_per_v, self.weight_errors_um_per_v
        if r.ndim != 1 or w.shape != r.shape:
            yield Mistake("weights_um_per_v", f"has shape {w.shape}, the thresholds {r.shape}; give one each")
        if errors is not None and errors.shape != w.shape:
            yield Mistake("weight_errors_um_per_v", f"has shape {errors.shape}, the weights {w.shape}")
        if not np.isfinite(r).all():
            yield Mistake("thresholds_v", "holds a value that is not finite")
        elif (r < 0).any():
            yield Mistake("thresholds_v", f"holds a negative value, {r.min():g} V; thresholds are 0 or more")
        elif r.ndim == 1 and (np.diff(r) <= 0).any():
            yield Mistake("thresholds_v", "is not strictly increasing; sort it and merge equal thresholds")
        if not np.isfinite(w).all():
            yield Mistake("weights_um_per_v", "holds a value that is not finite")

    @classmethod
    def linear(cls, gain_um_per_v: float) -> Pair:
        """Pass the input times a gain [um/V]."""
        return cls(_frozen([0.0]), _frozen([gain_um_per_v]))

    @classmethod
    def absent(cls) -> Pair:
        """Hear nothing of the input."""
        return cls(_frozen([]), _frozen([]))

    def __repr__(self) -> str:
        r, w = self.thresholds_v, self.weights_um_per_v
        if not len(r):
            return "Pair(absent)"
        thresholds = f"thresholds {r[0]:.4g} to {r[-1]:.4g} V"
        return f"Pair({len(r)} operators, {thresholds}, summed weight {w.sum():.4g} um/V)"

    @property
    def slopes(self) -> Array:
        """Partial sums of the weights (operator,) [um/V]: the slope while operators 1..j move."""
        return np.cumsum(self.weights_um_per_v)

    def amplitude(self, amplitude_v: float) -> float:
        """Half height of the settled loop [um]: sum of w (A - r) over the thresholds below A."""
        r, w = self.thresholds_v, self.weights_um_per_v
        return float(w @ np.maximum(amplitude_v - r, 0.0))

    def loop_area(self, amplitude_v: float) -> float:
        """Area of the settled loop [um V]: 4 sum of w r (A - r) over the thresholds below A."""
        r, w = self.thresholds_v, self.weights_um_per_v
        return float(4.0 * (w * r) @ np.maximum(amplitude_v - r, 0.0))

    def rising_branch(self, u_v: ArrayLike, amplitude_v: float) -> Array:
        """Rise above the lower tip of the settled loop [um]: sum of w max(0, u + A - 2 r)."""
        r, w = self.thresholds_v, self.weights_um_per_v
        rise = np.subtract.outer(np.asarray(u_v) + amplitude_v, 2.0 * r)
        return np.asarray(np.maximum(rise, 0.0) @ w)


@dataclass(frozen=True, eq=False)
class WeightCovariance:
    """How the errors of all weights of one output hang together: their covariance L L^T.

    factor_um_per_v : (weight, weight) lower triangle L [um/V]; pair after pair in the order of the inputs
    slopes_at_bound : slopes that the fit held at a bound; their weights vary with the others alone
    """

    factor_um_per_v: Array
    slopes_at_bound: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "factor_um_per_v", _frozen(self.factor_um_per_v))
        if not np.isfinite(self.factor_um_per_v).all():
            raise InputError("weight_covariance", "holds a value that is not finite")

    @property
    def covariance(self) -> Array:
        """Covariance (weight, weight) [um^2/V^2]."""
        return np.asarray(self.factor_um_per_v @ self.factor_um_per_v.T)


@dataclass(frozen=True, eq=False)
class PlayState:
    """Memory of a Prandtl-Ishlinskii model: the stack of segments of each input (see ``kernels``).

    Made by ``PrandtlIshlinskii.rest``, ``.state_of`` or by a run; its arrays are not written to.

    count : (m,) height of each stack; end, x, d : (m, operator+1); below : (m, operator+1, p)
    """

    count: Counts
    end: Counts
    x: Array
    d: Array
    below: Array

    def copy(self) -> PlayState:
        """Give an independent copy."""
        return PlayState(*(array.copy() for array in self._arrays()))

    def _arrays(self) -> tuple[Any, ...]:
        return self.count, self.end, self.x, self.d, self.below

    def as_dict(self) -> dict[str, Any]:
        """Give plain lists that JSON keeps to the last bit."""
        names = ("count", "end", "x", "d", "below")
        return {name: array.tolist() for name, array in zip(names, self._arrays(), strict=True)}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> PlayState:
        """Restore what ``as_dict`` saved."""
        count, end = (np.array(data[name], dtype=np.int64) for name in ("count", "end"))
        x, d, below = (np.array(data[name], dtype=np.float64) for name in ("x", "d", "below"))
        return cls(count, end, x, d, below)


@dataclass(frozen=True, eq=False)
class Bank:
    """All operators of every input on one threshold grid an input, as the kernels want them.

    n : (m,) operators of each input
    r : (m, n_max) thresholds [V], filled up with infinity
    w : (m, n_max, p) weights [um/V], zero where an output lacks the operator
    slope, moment : (m, n_max+1, p) partial sums of w and of w r
    lines : (m, n_max+1, 2 p) the two side by side
    guide, scale : (m, levels), (m,) where the search for a threshold begins, see ``kernels``
    """

    n: Counts
    r: Array
    w: Array
    slope: Array
    moment: Array
    lines: Array
    guide: Counts
    scale: Array

    @classmethod
    def of(cls, pairs: Sequence[Sequence[Pair]]) -> Bank:
        """Merge the pairs (output, input) onto one grid an input."""
        from hammerstein.hysteresis.play_kernels import search_guide

        p, m = len(pairs), len(pairs[0])
        grids = [np.unique(np.concatenate([pairs[o][k].thresholds_v for o in range(p)])) for k in range(m)]
        n = np.array([len(grid) for grid in grids], dtype=np.int64)
        r = np.full((m, max(1, int(n.max()))), np.inf)
        w = np.zeros((*r.shape, p))
        for k, grid in enumerate(grids):
            r[k, : len(grid)] = grid
            for o in range(p):
                pair = pairs[o][k]
                w[k, np.searchsorted(grid, pair.thresholds_v), o] = pair.weights_um_per_v
        slope, moment = np.zeros((2, m, r.shape[1] + 1, p))
        np.cumsum(w, axis=1, out=slope[:, 1:])
        np.cumsum(w * np.where(np.isfinite(r), r, 0.0)[:, :, None], axis=1, out=moment[:, 1:])
        lines = np.concatenate([slope, moment], axis=2)
        guide, scale = search_guide(r, n)
        for array in (n, r, w, slope, moment, lines, guide, scale):
            array.flags.writeable = False
        return cls(n, r, w, slope, moment, lines, guide, scale)


@dataclass(frozen=True, eq=False)
class PrandtlIshlinskii:
    """Rate-independent hysteresis of m inputs and p outputs: every output hears every input.

        v_l[k] = sum over inputs j and operators i of  w_lji  play(u_j; r_lji)[k]      (paper, eq. 4)

    Every pair has its own number of operators and its own thresholds; a pair may also be a linear gain
    or absent. The model may be rectangular.

    Parameters
    ----------
    pairs : (output, input) nested sequence of ``Pair``
    weight_covariance : (output,) covariance of the weights, where it is known

    Raises
    ------
    InputError : rows of different length, no operator at all, or a covariance of other weights

    Examples
    --------
    >>> model = PrandtlIshlinskii([[Pair([0.5], [2.0])]])
    >>> v, state = model.respond([[0.0, 2.0, 1.0, -2.0]])
    >>> v
    array([[ 0.,  3.,  3., -3.]])
    """

    pairs: tuple[tuple[Pair, ...], ...] = field()
    weight_covariance: tuple[WeightCovariance, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", tuple(tuple(row) for row in self.pairs))
        widths = {len(row) for row in self.pairs}
        if len(widths) != 1 or not self.pairs[0]:
            raise InputError("Prandtl-Ishlinskii model", "every output needs one pair for every input")
        if not any(len(pair.thresholds_v) for row in self.pairs for pair in row):
            raise InputError("Prandtl-Ishlinskii model", "all pairs are absent; give at least one operator")
        if self.weight_covariance is not None:
            weights = [sum(len(pair.thresholds_v) for pair in row) for row in self.pairs]
            if [known.factor_um_per_v.shape for known in self.weight_covariance] != [(n, n) for n in weights]:
                raise InputError("weight_covariance", f"must have one factor an output, of {weights} rows")

    def __repr__(self) -> str:
        return f"PrandtlIshlinskii({self.describe()})"

    def describe(self) -> str:
        """Say in a few words what it is."""
        pairs = [pair for row in self.pairs for pair in row if len(pair.thresholds_v)]
        counts = sorted({len(pair.thresholds_v) for pair in pairs})
        thresholds = np.concatenate([pair.thresholds_v for pair in pairs])
        operators = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
        plural = "" if counts[-1] == 1 else "s"
        return (
            f"{self.n_inputs} inputs, {self.n_outputs} outputs, {operators} operator{plural} a pair, "
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
        r = _frozen(thresholds_v)
        rows = []
        for l, row in enumerate(weights):  # noqa: E741 - the paper's index of an output
            rows.append(tuple(_named_pair(r, w, l, k) for k, w in enumerate(row)))
        return cls(tuple(rows))

    @property
    def n_inputs(self) -> int:
        """Number m of inputs."""
        return len(self.pairs[0])

    @property
    def n_outputs(self) -> int:
        """Number p of outputs."""
        return len(self.pairs)

    @cached_property
    def bank(self) -> Bank:
        """All operators on one threshold grid an input."""
        return Bank.of(self.pairs)

    def rest(self) -> PlayState:
        """State of a model that was never driven: all plays at zero."""
        return self.state_of([np.zeros(n) for n in self.bank.n], at_rest=True)

    def state_of(self, plays_v: Sequence[ArrayLike], *, at_rest: bool = False) -> PlayState:
        """State with given play outputs, one array an input on that input's threshold grid [V].

        Raises InputError where no history of the input leads to them: neighbours may differ by no more
        than their thresholds do.
        """
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
        return PlayState(count, end, x, d, below)

    def plays_of(self, state: PlayState) -> list[Array]:
        """Play outputs held by a state, one array an input on that input's threshold grid [V]."""
        bank, plays = self.bank, []
        for k, n in enumerate(bank.n):
            values, first = np.empty(n), 0
            for s in range(int(state.count[k]) - 1, -1, -1):
                last = int(state.end[k, s])
                values[first:last] = state.x[k, s] - state.d[k, s] * bank.r[k, first:last]
                first = last
            plays.append(values)
        return plays

    def weighted(self, plays_v: Sequence[Array]) -> Array:
        """Output (output,) of given play outputs, one array an input on that input's threshold grid [um].

        v_l = sum over j and i of w_lji p_ji                                           (paper, eq. 4)
        """
        bank = self.bank
        rows = [plays @ bank.w[k, : len(plays)] for k, plays in enumerate(plays_v)]
        return np.asarray(np.sum(rows, axis=0))

    def respond(self, u_v: ArrayLike, start: PlayState | None = None) -> tuple[Array, PlayState]:
        """Outputs for a whole signal.

        A signal too long for the memory is worked off in blocks, each from the state after the one before;
        the numbers are those of one piece to the last bit.

        Parameters
        ----------
        u_v : (input, sample) voltages [V], finite
        start : state before the first sample; at rest if not given

        Returns
        -------
        v_um : (output, sample) outputs [um]
        state : state after the last sample

        Raises
        ------
        InputError : wrong number of inputs
        SimulationError : a voltage that is not finite

        Examples
        --------
        >>> model = PrandtlIshlinskii([[Pair([0.5], [2.0])]])
        >>> state = model.rest()
        >>> for block in ([[0.0, 2.0]], [[1.0, -2.0]]):
        ...     v, state = model.respond(block, state)
        >>> v
        array([[ 3., -3.]])
        """
        from hammerstein.hysteresis.play_kernels import respond_turning_points

        u = np.ascontiguousarray(np.atleast_2d(np.asarray(u_v, dtype=np.float64)))
        if u.ndim != 2 or u.shape[0] != self.n_inputs:
            message = f"has shape {u.shape}; the model wants ({self.n_inputs}, samples)"
            raise InputError("voltage", message)
        state = self.rest() if start is None else start.copy()
        y = np.empty((self.n_outputs, u.shape[1]))
        b, s = self.bank, state
        bank = (b.r, b.guide, b.scale, b.n, b.lines)
        stack = (s.count, s.end, s.x, s.d, s.below)
        done = respond_turning_points(u, *bank, *stack, y, (0,) * self.n_outputs)
        if done < u.shape[1]:
            axis, sample = (int(i[0]) for i in np.nonzero(~np.isfinite(u)))
            raise SimulationError(f"voltage of input {axis + 1} is not finite at sample {sample}")
        return y, state

    def step(self, u_v: ArrayLike, state: PlayState) -> tuple[Array, PlayState]:
        """Outputs (output,) [um] for one sample (input,) [V], and the state after it.

        Equal to ``respond`` to the last bit.
        """
        y, after = self.respond(np.reshape(np.asarray(u_v, dtype=np.float64), (-1, 1)), state)
        return y[:, 0], after

    def amplitude(self, amplitude_v: float) -> Array:
        """Half heights of the settled loops (output, input) [um] for a voltage amplitude [V]."""
        return np.array([[pair.amplitude(amplitude_v) for pair in row] for row in self.pairs])

    def gain(self, amplitude_v: float) -> Array:
        """Gain matrix (output, input) [um/V] of the settled loops at a voltage amplitude [V]."""
        return self.amplitude(amplitude_v) / amplitude_v

    def loop_area(self, amplitude_v: float) -> Array:
        """Areas of the settled loops (output, input) [um V] for a voltage amplitude [V]."""
        return np.array([[pair.loop_area(amplitude_v) for pair in row] for row in self.pairs])

    def slope_columns(self, k: int) -> Array:
        """Slopes (operator, output) [um/V] while the first 1, 2, ... operators of input k move."""
        return self.bank.slope[k, 1 : self.bank.n[k] + 1]

    def to_iosys(self, sample_time_s: float, name: str = "hysteresis") -> BlockSystem:
        """Give the block as a discrete ``control.NonlinearIOSystem``, ``drive_v[k]`` to ``hysteresis_um[o]``.

        Raises InputError for a sample time that is not above zero.
        """
        from hammerstein.interop.block_system import BlockSystem, Stepwise, require_grid, signals

        require_grid(None, sample_time_s, "hysteresis")
        block = Stepwise(self.rest(), self.step, PlayState.as_dict, PlayState.from_dict)
        wires = signals("drive_v", self.n_inputs), signals("hysteresis_um", self.n_outputs)
        return BlockSystem(block, *wires, sample_time_s, name)

    def to_describing_function(self, range_v: float = np.inf) -> HysteresisNonlinearity:
        """Give a block of one pair, behind a drive, as ``control.DescribingFunctionNonlinearity``.

        Parameters
        ----------
        range_v : range of the drive, the same on both sides [V]; inf: none

        Raises
        ------
        InputError : more than one input or output, or a range within which no operator moves
        """
        from hammerstein.hysteresis.describing_function import nonlinearity_of

        return nonlinearity_of(self, range_v)


def _named_pair(r: Array, w: Array, output: int, input_: int) -> Pair:
    try:
        return Pair(r, w)
    except InputError as error:
        name = f"pair of output {output + 1} and input {input_ + 1}"
        raise InputError(name, error.mistakes) from None


def _checked_plays(plays: Array, r: Array, k: int) -> Array:
    if plays.shape != r.shape or not np.isfinite(plays).all():
        message = f"give {len(r)} finite plays for input {k + 1}, one for each threshold of its grid"
        raise InputError("start", message)
    slack = 1e-12 * (1.0 + np.abs(plays).max(initial=0.0) + r.max(initial=0.0))
    if (np.abs(np.diff(plays)) > np.diff(r) + slack).any():
        i = int(np.argmax(np.abs(np.diff(plays)) - np.diff(r)))
        message = (
            f"plays {i + 1} and {i + 2} of input {k + 1} differ by more than their thresholds; "
            "no voltage leads there"
        )
        raise InputError("start", message)
    return plays

"""Play operators: single ones, weighted banks with uncertainties, and all of a model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, ByValue, Indices, filled, freeze, freeze_fields, frozen
from hammerstein.blocks import Memory
from hammerstein.errors import InputError, Mistake, refuse


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

    Raises
    ------
    InputError : arrays of another shape, a number that is not finite, or a negative threshold

    Examples
    --------
    >>> play([0.0, 2.0, 1.0, -2.0], [0.5])
    array([[ 0. ,  1.5,  1.5, -1.5]])
    """
    from hammerstein.hysteresis.play_kernels import play_bank

    voltages, thresholds = _line("u", u), _line("r", np.atleast_1d(r))
    if (thresholds < 0.0).any():
        raise InputError("play", f"r holds {thresholds.min():g} V, but thresholds are 0 or more")
    plays = np.zeros(len(thresholds)) if start is None else _line("start", start).copy()
    if plays.shape != thresholds.shape:
        raise InputError(
            "play",
            f"start has {len(plays)} outputs, r {len(thresholds)} thresholds; they must be equally many",
        )
    shape = (len(thresholds), len(voltages))
    return filled(play_bank, voltages, thresholds, plays, shape=shape, products=4 * len(thresholds))


def played(path_v: ArrayLike, r: ArrayLike) -> Array:
    """Outputs (operator,) of plays at rest at the first voltage of a path, after following it slowly [V].

    Examples
    --------
    >>> played([5.0, 20.0, 12.0], [0.0, 2.0, 6.0, 50.0])
    array([12., 14., 14.,  5.])
    """
    thresholds = np.atleast_1d(np.asarray(r, dtype=np.float64))
    path = np.asarray(path_v, dtype=np.float64)
    held = np.full(len(thresholds), path[0])
    for voltage in path[1:]:
        held = np.maximum(voltage - thresholds, np.minimum(voltage + thresholds, held))
    return held


def play_bends(
    before: tuple[Array, Array], own: tuple[Array, Array], r: Array, w: Array, passes: int
) -> tuple[Array, Array]:
    """Derivatives of sums of plays of one input by their thresholds, then by the numbers that move it.

    Parameters
    ----------
    before, own : path before the record and record: input (N,), and its derivatives (number, N)
    r, w : (n,) thresholds, (n, p) weights
    passes : number of repetitions of the record; only the last one counts

    Returns
    -------
    values, held : (n + number, p, N) over the record, (n + number, p) before it
    """
    from hammerstein.hysteresis.shape_kernels import play_derivatives

    found, n = [], len(r)
    memory = np.full(n, before[0][0]), np.zeros(n), np.tile(before[1][:, 0], (n, 1))
    for x, moved in (before, *(own,) * passes):
        found.append(np.empty((n + len(moved), w.shape[1], len(x))))
        play_derivatives(x, moved, r, w, *memory, found[-1])
    return found[-1], found[0][:, :, -1]


def _line(name: str, values: ArrayLike) -> Array:
    """Finite numbers (n,); raises InputError for anything else."""
    try:
        found = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            "play", f"{name} contains a value that is not a number; give a list of numbers"
        ) from None
    if np.ndim(values) != 1:
        raise InputError(
            "play",
            f"{name} has shape {np.shape(values)}; give a list of numbers. For several inputs at "
            "once, use PrandtlIshlinskii(...).respond",
        )
    if not np.isfinite(found).all():
        raise InputError("play", f"{name} is not finite at index {int(np.argmin(np.isfinite(found)))}")
    return found


@dataclass(frozen=True, eq=False)
class Pair(ByValue):
    """Response of one output to one input: a bank of play operators.

    A linear gain is a bank with the single threshold 0, because a play with threshold 0 equals its input. An
    absent pair is an empty bank (paper, definition 3.1).

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
        freeze_fields(self, "thresholds_v", "weights_um_per_v", "weight_errors_um_per_v")
        r, w, errors = self.thresholds_v, self.weights_um_per_v, self.weight_errors_um_per_v
        mistakes = list(weighted_mistakes("thresholds", r, w, errors))
        if (r < 0).any():
            what = f"holds a negative value, {r.min():g} V; thresholds are 0 or more"
            mistakes.append(Mistake("thresholds_v", what))
        refuse("Prandtl-Ishlinskii pair", mistakes)

    @classmethod
    def linear(cls, gain_um_per_v: float) -> Pair:
        """Pass the input times a gain [um/V]."""
        return cls(frozen([0.0]), frozen([gain_um_per_v]))

    @classmethod
    def absent(cls) -> Pair:
        """Pair without response."""
        return cls(frozen([]), frozen([]))

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


def weighted_mistakes(name: str, places_v: Array, w: Array, errors: Array | None) -> Iterable[Mistake]:
    """Mistakes in weights, and in their errors, of operators; ``name`` says which operators."""
    if places_v.ndim != 1 or w.shape != places_v.shape:
        yield Mistake(
            "weights_um_per_v",
            f"has shape {w.shape}, the {name} {places_v.shape}; they must be equally many",
        )
    if errors is not None and errors.shape != w.shape:
        yield Mistake("weight_errors_um_per_v", f"has shape {errors.shape}, the weights {w.shape}")
    if not np.isfinite(places_v).all():
        yield Mistake(f"{name}_v", "holds a value that is not finite")
    elif places_v.ndim == 1 and (np.diff(places_v) <= 0).any():
        yield Mistake(f"{name}_v", f"is not strictly increasing; sort it and merge equal {name}")
    if not np.isfinite(w).all():
        yield Mistake("weights_um_per_v", "holds a value that is not finite")


@dataclass(frozen=True, eq=False)
class WeightCovariance(ByValue):
    """Covariance L L^T of the errors of all weights of one output.

    It holds for given thresholds; how weights follow those that err is told by the model's covariance.

    factor_um_per_v : (weight, weight) lower triangle L [um/V]; pair after pair in the order of the inputs
    slopes_at_bound : slopes that the fit held at a bound; their weights vary with the others alone
    """

    factor_um_per_v: Array
    slopes_at_bound: int = 0

    def __post_init__(self) -> None:
        freeze_fields(self, "factor_um_per_v")
        if not np.isfinite(self.factor_um_per_v).all():
            raise InputError("weight_covariance", "holds a value that is not finite")

    @property
    def covariance(self) -> Array:
        """Covariance (weight, weight) [um^2/V^2]."""
        return np.asarray(self.factor_um_per_v @ self.factor_um_per_v.T)


def triangle(spread: Array) -> Array:
    """Lower triangle L (n, n) with L L^T = S S^T for a matrix S (n, k), its diagonal not negative."""
    n = len(spread)
    factor = np.zeros((n, n))
    upper = np.asarray(np.linalg.qr(spread.T, mode="r"))
    factor[:, : len(upper)] = upper.T
    return np.asarray(factor * np.where(np.diag(factor) < 0.0, -1.0, 1.0))


def refuse_other_sizes(
    operators: Sequence[Sequence[int]], weights: Sequence[WeightCovariance] | None
) -> None:
    """Refuse covariances of other sizes than the weights (output, input)."""
    sizes = [sum(row) for row in operators]
    if weights is not None and [w.factor_um_per_v.shape for w in weights] != [(n, n) for n in sizes]:
        raise InputError("weight_covariance", f"must have one factor for each output, of {sizes} rows")


@dataclass(frozen=True, eq=False)
class PlayState(Memory):
    """Memory of a Prandtl-Ishlinskii model: the stack of segments of each input (see ``kernels``).

    ``PrandtlIshlinskii.rest``, ``.state_of`` and every run return one; its arrays are read-only.

    count : (m,) height of each stack; end, x, d : (m, operator+1); below : (m, operator+1, p)
    window : (m, columns) which form each input is in, and how often it turned lately (see ``play_kernels``)
    """

    count: Indices
    end: Indices
    x: Array
    d: Array
    below: Array
    window: Array


@dataclass(frozen=True, eq=False)
class Bank:
    """All operators on one threshold grid per input, for the kernels.

    n : (m,) operators of each input
    r : (m, n_max) thresholds [V], filled up with infinity
    w : (m, n_max, p) weights [um/V], zero where an output lacks the operator
    slope, moment : (m, n_max+1, p) partial sums of w and of w r
    lines : (m, n_max+1, 2 p) the two side by side
    guide, scale : (m, levels), (m,) where the search for a threshold begins, see ``kernels``
    """

    n: Indices
    r: Array
    w: Array
    slope: Array
    moment: Array
    lines: Array
    guide: Indices
    scale: Array

    @classmethod
    def of(cls, pairs: Sequence[Sequence[Pair]]) -> Bank:
        """Merge the pairs (output, input) onto one grid an input."""
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
        freeze(n, r, w, slope, moment, lines, guide, scale)
        return cls(n, r, w, slope, moment, lines, guide, scale)


def search_guide(r: Array, n: Indices) -> tuple[Indices, Array]:
    """Start of the search of ``first_at_least`` in ``play_kernels``: guide (m, levels), scale (m,).

    Levels go in steps of 1 / scale, two steps a threshold on average. Guides are a hair early, so that
    rounding makes none late.
    """
    steps = 2 * r.shape[1]
    guide, scale = np.zeros((r.shape[0], steps + 2), np.int64), np.zeros(r.shape[0])
    for k, grid in enumerate(r[k, : n[k]] for k in range(r.shape[0])):
        if len(grid) > 1 and grid[-1] > 1e-290:
            scale[k] = steps / grid[-1]
            levels = np.arange(steps + 2) / scale[k] * (1.0 - 1e-14)
            guide[k] = np.minimum(np.searchsorted(grid, levels), len(grid) - 1)
    return guide, scale

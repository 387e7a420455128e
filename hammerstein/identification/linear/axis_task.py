"""One axis during its fit: fixed data, and paths for given parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hammerstein.arrays import Array
from hammerstein.dynamics import Axis, CreepMode, LinearBlock
from hammerstein.dynamics.models import StateMatrices
from hammerstein.identification.score import SensorModel
from hammerstein.identification.static.normal_equations import Moments, moments_of, pooled
from hammerstein.identification.static.regressors import (
    MOST_KEPT,
    Filter,
    InitialState,
    PlayColumns,
    Regressors,
    SideBySide,
    behind_filters,
    delayed,
)
from hammerstein.quantities import RESONANCE_HZ, TIME_CONSTANT_S, number_of
from hammerstein.records.record import Record

SERIES = 16
"""Terms of the exponential series, for a matrix with a norm of at most a half: the next one is rounding."""
LARGEST_CREEP = 1.0
"""Largest gain of a slow mode, in parts of the fast displacement, on whose way it goes."""
STEP = 1e-6
"""Change of a parameter for its derivative: the parameters are logarithms and relative gains."""


@dataclass(frozen=True, eq=False)
class OfSum:
    """A linear block that responds to one sum of all columns."""

    weights: Array
    block: LinearBlock

    def settled(self, columns: Array) -> Array:
        """State of a block that was held at these columns for ever."""
        return self.block.settled([float(self.weights @ columns)])

    def respond(self, columns: Array, start: Array) -> tuple[Array, Array]:
        """Outputs (row, sample) and the state after them."""
        return self.block.respond(self.weights @ columns, start)


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of the output of a path from one sum of all columns by each of its parameters.

    weights : of the columns; paths : the path, and the ones with each parameter a step ahead
    """

    weights: Array
    paths: tuple[LinearBlock, ...]

    def settled(self, columns: Array) -> Array:
        """State (group, state, 4) of paths that were held at these columns for ever."""
        held = float(self.weights @ columns)
        return held * self._of_one if held else np.zeros_like(self._matrices[1])

    def among(self, columns: NDArray[np.intp]) -> Derivatives:
        """The same for the columns of these numbers; all others are zero."""
        return replace(self, weights=self.weights[columns])

    def respond(self, columns: Array, start: Array) -> tuple[Array, Array]:
        """Derivatives (parameter, sample) and the state after them."""
        from hammerstein.dynamics.path_kernel import respond_paths

        v, state = np.ascontiguousarray(self.weights @ columns), start.copy()
        y = np.empty((4 * len(start), len(v)))
        respond_paths(*self._matrices, state, v, y)
        return (y[1 : len(self.paths)] - y[0]) / STEP, state

    @cached_property
    def _matrices(self) -> tuple[Array, Array, Array, Array]:
        """Matrices of all paths, four side by side."""
        each = [(path.A, path.B[:, 0], path.C[0], path.D[0, 0]) for path in self.paths]
        a, b, c, d = map(self._side_by_side, zip(*each, strict=True))
        return a, b, c, d

    @cached_property
    def _of_one(self) -> Array:
        """State of paths that were held at 1 for ever."""
        return self._side_by_side([path.settled([1.0]) for path in self.paths])

    @staticmethod
    def _side_by_side(each: Sequence[ArrayLike]) -> Array:
        """Arrays of all paths as (group, ..., 4), the last group filled up with zeros."""
        whole = np.array(each, dtype=np.float64)
        filled = np.concatenate([whole, np.zeros((-len(whole) % 4, *whole.shape[1:]))])
        return np.ascontiguousarray(np.moveaxis(filled.reshape(-1, 4, *whole.shape[1:]), 1, -1))


ByColumn = SideBySide | Derivatives
"""Filters of columns that may be fewer."""


@dataclass(frozen=True)
class AxisShape:
    """Components of an axis; the order of its parameters is that of the fields.

    resonance : ln frequency and ln damping; lag : ln time constant
    creep_modes : gain and ln time constant of each
    """

    resonance: bool = True
    lag: bool = False
    creep_modes: int = 0

    @property
    def parameters(self) -> int:
        """Number of parameters."""
        return self.slow + 2 * self.creep_modes

    @property
    def slow(self) -> int:
        """Number of the parameters before those of the creep."""
        return 2 * self.resonance + self.lag

    @property
    def name(self) -> str:
        """Words for a table."""
        fast = [word for word, held in (("lag", self.lag), ("second order", self.resonance)) if held]
        creep = [number_of(self.creep_modes, "creep mode")] if self.creep_modes else []
        return " + ".join([*fast, *creep]) or "none"


@dataclass(frozen=True, eq=False)
class AxisTask:
    """Data that stay fixed while one axis is fitted.

    ``every`` thins the sums, not the signals: 3 counts every third sample. ``kept`` replaces the columns of
    all thresholds. Whole samples of the delay shift the columns; the rest of the delay, and
    the delay of the sensor, belong to the path.
    """

    records: tuple[Record, ...]
    starts: tuple[InitialState, ...]
    grids: tuple[Array, ...]
    output: int
    shape: AxisShape
    delay_samples: float
    sensor: SensorModel
    every: int = 1
    kept: tuple[Regressors, ...] = ()

    @property
    def columns(self) -> int:
        """Columns whose slopes are fitted: those of all inputs, or the sums kept of them."""
        return len(self.kept[0].held) if self.kept else sum(map(len, self.grids))

    def blocks(self, number: int, filters: Sequence[Filter]) -> Iterator[tuple[int, Array]]:
        """First sample and columns of each block of a record behind the filters."""
        return behind_filters(self._columns(number), self.starts[number], filters)

    def _columns(self, number: int) -> PlayColumns:
        """Columns of a record before any filter."""
        record, start = self.records[number], self.starts[number]
        whole, _ = self.late(record.sample_time_s)
        if self.kept:
            return self.kept[number].late(start, whole)
        return PlayColumns.of(delayed(record, start, whole), start, self.grids)

    @cached_property
    def _moving(self) -> tuple[tuple[NDArray[np.intp], PlayColumns], ...]:
        """Columns of each record that move, often those of one input, and their numbers, for every step.

        None where they would fill the memory.
        """
        if self.kept:
            few = replace(self, kept=tuple(one.moving[1] for one in self.kept))
            return tuple((one.moving[0], few._columns(i)) for i, one in enumerate(self.kept))
        if self.columns * sum(record.samples for record in self.records) > MOST_KEPT:
            return ()
        return tuple(self._columns(i).moving() for i in range(len(self.records)))

    @property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest parameters that records of this length and rate can identify."""
        step = min(record.sample_time_s for record in self.records)
        span = duration_s(self.records)
        shape, lower, upper = self.shape, [], []
        if shape.resonance:
            slowest = math.log(max(0.2 / span, RESONANCE_HZ.low))
            lower, upper = [slowest, math.log(1e-4)], [math.log(0.45 / step), math.log(10.0)]
        if shape.lag:
            shortest = math.log(max(0.05 * step, TIME_CONSTANT_S.low))
            lower, upper = [*lower, shortest], [*upper, math.log(0.1 * span)]
        lower += shape.creep_modes * [0.0, math.log(10.0 * step)]
        upper += shape.creep_modes * [LARGEST_CREEP, math.log(10.0 * span)]
        return np.array(lower), np.array(upper)

    def path(self, x: Array, sample_time_s: float) -> LinearBlock:
        """Discrete path from the static block to the reading; a fast form of ``discretise``."""
        return self.paths([x], sample_time_s)[0]

    def paths(self, places: Sequence[Array], sample_time_s: float) -> list[LinearBlock]:
        """Discrete paths for several points of the search."""
        each = [self._observed(*axis_matrices(self.shape, x)) for x in places]
        return held_each(each, sample_time_s, self.late(sample_time_s)[1])

    def _observed(self, a: Array, b: Array, c: Array, d: Array) -> StateMatrices:
        """Continuous A, B, C, D of an axis and the sensor behind it; the state of the sensor is last."""
        if self.sensor.bandwidth_hz is None:
            return a, b, c, d
        n, s = len(a), 2.0 * math.pi * self.sensor.bandwidth_hz
        both, driven, seen = np.zeros((n + 1, n + 1)), np.empty((n + 1, 1)), np.zeros((1, n + 1))
        both[:n, :n], both[n, :n], both[n, n] = a, s * c[0], -s
        driven[:n], driven[n] = b, s * d[0]
        seen[0, n] = 1.0
        return both, driven, seen, np.zeros((1, 1))

    def late(self, sample_time_s: float) -> tuple[int, float]:
        """Whole samples and fraction of the delay of a reading, sensor delay included."""
        samples = self.delay_samples + self.sensor.part_s(sample_time_s) / sample_time_s
        return math.floor(samples), samples % 1.0

    def sensor_path(self, sample_time_s: float) -> LinearBlock:
        """Discrete path of an axis without dynamics: the sensor alone."""
        return replace(self, shape=AxisShape(False)).path(np.empty(0), sample_time_s)

    def derivatives(self, x: Array, slopes: Array, sample_time_s: float) -> Derivatives:
        """Derivatives of the output by every x_i, for the static block with these slopes."""
        places = [x, *(x + STEP * np.eye(len(x)))]
        return Derivatives(slopes, tuple(self.paths(places, sample_time_s)))

    def moments(self, filters: Callable[[float], Sequence[ByColumn]], columns: int) -> Moments:
        """Moments of the columns with the output over all records; the filters depend on the sample time."""
        built = {time: filters(time) for time in {record.sample_time_s for record in self.records}}
        parts = []
        for i, record in enumerate(self.records):
            y, step = record.y_um[[self.output]], self.every
            own, held = self._moving[i] if self._moving else (np.arange(self.columns), self._columns(i))
            passed = built[record.sample_time_s]
            few = [one.among(own) if isinstance(one, Derivatives) else one for one in passed]
            blocks = behind_filters(held, self.starts[i], few)
            counted = ((c[:, ::step], y[:, k : k + c.shape[1] : step]) for k, c in blocks)
            numbers = np.append(own, np.arange(self.columns, columns))
            parts.append(moments_of(counted, columns, 1, numbers))
        return pooled(parts)


def duration_s(records: Sequence[Record]) -> float:
    """Duration of the longest record [s]."""
    return max(record.sample_time_s * record.samples for record in records)


def axis_matrices(shape: AxisShape, x: Array) -> tuple[Array, Array, Array, Array]:
    """Continuous A, B, C, D of an axis: states low-pass, position, speed / w, one for each slow mode."""
    n = shape.lag + 2 * shape.resonance + shape.creep_modes
    a, b = np.zeros((n, n)), np.zeros((n, 1))
    seen, through, i = np.zeros(n), 1.0, 0  # what the next block gets, of the states and of the input
    if shape.lag:
        rate = math.exp(-x[shape.slow - 1])
        a[0, 0], b[0] = -rate, rate
        seen, through, i = np.eye(n)[0], 0.0, 1
    if shape.resonance:
        w, damping = 2.0 * math.pi * math.exp(x[0]), math.exp(x[1])
        a[i, i + 1], a[i + 1, i : i + 2] = w, [-w, -2.0 * damping * w]
        a[i + 1] += w * seen
        b[i + 1] = w * through
        seen, through, i = np.eye(n)[i], 0.0, i + 2
    gains, rates = x[shape.slow :: 2], np.exp(-x[shape.slow + 1 :: 2])
    a[i:] = rates[:, None] * seen
    b[i:, 0] = rates * through
    a[range(i, n), range(i, n)] -= rates
    c = seen.copy()
    c[i:] += gains
    return a, b, c[None], np.full((1, 1), through)


def held_each(blocks: Sequence[StateMatrices], sample_time_s: float, late: float = 0.0) -> list[LinearBlock]:
    """Blocks on a sample grid, exact for an input held over each sample: exponential of [[A, B], [0, 0]] T.

    All have as many states and inputs. The input comes a part ``late`` of a sample late, as in
    ``LinearBlock.held``.

    Examples
    --------
    >>> one = np.ones((1, 1))
    >>> [block] = held_each([(-one, one, one, 0.0 * one)], 1.0)
    >>> abs(float(block.A[0, 0]) - math.exp(-1.0)) < 1e-15
    True
    """
    if late:
        begins = held_each(blocks, late * sample_time_s)
        ends = held_each(blocks, (1.0 - late) * sample_time_s)
        return [begin.then(end, sample_time_s) for begin, end in zip(begins, ends, strict=True)]
    n, m = blocks[0][1].shape
    full = np.zeros((len(blocks), n + m, n + m))
    for whole, (a, b, _, _) in zip(full, blocks, strict=True):
        whole[:n, :n], whole[:n, n:] = a, b
    return [
        LinearBlock(result[:n, :n], result[:n, n:], c, d, sample_time_s)
        for result, (_, _, c, d) in zip(_exponentials(full * sample_time_s), blocks, strict=True)
    ]


def _exponentials(matrices: Array) -> Array:
    """Exponentials of small matrices (matrix, row, column), by their series after halving and squaring again.

    SciPy's solves a system with every call, and BLAS with several threads takes 10 ms for one of three rows.
    """
    largest = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halvings = max(0, math.frexp(largest)[1] + 1)
    part = matrices / 2.0**halvings
    term = part
    total = np.eye(matrices.shape[1]) + part
    for i in range(2, SERIES):
        term = term @ part / i
        total += term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def axis_of(shape: AxisShape, x: Array) -> Axis:
    """Axis with given parameters."""
    pairs = x[shape.slow :].reshape(-1, 2)
    return Axis(
        resonance_hz=math.exp(x[0]) if shape.resonance else None,
        damping_ratio=math.exp(x[1]) if shape.resonance else None,
        lag_s=math.exp(x[shape.slow - 1]) if shape.lag else None,
        creep=tuple(CreepMode(gain=float(g), time_constant_s=math.exp(t)) for g, t in pairs),
    )


def parameters_of(axis: Axis) -> tuple[AxisShape, Array]:
    """Shape and parameters of an axis, creep included."""
    return AxisShape(axis.resonance_hz is not None, axis.lag_s is not None, len(axis.creep)), axis.free

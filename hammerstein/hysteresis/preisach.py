"""Preisach hysteresis: a plane of relays with the staircase of dominant turns of each voltage as memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array, Flags, Indices, filled, freeze, freeze_fields, frozen
from hammerstein.blocks import Memory
from hammerstein.errors import Mistake, refuse
from hammerstein.hysteresis.identifiable import Bounds, ColumnChoice, Driven, Identifiable
from hammerstein.hysteresis.kind import (
    Describable,
    Hysteresis,
    HysteresisFile,
    lower_rows,
    lower_triangle,
    refuse_not_finite,
    working_point,
)
from hammerstein.quantities import Offset, Weight

MOST_CELLS = 40
"""Most cells per side of a plane: 820 weights per pair."""
CELLS = (10, 20)
"""Numbers of cells per side that are tried by default: 40 take ten times as long as 20."""
MOST_COLUMNS = 500
"""Most weights of an output for a default trial: each needs a response of all samples in memory."""
ASIDE = 0.1
"""Distance of the working point from the middle of the range, in parts of half of it, from which a plane with
that point in its middle is another one."""
TURNS = 200
"""Turns that the memory of an input holds. Of more, those whose corner of the staircase is the smallest go;
a plane of 40 cells has at most 81 at rest."""


@dataclass(frozen=True, eq=False)
class PreisachState(Memory):
    """Memory of a Preisach model: the staircase of each input, see ``preisach_kernels``.

    count : (m,) turns; x : (m, turn) voltages [V]; tip : (m, turn, p) outputs there [um]
    last : (m,) last voltage within the plane [V]
    """

    count: Indices
    x: Array
    tip: Array
    last: Array


class Planes(NamedTuple):
    """Planes of all inputs, for the kernels.

    rest, low, high, size : (m,) working point, ends of the plane, width of a cell [V]; cells : (m,)
    node : (m, n_max+1, n_max+1, p) Everett function at the levels [um]
    beyond : (m, 2, p) slopes below and above the plane [um/V]
    """

    rest: Array
    low: Array
    high: Array
    size: Array
    cells: Indices
    node: Array
    beyond: Array

    @classmethod
    def of(cls, low_v: Array, high_v: Array, weights: Sequence[Array], rest_v: Array) -> Planes:
        """Weights (p, n, n) of each input, lower triangles [um/V]."""
        cells = np.array([w.shape[1] for w in weights], dtype=np.int64)
        size = (high_v - low_v) / cells
        p, levels = len(weights[0]), int(cells.max()) + 1
        node, beyond = np.zeros((len(weights), levels, levels, p)), np.zeros((len(weights), 2, p))
        for k, (w, n) in enumerate(zip(weights, cells.tolist(), strict=True)):
            summed = np.cumsum(np.cumsum(w[:, :, ::-1], axis=2)[:, :, ::-1], axis=1)
            node[k, 1 : n + 1, :n] = size[k] * np.moveaxis(summed, 0, -1)
            node[k, np.triu_indices(levels)[0], np.triu_indices(levels)[1]] = 0.0
            beyond[k] = w[:, :, 0].sum(axis=1), w[:, -1].sum(axis=1)
        freeze(size, cells, node, beyond)
        return cls(rest_v, low_v, high_v, size, cells, node, beyond)

    def run(self, u_v: Array, start: PreisachState) -> tuple[Array, PreisachState]:
        """Outputs (p, N) for voltages (m, N) relative to the working point, and the memory after them."""
        from hammerstein.hysteresis.preisach_kernels import respond_preisach

        own, shape = start.copy(), (self.node.shape[3], u_v.shape[1])
        given = (u_v, *self.numbers(own))
        return filled(respond_preisach, *given, shape=shape, products=8 * len(u_v) * shape[0]), own

    def numbers(self, memory: PreisachState) -> tuple[Any, ...]:
        """Arguments of the kernel other than voltages and outputs."""
        return (*self, memory.count, memory.x, memory.tip, memory.last)

    def fresh(self, home_v: Array) -> PreisachState:
        """Memory of an actuator at rest at absolute voltages (m,) [V].

        It is that after swings about them which die away by a cell each: the staircase lies along the line
        of turns with these voltages in their middle, as it does for plays that were never moved.
        """
        m, p = len(home_v), self.node.shape[3]
        begun = PreisachState(
            np.ones(m, dtype=np.int64),
            np.repeat(self.low[:, None], TURNS, axis=1),
            np.zeros((m, TURNS, p)),
            self.low.copy(),
        )
        swings = int(np.ceil((np.maximum(home_v - self.low, self.high - home_v) / self.size).max()))
        sizes = np.repeat(np.arange(max(swings, 0), 0, -1), 2) * np.tile([1.0, -1.0], max(swings, 0))
        path = home_v[:, None] + self.size[:, None] * np.append(sizes, 0.0)
        return self.run(np.clip(path, self.low[:, None], self.high[:, None]) - self.rest[:, None], begun)[1]

    def after(self, path_v: Array) -> PreisachState:
        """Memory after a path (m, turn) of voltages from rest."""
        return self.run(path_v, self.fresh(path_v[:, 0] + self.rest))[1]


@dataclass(frozen=True, eq=False, repr=False)
class Preisach(Hysteresis[PreisachState], Identifiable, Describable):
    """Sum of relays over a plane of switching voltages for each pair of m inputs and p outputs.

        v_l = sum over inputs j of  integral over beta <= alpha of  mu_lj(alpha, beta) relay(u_j; alpha, beta)

    A relay switches on as u rises to alpha and off as it falls to beta. mu is constant in every cell of a
    square grid; in a diagonal cell it is concentrated on the diagonal, as a slope without hysteresis.
    Between two levels of the grid a branch is then a straight line, and the output is continuous.

    Loops between two voltages have the same shape for any history (congruency), and a closed excursion
    leaves no trace (wiping out); plays are the case of weights that are equal along every line
    alpha - beta = 2 r. The memory is the staircase of dominant turns, the same for all outputs of an input.
    Beyond the plane, the output continues along the ends of the largest loop, without hysteresis.

    Parameters
    ----------
    low_v, high_v : (m,) ends of the plane of each input, as they are sent [V]
    cells_um_per_v : (output, input) nested sequence of lower triangles (n, n) of weights [um/V], n up to 40:
        row a and column b hold mu times the width of a cell for relays that switch on between levels a and
        a + 1 and off between levels b and b + 1. A rising branch has the slope of a sum along a row, from the
        column of its turn to the diagonal; a falling one of a sum down a column
    working_point_v : (m,) voltage from which the model counts [V]; zeros if not given

    Raises
    ------
    InputError : planes without width, triangles of other sizes, or numbers that are not finite

    Source: Mayergoyz, Mathematical Models of Hysteresis (1991), chapter 1; the multivariable form is this
    work's.

    Examples
    --------
    Two levels between -2 and 2 V: a slope of 1 um/V, and relays that add 0.5 um/V over a whole cell.

    >>> model = Preisach([-2.0], [2.0], [[[[1.0, 0.0], [0.5, 1.0]]]], [-2.0])
    >>> model.respond([[0.0, 2.0, 4.0, 2.0, 0.0]])[0]
    array([[0., 2., 5., 3., 0.]])
    """

    low_v: Array
    high_v: Array
    cells_um_per_v: tuple[tuple[Array, ...], ...]
    working_point_v: Array | None = None

    kind: ClassVar[str] = "preisach"
    wipes_out: ClassVar[bool] = True
    n_beside_weights: ClassVar[int] = 0  # the planes are those of the records
    # the records determine sums of cells, and the smoothness distributes them
    weight_covariance = None

    def __post_init__(self) -> None:
        freeze_fields(self, "low_v", "high_v")
        rows = tuple(tuple(frozen(cells) for cells in row) for row in self.cells_um_per_v)
        object.__setattr__(self, "cells_um_per_v", rows)
        m = len(self.low_v) if self.low_v.ndim == 1 else 0
        refuse("preisach model", self._mistakes(m))
        object.__setattr__(self, "working_point_v", working_point(self.working_point_v, m, self.kind))

    def _mistakes(self, m: int) -> list[Mistake]:
        """What is wrong with the numbers given."""
        low, high, rows = self.low_v, self.high_v, self.cells_um_per_v
        if not m or high.shape != (m,) or not (np.isfinite(low) & np.isfinite(high) & (low < high)).all():
            return [Mistake("low_v", "and high_v must be finite ends of each plane, the lower one below")]
        if not rows or any(len(row) != m for row in rows):
            return [Mistake("cells_um_per_v", f"must be a row of {m} triangles for each output")]
        for k, cells in enumerate(rows[0]):
            n, shapes = len(cells), {row[k].shape for row in rows}
            if shapes != {(n, n)} or not 1 <= n <= MOST_CELLS:
                what = f"of input {k + 1} must be square, 1 to {MOST_CELLS} cells a side"
                return [Mistake("cells_um_per_v", f"{what}, the same for all outputs")]
        if any(not np.isfinite(c).all() or np.triu(c, 1).any() for row in rows for c in row):
            return [Mistake("cells_um_per_v", "must be finite, and 0 above the diagonal")]
        return []

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of cells of every pair (output, input)."""
        return tuple(tuple(len(c) * (len(c) + 1) // 2 for c in row) for row in self.cells_um_per_v)

    def describe(self) -> str:
        """Short description."""
        sides = " and ".join(str(n) for n in dict.fromkeys(len(c) for c in self.cells_um_per_v[0]))
        return f"{self.ports}, a plane of {sides} cells on each side for each input"

    def counted_from(self, working_point_v: ArrayLike) -> Preisach:
        """Return the hysteresis relative to another working point (m,) [V]."""
        return replace(self, working_point_v=np.asarray(working_point_v, dtype=np.float64))

    @cached_property
    def planes(self) -> Planes:
        """Everett function of all pairs."""
        each = [np.stack(own) for own in zip(*self.cells_um_per_v, strict=True)]
        return Planes.of(self.low_v, self.high_v, each, np.asarray(self.working_point_v))

    @cached_property
    def _home_um(self) -> Array:
        """Outputs (p,) at rest, from the lower ends of the planes: those that count as 0 [um]."""
        still = np.zeros((self.n_inputs, 1))
        return self.planes.run(still, self.planes.fresh(np.asarray(self.working_point_v)))[0][:, 0]

    def _counted(self, state: PreisachState) -> PreisachState:
        """Memory whose outputs count from those at rest."""
        state.tip[0] -= self._home_um
        return state

    def rest(self) -> PreisachState:
        """Memory at rest."""
        return self._counted(self.planes.fresh(np.asarray(self.working_point_v)))

    def after(self, path_v: Array) -> PreisachState:
        """Memory after a path; see ``Hysteresis.after``."""
        return self._counted(self.planes.after(path_v))

    def _respond(self, u_v: Array, start: PreisachState) -> tuple[Array, PreisachState]:
        refuse_not_finite(u_v)
        return self.planes.run(u_v, start)

    def in_loop(self, memory: PreisachState) -> tuple[Any, ...]:
        """Planes and staircases; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Staircases

        return Staircases(self.planes.numbers(memory), np.empty((self.n_outputs, 1)))

    def slope_columns(self, k: int) -> Array:
        """Slopes (number, output) [um/V] of input k on branches that begin at a level, and beyond the plane.

        Every other slope lies between two of them, in the same share for all outputs.
        """
        found = []
        for cells in (row[k] for row in self.cells_um_per_v):
            rising = np.cumsum(cells[:, ::-1], axis=1)[:, ::-1]
            falling = np.cumsum(cells, axis=0)
            within = np.tril_indices(len(cells))
            found.append(np.concatenate([rising[within], falling[within]]))
        return np.stack(found, axis=1)

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, pair after pair, triangles row by row [um/V]."""
        return tuple(np.concatenate([c[np.tril_indices(len(c))] for c in row]) for row in self.cells_um_per_v)

    def with_weights(self, weights: Sequence[ArrayLike]) -> Self:
        """Return the same planes with other weights."""
        rows = []
        for row, parts in zip(self.cells_um_per_v, self._by_pair(weights), strict=True):
            triangles = []
            for cells, part in zip(row, parts, strict=True):
                triangles.append(np.zeros(cells.shape))
                triangles[-1][np.tril_indices(len(cells))] = part
            rows.append(tuple(triangles))
        return replace(self, cells_um_per_v=tuple(rows))

    @classmethod
    def first_guesses(cls, driven: Driven) -> list[Preisach]:
        """Planes over the range of each input, coarse ones first; see ``Identifiable``.

        Each is also tried with the working point in its middle. If an actuator that was never driven rests
        near the end of its range, its first rise passes relays that switch off below the range.
        """
        driven.refuse_still()
        tried = (min(max(len(r) for r in driven.thresholds_v), MOST_CELLS),) if driven.given else CELLS
        m, rest = len(driven.low_v), driven.working_point_v
        few = [n for n in tried if m * n * (n + 1) // 2 <= MOST_COLUMNS]
        reach = np.maximum(driven.high_v - rest, rest - driven.low_v)
        ends = [(driven.low_v, driven.high_v)]
        if (reach > (1.0 + ASIDE) * driven.half_swing_v).any():
            ends.append((rest - reach, rest + reach))
        return [
            cls(low, high, ((np.eye(n),) * m,) * driven.outputs, rest)
            for n in few or tried[:1]
            for low, high in ends
        ]

    def column_choices(self, driven: Driven) -> list[ColumnChoice]:
        """All cells: only their smoothness is chosen; see ``Identifiable``."""
        whole = np.ones(sum(self.operators[0]), dtype=np.bool_)
        return [ColumnChoice([whole], whole)]

    def with_columns(self, kept: Flags) -> Preisach:
        """Return itself: a plane keeps all of its cells."""
        return self

    @property
    def roughness(self) -> Array:
        """Differences (number, weight) of neighbours along the lines of one width.

        They are zero for plays. Where the records do not determine the weights, the smoothest model therefore
        consists of plays.
        """
        counts = self.operators[0]
        rows, first = [], 0
        for cells, count in zip(self.cells_um_per_v[0], counts, strict=True):
            a = np.tril_indices(len(cells))[0]
            inner = np.flatnonzero(a < len(cells) - 1)
            along = np.zeros((len(inner), sum(counts)))
            along[np.arange(len(inner)), first + inner] = -1.0
            along[np.arange(len(inner)), first + inner + a[inner] + 2] = 1.0  # row a has a + 1 cells
            rows.append(along)
            first += count
        return np.vstack(rows)

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Response to each cell alone, the same for all outputs; see ``Identifiable``."""
        values, held = [], []
        rest = np.asarray(self.working_point_v)
        for k, cells in enumerate(self.cells_um_per_v[output]):
            unit = np.zeros((len(cells) * (len(cells) + 1) // 2, *cells.shape))
            unit[np.arange(len(unit)), *np.tril_indices(len(cells))] = 1.0
            one = slice(k, k + 1)
            planes = Planes.of(self.low_v[one], self.high_v[one], [unit], rest[one])
            home, _ = planes.run(np.zeros((1, 1)), planes.fresh(rest[one]))
            stood, memory = planes.run(before_v[one, -1:], planes.after(before_v[one]))
            for _ in range(passes):
                own, memory = planes.run(np.ascontiguousarray(u_v[one]), memory)
            values.append(own - home)
            held.append(stood[:, 0] - home[:, 0])
        return np.vstack(values), np.concatenate(held)

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds:
        """No weight has the opposite sign of the slope, and the diagonal keeps the minimum."""
        counts = self.operators[output]
        own = slice(sum(counts[:input_]), sum(counts[: input_ + 1]))
        side, bound = np.zeros((2, sum(counts)))
        side[own] = np.sign(least)
        n = len(self.cells_um_per_v[output][input_])
        bound[own.start + np.cumsum(np.arange(1, n + 1)) - 1] = least
        return Bounds(np.eye(sum(counts)), side, bound)

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Return the grid, and the part of it that plays cannot represent."""
        found = []
        for name, cells in zip(inputs, self.cells_um_per_v[0], strict=True):
            found.append(f"the Preisach plane of {name} has {len(cells)} x {len(cells)} cells")
        return found

    @property
    def reversals_v(self) -> Array:
        """Half of the width of a relay, from none to that of the plane; see ``Describable``."""
        return np.array([0.0, 0.5 * float(self.high_v[0] - self.low_v[0])])

    def file(self) -> PreisachFile:
        """Form in a model file, without the working point, which the voltages hold."""
        rows = tuple(tuple(lower_rows(cells) for cells in row) for row in self.cells_um_per_v)
        return PreisachFile(low_v=tuple(self.low_v), high_v=tuple(self.high_v), cells_um_per_v=rows)


Cells = Annotated[tuple[tuple[Weight, ...], ...], Field(min_length=1, max_length=MOST_CELLS)]


class PreisachFile(HysteresisFile):
    """A plane of relays for each pair (output, input): lower triangles, each row up to its diagonal."""

    kind: Literal["preisach"] = "preisach"
    describes: ClassVar = Preisach
    low_v: Annotated[tuple[Offset, ...], Field(min_length=1, description="absolute voltage of each input")]
    high_v: Annotated[tuple[Offset, ...], Field(min_length=1, description="absolute voltage of each input")]
    cells_um_per_v: Annotated[tuple[tuple[Cells, ...], ...], Field(min_length=1)]

    def hysteresis(self) -> Preisach:
        """Return the hysteresis this describes."""
        rows = tuple(
            tuple(lower_triangle("cells_um_per_v", cells) for cells in row) for row in self.cells_um_per_v
        )
        return Preisach(np.array(self.low_v), np.array(self.high_v), rows)

"""From a record to regressors: plays, differences of neighbouring plays, and both behind a linear block.

With the slopes c_j = w_1 + ... + w_j of a pair, the response of its operators is

    sum of w_j p_j = sum of c_j s_j,     s_j = p_j - p_{j+1},   s_n = p_n

The effects of the differences s_j hardly overlap, so they are well-conditioned regressors, and bounds on the
slopes are bounds on single unknowns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array, ByValue
from hammerstein.dynamics import LinearBlock
from hammerstein.hysteresis import play
from hammerstein.hysteresis.pair import played
from hammerstein.records.record import Record

BLOCK = 8192
"""Samples handled at once: large enough for BLAS, small enough for the cache."""
MOST_KEPT = 4_000_000
"""Numbers of the plays that are kept in memory: 32 MB, twice as many for records that are repeated."""


class Filter(Protocol):
    """A linear block that columns pass, with its memory outside."""

    def settled(self, columns: Array) -> NDArray[Any]:
        """State of a block that was held at ``columns`` (column,) for ever."""

    def respond(self, columns: Array, start: NDArray[Any], /) -> tuple[Array, NDArray[Any]]:
        """Outputs (row, sample) and the state after them."""


@dataclass(frozen=True)
class InitialState:
    """State of the actuator before the first sample, as far as it is known.

    Parameters
    ----------
    kind : ``rest``: never driven, all plays at the 0 V of the record; ``stepped``: the same at another
        voltage, from which it stepped to the first one; ``turned``: driven from there to the last turning
        point, then to the first voltage, and held; ``repeated``: the same record came before
    first : first sample that counts; earlier ones only fill the memory
    turn_v : (input, 2) voltage at which the plays were at rest, and the last turning point [V]
    held : samples for which the first voltage was held after a step from there, while creep went on
    """

    kind: Literal["rest", "stepped", "turned", "repeated"]
    first: int = 0
    turn_v: tuple[tuple[float, float], ...] = ()
    held: int = 0

    def path_v(self, u_v: Array) -> Array:
        """Voltages (input, turn) that went before others (input, sample) [V]; the last was held."""
        if self.kind in ("rest", "repeated"):
            return np.zeros((len(u_v), 1))
        turns = np.array(self.turn_v)
        return turns if self.kind == "stepped" else np.column_stack([turns, u_v[:, 0]])


def delayed(record: Record, start: InitialState, samples: int) -> Array:
    """Voltages (input, sample) late by whole samples; before the record the actuator is as ``start`` says."""
    if samples == 0:
        return record.u_v
    u = np.roll(record.u_v, samples, axis=1)
    if start.kind != "repeated":
        u[:, :samples] = record.u_v[:, :1] if start.held else start.path_v(record.u_v)[:, -1:]
    return u


class PlayColumns(NamedTuple):
    """Columns of one record before any filter, in blocks: computed on demand, or kept.

    held : (column,) values before the record
    before : (column, sample) of the same record played before; None if it was not
    counted : first sample and (column, sample) of the record itself
    """

    held: Array
    before: Iterable[Array]
    counted: Iterable[tuple[int, Array]]

    @classmethod
    def of(
        cls, u_v: Array, start: InitialState, grids: Sequence[Array], with_derivatives: bool = False
    ) -> PlayColumns:
        """Columns that are computed on demand, those before the record first.

        Parameters
        ----------
        u_v : (input, sample) voltages [V]
        start : what went before
        grids : thresholds of each input [V]; the columns follow them, input by input
        with_derivatives : whether the derivatives of the plays by their thresholds follow as further columns,
            input by input: -1 after a play was last moved upwards, 1 after downwards, 0 before it was moved
        """
        plays = [played(path, grid) for path, grid in zip(start.path_v(u_v), grids, strict=True)]
        signs = _first_signs(u_v, plays, grids) if with_derivatives else None
        held = _held(plays, signs)
        before: Iterable[Array] = ()
        if start.kind == "repeated":
            before = (x for _, x in _blocks(u_v, grids, plays, signs))
        elif start.held:
            [(_, at_first)] = _blocks(u_v[:, :1], grids, plays, signs)
            before = (np.repeat(at_first, start.held, axis=1),)
        return cls(held, before, _blocks(u_v, grids, plays, signs))

    def kept(self) -> PlayColumns:
        """The same in memory, to be gone through many times."""
        return PlayColumns(self.held, tuple(self.before), tuple(self.counted))

    def moving(self) -> tuple[NDArray[np.intp], PlayColumns]:
        """Numbers of the columns that are not zero all the time, and these alone, in memory."""
        before, counted = list(self.before), list(self.counted)
        parts = [*before, *(x for _, x in counted)]
        own = np.flatnonzero(np.any([x.any(axis=1) for x in parts], axis=0) | (self.held != 0.0))
        before, counted = [x[own] for x in before], [(k, x[own]) for k, x in counted]
        return own, PlayColumns(self.held[own], before, counted)


def behind_filters(
    columns: PlayColumns, start: InitialState, filters: Sequence[Filter]
) -> Iterator[tuple[int, Array]]:
    """First sample and rows (row, sample) of each block from ``start.first`` on.

    filters : linear blocks that respond to all columns; their outputs, one block below the other, take the
        place of the columns
    """
    states = [block.settled(columns.held) for block in filters]
    for x in columns.before:
        _filtered(x, filters, states)
    for k, x in columns.counted:
        passed = _filtered(x, filters, states)
        skip = max(start.first - k, 0)
        if skip < x.shape[1]:
            yield k + skip, passed[:, skip:]


def _first_signs(u_v: Array, plays: Sequence[Array], grids: Sequence[Array]) -> list[Array]:
    """Derivatives of the plays by their thresholds before the record: of those that lean on their voltage."""
    signs = []
    for u, held, grid in zip(u_v, plays, grids, strict=True):
        lag = u[0] - held
        leans = (np.abs(np.abs(lag) - grid) <= 1e-9 * (1.0 + grid)) & (grid > 0.0) & (held != 0.0)
        signs.append(np.where(leans, -np.sign(lag), 0.0))
    return signs


def _held(plays: Sequence[Array], signs: Sequence[Array] | None) -> Array:
    """Columns (column,) that stand at the plays before the record."""
    rows = [np.append(-np.diff(held), held[-1:]) for held in plays]
    return np.concatenate([*rows, *(signs or ())])


@dataclass(frozen=True, eq=False)
class Regressors:
    """Regressors of one record kept in memory, for searches that pass them through many filters.

    values : (column, sample) over the whole record; held : (column,) before it
    """

    values: Array
    held: Array

    def blocks(
        self, start: InitialState, delay_samples: int, filters: Sequence[Filter]
    ) -> Iterator[tuple[int, Array]]:
        """First sample and rows of each block from ``start.first`` on, behind the filters and a delay."""
        return behind_filters(self.late(start, delay_samples), start, filters)

    @cached_property
    def moving(self) -> tuple[NDArray[np.intp], Regressors]:
        """Numbers of the columns that are not zero all the time, and these alone."""
        own = np.flatnonzero(self.values.any(axis=1) | (self.held != 0.0))
        return own, Regressors(self.values[own], self.held[own])

    def late(self, start: InitialState, delay_samples: int) -> PlayColumns:
        """Blocks of the columns behind a delay, which can be gone through many times."""
        values = np.roll(self.values, delay_samples, axis=1) if delay_samples else self.values
        if delay_samples and start.kind != "repeated":
            values[:, :delay_samples] = self.values[:, :1] if start.held else self.held[:, None]
        before: tuple[Array, ...] = (np.repeat(values[:, :1], start.held, axis=1),) if start.held else ()
        before = (values,) if start.kind == "repeated" else before
        counted = [(k, values[:, k : k + BLOCK]) for k in range(0, values.shape[1], BLOCK)]
        return PlayColumns(self.held, before, counted)


def _filtered(columns: Array, filters: Sequence[Filter], states: list[NDArray[Any]]) -> Array:
    """Columns behind the filters, whose states continue."""
    if not filters:
        return columns
    rows = []
    for i, block in enumerate(filters):
        passed, states[i] = block.respond(columns, states[i])
        rows.append(passed)
    return np.vstack(rows)


def _blocks(
    u_v: Array, grids: Sequence[Array], plays: list[Array], signs: list[Array] | None
) -> Iterator[tuple[int, Array]]:
    """Differences of neighbouring plays, and the derivatives if ``signs`` are given.

    ``plays`` and ``signs`` hold the memory from block to block.
    """
    from hammerstein.hysteresis.play_kernels import threshold_derivatives

    for k in range(0, u_v.shape[1], BLOCK):
        rows, moved = [], []
        for i, grid in enumerate(grids):
            outputs = _played(u_v[i, k : k + BLOCK], grid, plays[i])
            if signs is not None:
                moved.append(np.empty_like(outputs))
                threshold_derivatives(outputs, plays[i], signs[i], moved[-1])
            plays[i] = outputs[:, -1].copy()
            outputs[:-1] -= outputs[1:]
            rows.append(outputs)
        yield k, np.vstack(rows + moved)


def _played(u: Array, grid: Array, before: Array) -> Array:
    """Outputs (operator, sample) of plays; those of an input that rests stay, and need no loop."""
    if (u[0] - grid <= before).all() and (before <= u[0] + grid).all() and (u == u[0]).all():
        return np.repeat(before[:, None], len(u), axis=1)
    return play(u, grid, before)


def channel(block: LinearBlock, output: int, input_: int) -> LinearBlock | None:
    """Path of a block from one input to one output, with the states it needs; None if there is none."""
    edges = block.A != 0.0
    reached = _closure(edges, block.B[:, input_] != 0.0)
    seen = _closure(edges.T, block.C[output] != 0.0)
    states = np.flatnonzero(reached & seen)
    through = block.D[output, input_]
    if states.size == 0 and through == 0.0:
        return None
    return LinearBlock(
        block.A[np.ix_(states, states)],
        block.B[states][:, [input_]],
        block.C[[output]][:, states],
        np.array([[through]]),
        block.sample_time_s,
    )


def _closure(edges: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """States reached from a set of states, where edges[i, j] leads from j to i."""
    reached = start
    for _ in range(len(edges)):
        further = reached | (edges @ reached)
        if (further == reached).all():
            break
        reached = further
    return reached


@dataclass(frozen=True, eq=False)
class SideBySide(ByValue):
    """Copies of a path with one input and one output, one for each column."""

    path: LinearBlock

    def settled(self, columns: Array) -> Array:
        """State (copy, state) of paths that were held at their column for ever."""
        if not columns.any():
            return np.zeros((len(columns), len(self.path.A)))
        return np.outer(columns, self._of_one)

    @cached_property
    def _of_one(self) -> Array:
        """State (state,) of one copy that was held at 1 for ever: a search asks for it thousands of times."""
        return self.path.settled([1.0])

    def respond(self, columns: Array, start: Array) -> tuple[Array, Array]:
        """Outputs (copy, sample) and the state after them."""
        from hammerstein.dynamics.path_kernel import respond_copies

        path, state, passed = self.path, start.copy(), np.empty_like(columns)
        respond_copies(path.A, path.B[:, 0], path.C[0], path.D[0, 0], state, columns, passed)
        return passed, state

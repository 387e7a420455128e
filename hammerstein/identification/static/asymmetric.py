"""Plays and one-sided dead-zones from records, by one linear least squares."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.linalg import block_diag

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii, WeightCovariance
from hammerstein.hysteresis.pair import triangle
from hammerstein.identification.score import path_before
from hammerstein.identification.static.folds import moments_of_folds
from hammerstein.identification.static.normal_equations import (
    Bounds,
    Moments,
    Solution,
    moments_of,
    pooled,
    solve,
)
from hammerstein.identification.static.regressors import Filter, Start, delayed, regressor_blocks
from hammerstein.identification.static.static_block import (
    LEAST_SLOPE,
    SlopeColumns,
    SquaresSolver,
    Thresholds,
    direct_pairs,
    half_swing,
    path_filters,
    refuse_unreached,
    ridge_of,
)
from hammerstein.records.record import Record

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class AsymmetricFit:
    """Plays and dead-zones found by regression, and how well they fit the records they were found from.

    Parameters
    ----------
    hysteresis : thresholds, breakpoints, weights and their standard errors
    offsets_um : (record, output) readings that belong to an output of zero [um]
    rms_um : (output,) rms of what is left [um]
    samples : samples used
    held : pairs (output, input) of which some slope stands at the least one that has an inverse
    """

    hysteresis: Asymmetric
    offsets_um: Array
    rms_um: Array
    samples: int
    held: tuple[tuple[int, int], ...]


def breakpoints_in(records: Sequence[Record], dead_zones: int) -> list[Array]:
    """Breakpoints of each input [V, as sent]: as many, at equal distances within the voltages driven.

    Examples
    --------
    >>> u = 4.0 * np.sin(np.linspace(0.0, 20.0, 20001))
    >>> breakpoints_in([Record([u], [u], 1e-3)], 3)[0].round(3)
    array([-2.,  0.,  2.])
    """
    low, high = _driven(records)
    shares = np.arange(1, dead_zones + 1) / (dead_zones + 1)
    return [a + (b - a) * shares if b > a else np.empty(0) for a, b in zip(low, high, strict=True)]


def _driven(records: Sequence[Record]) -> tuple[Array, Array]:
    """Lowest and highest voltage of each input over all records (input,), as sent [V]."""
    low = np.array([r.u_v.min(axis=1) + r.rest_v for r in records])
    high = np.array([r.u_v.max(axis=1) + r.rest_v for r in records])
    return low.min(axis=0), high.max(axis=0)


def fit_asymmetric(
    records: Sequence[Record],
    thresholds_v: Thresholds,
    breakpoints_v: Sequence[Array],
    *,
    solver: SquaresSolver = "invertible",
    starts: Sequence[Start] = (),
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
    ridge: float = 0.0,
) -> AsymmetricFit:
    """Weights of plays and dead-zones of all pairs from several records together.

        y_l = offset_l + sum over k ( sum_i w_lki play(u_k; r_lki) + sum_q v_lkq D_q(u_k) )

    linear in all weights. Unknowns are slopes: S_j, with j plays engaged, and D_m, what the dead-zones below
    zone m add. The regressor of D_m is how far the voltage has risen in zone m, so that neighbours hardly
    overlap in what they do.

    With ``invertible`` every slope S_j + D_m of a direct pair stays above a twentieth c of its mean slope:
    S_j >= t and D_m >= c - t for some t, an unknown as well, which leaves one bounded least squares.

    Parameters
    ----------
    records : at least one, all with the same axes
    thresholds_v : (output, input) arrays of thresholds [V], the smallest of each input 0; an empty one leaves
        the plays of the pair out
    breakpoints_v : (input,) arrays of breakpoints, as voltages are sent [V]; the outputs share them
    solver : ``least_squares`` or ``invertible``; ``nonnegative`` bounds the weights of the plays alone
    starts : what went before each record; rest if not given
    delay_samples : samples by which the outputs come late
    through : linear block of each record behind the static one
    ridge : penalty of the weights, but of the first play of each pair, relative to the power of the plays

    Raises
    ------
    IdentificationError : inputs that never move, a smallest threshold above 0, or a breakpoint that
        no record passes

    Source: as ``Asymmetric``; the inequalities are this work's.
    """
    layout = SlopeColumns.of(thresholds_v)
    refuse_unreached(records, layout.grids)
    if any(grid.size and grid[0] > 0.0 for grid in layout.grids):
        raise IdentificationError("dead-zones need a smallest threshold of 0: after a reversal no play moves")
    for name, q, low, high in zip(records[0].inputs, breakpoints_v, *_driven(records), strict=True):
        if q.size and not low < q[0] <= q[-1] < high:
            beyond = q[-1] if q[-1] >= high else q[0]
            raise IdentificationError(
                f"the breakpoint {beyond:g} V of input {name} is never passed: it is driven from {low:g} to "
                f"{high:g} V"
            )
    begun = tuple(starts) or (Start("rest"),) * len(records)
    task = AsymmetricTask(records, begun, layout, tuple(breakpoints_v), delay_samples, tuple(through))
    moments = task.moments()
    zones = SlopeColumns.of([list(breakpoints_v)])
    columns = [AsymmetricColumns.of(layout, o, zones) for o in range(len(thresholds_v))]
    free = [_solved(column, moment, ridge) for column, moment in zip(columns, moments, strict=True)]
    found, held = free, []
    if solver != "least_squares":
        each = zip(columns, thresholds_v, free, strict=True)
        gains = np.array([c.gains(s.coefficients, row, task) for c, row, s in each])
        for o, k in direct_pairs(gains):
            least = LEAST_SLOPE * float(gains[o, k])
            slopes = columns[o].joint_slopes(free[o].coefficients, k)
            if (np.sign(least) * slopes < abs(least)).any():
                found[o] = _solved(columns[o], moments[o], ridge, columns[o].bounds(k, least))
                held.append((o, k))
    return _fit(task, thresholds_v, columns, moments, found, held)


class AsymmetricTask(NamedTuple):
    """Records and what stands behind the static block."""

    records: Sequence[Record]
    starts: Sequence[Start]
    layout: SlopeColumns
    breakpoints_v: tuple[Array, ...]
    delay_samples: int
    through: tuple[LinearBlock, ...]

    @property
    def columns(self) -> int:
        """Columns of plays and dead-zones of all inputs."""
        return sum(map(len, (*self.layout.grids, *self.breakpoints_v)))

    def moments(self) -> list[Moments]:
        """Moments of each output with all columns, over all records."""

        def of_record(i: int, outputs: Sequence[int]) -> Moments:
            y = self.records[i].y_um[list(outputs)]
            blocks = ((x, y[:, k : k + x.shape[1]]) for k, x in self._blocks(i, outputs[0]))
            return moments_of(blocks, self.columns, len(y))

        return [pooled(parts) for parts in self._each(of_record, Moments.of_output)]

    def folds(self, parts: int) -> list[list[dict[int, Moments]]]:
        """Moments (output) (record) of each fold with all columns."""

        def of_record(i: int, outputs: Sequence[int]) -> dict[int, Moments]:
            y, first = self.records[i].y_um[list(outputs)], self.starts[i].first
            return moments_of_folds(self._blocks(i, outputs[0]), y, first, self.columns, parts)

        return self._each(of_record, lambda folds, o: {f: m.of_output(o) for f, m in folds.items()})

    def _each(
        self, of_record: Callable[[int, Sequence[int]], T], of_output: Callable[[T, int], T]
    ) -> list[list[T]]:
        """Something of each (output) (record): without a linear block all outputs share their columns."""
        p, every = len(self.records[0].y_um), range(len(self.records))
        if self.through:
            return [[of_record(i, [o]) for i in every] for o in range(p)]
        whole = [of_record(i, range(p)) for i in every]
        return [[of_output(one, o) for one in whole] for o in range(p)]

    def _blocks(self, i: int, o: int) -> Iterator[tuple[int, Array]]:
        """First sample and columns of each block of a record, behind the path of output o."""
        record, start = self.records[i], self.starts[i]
        u, p = delayed(record, start, self.delay_samples), len(record.y_um)
        plays, zones = sum(map(len, self.layout.grids)), sum(map(len, self.breakpoints_v))
        filters = path_filters(self.through, i, o, plays, p)
        counted = [q - r for q, r in zip(self.breakpoints_v, record.rest_v, strict=True)]
        ramps = _ramps(u, counted)
        if filters and zones:
            [behind] = path_filters(self.through, i, o, zones, p)
            held = _ramps(path_before(record, start)[:, -1:], counted)[:, 0]
            ramps = _passed(ramps, start, behind, held)
        for k, x in regressor_blocks(u, start, self.layout.grids, filters):
            yield k, np.vstack([x, ramps[:, k : k + x.shape[1]]])


def _ramps(u_v: Array, counted_v: Sequence[Array]) -> Array:
    """Rise within each zone (zone, sample) [V], from where the record counts."""
    rows = [np.empty((0, u_v.shape[1]))]
    for u, q in zip(u_v, counted_v, strict=True):
        depth = np.append(np.diff(q), np.inf)[: len(q)]
        for a, d in zip(q, depth, strict=True):
            rows.append(np.clip(u - a, 0.0, d)[None, :] - min(max(-a, 0.0), d))
    return np.vstack(rows)


def _passed(ramps: Array, start: Start, path: Filter, held: Array) -> Array:
    """Ramps behind their path, which was held at given ramps (zone,) before."""
    passed, state = path.respond(ramps, path.settled(held))
    return path.respond(ramps, state)[0] if start.kind == "repeated" else passed


class AsymmetricColumns(NamedTuple):
    """Where the slopes of one output stand: those of its plays, then of the dead-zones of all inputs."""

    merge: Array
    plays: tuple[slice, ...]
    zones: tuple[slice, ...]

    @classmethod
    def of(cls, plays: SlopeColumns, o: int, zones: SlopeColumns, z: int = 0) -> AsymmetricColumns:
        """Plays of row o and dead-zones of row z of their layouts."""
        first = plays.merge[o].shape[1]
        parts = tuple(slice(first + part.start, first + part.stop) for part in zones.parts[z])
        return cls(block_diag(plays.merge[o], zones.merge[z]), plays.parts[o], parts)

    def penalty(self, gram: Array, ridge: float) -> Array | None:
        """Penalty of the weights in terms of the slopes: it is the bends that it makes small."""
        return ridge_of(self.plays, gram, ridge, self.zones) if ridge > 0.0 else None

    def joint_slopes(self, slopes: Array, k: int) -> Array:
        """Slopes (engaged, zone) of the pair of input k."""
        zones = np.append(0.0, slopes[self.zones[k]])
        plays = slopes[self.plays[k]]
        return np.asarray(np.add.outer(plays if plays.size else np.zeros(1), zones))

    def gains(self, slopes: Array, thresholds_v: Sequence[Array], task: AsymmetricTask) -> Array:
        """Mean slope of every input (input,) over the voltages driven [um/V]; thresholds of its plays."""
        found = []
        reach = half_swing(task.records)
        _, tops = _driven(task.records)
        for k, (r, q) in enumerate(zip(thresholds_v, task.breakpoints_v, strict=True)):
            rise = float(np.diff(slopes[self.plays[k]], prepend=0.0) @ (reach[k] - r))
            rise += 0.5 * float(np.diff(slopes[self.zones[k]], prepend=0.0) @ (tops[k] - q))
            found.append(rise / reach[k] if reach[k] > 0.0 else 0.0)
        return np.array(found)

    def bounds(self, k: int, least: float) -> Bounds:
        """Slopes S_j = t + x_j, D_m = x_m - t of input k with t >= c, x_j >= 0 and x_m >= c; others free."""
        size = self.merge.shape[1]
        basis, side, bound = np.eye(size, size + 1), np.zeros(size + 1), np.zeros(size + 1)
        way = float(np.sign(least))
        side[self.plays[k]] = side[self.zones[k]] = side[size] = way
        bound[self.zones[k]] = bound[size] = least
        basis[self.plays[k], size], basis[self.zones[k], size] = 1.0, -1.0
        return Bounds(basis, side, bound)


def _solved(
    columns: AsymmetricColumns, moment: Moments, ridge: float, bounds: Bounds | None = None
) -> Solution:
    gram = columns.merge.T @ moment.gram @ columns.merge
    cross = columns.merge.T @ moment.cross[:, 0]
    penalty = columns.penalty(gram, ridge)
    return solve(gram, cross, float(moment.power[0]), moment.freedom, bounds=bounds, penalty=penalty)


def _fit(
    task: AsymmetricTask,
    thresholds_v: Thresholds,
    columns: Sequence[AsymmetricColumns],
    moments: Sequence[Moments],
    found: Sequence[Solution],
    held: Sequence[tuple[int, int]],
) -> AsymmetricFit:
    """Weights from slopes, with what is said of them."""
    pairs, zones, known, offsets = [], [], [], []
    for row, own, moment, solution in zip(thresholds_v, columns, moments, found, strict=True):
        parts = [part for both in zip(own.plays, own.zones, strict=True) for part in both]
        weights = [np.diff(solution.coefficients[part], prepend=0.0) for part in parts]
        spread = np.vstack([np.diff(solution.spread[part], axis=0, prepend=0.0) for part in parts])
        ends = np.cumsum([len(w) for w in weights])[:-1]
        errors = np.split(np.sqrt(np.sum(spread**2, axis=1)), ends)
        each = list(zip(weights, errors, strict=True))
        pairs.append(tuple(Pair(r, *both) for r, both in zip(row, each[::2], strict=True)))
        bends = zip(task.breakpoints_v, each[1::2], strict=True)
        zones.append(tuple(DeadZones(q, *both) for q, both in bends))
        at_bound = int(solution.at_bound[: len(solution.coefficients)].sum())
        known.append(WeightCovariance(triangle(spread), at_bound))
        offsets.append(moment.means[:, -1] - moment.means[:, :-1] @ (own.merge @ solution.coefficients))
    plays, rest = PrandtlIshlinskii(tuple(pairs)), task.records[0].rest_v
    return AsymmetricFit(
        hysteresis=Asymmetric(plays, tuple(zones), rest, tuple(known)),
        offsets_um=np.column_stack(offsets),
        rms_um=np.array([solution.residual_rms for solution in found]),
        samples=moments[0].samples,
        held=tuple(held),
    )

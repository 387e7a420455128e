"""Thresholds for given records, and weights of the static block by linear least squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import linear_sum_assignment

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, WeightCovariance
from hammerstein.hysteresis.pair import triangle
from hammerstein.identification.options import Partition
from hammerstein.identification.static.closed_form import (
    thresholds_uniform_in_time,
    thresholds_uniform_in_voltage,
)
from hammerstein.identification.static.normal_equations import (
    Bounds,
    Moments,
    Solution,
    moments_of,
    not_nothing,
    pooled,
    solve,
)
from hammerstein.identification.static.regressors import (
    MOST_KEPT,
    Filter,
    InitialState,
    PlayColumns,
    SideBySide,
    behind_filters,
    channel,
    delayed,
)
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import find_cycles

Thresholds = Sequence[Sequence[Array]]
SquaresSolver = Literal["least_squares", "nonnegative", "invertible"]

LEAST_SLOPE = 0.05
"""Bound of the slopes of a direct pair, in parts of its mean slope."""
WHITENED = 1e-6
"""Power of a combination of the plays of one input, in parts of the largest, from which it is identified."""
INSEPARABLE = 1e-10
"""One minus a correlation of two inputs, below which they are inseparable."""
SHARED = 0.1
"""Share of an input in such a combination from which it takes part."""


@dataclass(frozen=True, eq=False)
class StaticFit:
    """Static block found by regression, and its errors on the fitted records.

    Parameters
    ----------
    hysteresis : thresholds, weights and their standard errors
    offsets_um : (record, output) reading at an output of zero [um]
    rms_um : (output,) rms residual [um]
    samples : samples used
    bounded : slopes (output, input, operator) at their bound, counted from 0
    open : pairs (output, input) whose weights the records do not determine one by one
    """

    hysteresis: PrandtlIshlinskii
    offsets_um: Array
    rms_um: Array
    samples: int
    bounded: tuple[tuple[int, int, int], ...]
    open: tuple[tuple[int, int], ...]


class SlopeColumns(NamedTuple):
    """Positions of the slopes of each pair among the columns of one output.

    ``merge[o]`` (column, slope) sums the columns of the merged threshold grids into those of the pairs;
    ``parts[o][k]`` are the slopes of the pair of input k.
    """

    grids: tuple[Array, ...]
    merge: tuple[Array, ...]
    parts: tuple[tuple[slice, ...], ...]

    @classmethod
    def of(cls, thresholds_v: Thresholds) -> SlopeColumns:
        """Lay out the pairs with thresholds (output, input)."""
        m = len(thresholds_v[0])
        grids = tuple(np.unique(np.concatenate([row[k] for row in thresholds_v])) for k in range(m))
        merge, parts = [], []
        for row in thresholds_v:
            ends = np.cumsum([len(r) for r in row])
            parts.append(tuple(slice(int(e) - len(r), int(e)) for e, r in zip(ends, row, strict=True)))
            owners = [np.searchsorted(*both, side="right") - 1 for both in zip(row, grids, strict=True)]
            sums = [own[:, None] == np.arange(len(r)) for own, r in zip(owners, row, strict=True)]
            merge.append(np.asarray(block_diag(*sums), dtype=np.float64))
        return cls(grids, tuple(merge), tuple(parts))


def fit_static(
    records: Sequence[Record],
    thresholds_v: Thresholds,
    *,
    solver: SquaresSolver = "invertible",
    starts: Sequence[InitialState] = (),
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
    ridge: float = 0.0,
) -> StaticFit:
    """Least-squares weights of all inputs and outputs from several records.

        y_l = offset_l + sum over k, i of w_lki play(u_k; r_lki)         (paper, eq. 4)

    The weights are linear in the plays, so that records with any excitation of one or several inputs at a
    time serve. Behind a linear block they are linear in the plays that have passed it, too.

    Parameters
    ----------
    records : at least one, all with the same axes
    thresholds_v : (output, input) arrays of thresholds [V]; an empty one leaves the pair out
    solver : ``least_squares``; ``nonnegative``: all weights of a pair have the sign of its gain;
        ``invertible``: all slopes (partial sums of weights) of the direct pairs stay above a twentieth of the
        pair's mean slope, weights may be negative
    starts : initial state of each record; rest if not given
    delay_samples : delay of the outputs in samples
    through : linear block of each record behind the static one, with p inputs; its last p outputs are the
        readings; empty if there is none
    ridge : penalty of the weights but the first, relative to the power of the plays

    Raises
    ------
    IdentificationError : inputs that never move, or never independently of each other

    Examples
    --------
    >>> u = 4.0 * np.sin(np.linspace(0.0, 20.0, 2000))
    >>> truth = PrandtlIshlinskii([[Pair([0.5, 2.0], [3.0, -1.0])]])
    >>> record = Record([u], truth.respond([u])[0] - 7.0, 1e-3)
    >>> fit = fit_static([record], [[np.array([0.5, 2.0])]], solver="least_squares")
    >>> fit.hysteresis.pairs[0][0].weights_um_per_v.round(9), fit.offsets_um.round(9)
    (array([ 3., -1.]), array([[-7.]]))
    """
    layout = SlopeColumns.of(thresholds_v)
    refuse_unreached(records, layout.grids)
    begun = tuple(starts) or (InitialState("rest"),) * len(records)
    moments = static_moments(records, layout.grids, begun, delay_samples, through)
    return solve_static(records, thresholds_v, layout, moments, solver, ridge)


def static_moments(
    records: Sequence[Record],
    grids: Sequence[Array],
    starts: Sequence[InitialState],
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
    *,
    with_derivatives: bool = False,
    every: int = 1,
    driven: bool = False,
) -> list[Moments]:
    """Moments of each output with the slope columns of all inputs, over all records.

    ``with_derivatives`` adds as many columns again: the derivatives of the plays by their thresholds.
    ``every`` leaves out samples of the sums: 3 takes every third. ``driven`` leaves out the plays of inputs
    that rest in a record.
    """
    p, sizes = len(records[0].y_um), [len(grid) for grid in grids]
    # records that drive the same inputs are summed first: another order rounds otherwise, and a search of
    # thresholds may then take another way
    alike: dict[tuple[bool, ...], list[list[Moments]]] = {}
    for i, (record, start) in enumerate(zip(records, starts, strict=True)):
        moves = tuple(not driven or _is_driven(u, start) for u in record.u_v)
        own = [grid if moved else grid[:0] for grid, moved in zip(grids, moves, strict=True)]
        plays = partial(PlayColumns.of, delayed(record, start, delay_samples), start, own, with_derivatives)
        filters = [path_filters(through, i, o, p) for o in range(p)]
        held = np.tile(np.repeat(moves, sizes), 1 + with_derivatives)
        alike.setdefault(moves, []).append(record_moments(record, start, plays, filters, held, every))
    parts = [[pooled(part) for part in zip(*own, strict=True)] for own in alike.values()]
    return [pooled(part) for part in zip(*parts, strict=True)]


def _is_driven(u_v: Array, start: InitialState) -> bool:
    """Whether an input moves in a record, its step from rest included."""
    return bool(np.ptp(u_v) > 0.0 or (start.kind == "rest" and u_v[0] != 0.0))


def path_filters(blocks: Sequence[LinearBlock], record: int, o: int, p: int) -> list[SideBySide]:
    """Path of one of p outputs in the block of a record; the block must not couple the outputs."""
    if not blocks:
        return []
    block = blocks[record]
    first = block.n_outputs - p
    paths = [channel(block, first + o, k) for k in range(p)]
    own = paths.pop(o)
    if own is None or any(path is not None for path in paths):
        raise IdentificationError(
            "the linear block couples the outputs; give one that acts on each output separately"
        )
    return [SideBySide(own)]


def record_moments(
    record: Record,
    start: InitialState,
    plays: Callable[[], PlayColumns],
    filters: Sequence[Sequence[Filter]],
    held: Flags,
    every: int = 1,
) -> list[Moments]:
    """Moments of each output with the plays behind its filters; those of outputs with one path at once.

    held : (column,) whether the plays have a column, which is zero otherwise
    """
    columns, moving = len(held), np.flatnonzero(held)

    def gathered(outputs: Sequence[int], made: PlayColumns) -> Moments:
        y = record.y_um[list(outputs)]
        blocks = behind_filters(made, start, filters[outputs[0]])
        pairs = ((x[:, ::every], y[:, k : k + x.shape[1] : every]) for k, x in blocks)
        return moments_of(pairs, columns, len(y), moving)

    outputs = range(len(filters))
    if all(own == filters[0] for own in filters):
        whole = gathered(outputs, plays())
        return [whole.of_output(o) for o in outputs]
    kept = plays().kept() if columns * record.samples <= MOST_KEPT else None
    return [gathered([o], kept or plays()) for o in outputs]


def solve_static(
    records: Sequence[Record],
    thresholds_v: Thresholds,
    layout: SlopeColumns,
    moments: Sequence[Moments],
    solver: SquaresSolver = "invertible",
    ridge: float = 0.0,
) -> StaticFit:
    """Weights from the moments of each output; see ``fit_static``."""
    refuse_inseparable(records[0], layout, moments)
    free = [_solve_output(layout, o, moment, ridge) for o, moment in enumerate(moments)]
    solutions = free
    if solver != "least_squares":
        gains = gains_of(records, thresholds_v, layout, [solution.coefficients for solution in free])
        solutions = [
            _solve_output(layout, o, moment, ridge, bounds_of(solver, layout, o, gains))
            for o, moment in enumerate(moments)
        ]
    columns = [merge @ one.coefficients for merge, one in zip(layout.merge, solutions, strict=True)]
    return as_block(thresholds_v, layout, free, solutions, columns, moments)


def as_block(
    thresholds_v: Thresholds,
    layout: SlopeColumns,
    free: Sequence[Solution],
    solutions: Sequence[Solution],
    columns: Sequence[Array],
    moments: Sequence[Moments],
) -> StaticFit:
    """Static block of the slopes of each output; ``free`` are those that no bounds held.

    columns, moments : slopes of all columns behind which an output was read, and its moments with them
    """
    means = [(moment.means[:, -1], moment.means[:, :-1]) for moment in moments]
    found = [_pairs_of(*each) for each in zip(thresholds_v, layout.parts, solutions, strict=True)]
    parts = [(o, k, part) for o, row in enumerate(layout.parts) for k, part in enumerate(row)]
    return StaticFit(
        hysteresis=PrandtlIshlinskii(tuple(pairs for pairs, _ in found), tuple(known for _, known in found)),
        offsets_um=np.column_stack([read - x @ c for (read, x), c in zip(means, columns, strict=True)]),
        rms_um=np.array([solution.residual_rms for solution in solutions]),
        samples=moments[0].samples,
        bounded=tuple(
            (o, k, int(j)) for o, k, part in parts for j in np.flatnonzero(solutions[o].at_bound[part])
        ),
        open=tuple((o, k) for o, k, part in parts if free[o].dependent[part].any()),
    )


def _solve_output(
    layout: SlopeColumns, o: int, moment: Moments, ridge: float, bounds: Bounds | None = None
) -> Solution:
    merge = layout.merge[o]
    gram = merge.T @ moment.gram @ merge
    penalty = ridge_of(layout.parts[o], gram, ridge) if ridge > 0.0 else None
    cross = merge.T @ moment.cross[:, 0]
    return solve(gram, cross, float(moment.power[0]), moment.freedom, bounds=bounds, penalty=penalty)


def _differences(parts: Sequence[slice]) -> Array:
    """Matrix from the slopes to the weights of all pairs of one output."""
    sizes = [part.stop - part.start for part in parts]
    return np.asarray(block_diag(*[np.eye(n) - np.eye(n, k=-1) for n in sizes]))


def ridge_of(parts: Sequence[slice], gram: Array, ridge: float) -> Array:
    """Penalty of all weights but the first of each of ``parts``, in terms of the slopes."""
    differences = _differences(parts)
    sums = np.linalg.inv(differences)
    strength = np.full(len(gram), ridge * float(np.diag(sums.T @ gram @ sums).max()))
    strength[[part.start for part in parts if part.stop > part.start]] = 0.0
    return differences.T @ (strength[:, None] * differences)


def gains_of(
    records: Sequence[Record], thresholds_v: Thresholds, layout: SlopeColumns, slopes: Sequence[Array]
) -> Array:
    """Gain of every pair (output, input) at the amplitude of the records [um/V], from slopes an output."""
    reach = half_swing(records)
    gains = np.zeros((len(thresholds_v), len(reach)))
    for o, row in enumerate(thresholds_v):
        for k, r in enumerate(row):
            if r.size:
                weights = np.diff(slopes[o][layout.parts[o][k]], prepend=0.0)
                gains[o, k] = weights @ (reach[k] - r) / reach[k]
    return gains


def bounds_of(solver: SquaresSolver, layout: SlopeColumns, o: int, gains: Array) -> Bounds:
    """Bounds of the slopes of one output under a solver.

    ``nonnegative``: all weights of a pair have the sign of its gain. ``invertible``: the slopes of the direct
    pair keep its sign and stay away from zero.
    """
    parts = layout.parts[o]
    side, bound = np.zeros((2, parts[-1].stop))
    if solver == "nonnegative":
        for part, gain in zip(parts, gains[o], strict=True):
            side[part] = 1.0 if gain >= 0.0 else -1.0
        return Bounds(np.asarray(np.linalg.inv(_differences(parts))), side, bound)
    for output, k in direct_pairs(gains):
        if output == o:
            side[parts[k]] = 1.0 if gains[o, k] > 0.0 else -1.0
            bound[parts[k]] = LEAST_SLOPE * gains[o, k]
    return Bounds(np.eye(len(side)), side, bound)


def direct_pairs(gains: Array) -> list[tuple[int, int]]:
    """Each output with the input that drives it most, no input twice: pairs (output, input)."""
    share = np.abs(gains) / np.maximum(np.abs(gains).max(axis=1, keepdims=True), np.finfo(float).tiny)
    outputs, inputs = linear_sum_assignment(share, maximize=True)
    return list(zip(outputs.tolist(), inputs.tolist(), strict=True))


def _pairs_of(
    row: Sequence[Array], parts: Sequence[slice], slopes: Solution
) -> tuple[tuple[Pair, ...], WeightCovariance]:
    """Pairs of one output with weights and standard errors, and the covariance of all its weights.

    Parameters
    ----------
    row : thresholds of each pair [V]
    parts : slopes of each pair
    """
    differences = _differences(parts)
    weights = differences @ slopes.coefficients
    factor = triangle(differences @ slopes.spread)
    errors = np.sqrt(np.sum(factor**2, axis=1))
    pairs = (Pair(r, weights[part], errors[part]) for r, part in zip(row, parts, strict=True))
    return tuple(pairs), WeightCovariance(factor, int(slopes.at_bound.sum()))


def half_swing(records: Sequence[Record]) -> Array:
    """Largest half swing of each input (input,) [V]: thresholds above it are never engaged both ways."""
    return np.asarray(np.max([0.5 * np.ptp(record.u_v, axis=1) for record in records], axis=0))


def swing_ends(records: Sequence[Record]) -> tuple[Array, Array]:
    """Lowest and highest recorded voltage of each input (input,) [V]."""
    low: Array = np.array([r.u_v.min(axis=1) + r.rest_v for r in records]).min(axis=0)
    return low, np.array([r.u_v.max(axis=1) + r.rest_v for r in records]).max(axis=0)


def refuse_unreached(records: Sequence[Record], grids: Sequence[Array]) -> None:
    """Refuse thresholds that no record engages, and inputs that never move."""
    for name, reach, grid in zip(records[0].inputs, half_swing(records), grids, strict=True):
        if grid.size and reach <= 0.0:
            raise IdentificationError(
                f"input {name} is never driven and therefore not identifiable; add a record that drives it"
            )
        if grid.size and grid[-1] >= reach:
            raise IdentificationError(
                f"the threshold {grid[-1]:g} V of input {name} is never engaged, because its largest "
                f"half swing is {reach:g} V; remove the thresholds from there on, or record a larger "
                "amplitude"
            )


def refuse_inseparable(record: Record, layout: SlopeColumns, moments: Sequence[Moments]) -> None:
    """Refuse records in which several inputs never move independently.

    Plays of one input may depend on each other; then only single weights are undetermined. Two inputs cannot
    be separated if the spaces spanned by their plays intersect: then the least eigenvalue of their
    correlations, each input whitened by itself, is zero (canonical correlation 1).
    """
    for o, moment in enumerate(moments):
        gram = layout.merge[o].T @ moment.gram @ layout.merge[o]
        bases = [_whitened(gram[part, part]) for part in layout.parts[o]]
        columns = np.asarray(block_diag(*bases))
        owner = np.repeat(np.arange(len(bases)), [base.shape[1] for base in bases])
        values, vectors = np.linalg.eigh(columns.T @ gram @ columns)
        shared = np.abs(vectors[:, values < INSEPARABLE]).max(axis=1, initial=0.0) > SHARED
        names = [record.inputs[k] for k in np.unique(owner[shared])]
        if len(names) > 1:
            raise IdentificationError(
                f"the records cannot separate inputs {' and '.join(names)}: they never move independently; "
                "add records in which one input is driven at a time"
            )


def _whitened(gram: Array) -> Array:
    """Combinations (column, direction) of the plays of one input that are independent and of power one."""
    scale = 1.0 / not_nothing(np.sqrt(np.diag(gram)))
    values, vectors = np.linalg.eigh(scale[:, None] * gram * scale)
    kept = values > WHITENED * max(values.max(initial=0.0), np.finfo(float).tiny)
    return np.asarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))


FINE = 1000
"""Samples a node where the records have no cycle: the partition's limit for many samples."""


def input_grids(records: Sequence[Record], operators: int, partition: Partition = "time") -> list[Array]:
    """Thresholds of each input [V], up to half the largest swing in the records.

    Parameters
    ----------
    records : voltages and displacements
    operators : number of thresholds of every input
    partition : ``time``: uniform in the time of a sine of the records' slowest cycle, as in the paper;
        ``voltage``: uniform in the voltage, from 0; ``fitted``: what the fit begins with, as ``time``
    """
    grids = []
    for k, reach in enumerate(half_swing(records)):
        if reach == 0.0:
            grids.append(np.empty(0))
        elif operators == 1:
            grids.append(np.zeros(1))
        elif partition == "voltage":
            grids.append(thresholds_uniform_in_voltage(reach, operators))
        else:
            half = _samples_per_half_cycle(records, k)
            samples = half if half >= 2 * (operators + 1) else float(FINE * (operators + 1))
            grids.append(thresholds_uniform_in_time(reach, operators, samples)[0])
    return grids


def _samples_per_half_cycle(records: Sequence[Record], k: int) -> float:
    """Half the length of the slowest cycle of one input [samples]; 0 if there is none."""
    halves = [0.0]
    for record in records:
        if k in driven_inputs(record):
            cycles = [e.stop - e.start for e in find_cycles(record.u_v[k]).excursions if not e.minor]
            halves += [0.5 * float(np.median(cycles))] if cycles else []
    return max(halves)

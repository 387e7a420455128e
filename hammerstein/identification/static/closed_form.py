"""Weights of a Prandtl-Ishlinskii model from one settled loop, in closed form (paper, appendix).

The paper's procedure on measured records: one settled loop of each input, then the closed form.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from hammerstein.arrays import Array, Indices
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import Excursion, find_cycles


def thresholds_uniform_in_time(
    amplitude_v: float, operators: int, samples_per_half_cycle: float
) -> tuple[Array, Indices]:
    """Thresholds at equal time steps along the rising half of a sine, as the published ones.

        s_j = j floor(N / (n + 1)) - 1,   r_j = A / 2 (1 - cos(pi s_j / N)),   j = 1 .. n

    The rising half cycle has N samples, and s counts them from the lower tip. One node more, s_{n+1}, is the
    top of the partition: the closed form needs the output there.

    Parameters
    ----------
    amplitude_v : amplitude A of the sine [V]
    operators : number n of thresholds
    samples_per_half_cycle : N; it need not be whole

    Returns
    -------
    thresholds_v : (operator,) [V]
    nodes : (operator + 1,) samples from the lower tip

    Raises
    ------
    IdentificationError : fewer samples in a half cycle than nodes

    Examples
    --------
    The published thresholds (paper, eq. 12), found at 50 Hz with samples of 50 us:

    >>> r, nodes = thresholds_uniform_in_time(10.0, 15, 200)
    >>> [round(float(v), 2) for v in r[:4]], int(nodes[-1])
    ([0.07, 0.32, 0.74, 1.3], 191)
    """
    nodes = nodes_uniform_in_time(operators, samples_per_half_cycle)
    thresholds = 0.5 * amplitude_v * (1.0 - np.cos(np.pi * nodes[:-1] / samples_per_half_cycle))
    return thresholds, nodes


def nodes_uniform_in_time(operators: int, samples_per_half_cycle: float) -> Indices:
    """Samples (operator + 1,) of the partition from the lower tip; see ``thresholds_uniform_in_time``."""
    _refuse_count(operators)
    spacing = math.floor(samples_per_half_cycle / (operators + 1))
    if spacing < 1:
        most = math.floor(samples_per_half_cycle) - 1
        fewer = f"at most {most} operators, " if most > 0 else ""
        raise IdentificationError(
            f"the rising half of a cycle has {samples_per_half_cycle:g} samples, too few for "
            f"{operators} operators; use {fewer}a lower frequency or a "
            "higher sampling rate, or thresholds uniform in voltage"
        )
    return spacing * np.arange(1, operators + 2, dtype=np.int64) - 1


def thresholds_uniform_in_voltage(amplitude_v: float, operators: int) -> Array:
    """Thresholds at equal voltage steps from 0 to below the amplitude: r_j = (j - 1) A / n, j = 1 .. n.

    Parameters
    ----------
    amplitude_v : amplitude A of the input [V]
    operators : number n of thresholds

    Returns
    -------
    (operator,) thresholds [V]

    Examples
    --------
    >>> thresholds_uniform_in_voltage(8.0, 4)
    array([0., 2., 4., 6.])
    """
    _refuse_count(operators)
    return amplitude_v * np.arange(operators) / operators


def _refuse_count(operators: int) -> None:
    if operators < 1:
        raise IdentificationError(f"{operators} operators are not a model; use at least one")


def closed_form(
    u_cycle_v: ArrayLike,
    y_cycle_um: ArrayLike,
    operators: int = 15,
    *,
    thresholds_v: Sequence[ArrayLike] | None = None,
) -> list[Pair]:
    """Closed-form thresholds and weights from one driven input to every output.

    From the lower tip of the settled loop, the rising branch of n operators is

        y(b) = sum over i of w_i max(0, b - 2 r_i),     b = u - u_tip        (paper, eq. 14)

    so its values at n points, one between each two thresholds, give a lower triangular system for the weights
    (eq. 15-17).

    Parameters
    ----------
    u_cycle_v : (sample,) one settled cycle of the driven input [V], evenly sampled, starting anywhere, with
        one rise and one fall
    y_cycle_um : (output, sample) the outputs over the same cycle [um]
    operators : number of operators; the thresholds are then uniform in time, and the points are samples of
        the record, as in the paper
    thresholds_v : (operator,) thresholds of each output [V] instead of their number

    Returns
    -------
    one pair for each output

    Raises
    ------
    IdentificationError : too few samples for so many operators, a threshold that the loop does not reach or
        that no sample separates from the next, an input without a swing

    Examples
    --------
    >>> from hammerstein.hysteresis import PrandtlIshlinskii
    >>> u = 4.0 * np.sin(2.0 * np.pi * np.arange(200) / 100)
    >>> y, _ = PrandtlIshlinskii([[Pair([0.5, 2.0], [3.0, 1.0])]]).respond([u])
    >>> pair = closed_form(u[100:], y[:, 100:], thresholds_v=[[0.5, 2.0]])[0]
    >>> bool(np.allclose(pair.weights_um_per_v, [3.0, 1.0], atol=1e-12))
    True
    """
    u, y = rising_branch(u_cycle_v, y_cycle_um)
    if thresholds_v is None:
        nodes = nodes_uniform_in_time(operators, 0.5 * np.size(u_cycle_v))
        return [_at_nodes(u, row, nodes) for row in y]
    grids = [np.asarray(r, dtype=np.float64) for r in thresholds_v]
    return [_at_thresholds(u, row, r) for r, row in zip(grids, y, strict=True)]


def rising_branch(u_cycle_v: ArrayLike, y_cycle_um: ArrayLike) -> tuple[Array, Array]:
    """Rise of the input above its lower tip (sample,) [V] and of the outputs (output, sample) [um]."""
    u = np.asarray(u_cycle_v, dtype=np.float64)
    y = np.atleast_2d(np.asarray(y_cycle_um, dtype=np.float64))
    if u.ndim != 1 or y.shape[1:] != u.shape:
        raise IdentificationError(
            f"a cycle needs one input and outputs of its length; got shapes {u.shape} and {y.shape}"
        )
    start = int(np.argmin(u))
    u, y = np.roll(u, -start), np.roll(y, -start, axis=1)
    stop = int(np.argmax(u)) + 1
    if stop == 1:
        raise IdentificationError("the input does not move in this cycle; choose the driven input")
    return u[:stop] - u[0], y[:, :stop] - y[:, :1]


def _at_nodes(u: Array, y: Array, nodes: Indices) -> Pair:
    """Thresholds at half the rise of the input at the nodes (paper, eq. 16)."""
    if nodes[-1] >= len(u):
        raise IdentificationError(
            f"the input rises for {len(u)} samples only, but the partition needs {nodes[-1] + 1}: the "
            "cycle is not symmetric; give thresholds instead of their number"
        )
    thresholds = 0.5 * u[nodes[:-1]]
    if np.any(np.diff(u[nodes]) <= 0):
        raise IdentificationError(
            "the input does not rise steadily from its lower tip; give thresholds instead"
        )
    return _solved(thresholds, u[nodes[1:]], y[nodes[1:]])


def _at_thresholds(u: Array, y: Array, r: Array) -> Pair:
    """One sample for each threshold: the last one before the next threshold engages."""
    Pair(r, np.zeros_like(r))  # refuses thresholds that are negative or not increasing
    highest = np.maximum.accumulate(u)
    nodes = np.searchsorted(highest, np.append(2.0 * r[1:], highest[-1]), side="right") - 1
    lonely = np.flatnonzero(u[nodes] <= 2.0 * r)
    if lonely.size:
        j = int(lonely[0])
        raise IdentificationError(
            f"no sample identifies the weight of threshold {r[j]:g} V: the input must rise "
            f"{2.0 * r[j]:g} V above its lower tip, at a sample before the next threshold engages; "
            "use fewer thresholds or a larger amplitude"
        )
    return _solved(r, u[nodes], y[nodes])


def _solved(r: Array, b: Array, y: Array) -> Pair:
    matrix = np.maximum(b[:, None] - 2.0 * r, 0.0)
    return Pair(r, solve_triangular(matrix, y, lower=True))


SAME_AMPLITUDE = 0.02
"""Part of the largest swing by which the cycles of one mean may differ."""


def closed_form_model(
    records: Sequence[Record], operators: int, thresholds_v: Sequence[Sequence[Array]] | None = None
) -> PrandtlIshlinskii:
    """Static block from the settled loops of records in which one input is driven at a time.

    Steps 1 to 4 of the paper's section 3.3: the loop of each input with the largest amplitude gives the
    pairs of that input with all outputs.

    Parameters
    ----------
    records : at least one for every input in which that input alone is driven
    operators : number of operators, for thresholds uniform in time
    thresholds_v : (output, input) thresholds [V] instead

    Raises
    ------
    IdentificationError : an input is never driven alone, or over less than two cycles
    """
    columns = []
    for k, name in enumerate(records[0].inputs):
        alone = [record for record in records if driven_inputs(record) == (k,)]
        if not alone:
            raise IdentificationError(
                f"the closed form needs a record in which only input {name} is driven over whole "
                "cycles; record one, or use least squares"
            )
        u, y = mean_cycle(max(alone, key=lambda record: float(np.ptp(record.u_v[k]))), k)
        grids = None if thresholds_v is None else [row[k] for row in thresholds_v]
        columns.append(closed_form(u, y, operators, thresholds_v=grids))
    rows: list[tuple[Pair, ...]] = [tuple(column[o] for column in columns) for o in range(len(columns[0]))]
    return PrandtlIshlinskii(tuple(rows))


def mean_cycle(record: Record, k: int) -> tuple[Array, Array]:
    """Mean of the cycles of largest swing: input (sample,) [V] and outputs (output, sample) [um].

    A cycle runs from tip to tip, so that what was before the first tip is forgotten in it.
    """
    u, y = record.u_v[k], record.y_um
    cycles = [e for e in find_cycles(u).excursions if not e.minor]
    if not cycles:
        raise IdentificationError(
            f"{record.source}: the closed form needs a whole cycle of {record.inputs[k]}"
        )
    swing = max(_swing(u, e) for e in cycles)
    alike = [e for e in cycles if _swing(u, e) >= (1.0 - SAME_AMPLITUDE) * swing]
    length = round(float(np.median([e.stop - e.start for e in alike])))
    phase = np.arange(length) / length
    stacks = [_resampled(np.vstack([u, y]), e, phase) for e in alike]
    turned = [np.roll(stack, -int(np.argmin(stack[0])), axis=1) for stack in stacks]
    mean = np.mean(turned, axis=0)
    return mean[0], mean[1:]


def _swing(u: Array, cycle: Excursion) -> float:
    return float(np.ptp(u[cycle.start : cycle.stop + 1]))


def _resampled(signals: Array, cycle: Excursion, phase: Array) -> Array:
    samples = cycle.start + phase * (cycle.stop - cycle.start)
    return np.array([np.interp(samples, np.arange(len(row)), row) for row in signals])

"""Invertibility of multivariable models, tested before a run."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Indices
from hammerstein.blocks import require_square
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    DeadZones,
    Generalised,
    Hysteresis,
    Pair,
    PrandtlIshlinskii,
    RateDependent,
    Sloped,
    slopes_of,
)
from hammerstein.hysteresis.rate_dependent import worst_shares
from hammerstein.quantities import number_of

LARGEST_NUMBER = 2_000_000
"""Most combinations of slopes in memory: 16 MB per pair."""


def slope_matrices(hysteresis: Hysteresis[Any], amplitude_v: float) -> Array:
    """All slope matrices J (combination, output, input) [um/V].

    Column k is a slope of all outputs while input k moves; every combination of columns can occur.

    amplitude_v : of the loops along which slopes are taken, for a kind that does not know all of its own [V]

    Raises SimulationError where there are too many to examine.
    """
    return every_matrix([slopes_of(hysteresis, k, amplitude_v) for k in range(hysteresis.n_inputs)])


def outermost(columns: Array) -> Array:
    """Columns (choice, row) on the convex hull; all if the hull has no volume."""
    if columns.shape[1] == 1:
        return np.unique([columns.min(axis=0), columns.max(axis=0)], axis=0)
    from scipy.spatial import ConvexHull, QhullError

    found = np.unique(columns, axis=0)
    if len(found) <= columns.shape[1] + 1:
        return found
    try:
        return np.asarray(found[ConvexHull(found).vertices])
    except QhullError:
        return found


def every_matrix(columns: Sequence[Array]) -> Array:
    """Every matrix (combination, row, input) with one of the columns (choice, row) of each input."""
    if any(len(column) == 0 for column in columns):
        raise SimulationError("An input moves no output, so the model has no inverse.")
    number = int(np.prod([len(column) for column in columns], dtype=float))
    if number > LARGEST_NUMBER:
        raise SimulationError(
            f"The model has {number} slope matrices, too many to examine; use fewer operators."
        )
    indices = np.array(list(itertools.product(*(range(len(column)) for column in columns))))
    return np.stack([column[i] for column, i in zip(columns, indices.T, strict=True)], axis=2)


SINGULAR = 1e-9
"""Determinant, in parts of the product of the columns, that is zero within rounding of the weights."""


@dataclass(frozen=True, eq=False)
class Invertibility:
    """Signs of the slope determinants of a model over all combinations of engaged operators.

    positive, negative, singular : number of combinations with a determinant of that sign, or near zero
    engaged : engaged operators of each input where the sign first differs; empty if it does not
    thresholds_v : largest threshold engaged there, by input [V]
    slopes_um_per_v : slope matrix there (output, input) [um/V]
    jump_v : (input,) jump of the drive at a reversal, twice the smallest threshold [V]
    inputs : names of the inputs; numbers if not given
    zones_v : voltages between two breakpoints of the dead-zones there, by input [V]; empty without any
    unproven : why nothing is known of the signs, where they were not counted; empty where they were
    """

    positive: int
    negative: int
    singular: int
    engaged: tuple[int, ...]
    thresholds_v: tuple[float, ...]
    slopes_um_per_v: Array
    jump_v: Array
    inputs: tuple[str, ...] = ()
    zones_v: tuple[tuple[float, float], ...] = ()
    unproven: str = ""

    def _name(self, k: int) -> str:
        return f"input {self.inputs[k] if self.inputs else k + 1}"

    def _between(self, k: int) -> str:
        return " between {:.4g} and {:.4g} V".format(*self.zones_v[k]) if self.zones_v else ""

    @property
    def invertible(self) -> bool:
        """True if every reference within the range has exactly one drive."""
        return not self.unproven and self.singular == 0 and min(self.positive, self.negative) == 0

    def statement(self) -> str:
        """State whether there is an inverse, and otherwise where it fails, in one sentence."""
        total = self.positive + self.negative + self.singular
        if self.invertible:
            jumps = ", ".join(f"{jump:.3g} V on {self._name(k)}" for k, jump in enumerate(self.jump_v))
            many = f"the determinants of its {total} slope matrices have the same sign."
            proof = many if total > 1 else "its only slope matrix is not singular."
            turns = f" At turning points of an input, its drive jumps: {jumps}." if self.jump_v.any() else ""
            return f"The model has an inverse for every reference: {proof}{turns}"
        if self.unproven:
            return f"It is not proven that the model has an inverse: {self.unproven}."
        counts = ((min(self.positive, self.negative), "of the other sign"), (self.singular, "zero"))
        flaws = [f"{n} {'is' if n == 1 else 'are'} {what}" for n, what in counts if n]
        places = "; ".join(
            f"{self._name(k)} with {number_of(n, 'moving operator')} (thresholds up to {r:.4g} V)"
            + self._between(k)
            for k, (n, r) in enumerate(zip(self.engaged, self.thresholds_v, strict=True))
        )
        first = f"first at {places}" if places else "for example"
        slopes = "; ".join(", ".join(f"{slope:.4g}" for slope in row) for row in self.slopes_um_per_v)
        return (
            f"The model has no inverse: of the determinants of its {total} slope matrices, "
            f"{' and '.join(flaws)}, {first}: [{slopes}] um/V."
        )


@singledispatch
def invertibility(
    hysteresis: Hysteresis[Any], range_v: ArrayLike = math.inf, amplitude_v: float | None = None
) -> Invertibility:
    """Examine every slope matrix that can occur for a drive within a range.

    Gamma(U) = Y has one solution for every Y if the determinants of all slope matrices J have one sign, for
    on a monotone piece the model is separable and piecewise affine (Fujisawa and Kuh 1972). Column k of J
    is the sum of the first 1, 2, ... weights of input k, and of those of its dead-zones below the voltage. A
    model with more inputs than outputs is first completed to a square one (see ``completed``).

    Parameters
    ----------
    hysteresis : m inputs, p <= m outputs
    range_v : farthest from the working point that the drive can go [V], for all inputs or each of them (m,),
        or lowest and highest voltage counted from it (2, m); operators with larger thresholds never move
    amplitude_v : amplitude for the gain matrix of a model with more inputs than outputs [V]

    For a kind that has slopes but no rule of its own, the slopes at the ends decide, because a determinant is
    linear in each column.

    Raises
    ------
    InputError : a kind without this ability, more outputs than inputs, an input that moves no output, or one
        that the range cannot move
    SimulationError : too many slope matrices to examine

    Examples
    --------
    >>> invertibility(PrandtlIshlinskii([[Pair([0.0, 1.0], [2.0, -3.0])]])).invertible
    False
    """
    if not isinstance(hysteresis, Sloped):
        raise InputError("inverse", f"hysteresis of kind {hysteresis.kind!r} has no test of invertibility")
    m, p = hysteresis.n_inputs, hysteresis.n_outputs
    require_square(m, p, "exact_inverse")
    slopes = every_matrix([outermost(hysteresis.slope_columns(k)) for k in range(m)])
    counts, first = _counted_signs(slopes)
    return Invertibility(*counts, (), (), slopes[first], np.zeros(m))


@invertibility.register(PrandtlIshlinskii)
@invertibility.register(Asymmetric)
def _(
    hysteresis: PrandtlIshlinskii | Asymmetric,
    range_v: ArrayLike = math.inf,
    amplitude_v: float | None = None,
) -> Invertibility:
    given = np.asarray(range_v, dtype=np.float64)
    low, high = given if given.ndim == 2 else (-given, given)
    low, high = (np.broadcast_to(end, hysteresis.n_inputs) for end in (low, high))
    farthest = np.maximum(np.abs(low), np.abs(high))
    square, smallest = completed(hysteresis, amplitude_v or _usual_amplitude(hysteresis, farthest.max()))
    if (smallest >= farthest).any():
        k = int(np.argmax(smallest - farthest))
        message = (
            f"of input {k + 1}, {smallest[k]:g} V, is beyond the range of {farthest[k]:g} V: nothing moves"
        )
        raise InputError("smallest threshold", message)
    ends = zip(np.minimum(low + smallest, 0.0), np.maximum(high - smallest, 0.0), strict=True)
    reached = [_reachable(square, k, *each) for k, each in enumerate(ends)]
    columns = [choices.slopes for choices in reached]
    dominant = _dominant_sign(columns)
    if dominant:
        number = math.prod(len(column) for column in columns)
        counts = (number, 0) if dominant > 0 else (0, number)
        slopes = _mean_slopes(columns)[: hysteresis.n_outputs]
        return Invertibility(*counts, 0, (), (), slopes, 2.0 * smallest)
    return _enumerated(square, reached, smallest, hysteresis.n_outputs)


@invertibility.register
def _(
    hysteresis: RateDependent, range_v: ArrayLike = math.inf, amplitude_v: float | None = None
) -> Invertibility:
    """Any set of plays may move together while thresholds change, so every sum of their weights counts.

    There is an inverse if each column, multiplied by the inverse of the mean slopes, is diagonally dominant
    for every combination of its plays.
    """
    m = hysteresis.n_inputs
    require_square(m, hysteresis.n_outputs, "exact_inverse")
    weights = hysteresis.bank.w.copy()  # (input, play, output)
    first = np.array([[w[0] for w in row] for row in hysteresis.weights_um_per_v])
    always = all(plays.thresholds_v[0] == 0.0 == plays.growth_s[0] for plays in hysteresis.inputs)
    mean = 0.5 * (first + weights.sum(axis=1).T)
    number = math.prod(2 ** (int(n) - 1) for n in hysteresis.bank.n)
    return Invertibility(
        number, 0, 0, (), (), mean, np.zeros(m), unproven=_why_unproven(weights, mean, always=always)
    )


def _why_unproven(weights: Array, mean: Array, *, always: bool) -> str:
    """Why plays that move in any combination may leave no inverse; empty where they cannot.

    weights : (input, play, output) [um/V]; mean : slopes (output, input); always : whether the first
        play of each input moves with it at all times
    """
    if not always:
        return "there is no play without a threshold, so an input may move nothing"
    if abs(np.linalg.det(mean)) <= SINGULAR * np.prod(np.linalg.norm(mean, axis=0)):
        return "the mean slopes are singular"
    for k, own_weights in enumerate(weights):
        shares = np.linalg.solve(mean, own_weights.T)
        others = np.delete(shares, k, axis=0)
        least, most = worst_shares(shares[k], others)
        if least <= most + SINGULAR:
            beside = f", and moves the others by up to {most:.3g} of theirs" if len(others) else ""
            return (
                f"while thresholds change with the rate, the plays of input {k + 1} move in any "
                f"combination; in the worst case, it keeps {least:.3g} of its own mean slope{beside}"
            )
    return ""


@invertibility.register
def _(hysteresis: BoucWen, range_v: ArrayLike = math.inf, amplitude_v: float | None = None) -> Invertibility:
    """A determinant is linear in each slope: it keeps its sign if it does at all ends of the slopes."""
    m = hysteresis.n_inputs
    require_square(m, hysteresis.n_outputs, "inverse")
    slopes = slope_matrices(hysteresis, 1.0)
    counts, first = _counted_signs(slopes)
    return Invertibility(*counts, (), (), slopes[first], np.zeros(m))


@invertibility.register
def _(
    hysteresis: Generalised, range_v: ArrayLike = math.inf, amplitude_v: float | None = None
) -> Invertibility:
    """That of the plays, for envelopes have inverses."""
    given = np.asarray(range_v, dtype=np.float64)
    low, high = given if given.ndim == 2 else (-given, given)
    ends = np.stack([np.broadcast_to(end, hysteresis.n_inputs) for end in (low, high)], axis=1)
    found = invertibility(hysteresis.plays, hysteresis.inner(ends).T, amplitude_v)
    least = np.array([one.all_slopes.min() for one in hysteresis.envelopes])
    return replace(found, jump_v=found.jump_v / least)


class _Reachable(NamedTuple):
    """Slopes (choice, row) that one input can have, with its engaged operators and zone (choice,)."""

    slopes: Array
    engaged: Indices
    zone: Indices


def _reachable(square: Asymmetric, k: int, low: float, high: float) -> _Reachable:
    """Every number of engaged operators in every zone where a drive from low to high can bring them about.

    After a reversal at low, operator j engages 2 r_j above it, and r_j above the working point where the
    actuator was at rest before; so it is downwards from high.
    """
    bank, lines = square.plays.bank, square.lines
    r = bank.r[k, : bank.n[k]]
    tops = lines.ends[k, : lines.n[k] + 1]
    bottoms = np.concatenate([[-np.inf], tops[:-1]])
    rises, falls = np.minimum(low + 2.0 * r, r), np.maximum(high - 2.0 * r, -r)
    up = np.maximum(bottoms[:, None], rises) < np.minimum(tops, high)[:, None]
    down = np.minimum(tops[:, None], falls) > np.maximum(bottoms, low)[:, None]
    zone, engaged = np.nonzero(up | down)
    slopes = lines.slope[k, zone] + bank.slope[k, engaged + 1]
    return _Reachable(slopes, (engaged + 1).astype(np.int64), zone.astype(np.int64))


def _mean_slopes(columns: Sequence[Array]) -> Array:
    """Mean over the slopes that each input can have (row, input) [um/V]."""
    return np.stack([column.mean(axis=0) for column in columns], axis=1)


def _dominant_sign(columns: Sequence[Array]) -> int:
    """Sign of all determinants where every slope stays close enough to its mean to tell at once, else 0.

    With J_0 the mean, the columns of J_0^-1 J are then dominated by their diagonal, which is positive.
    """
    if not all(len(column) for column in columns):
        return 0
    mean = _mean_slopes(columns)
    determinant = float(np.linalg.det(mean))
    if abs(determinant) <= SINGULAR * float(np.prod(np.linalg.norm(mean, axis=0))):
        return 0
    for k, column in enumerate(columns):
        scaled = np.linalg.solve(mean, column.T)
        others = np.abs(scaled).sum(axis=0) - np.abs(scaled[k])
        if (scaled[k] <= others + SINGULAR).any():
            return 0
    return 1 if determinant > 0.0 else -1


def _enumerated(
    square: Asymmetric, reached: Sequence[_Reachable], smallest_v: Array, n_outputs: int
) -> Invertibility:
    """Examine all determinants one by one."""
    slopes = every_matrix([choices.slopes for choices in reached])
    counts, first = _counted_signs(slopes)
    engaged: tuple[int, ...] = ()
    zones: list[tuple[float, float]] = []
    if min(counts[:2]) or counts[2]:
        choice = np.unravel_index(first, [len(choices.engaged) for choices in reached])
        engaged = tuple(int(one.engaged[i]) for one, i in zip(reached, choice, strict=True))
        if square.lines.n.any():
            zones = [_ends_v(square, k, int(one.zone[choice[k]])) for k, one in enumerate(reached)]
    thresholds = tuple(float(square.plays.bank.r[k, n - 1] + smallest_v[k]) for k, n in enumerate(engaged))
    place = (engaged, thresholds, slopes[first, :n_outputs])
    return Invertibility(*counts, *place, 2.0 * smallest_v, zones_v=tuple(zones))


def _counted_signs(slopes: Array) -> tuple[tuple[int, int, int], int]:
    """Number of positive, negative and singular matrices, and the first whose sign is not that of most."""
    determinants = np.linalg.det(slopes)
    size = np.prod(np.linalg.norm(slopes, axis=1), axis=1)
    sign = np.where(np.abs(determinants) <= SINGULAR * size, 0, np.sign(determinants)).astype(int)
    positive, negative, singular = (int((sign == value).sum()) for value in (1, -1, 0))
    return (positive, negative, singular), int(np.argmax(sign != (1 if positive >= negative else -1)))


def _ends_v(square: Asymmetric, k: int, zone: int) -> tuple[float, float]:
    """Where a zone of input k begins and ends, as voltages are sent [V]."""
    tops, rest = square.lines.ends[k], float(np.asarray(square.working_point_v)[k])
    return (float(tops[zone - 1]) + rest if zone else -math.inf), float(tops[zone]) + rest


def completed(hysteresis: PrandtlIshlinskii | Asymmetric, amplitude_v: float) -> tuple[Asymmetric, Array]:
    """Make the model square, with smallest thresholds of zero, for the exact inverse.

    The smallest threshold of each input is subtracted from all of its thresholds; dead-zones act after it
    anyway. A model with m > p inputs gets m - p additional rows ``M q = 0``. M spans the null space of the
    gain matrix G of the settled loops, so that of all drives with the same displacement, the smallest
    remains. A classical model has no dead-zones.

    Returns
    -------
    square : the model with m rows
    smallest_v : (input,) the thresholds taken off [V]
    """
    m, p = hysteresis.n_inputs, hysteresis.n_outputs
    if p > m:
        raise InputError(
            "exact_inverse",
            f"the model has {m} inputs for {p} outputs: {m} voltages cannot control {p} positions "
            "independently; remove outputs or add inputs",
        )
    model = hysteresis
    if isinstance(model, PrandtlIshlinskii):
        model = Asymmetric(model, ((DeadZones.absent(),) * m,) * p)
    pairs, zones = list(model.plays.pairs), list(model.zones)
    for k in range(m):
        if any(len(row[k].thresholds_v) for row in pairs):
            continue
        if not any(len(row[k].breakpoints_v) for row in zones):
            raise InputError("exact_inverse", f"input {k + 1} moves no output: the model has no inverse")
        pairs[0] = (*pairs[0][:k], Pair.linear(0.0), *pairs[0][k + 1 :])
    smallest = model.smallest_v
    rows = [
        tuple(Pair(pair.thresholds_v - smallest[k], pair.weights_um_per_v) for k, pair in enumerate(row))
        for row in pairs
    ]
    if m > p:
        gain = hysteresis.gain(amplitude_v)
        scale = float(np.abs(gain).max())
        for direction in np.linalg.svd(gain)[2][p:]:
            rows.append(tuple(Pair.linear(scale * share) for share in direction.tolist()))
            zones.append((DeadZones.absent(),) * m)
    return Asymmetric(PrandtlIshlinskii(tuple(rows)), tuple(zones), model.working_point_v), smallest


def require_inverse(found: Invertibility, law: str, run_anyway: bool) -> None:
    """Raise SimulationError with the reason unless there is an inverse or the caller insists."""
    if not (found.invertible or run_anyway):
        raise SimulationError(
            f"{found.statement()} {law} needs the same sign for all. Identify another hysteresis, such as "
            "prandtl_ishlinskii with solver = invertible. If it is a phase lag that was identified as "
            "hysteresis, identify with dynamics or at a lower frequency. Or set run_anyway = true."
        )


def _usual_amplitude(hysteresis: PrandtlIshlinskii | Asymmetric, range_v: float) -> float:
    """Drive range, or where there is none, twice the largest threshold [V]."""
    if math.isfinite(range_v):
        return range_v
    bank = hysteresis.bank if isinstance(hysteresis, PrandtlIshlinskii) else hysteresis.plays.bank
    largest = max((float(bank.r[k, n - 1]) for k, n in enumerate(bank.n) if n), default=0.0)
    return 2.0 * largest or 1.0

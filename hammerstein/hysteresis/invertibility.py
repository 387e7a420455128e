"""Whether a multivariable Prandtl-Ishlinskii model has an inverse, told before a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.blocks import Array
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Hysteresis, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.slopes import slope_matrices

SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class Invertibility:
    """Signs of the slope determinants of a model over all combinations of engaged operators.

    positive, negative, singular : number of combinations with a determinant of that sign, or near zero
    engaged : engaged operators of each input where the sign first differs; empty if it does not
    thresholds_v : largest threshold engaged there, by input [V]
    slopes_um_per_v : slope matrix there (output, input) [um/V]
    jump_v : (input,) jump of the drive at a reversal, twice the smallest threshold [V]
    inputs : names of the inputs; numbers if not given
    """

    positive: int
    negative: int
    singular: int
    engaged: tuple[int, ...]
    thresholds_v: tuple[float, ...]
    slopes_um_per_v: Array
    jump_v: Array
    inputs: tuple[str, ...] = ()

    def _name(self, k: int) -> str:
        return f"input {self.inputs[k] if self.inputs else k + 1}"

    @property
    def invertible(self) -> bool:
        """True if every reference within the range has exactly one drive."""
        return self.singular == 0 and min(self.positive, self.negative) == 0

    def statement(self) -> str:
        """Say in a sentence whether there is an inverse, and if not, where it fails."""
        total = self.positive + self.negative + self.singular
        if self.invertible:
            jumps = ", ".join(f"{jump:.3g} V on {self._name(k)}" for k, jump in enumerate(self.jump_v))
            return (
                f"The model has an inverse for every reference: the determinants of its {total} slope "
                "matrices have one sign."
            ) + (f" Where an input turns, its drive jumps: {jumps}." if self.jump_v.any() else "")
        other = min(self.positive, self.negative)
        places = "; ".join(
            f"{self._name(k)} with {n} operators engaged (thresholds to {r:.4g} V)"
            for k, (n, r) in enumerate(zip(self.engaged, self.thresholds_v, strict=True))
        )
        slopes = np.array2string(self.slopes_um_per_v, precision=4, separator=", ").replace("\n", "")
        return (
            f"The model has no inverse: of its {total} slope matrices {other} have a determinant of the "
            f"other sign and {self.singular} are singular, first at {places}: {slopes} um/V."
        )


@singledispatch
def invertibility(
    hysteresis: Hysteresis[Any], range_v: ArrayLike = math.inf, amplitude_v: float | None = None
) -> Invertibility:
    """Examine every slope matrix that a drive within a range can bring about.

    Gamma(U) = Y has one solution for every Y if the determinants of all slope matrices J have one sign, for
    on a monotone stretch the model is separable and piecewise affine (Fujisawa and Kuh 1972). Column k of J
    is the sum of the first 1, 2, ... weights of input k. A model with more inputs than outputs is first
    completed to a square one (see ``completed``).

    Parameters
    ----------
    hysteresis : m inputs, p <= m outputs
    range_v : farthest from the working point that the drive can go [V], for all inputs or each of them (m,);
        operators with larger thresholds never move
    amplitude_v : amplitude for the gain matrix of a model with more inputs than outputs [V]

    Raises
    ------
    InputError : a kind that cannot tell, more outputs than inputs, an input that moves no output, or one
        that the range cannot move
    SimulationError : too many slope matrices to examine

    Examples
    --------
    >>> invertibility(PrandtlIshlinskii([[Pair([0.0, 1.0], [2.0, -3.0])]])).invertible
    False
    """
    raise InputError("inverse", f"hysteresis of kind {hysteresis.kind!r} does not tell whether it has one")


@invertibility.register
def _(
    hysteresis: PrandtlIshlinskii, range_v: ArrayLike = math.inf, amplitude_v: float | None = None
) -> Invertibility:
    farthest = np.broadcast_to(np.asarray(range_v, dtype=np.float64), hysteresis.n_inputs)
    square, smallest = completed(hysteresis, amplitude_v or _usual_amplitude(hysteresis, farthest.max()))
    if (smallest >= farthest).any():
        k = int(np.argmax(smallest - farthest))
        message = (
            f"of input {k + 1}, {smallest[k]:g} V, is beyond the range of {farthest[k]:g} V: nothing moves"
        )
        raise InputError("smallest threshold", message)
    reached = _within(square, farthest - smallest)
    dominant = _dominant_sign(reached)
    if dominant:
        number = math.prod(int(n) for n in reached.bank.n)
        counts = (number, 0) if dominant > 0 else (0, number)
        return Invertibility(
            *counts, 0, (), (), _mean_slopes(reached)[: hysteresis.n_outputs], 2.0 * smallest
        )
    return _enumerated(reached, smallest, hysteresis.n_outputs)


def _mean_slopes(square: PrandtlIshlinskii) -> Array:
    """Mean over the slopes that each input can have (row, input) [um/V]."""
    return np.stack([square.slope_columns(k).mean(axis=0) for k in range(square.n_inputs)], axis=1)


def _dominant_sign(square: PrandtlIshlinskii) -> int:
    """Sign of all determinants where every slope stays close enough to its mean to tell at once, else 0.

    With J_0 the mean, the columns of J_0^-1 J are then dominated by their diagonal, which is positive.
    """
    if not square.bank.n.all():
        return 0
    mean = _mean_slopes(square)
    determinant = float(np.linalg.det(mean))
    if abs(determinant) <= SINGULAR * float(np.prod(np.linalg.norm(mean, axis=0))):
        return 0
    for k in range(square.n_inputs):
        scaled = np.linalg.solve(mean, square.slope_columns(k).T)
        others = np.abs(scaled).sum(axis=0) - np.abs(scaled[k])
        if (scaled[k] <= others + SINGULAR).any():
            return 0
    return 1 if determinant > 0.0 else -1


def _enumerated(square: PrandtlIshlinskii, smallest_v: Array, n_outputs: int) -> Invertibility:
    """Examine all determinants one by one."""
    slopes = slope_matrices(square, math.inf)
    determinants = np.linalg.det(slopes)
    size = np.prod(np.linalg.norm(slopes, axis=1), axis=1)
    sign = np.where(np.abs(determinants) <= SINGULAR * size, 0, np.sign(determinants)).astype(int)
    positive, negative, singular = (int((sign == value).sum()) for value in (1, -1, 0))
    first = int(np.argmax(sign != (1 if positive >= negative else -1)))
    engaged: tuple[int, ...] = ()
    if min(positive, negative) or singular:
        counts = tuple(int(n) for n in square.bank.n)
        engaged = tuple(int(i) + 1 for i in np.unravel_index(first, counts))
    thresholds = tuple(float(square.bank.r[k, n - 1] + smallest_v[k]) for k, n in enumerate(engaged))
    return Invertibility(
        positive, negative, singular, engaged, thresholds, slopes[first, :n_outputs], 2.0 * smallest_v
    )


def completed(hysteresis: PrandtlIshlinskii, amplitude_v: float) -> tuple[PrandtlIshlinskii, Array]:
    """Make the model square and its smallest thresholds zero, as the exact inverse wants it.

    The smallest threshold of each input is taken off all of its thresholds. A model with m > p inputs gets
    m - p rows ``M q = 0`` more, M spanning what the gain matrix G of the settled loops maps to zero: of all
    drives that G maps to the same displacement they leave the shortest.

    Returns
    -------
    square : the model with m rows
    smallest_v : (input,) the thresholds taken off [V]
    """
    m, p = hysteresis.n_inputs, hysteresis.n_outputs
    if p > m:
        raise InputError(
            "exact_inverse",
            f"the model has {m} inputs for {p} outputs: {m} voltages cannot hold {p} positions at will; "
            "leave out outputs or add inputs",
        )
    idle = [k + 1 for k in range(m) if all(len(row[k].thresholds_v) == 0 for row in hysteresis.pairs)]
    if idle:
        raise InputError("exact_inverse", f"input {idle[0]} moves no output: the model has no inverse")
    smallest = np.array([hysteresis.bank.r[k, 0] for k in range(m)])
    rows = [
        tuple(Pair(pair.thresholds_v - smallest[k], pair.weights_um_per_v) for k, pair in enumerate(row))
        for row in hysteresis.pairs
    ]
    if m > p:
        gain = hysteresis.gain(amplitude_v)
        scale = float(np.abs(gain).max())
        for direction in np.linalg.svd(gain)[2][p:]:
            rows.append(tuple(Pair.linear(scale * share) for share in direction.tolist()))
    return PrandtlIshlinskii(tuple(rows)), smallest


def require_inverse(found: Invertibility, law: str, run_anyway: bool) -> None:
    """Raise SimulationError with the reason unless there is an inverse or the caller insists."""
    if not (found.invertible or run_anyway):
        raise SimulationError(
            f"{found.statement()} {law} needs one sign. Phase lag identified as hysteresis does this: "
            "identify at a lower frequency, through the linear block, or with bounded partial sums; or set "
            "run_anyway = true."
        )


def _within(square: PrandtlIshlinskii, bound_v: Array) -> PrandtlIshlinskii:
    """Leave the operators out that no drive within the bounds moves."""
    rows = []
    for row in square.pairs:
        pairs = []
        for k, pair in enumerate(row):
            moves = pair.thresholds_v < bound_v[k]
            pairs.append(Pair(pair.thresholds_v[moves], pair.weights_um_per_v[moves]))
        rows.append(tuple(pairs))
    return PrandtlIshlinskii(tuple(rows))


def _usual_amplitude(hysteresis: PrandtlIshlinskii, range_v: float) -> float:
    """Drive range, or where there is none, twice the largest threshold [V]."""
    if math.isfinite(range_v):
        return range_v
    bank = hysteresis.bank
    largest = max((float(bank.r[k, n - 1]) for k, n in enumerate(bank.n) if n), default=0.0)
    return 2.0 * largest or 1.0

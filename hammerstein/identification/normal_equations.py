"""Linear least squares on long records: moments summed block by block, then small dense problems.

The sums are exact enough for a recovery to 1e-8 because the regressors are chosen well: differences of
neighbouring plays have a condition number near 20 where the plays themselves have 10^3 and more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from hammerstein.errors import IdentificationError

Array = NDArray[np.float64]

DEPENDENT = 1e-10
"""Eigenvalue of the scaled Gram matrix, relative to the largest, under which columns depend on each other."""
SERIAL_PRODUCT = 250_000
"""Multiplications that BLAS does on one core. Waiting for a second, busy core costs more than it brings."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Second moments of regressors and outputs about their means in each record.

    Parameters
    ----------
    gram : (column, column) regressors with each other
    cross : (column, output) regressors with outputs
    power : (output,) outputs with themselves
    samples : how many samples were summed
    means : (record, column + output) means in each record, regressors first
    """

    gram: Array
    cross: Array
    power: Array
    samples: int
    means: Array

    @property
    def freedom(self) -> int:
        """Samples less one for the offset of each record."""
        return self.samples - len(self.means)

    def of_output(self, o: int) -> Moments:
        """Give the moments of one output alone."""
        columns = len(self.gram)
        means = self.means[:, [*range(columns), columns + o]]
        return Moments(self.gram, self.cross[:, [o]], self.power[[o]], self.samples, means)


def moments_of(blocks: Iterable[tuple[Array, Array]], columns: int, outputs: int) -> Moments:
    """Moments of one record from blocks (column, sample) and (output, sample)."""
    k = columns + outputs
    chunk = max(16, SERIAL_PRODUCT // (k + 1) ** 2)
    total = np.zeros((k + 1, k + 1))
    reference: Array | None = None
    for x, y in blocks:
        rows = np.vstack([x, y, np.ones((1, x.shape[1]))])
        if reference is None:
            reference = rows[:k, :1].copy()
        rows[:k] -= reference  # sums of large numbers would lose what their differences tell
        for part in range(0, rows.shape[1], chunk):
            piece = rows[:, part : part + chunk]
            total += piece @ piece.T
    if reference is None:
        raise IdentificationError("no sample of the record can be used")
    samples = total[k, k]
    mean = total[:k, k] / samples
    centred = total[:k, :k] - samples * np.outer(mean, mean)
    return Moments(
        gram=centred[:columns, :columns],
        cross=centred[:columns, columns:],
        power=np.diag(centred)[columns:].copy(),
        samples=int(samples),
        means=(mean + reference[:, 0])[None, :],
    )


def pooled(parts: Sequence[Moments]) -> Moments:
    """Moments of several records together, each about its own mean."""
    return Moments(
        gram=np.sum([m.gram for m in parts], axis=0),
        cross=np.sum([m.cross for m in parts], axis=0),
        power=np.sum([m.power for m in parts], axis=0),
        samples=sum(m.samples for m in parts),
        means=np.vstack([m.means for m in parts]),
    )


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients of one least-squares problem.

    Parameters
    ----------
    coefficients : (column,) estimates
    covariance : (column, column) of the estimates, for independent errors; nothing from unknowns at a bound
    residual_rms : rms of what is left, in the unit of the output
    at_bound : (unknown,) whether the unknown stands on its bound
    dependent : (column,) whether the column takes part in a combination that the data leave open; such
        combinations are set to zero
    """

    coefficients: Array
    covariance: Array
    residual_rms: float
    at_bound: NDArray[np.bool_]
    dependent: NDArray[np.bool_]


class Bounds(NamedTuple):
    """Bounds of the unknowns x that make up the coefficients c = basis x."""

    basis: Array
    lower: Array
    upper: Array


def solve(
    gram: Array,
    cross: Array,
    power: float,
    freedom: int,
    *,
    bounds: Bounds | None = None,
    penalty: Array | None = None,
) -> Solution:
    """Minimise power - 2 cross.c + c.gram.c + c.penalty.c, between bounds if they are given.

    Parameters
    ----------
    gram, cross, power : moments of one output
    freedom : samples less offsets
    bounds : unknowns and their bounds; the coefficients are free if not given
    penalty : (column, column) quadratic penalty, such as a ridge
    """
    matrix = gram if penalty is None else gram + penalty
    norm = np.sqrt(np.diag(matrix))
    scale = 1.0 / np.where(norm > 0.0, norm, 1.0)
    values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
    kept = values > DEPENDENT * max(values[-1], np.finfo(float).tiny)
    roots, directions = np.sqrt(values[kept]), vectors[:, kept]
    target = directions.T @ (scale * cross) / roots
    if bounds is None:
        basis, free = np.diag(scale), np.ones(len(scale), dtype=np.bool_)
        x = directions @ (target / roots)
        root = roots[:, None] * directions.T
    else:
        root = (roots[:, None] * directions.T / scale) @ bounds.basis
        size = 1.0 / np.maximum(np.linalg.norm(root, axis=0), np.finfo(float).tiny)
        basis, root = bounds.basis * size, root * size
        limits = bounds.lower / size, bounds.upper / size
        found = lsq_linear(root, target, limits, method="bvls", tol=1e-14, max_iter=50 * len(size))
        x, free = found.x, found.active_mask == 0
    coefficients = basis @ x
    rest = max(power - 2.0 * cross @ coefficients + coefficients @ gram @ coefficients, 0.0)
    spread = np.linalg.pinv(root[:, free]) if free.any() else np.zeros((0, len(root)))
    spread = basis[:, free] @ spread
    return Solution(
        coefficients=coefficients,
        covariance=rest / max(freedom - int(free.sum()), 1) * (spread @ spread.T),
        residual_rms=float(np.sqrt(rest / max(freedom, 1))),
        at_bound=~free,
        dependent=np.any(np.abs(vectors[:, ~kept]) > 1e-3, axis=1),
    )

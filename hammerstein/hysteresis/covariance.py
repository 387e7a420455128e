"""Covariances as the triangles that draws need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis.pair import WeightCovariance


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
    """Refuse covariances that are not those of so many weights (output, input)."""
    sizes = [sum(row) for row in operators]
    if weights is not None and [w.factor_um_per_v.shape for w in weights] != [(n, n) for n in sizes]:
        raise InputError("weight_covariance", f"must have one factor an output, of {sizes} rows")

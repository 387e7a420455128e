"""How sure fitted thresholds are, and what follows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array, ByValue, freeze_fields, frozen
from hammerstein.errors import InputError
from hammerstein.hysteresis.pair import WeightCovariance


@dataclass(frozen=True, eq=False)
class ThresholdCovariance(ByValue):
    """How the errors of fitted thresholds, which all outputs share, hang together, and what follows them.

        r + d,   w + M d + (what the weights err by with given thresholds),   cov d = L L^T

    factor_v : (threshold, threshold) lower triangle L [V]; input after input
    following_um_per_v2 : (output,) matrices M (weight, threshold) [um/V^2]
    open : thresholds, counted from 0 over all inputs, whose place the records leave open; they are held
    """

    factor_v: Array
    following_um_per_v2: tuple[Array, ...]
    open: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        freeze_fields(self, "factor_v")
        object.__setattr__(self, "following_um_per_v2", tuple(map(frozen, self.following_um_per_v2)))
        if not all(np.isfinite(matrix).all() for matrix in (self.factor_v, *self.following_um_per_v2)):
            raise InputError("threshold_covariance", "holds a value that is not finite")

    @property
    def errors_v(self) -> Array:
        """Standard errors (threshold,) [V]; zero for those that are held."""
        return np.asarray(np.sqrt(np.sum(self.factor_v**2, axis=1)))


def triangle(spread: Array) -> Array:
    """Lower triangle L (n, n) with L L^T = S S^T for a matrix S (n, k), its diagonal not negative."""
    n = len(spread)
    factor = np.zeros((n, n))
    upper = np.asarray(np.linalg.qr(spread.T, mode="r"))
    factor[:, : len(upper)] = upper.T
    return np.asarray(factor * np.where(np.diag(factor) < 0.0, -1.0, 1.0))


def refuse_other_sizes(
    thresholds: Sequence[Sequence[int]],
    weights: Sequence[WeightCovariance] | None,
    places: ThresholdCovariance | None = None,
) -> None:
    """Refuse covariances that are not those of so many thresholds (output, input)."""
    sizes = [sum(row) for row in thresholds]
    if weights is not None and [w.factor_um_per_v.shape for w in weights] != [(n, n) for n in sizes]:
        raise InputError("weight_covariance", f"must have one factor an output, of {sizes} rows")
    if places is None:
        return
    shared = len({tuple(row) for row in thresholds}) == 1
    wanted = [(sizes[0], sizes[0])] * (1 + len(sizes))
    if not shared or [m.shape for m in (places.factor_v, *places.following_um_per_v2)] != wanted:
        raise InputError(
            "threshold_covariance",
            f"must have {sizes[0]} rows and columns, and as many for each of {len(sizes)} outputs, which "
            "share their thresholds",
        )
    if weights is None or not all(0 <= i < sizes[0] for i in places.open):
        raise InputError("threshold_covariance", "stands beside a weight_covariance, with open ones in range")

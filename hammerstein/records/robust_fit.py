"""A fit that is good enough to suspect a record: plays and delayed copies of the voltages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.hysteresis import play

LAGS = (1, 2, 3, 5, 8, 13)
"""Samples by which voltages are delayed: they take up what dynamics and delay do at the edges."""
FITTED = 40_000
"""Samples of which a fit is made."""
CHUNK = 256
"""Samples of one product: small enough that BLAS does it on one core."""


def regressors(u: Array, plays: int, stride: int = 1) -> Array:
    """Plays of a voltage whose thresholds divide half its range, from rest, and the voltage some samples ago.

    Parameters
    ----------
    u : (sample,) voltage [V]
    plays : how many
    stride : samples from one that is kept to the next

    Returns
    -------
    (row, sample), counted from the first voltage
    """
    v = u - u[0]
    thresholds = 0.5 * float(np.ptp(u)) * np.arange(plays) / plays
    rows = [play(v, [threshold])[0, ::stride] for threshold in thresholds]
    rows += [np.concatenate([np.zeros(d), v[:-d]])[::stride] for d in LAGS if d < len(u)]
    return np.vstack(rows)


@dataclass(frozen=True, eq=False)
class Products:
    """Products of signals with each other, from which fits of one by any others follow.

    Parameters
    ----------
    gram : (signal, signal) sums over the samples
    samples : how many
    """

    gram: Array
    samples: int

    @classmethod
    def of(cls, signals: Array) -> Products:
        """Products of signals (signal, sample)."""
        count, samples = signals.shape
        whole = samples - samples % CHUNK
        stack = signals[:, :whole].reshape(count, -1, CHUNK).transpose(1, 0, 2)
        rest = signals[:, whole:]
        gram = np.matmul(stack, stack.transpose(0, 2, 1)).sum(axis=0) + rest @ rest.T
        return cls(gram, samples)

    def fit(self, columns: Sequence[int], target: int) -> tuple[Array, float]:
        """Weights of some signals that make up another one best, and the rms of what they leave.

        Examples
        --------
        >>> t = np.arange(10.0)
        >>> weights, left = Products.of(np.vstack([t, np.ones(10), 3.0 * t + 2.0])).fit([0, 1], 2)
        >>> weights.round(9), round(left, 6)
        (array([3., 2.]), 0.0)
        """
        used = list(columns)
        size = np.sqrt(np.maximum(np.diag(self.gram)[used], np.finfo(float).tiny))
        gram, cross = self.gram[np.ix_(used, used)], self.gram[used, target]
        scaled = np.linalg.lstsq(gram / np.outer(size, size), cross / size, rcond=1e-12)[0]
        weights = np.asarray(scaled / size)
        squares = self.gram[target, target] - 2.0 * weights @ cross + weights @ gram @ weights
        return weights, float(np.sqrt(max(squares, 0.0) / self.samples))

"""A state-space model straight from a frequency response, without iteration: the start of every fit."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from hammerstein.arrays import Array
from hammerstein.identification.linear.weighted_lines import Matrices, WeightedLines

MARGIN = 1e-6
"""Distance from the unit circle of a pole that stood on it, after it is put back inside."""


def subspace(lines: WeightedLines, order: int, block_rows: int) -> Matrices:
    """Estimate a stable model of given order from weighted lines.

    With Z_k = [1, z_k, ..., z_k^(q-1)] every line obeys

        Z_k (x) G_k R_k = O X_k + T (Z_k (x) R_k),    O = [C; C A; ...; C A^(q-1)]

    The part of the left side that is orthogonal to Z_k (x) R_k spans the columns of O. Its leading left
    singular vectors give C and, by their shift structure, A; B and D follow by linear least squares.

    Parameters
    ----------
    lines : what to fit
    order : number of states n
    block_rows : q, larger than n / p

    Returns
    -------
    Matrices, stable: a pole outside the unit circle is mirrored into it

    References
    ----------
    McKelvey, Akcay, Ljung, Subspace-based multivariable system identification from frequency response data,
    IEEE Trans. Automatic Control 41 (1996) 960-979, algorithm 2, each line weighted as in the fit.
    """
    p = lines.target.shape[1]
    vectors = linalg.svd(_orthogonal_part(lines, block_rows), full_matrices=False)[0][:, :order]
    A = linalg.lstsq(vectors[:-p], vectors[p:], lapack_driver="gelsy")[0]
    A, C = stable(A), vectors[:p] / _mean_left(lines)[:, None]
    return Matrices(A, C=C, **dict(zip("BD", _input_matrices(lines, A, C), strict=True)))


def stable(A: Array) -> Array:
    """Mirror the eigenvalues outside the unit circle into it."""
    if not len(A) or np.abs(linalg.eigvals(A)).max() < 1.0:
        return A
    # ordered so that the unstable poles stand in the last block, whose inverse has the mirrored ones
    T, Q, inside = linalg.schur(A, sort="iuc")
    last = slice(inside, None)
    T[last, last] = (1.0 - MARGIN) * linalg.inv(T[last, last])
    return np.asarray(Q @ T @ Q.T)


def _mean_left(lines: WeightedLines) -> Array:
    """One weight an output, since the shift structure of O allows no more."""
    return np.asarray(np.sqrt(np.mean(lines.left**2, axis=0)))


def _orthogonal_part(lines: WeightedLines, q: int) -> Array:
    """Triangular factor of the responses' extended rows after those of the inputs are projected out."""
    p, m = lines.target.shape[1:]
    mean_left = _mean_left(lines)
    line_weight = np.sqrt(np.mean((lines.left / mean_left) ** 2, axis=1))
    rows = np.empty((0, q * (m + p)))
    for k in lines.chunks():
        right = lines.right[k] * line_weight[k, None, None]
        powers = lines.z[k, None] ** np.arange(q)
        extended = [
            (powers[:, :, None, None] * block[:, None]).reshape(len(right), -1, m)
            for block in (right, mean_left[:, None] * (lines.target[k] @ right))
        ]
        fresh = np.concatenate(extended, axis=1).swapaxes(1, 2).reshape(-1, q * (m + p))
        rows = linalg.qr(np.concatenate([rows, fresh.real, fresh.imag]), mode="r", overwrite_a=True)[0]
        rows = rows[: q * (m + p)]
    return np.asarray(rows[q * m :, q * m :].T)


def _input_matrices(lines: WeightedLines, A: Array, C: Array) -> tuple[Array, Array]:
    """B and D that fit best to the response, input by input."""
    n, (p, m) = len(A), lines.target.shape[1:]
    rows = np.empty((0, n + p + m))
    size = np.sqrt(np.mean(np.abs(lines.right) ** 2, axis=(1, 2)))
    for k in lines.chunks():
        states = np.linalg.inv(lines.z[k, None, None] * np.eye(n) - A)
        count = len(states)
        direct = np.broadcast_to(np.eye(p), (count, p, p))
        known = np.concatenate([C @ states, direct, lines.target[k]], axis=2)
        known = (known * (lines.left[k] * size[k, None])[:, :, None]).reshape(count * p, n + p + m)
        rows = linalg.qr(np.concatenate([rows, known.real, known.imag]), mode="r", overwrite_a=True)[0]
        rows = rows[: n + p + m]
    both = linalg.lstsq(rows[:, : n + p], rows[:, n + p :])[0]
    return both[:n], both[n:]

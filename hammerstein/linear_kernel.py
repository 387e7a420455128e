"""Compiled time loop of a linear block."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def respond_linear(start, column, value, x, v, y):  # type: ignore[no-untyped-def]
    """x[k+1], y[k] = [[A, B], [C, D]] (x[k], v[k]), the matrix given by its non-zero entries.

    start : (n+p+1,) first entry of each row; column, value : (entry,)
    x : (n,) state, updated in place; v : (m, N) inputs; y : (p, N) outputs, overwritten
    """
    n, m, p = x.shape[0], v.shape[0], y.shape[0]
    z = np.empty(n + m)
    # Not in slices: numba takes seconds to compile their assignment.
    for i in range(n):
        z[i] = x[i]
    new = np.empty(n)
    for t in range(v.shape[1]):
        for j in range(m):
            z[n + j] = v[j, t]
        for i in range(n + p):
            total = 0.0
            for e in range(start[i], start[i + 1]):
                total += value[e] * z[column[e]]
            if i < n:
                new[i] = total
            else:
                y[i - n, t] = total
        for i in range(n):
            z[i] = new[i]
    for i in range(n):
        x[i] = z[i]

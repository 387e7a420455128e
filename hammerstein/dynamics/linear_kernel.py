"""Compiled time loop of a linear block."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled

at = np.uint64  # an index of unsigned type is not tested for Python's counting from the end


@compiled()
def respond_linear(start, column, value, x, v, first, end, y):  # type: ignore[no-untyped-def]
    """x[k+1], y[k] = [[A, B], [C, D]] (x[k], v[k]), the matrix given by its non-zero entries.

    start : (n+p+1,) first entry of each row; column, value : (entry,)
    x : (n,) state, updated in place; v : (m, N) inputs; y : (p, N) outputs, overwritten from first up to end
    """
    n, m, p = x.shape[0], v.shape[0], y.shape[0]
    now, later = np.empty(n + m), np.empty(n + m)
    for i in range(n):  # not in slices: numba takes seconds to compile their assignment
        now[i] = x[i]
    for t in range(first, end):
        for j in range(m):
            now[at(n + j)] = v[at(j), at(t)]
        e = at(start[0])
        for i in range(n + p):
            total, stop = 0.0, at(start[at(i + 1)])
            while e < stop:
                total += value[e] * now[at(column[e])]
                e += at(1)
            if i < n:
                later[at(i)] = total
            else:
                y[at(i - n), at(t)] = total
        now, later = later, now
    for i in range(n):
        x[i] = now[i]

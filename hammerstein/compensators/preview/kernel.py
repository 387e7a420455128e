"""Compiled loops of the inverse of the linear block. Every sum has a fixed order, however long the signal."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled

at = np.uint64  # an index of unsigned type is not tested for Python's counting from the end


@compiled()
def filtered(taps, y, first, stop, out):  # type: ignore[no-untyped-def]
    """out[i, k] = sum over j of taps[j] y[i, k+j]: y (p, N + taps - 1), out (p, N) from first up to stop."""
    out[:, first:stop] = 0.0
    for i in range(out.shape[0]):
        for j in range(taps.shape[0]):
            for k in range(first, stop):
                out[i, at(k)] += taps[j] * y[i, at(k + j)]


@compiled()
def run_inverse(a, b, c, taps, ahead, x, y, first, stop, v):  # type: ignore[no-untyped-def]
    """x[k+1] = a x[k] + b y+[k], v[k] = c x[k] + sum of taps[j] y+[k+j], with y+_i[k] = y[i, k + ahead_i].

    a (n, n), b (n, p), c (p, n); taps (j, p, p); ahead (p,); x (n,) updated
    y (p, N + longest ahead + taps - 1); v (p, N) overwritten from sample first up to stop
    """
    n, p = b.shape
    v[:, first:stop] = 0.0
    for o in range(p):
        for i in range(p):
            for j in range(taps.shape[0]):
                for k in range(first, stop):
                    v[o, at(k)] += taps[j, o, i] * y[i, at(k + j + ahead[i])]
    new = x.copy()
    for k in range(first, stop):
        for o in range(p):
            for s in range(n):
                v[o, at(k)] += c[o, s] * x[s]
        for s in range(n):
            total = 0.0
            for q in range(n):
                total += a[s, q] * x[q]
            for i in range(p):
                total += b[s, i] * y[i, at(k + ahead[i])]
            new[s] = total
        for s in range(n):
            x[s] = new[s]

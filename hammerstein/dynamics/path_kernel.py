"""Compiled time loop of many copies of one linear path."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled


@compiled()
def respond_copies(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """x[k+1] = a x[k] + b v[k], y[k] = c x[k] + d v[k], each row of v through its own copy.

    a : (n, n); b, c : (n,); d : number; x : (copy, n) states, updated in place
    v : (copy, N) inputs; y : (copy, N) outputs, overwritten
    """
    n = b.shape[0]
    now, new = np.empty(n), np.empty(n)
    for row in range(v.shape[0]):
        for i in range(n):  # not in slices: numba takes seconds to compile their assignment
            now[i] = x[row, i]
        for t in range(v.shape[1]):
            u = v[row, t]
            out = d * u
            for i in range(n):
                out += c[i] * now[i]
                total = b[i] * u
                for j in range(n):
                    total += a[i, j] * now[j]
                new[i] = total
            y[row, t] = out
            for i in range(n):
                now[i] = new[i]
        for i in range(n):
            x[row, i] = now[i]


@compiled()
def respond_modes(poles, b, c, d, z, v, y):  # type: ignore[no-untyped-def]
    """z[k+1] = poles z[k] + b v[k], y[k] = Re(c z[k]) + d v[k], each row of v through its own copy.

    poles, b, c : (mode,) complex; d : number; z : (copy, mode) states, updated in place
    v : (copy, N) inputs; y : (copy, N) outputs, overwritten
    """
    for row in range(v.shape[0]):
        for t in range(v.shape[1]):
            u = v[row, t]
            out = d * u
            for i in range(poles.shape[0]):
                now = z[row, i]
                out += c[i].real * now.real - c[i].imag * now.imag
                z[row, i] = poles[i] * now + b[i] * u
            y[row, t] = out

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
    whole = v.shape[0] // 4 * 4
    for row in range(0, whole, 4):
        _four(a, b, c, d, x[row : row + 4], v[row : row + 4], y[row : row + 4])
    for row in range(whole, v.shape[0]):
        _one(a, b, c, d, x[row], v[row], y[row])


@compiled()
def _four(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """Four copies side by side, which a processor works out at once: x (4, n), v and y (4, N)."""
    n = b.shape[0]
    now, new = np.empty((n, 4)), np.empty((n, 4))
    for i in range(n):  # not in slices: numba takes seconds to compile their assignment
        for k in range(4):
            now[i, k] = x[k, i]
    v0, v1, v2, v3, y0, y1, y2, y3 = v[0], v[1], v[2], v[3], y[0], y[1], y[2], y[3]
    for t in range(v.shape[1]):
        u0, u1, u2, u3 = v0[t], v1[t], v2[t], v3[t]
        out0, out1, out2, out3 = d * u0, d * u1, d * u2, d * u3
        for i in range(n):
            seen, driven = c[i], b[i]
            out0 += seen * now[i, 0]
            out1 += seen * now[i, 1]
            out2 += seen * now[i, 2]
            out3 += seen * now[i, 3]
            sum0, sum1, sum2, sum3 = driven * u0, driven * u1, driven * u2, driven * u3
            for j in range(n):
                part = a[i, j]
                sum0 += part * now[j, 0]
                sum1 += part * now[j, 1]
                sum2 += part * now[j, 2]
                sum3 += part * now[j, 3]
            new[i, 0], new[i, 1], new[i, 2], new[i, 3] = sum0, sum1, sum2, sum3
        y0[t], y1[t], y2[t], y3[t] = out0, out1, out2, out3
        now, new = new, now
    for i in range(n):
        for k in range(4):
            x[k, i] = now[i, k]


@compiled()
def _one(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """One copy: x (n,), v and y (N,)."""
    n = b.shape[0]
    now, new = x.copy(), np.empty(n)
    for t in range(v.shape[0]):
        u = v[t]
        out = d * u
        for i in range(n):
            out += c[i] * now[i]
            total = b[i] * u
            for j in range(n):
                total += a[i, j] * now[j]
            new[i] = total
        y[t] = out
        now, new = new, now
    for i in range(n):
        x[i] = now[i]


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

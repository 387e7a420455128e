"""Compiled time loops of many copies of one linear path, and of several paths."""

import numpy as np

from hammerstein.compiled import at, compiled, helper


@compiled()
def respond_linear(start, column, value, x, v, first, end, y):  # type: ignore[no-untyped-def]
    """x[k+1], y[k] = [[A, B], [C, D]] (x[k], v[k]), the matrix given by its non-zero entries.

    start : (n+p+1,) first entry of each row; column, value : (entry,)
    x : (n,) state, updated in place; v : (m, N) inputs; y : (p, N) outputs, overwritten from first up to end
    """
    n, m = x.shape[0], v.shape[0]
    now, later = np.empty(n + m), np.empty(n + m)
    for i in range(n):  # not in slices: numba takes seconds to compile their assignment
        now[i] = x[i]
    for t in range(first, end):
        for j in range(m):
            now[at(n + j)] = v[at(j), at(t)]
        linear_step(start, column, value, now, later, n, t, y)
        now, later = later, now
    for i in range(n):
        x[i] = now[i]


@helper(inline="always")
def linear_step(start, column, value, now, later, n, t, y):  # type: ignore[no-untyped-def]
    """One sample t: from n states and the inputs in ``now`` to the states in ``later``, and outputs y."""
    e = at(start[0])
    for i in range(n + y.shape[0]):
        total, stop = 0.0, at(start[at(i + 1)])
        while e < stop:
            total += value[e] * now[at(column[e])]
            e += at(1)
        if i < n:
            later[at(i)] = total
        else:
            y[at(i - n), at(t)] = total


@compiled()
def respond_copies(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """x[k+1] = a x[k] + b v[k], y[k] = c x[k] + d v[k], each row of v through its own copy.

    Copies at rest whose inputs stay zero cost next to nothing: often one actuator input is driven at a time.

    a : (n, n); b, c : (n,); d : number; x : (copy, n) states, updated in place
    v : (copy, N) inputs; y : (copy, N) outputs, overwritten
    """
    whole = v.shape[0] // 4 * 4
    for row in range(0, whole, 4):
        if _zero(x[row : row + 4]) and _zero(v[row : row + 4]):
            y[row : row + 4] = 0.0
        else:
            _four(a, b, c, d, x[row : row + 4], v[row : row + 4], y[row : row + 4])
    for row in range(whole, v.shape[0]):
        _one(a, b, c, d, x[row], v[row], y[row])


@helper()
def _zero(rows):  # type: ignore[no-untyped-def]
    """Whether all of some rows (row, N) is zero."""
    for i in range(rows.shape[0]):
        for t in range(rows.shape[1]):
            if rows[i, t] != 0.0:
                return False
    return True


@helper()
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


@helper()
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
def respond_paths(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """Several paths of one input, four at a time; each as in ``respond_copies``.

    a : (group, n, n, 4); b, c : (group, n, 4); d : (group, 4); x : (group, n, 4) states, updated in place
    v : (N,) input; y : (4 groups, N) outputs, overwritten
    """
    for k in range(a.shape[0]):
        _four_paths(a[k], b[k], c[k], d[k], x[k], v, y[4 * k : 4 * k + 4])


@helper()
def _four_paths(a, b, c, d, x, v, y):  # type: ignore[no-untyped-def]
    """Four paths: a (n, n, 4), b, c and x (n, 4), d (4,), v (N,) and y (4, N)."""
    n = b.shape[0]
    now, new = x.copy(), np.empty((n, 4))
    y0, y1, y2, y3 = y[0], y[1], y[2], y[3]
    for t in range(v.shape[0]):
        u = v[t]
        out0, out1, out2, out3 = d[0] * u, d[1] * u, d[2] * u, d[3] * u
        for i in range(n):
            out0 += c[i, 0] * now[i, 0]
            out1 += c[i, 1] * now[i, 1]
            out2 += c[i, 2] * now[i, 2]
            out3 += c[i, 3] * now[i, 3]
            sum0, sum1, sum2, sum3 = b[i, 0] * u, b[i, 1] * u, b[i, 2] * u, b[i, 3] * u
            for j in range(n):
                sum0 += a[i, j, 0] * now[j, 0]
                sum1 += a[i, j, 1] * now[j, 1]
                sum2 += a[i, j, 2] * now[j, 2]
                sum3 += a[i, j, 3] * now[j, 3]
            new[i, 0], new[i, 1], new[i, 2], new[i, 3] = sum0, sum1, sum2, sum3
        y0[t], y1[t], y2[t], y3[t] = out0, out1, out2, out3
        now, new = new, now
    for i in range(n):
        for k in range(4):
            x[i, k] = now[i, k]


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

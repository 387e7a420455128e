"""Compiled functions of one play per input: one-sided dead-zones, the inverse of an envelope."""

import numpy as np

from hammerstein.compiled import at, compiled, helper
from hammerstein.hysteresis.play_kernels import BLOCK

HALVINGS = 60
"""Steps in which the tangent is inverted: more than the bits of a number."""
LIMIT, DOUBLINGS = 20.0, 8
"""Argument from which a hyperbolic tangent is 1, and how often its argument is halved for its series."""
SERIES = (-1382.0 / 155925.0, 62.0 / 2835.0, -17.0 / 315.0, 2.0 / 15.0, -1.0 / 3.0, 1.0)
"""The series, the highest power first: of the largest argument it leaves out a rounding error."""


@helper()
def tanh_by_doubling(x):  # type: ignore[no-untyped-def]
    """Hyperbolic tangent of any numbers, to a few rounding errors.

        tanh 2 z = 2 tanh z / (1 + tanh^2 z)

    Products, sums and quotients alone: exported C, which has no mathematical library, gives the same bits.

    Examples
    --------
    >>> float(tanh_by_doubling(np.array(0.5)))  # doctest: +ELLIPSIS
    0.4621171572600...
    """
    z = np.minimum(np.maximum(x, -LIMIT), LIMIT) / 2.0**DOUBLINGS
    square = z * z
    total = 0.0 * z
    for term in SERIES:
        total = term + square * total
    t = z * total
    for _ in range(DOUBLINGS):
        t = (2.0 * t) / (1.0 + t * t)
    return t


@compiled()
def bent_at(g, low, high, lines, bend):  # type: ignore[no-untyped-def]
    """Voltages between two bounds at which lines and a tangent have some values, all (point,) [V]."""
    (knots, intercepts, slopes), (a, b, c) = lines, bend
    for i in range(len(g)):
        for _ in range(HALVINGS):
            middle = 0.5 * (low[i] + high[i])
            line = np.searchsorted(knots, middle)
            straight = intercepts[line] + slopes[line] * middle
            side = low if straight + a * tanh_by_doubling(b * (middle - c)) < g[i] else high
            side[i] = middle
    return 0.5 * (low + high)


@compiled()
def play_derivatives(x, moved, r, w, plays, signs, held, out):  # type: ignore[no-untyped-def]
    """Derivatives of sums of plays by their thresholds, and by the numbers that move their input.

    A play that moved last at some time changes as its input did then, and by -1 or 1 with its threshold.

    x : (N,); moved : (number, N) its derivatives; r : (n,); w : (n, p)
    plays, signs : (n,), held : (n, number) of each play: output, derivatives; updated in place
    out : (n + number, p, N) derivatives, overwritten: by the thresholds first
    """
    n = len(r)
    for t in range(len(x)):
        out[n:, :, t] = 0.0
        for i in range(n):
            high, low = x[t] + r[i], x[t] - r[i]
            if low > plays[i] or high < plays[i]:
                signs[i] = -1.0 if low > plays[i] else 1.0
                plays[i] = x[t] + signs[i] * r[i]
                held[i] = moved[:, t]
            for o in range(w.shape[1]):
                out[i, o, t] = w[i, o] * signs[i]
                for k in range(len(moved)):
                    out[n + k, o, t] += w[i, o] * held[i, k]


@compiled()
def add_dead_zones(  # type: ignore[no-untyped-def]
    u, r, held, ends, slope, intercept, y, outputs
):
    """Add to y the dead-zones of all inputs, behind their smallest plays.

    Samples that follow each other in one zone are worked off together.

    u : (m, N); r : (m,) smallest threshold; held : (m,) outputs of that play, updated in place
    ends : (m, zones) where each zone ends, the last one at infinity
    slope, intercept : (m, zones, p) line of each zone; y : (p, N)
    outputs : p zeros in a tuple: a number of outputs that the compiler knows, for it unrolls their loops
    """
    q = np.empty(min(BLOCK, u.shape[1]))
    for k in range(u.shape[0]):
        bent = ends[k, 0] < np.inf
        for start in range(0, u.shape[1], BLOCK):
            stop = min(start + BLOCK, u.shape[1])
            if r[k] > 0.0:
                held[k] = _smallest(u[k], r[k], held[k], start, stop, q)
                if bent:
                    _add_lines(q, start, start, stop, ends[k], slope[k], intercept[k], y, outputs)
            else:
                held[k] = u[k, at(stop - 1)]
                if bent:
                    _add_lines(u[k], 0, start, stop, ends[k], slope[k], intercept[k], y, outputs)


@helper()
def _smallest(u, r, p, start, stop, q):  # type: ignore[no-untyped-def]
    """Put the smallest play of samples start to stop into q; returns the last one."""
    for t in range(start, stop):
        p = max(u[at(t)] - r, min(u[at(t)] + r, p))
        q[at(t - start)] = p
    return p


@helper()
def _add_lines(q, shift, start, stop, ends, slope, intercept, y, outputs):  # type: ignore[no-untyped-def]
    """Add the lines of the zones that the smallest plays of samples start to stop stand in.

    q : smallest plays, that of sample t at t - shift
    """
    t, z = start, 0
    while t < stop:
        while q[at(t - shift)] > ends[at(z)]:
            z += 1
        while z > 0 and q[at(t - shift)] <= ends[at(z - 1)]:
            z -= 1
        low, high = -np.inf if z == 0 else ends[at(z - 1)], ends[at(z)]
        first = t
        while t < stop and low < q[at(t - shift)] and q[at(t - shift)] <= high:
            t += 1
        for o in range(len(outputs)):
            rise, begin = slope[at(z), at(o)], intercept[at(z), at(o)]
            for i in range(first, t):
                y[at(o), at(i)] += begin + rise * q[at(i - shift)]

"""Compiled inverse of an envelope with a tangent."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled, helper

HALVINGS = 60
"""Steps in which the tangent is inverted: more than the bits of a number."""
LIMIT, DOUBLINGS = 20.0, 8
"""Argument from which a hyperbolic tangent is 1, and how often its argument is halved for its series."""
SERIES = (-1382.0 / 155925.0, 62.0 / 2835.0, -17.0 / 315.0, 2.0 / 15.0, -1.0 / 3.0, 1.0)
"""The series, the highest power first: of the largest argument it leaves out a rounding error."""


@helper()
def tanh_by_doubling(x):  # type: ignore[no-untyped-def]
    """Hyperbolic tangent of any numbers, within some rounding errors of it.

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

"""Compiled time loops of the play operators.

Two forms of the same law. The textbook loop updates every operator in every sample. The turning-point
form below gives the same outputs at a cost a sample that does not grow with the number of operators.

The operators of one input stand on one grid of increasing thresholds r[0] < r[1] < ... . Whatever moved the
input, neighbouring operators that were last engaged together form a *segment*: operators ``start..end-1``
with outputs

    p[i] = x - d r[i],      d = +1 rising, -1 falling, 0 never engaged since the start

and the segments form a stack: the top one begins at operator 0, the bottom one ends at the last operator.
Moving the input by a monotone stretch engages a prefix of the grid; the prefix becomes the new top segment
and wipes out what it covers (the wiping-out property of Prandtl-Ishlinskii models). The next operator k of
the segment below, at (x', d'), engages when

    d (u - x') > (1 - d d') r[k]

Between two such events the output is a line in u, with slope W[k] = w[0] + ... + w[k-1]:

    y = W[k] u - d Rw[k] + below,   Rw[k] = w[0] r[0] + ... + w[k-1] r[k-1]

where ``below`` is what the deeper segments add. No reversal touches all operators.

Source: Brokate and Sprekels, Hysteresis and Phase Transitions (1996), chapter 2 (play operator, memory).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def play_bank(u, r, plays, p):  # type: ignore[no-untyped-def]
    """Outputs of every play: u (N,), r (n,), plays (n,) updated in place, p (n, N) overwritten."""
    for i in range(r.shape[0]):
        now = plays[i]
        for t in range(u.shape[0]):
            now = max(u[t] - r[i], min(u[t] + r[i], now))
            p[i, t] = now
        plays[i] = now


@njit(cache=True, nogil=True)
def respond_textbook(u, r, n, w, plays, y):  # type: ignore[no-untyped-def]
    """Textbook loop: every play operator in every sample, shared by all outputs of its input.

    u : (m, N) inputs; r : (m, n_max) thresholds; n : (m,) operators of each input
    w : (m, n_max, p) weights; plays : (m, n_max) operator outputs, updated in place
    y : (p, N) outputs, overwritten
    """
    y[:] = 0.0
    for k in range(u.shape[0]):
        for t in range(u.shape[1]):
            v = u[k, t]
            for i in range(n[k]):
                play = max(v - r[k, i], min(v + r[k, i], plays[k, i]))
                plays[k, i] = play
                for o in range(y.shape[0]):
                    y[o, t] += w[k, i, o] * play


@njit(cache=True, nogil=True, inline="always")
def engaged(gap, factor, r, k, end):  # type: ignore[no-untyped-def]
    """First operator in k..end that a gap does not engage: factor r[i] >= gap (galloping search)."""
    if k == end or factor * r[k] >= gap:
        return k
    step = 1
    low = k
    while low + step < end and factor * r[low + step] < gap:
        low += step
        step *= 2
    high = min(low + step, end)
    low += 1
    while low < high:
        middle = (low + high) // 2
        if factor * r[middle] < gap:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True, inline="always")
def direction_of(u, r, x, d, top):  # type: ignore[no-untyped-def]
    """+1 or -1 if moving to u engages operator 0 rising or falling, 0 inside its dead zone."""
    gap = u - x[top]
    if gap > (1.0 - d[top]) * r[0]:
        return 1.0
    if -gap > (1.0 + d[top]) * r[0]:
        return -1.0
    return 0.0


@njit(cache=True, nogil=True)
def advance(u, r, w, rw, count, end, x, d, below):  # type: ignore[no-untyped-def]
    """Move one input to u; updates the stack in place and returns its new height.

    r : (n,) thresholds; w, rw : (n+1, p) partial sums of weights and of weights times thresholds
    end, x, d : (n+1,) the stack; below : (n+1, p) what the segments under each one add
    """
    top = count - 1
    direction = direction_of(u, r, x, d, top)
    if direction == 0.0:
        return count
    k = 0
    if d[top] == direction:
        k = end[top]
        top -= 1
    while top >= 0:
        k = engaged(direction * (u - x[top]), 1.0 - direction * d[top], r, k, end[top])
        if k < end[top]:
            break
        top -= 1
    new = top + 1
    for o in range(w.shape[1]):
        below[new, o] = 0.0
        if top >= 0:
            rest = x[top] * (w[end[top], o] - w[k, o]) - d[top] * (rw[end[top], o] - rw[k, o])
            below[new, o] = below[top, o] + rest
    end[new] = k
    x[new] = u
    d[new] = direction
    return new + 1


@njit(cache=True, nogil=True, inline="always")
def next_engagement(r, count, end, x, d):  # type: ignore[no-untyped-def]
    """Input at which the active top segment engages its next operator (infinite if none is left)."""
    direction = d[count - 1]
    if count == 1:
        return direction * np.inf
    below = count - 2
    return x[below] + direction * (1.0 - direction * d[below]) * r[end[count - 1]]


@njit(cache=True, nogil=True)
def respond_turning_points(u, r, n, w, rw, count, end, x, d, below, y):  # type: ignore[no-untyped-def]
    """Turning-point form: the same outputs as the textbook loop; the stack is updated in place.

    u : (m, N); r : (m, n_max); n : (m,); w, rw : (m, n_max+1, p) partial sums
    count : (m,); end, x, d : (m, n_max+1); below : (m, n_max+1, p); y : (p, N), overwritten
    """
    y[:] = 0.0
    for k in range(u.shape[0]):
        if n[k] > 0:
            count[k] = _respond_one(u[k], r[k], w[k], rw[k], count[k], end[k], x[k], d[k], below[k], y)


@njit(cache=True, nogil=True)
def _respond_one(u, r, w, rw, count, end, x, d, below, y):  # type: ignore[no-untyped-def]
    """Add to y what one input contributes; returns the new height of its stack."""
    samples = u.shape[0]
    t = 0
    while t < samples:
        count = advance(u[t], r, w, rw, count, end, x, d, below)
        top = count - 1
        k = end[top]
        stop = t + 1
        if d[top] != 0.0 and x[top] == u[t]:
            stop = _run(u, t, d[top], next_engagement(r, count, end, x, d))
            x[top] = u[stop - 1]
            for o in range(y.shape[0]):
                slope = w[k, o]
                offset = below[top, o] - d[top] * rw[k, o]
                for i in range(t, stop):
                    y[o, i] += slope * u[i] + offset
        else:
            for o in range(y.shape[0]):
                y[o, t] += w[k, o] * x[top] + (below[top, o] - d[top] * rw[k, o])
        t = stop
    return count


@njit(cache=True, nogil=True, inline="always")
def _run(u, t, direction, limit):  # type: ignore[no-untyped-def]
    """End of the stretch from t that keeps its direction and stays short of the next engagement."""
    stop = t + 1
    if direction > 0.0:
        while stop < u.shape[0] and u[stop] >= u[stop - 1] and u[stop] <= limit:
            stop += 1
    else:
        while stop < u.shape[0] and u[stop] <= u[stop - 1] and u[stop] >= limit:
            stop += 1
    return stop

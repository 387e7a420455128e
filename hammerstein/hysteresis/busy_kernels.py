"""Compiled loop of plays for an input with frequent turns: it updates every operator in every sample.

In the turning-point form (``play_kernels``), a turn costs as much as updating fifty operators. An input with
few operators that turns often therefore uses the *busy form*, the textbook loop

    p[i] = max(u - r[i], min(u + r[i], p[i]))        y = sum over i of  w[i] p[i]

for groups of operators whose plays stay in registers through a piece of the signal; the weighted sums follow
for all samples of the piece at once, each sample's always in the same order.

The form of an input is part of its memory. It follows from the past of the input alone, never from how the
signal is cut. With n operators a window of it is busy if more than one sample in ``TURN / n`` turns:

- Turning-point form: the first turn after ``LOOK`` samples closes the window, and begins the busy form if
  that window was busy. Leaving the dead zone of the smallest threshold counts as a turn, because it costs as
  much.
- Busy form: windows are ``WINDOW`` samples long. The first that was not busy ends it.
"""

import numpy as np

from hammerstein.compiled import at, helper

LOOK, WINDOW = 64, 512
"""Samples after which turns are looked at: few in the turning-point form, for there much is lost where all of
them turn; more in the busy form, where every window has its own overhead."""
TURN = 50
"""Cost of a turn, in updates of one operator."""
GROUP = 5
"""Operators in registers at once."""

SEEN, TURNS, BUSY, RESTED, LAST, BEFORE = range(6)
"""Columns of a window, a row an input: samples and turns since it began, whether the form is the busy one,
whether operator 0 rested in the last sample, and in the busy form the last two inputs [V]."""
COLUMNS = 6
"""Number of columns."""


@helper()
def respond_busy(u, start, stop, r, w, n, plays, window, kept, y, outputs):  # type: ignore[no-untyped-def]
    """Add to y what one input contributes from start to the end of its window or to stop; returns where.

    u : (N,); r : (n_max,); w : (n_max, p); plays : (n_max,), updated; window : see above, updated
    kept : (GROUP, samples) room for the plays of a group; y : (p, N); outputs : p zeros in a tuple
    """
    stop = min(stop, start + WINDOW - np.int64(window[SEEN]))
    window[SEEN] += stop - start
    window[TURNS] += _turns(u, start, stop, window)
    for i in range(0, n, GROUP):
        _move_group(u, start, stop, r, plays, i, n, kept)
        for o in range(len(outputs)):
            _add_group(start, stop, w, i, n, o, kept, y)
    if window[SEEN] == WINDOW:
        window[BUSY] = 1.0 if window[TURNS] * TURN > n * WINDOW else 0.0
        window[SEEN], window[TURNS] = 0.0, 0.0
    return stop


@helper()
def _turns(u, start, stop, window):  # type: ignore[no-untyped-def]
    """Samples from start to stop with which the input turns."""
    turns, last, before = 0, window[LAST], window[BEFORE]
    for t in range(start, min(start + 2, stop)):
        turns += (u[t] - last) * (last - before) < 0.0
        last, before = u[t], last
    for t in range(start + 2, stop):
        turns += (u[at(t)] - u[at(t - 1)]) * (u[at(t - 1)] - u[at(t - 2)]) < 0.0
    window[LAST], window[BEFORE] = u[stop - 1], u[stop - 2] if stop - start > 1 else before
    return turns


@helper()
def _move_group(u, start, stop, r, plays, i, n, kept):  # type: ignore[no-untyped-def]
    """Move operators i, i+1, ... of n through the samples; what is missing has an infinite threshold."""
    ra, rb, rc, rd, re = r[i], np.inf, np.inf, np.inf, np.inf
    a, b, c, d, e = plays[i], 0.0, 0.0, 0.0, 0.0
    if i + 1 < n:
        b, rb = plays[i + 1], r[i + 1]
    if i + 2 < n:
        c, rc = plays[i + 2], r[i + 2]
    if i + 3 < n:
        d, rd = plays[i + 3], r[i + 3]
    if i + 4 < n:
        e, re = plays[i + 4], r[i + 4]
    for t in range(stop - start):
        v = u[at(start + t)]
        a = max(v - ra, min(v + ra, a))
        b = max(v - rb, min(v + rb, b))
        c = max(v - rc, min(v + rc, c))
        d = max(v - rd, min(v + rd, d))
        e = max(v - re, min(v + re, e))
        kept[0, at(t)], kept[1, at(t)], kept[2, at(t)], kept[3, at(t)], kept[4, at(t)] = a, b, c, d, e
    for j in range(i, min(i + GROUP, n)):
        plays[j] = kept[j - i, stop - start - 1]


@helper()
def _add_group(start, stop, w, i, n, o, kept, y):  # type: ignore[no-untyped-def]
    """Add the weighted plays of operators i, i+1, ... of n to output o."""
    a, b, c, d, e = w[i, o], 0.0, 0.0, 0.0, 0.0
    if i + 1 < n:
        b = w[i + 1, o]
    if i + 2 < n:
        c = w[i + 2, o]
    if i + 3 < n:
        d = w[i + 3, o]
    if i + 4 < n:
        e = w[i + 4, o]
    for t in range(stop - start):
        low = a * kept[0, at(t)] + b * kept[1, at(t)]
        y[at(o), at(start + t)] += low + c * kept[2, at(t)] + d * kept[3, at(t)] + e * kept[4, at(t)]

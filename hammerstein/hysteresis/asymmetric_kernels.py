"""Compiled time loop of one-sided dead-zones: a piecewise linear function of one play an input."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled, helper
from hammerstein.hysteresis.play_kernels import BLOCK, at


@compiled()
def add_dead_zones(  # type: ignore[no-untyped-def]
    u, r, held, ends, slope, intercept, y, outputs
):
    """Add to y what the dead-zones of all inputs make of their smallest plays.

    Samples that follow each other in one zone are worked off together.

    u : (m, N); r : (m,) smallest threshold; held : (m,) outputs of that play, updated in place
    ends : (m, zones) where each zone ends, the last one at infinity
    slope, intercept : (m, zones, p) line of each zone; y : (p, N)
    outputs : p zeros in a tuple: a number of outputs that the compiler knows, for it unrolls their loops
    """
    q = np.empty(min(BLOCK, u.shape[1]))
    for k in range(u.shape[0]):
        if ends.shape[1] == 1 or ends[k, 0] == np.inf:
            if u.shape[1] > 0:
                held[k] = _smallest(u[k], r[k], held[k], 0, u.shape[1])
            continue
        for start in range(0, u.shape[1], BLOCK):
            stop = min(start + BLOCK, u.shape[1])
            if r[k] == 0.0:
                held[k] = u[k, at(stop - 1)]
                _add_lines(u[k], 0, start, stop, ends[k], slope[k], intercept[k], y, outputs)
            else:
                held[k] = _smallest_block(u[k], r[k], held[k], start, stop, q)
                _add_lines(q, start, start, stop, ends[k], slope[k], intercept[k], y, outputs)


@helper()
def _smallest(u, r, p, start, stop):  # type: ignore[no-untyped-def]
    """Smallest play after samples start to stop."""
    if r == 0.0:
        return u[at(stop - 1)]
    for t in range(start, stop):
        p = max(u[at(t)] - r, min(u[at(t)] + r, p))
    return p


@helper()
def _smallest_block(u, r, p, start, stop, q):  # type: ignore[no-untyped-def]
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

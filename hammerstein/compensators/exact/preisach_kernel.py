"""Compiled time loop of the exact inverse of Preisach planes.

Seen from its memory, the output of an input is a polygon in its voltage: it rises along one branch and falls
along another, each straight from level to level, and changes branch where a turn is wiped out. This map of a
sample is given to the walk of ``inverse_kernel`` as dead-zones beside a single play without weight. At first
it holds the two pieces about the last voltage alone; only where they do not hold the solution is all of it
made.
"""

from __future__ import annotations

import numpy as np

from hammerstein.compensators.exact.inverse_kernel import drift, walk
from hammerstein.compiled import compiled, helper
from hammerstein.hysteresis.preisach_kernels import branch, level_below, moved


@compiled(error_model="numpy")
def respond_exact_preisach(  # type: ignore[no-untyped-def]
    reference, a, b, gain, away, w, here, plane, memory, first, stop, drive
):
    """Drive (m, N) whose model output is the reference (p, N), from sample first up to stop.

    The drive is overwritten there, the memory updated.

    a, b, gain, away : linear block behind it, as for ``respond_exact``
    plane : rest, low, high, size, cells, node, beyond of the forward loop
    memory : count, x, tip, last of it, and the last voltages (m,)
    """
    rest, low, high, size, cells, node, _ = plane
    count, x, tip, last, sent = memory
    m, p = drive.shape[0], reference.shape[0]
    new, off = np.empty(away.shape[0]), False
    value, slope, ends = np.empty(p), np.empty(p), np.empty((m, 2))
    for s in range(away.shape[0]):
        off = off or away[s] != 0.0
    for t in range(first, stop):
        for o in range(p):
            here[o].y = reference[o, t]
            if off:
                for s in range(away.shape[0]):
                    here[o].y -= gain[o, s] * away[s]
        for most in (1, w.shape[1]):
            for k in range(m):
                _map(w, here, k, most, plane, memory, value, slope, ends)
            walk(False, 0, w, here)
            if _holds(here, ends):
                break
        for o in range(p):
            off = off or (here[o].missed != 0.0 and away.shape[0] > 0)
        for k in range(m):
            drive[k, t] = sent[k] = here[k].u
            top, z = count[k] - 1, min(max(sent[k] + rest[k], low[k]), high[k])
            if z != last[k]:
                i, rises = level_below(last[k], low[k], size[k], cells[k]), top % 2 == 0
                begin = branch(k, x[k, top], tip[k, top], rises, i, low, size, cells, node, value, slope)
                count[k] = moved(k, z, top, begin, value, slope, x, tip, last) + 1
        if off:
            off = drift(reference, t, a, b, away, new, w, here)


@helper(error_model="numpy")
def _holds(here, ends):  # type: ignore[no-untyped-def]
    """Whether a walk arrived within the pieces that its map holds."""
    whole = True
    for k in range(ends.shape[0]):
        u = here[k].u
        whole = whole and here[k].missed == 0.0 and ends[k, 0] <= u and u <= ends[k, 1]
    return whole


@helper(error_model="numpy")
def _map(w, here, k, most, plane, memory, value, slope, ends):  # type: ignore[no-untyped-def]
    """Put the map of input k into its zones, so many pieces on each side at most, and where it stands.

    ends : (m, 2) lowest and highest voltage that the map holds, overwritten
    """
    rest, low, high, size, cells, node, _ = plane
    count, x, tip, last, sent = memory
    top, i = count[k] - 1, level_below(last[k], low[k], size[k], cells[k])
    rises = top % 2 == 0
    begin = branch(k, x[k, top], tip[k, top], rises, i, low, size, cells, node, value, slope)
    home = value + slope * (last[k] - begin)
    down = _side(w, k, 0, most, False, plane, memory, value, slope, home, ends)
    for z in range(down // 2):
        one, other = w[k, z], w[k, down - 1 - z]
        one.zone_end, other.zone_end = other.zone_end, one.zone_end
        for o in range(home.shape[0]):
            one.zone_slope[o], other.zone_slope[o] = other.zone_slope[o], one.zone_slope[o]
            one.zone_start[o], other.zone_start[o] = other.zone_start[o], one.zone_start[o]
    w[k, down - 1].zone_end = min(max(sent[k], low[k] - rest[k]), high[k] - rest[k])
    up = _side(w, k, down, most, True, plane, memory, value, slope, home, ends)
    w[k, down + up - 1].zone_end = np.inf
    w[k, 0].end, w[k, 0].x, w[k, 0].d = 1, sent[k], 1.0 if rises else -1.0
    here[k].count, here[k].wanted, here[k].ramp, here[k].fixed = 1, sent[k], 1.0, -1


@helper(error_model="numpy")
def _side(w, k, row, most, rises, plane, memory, value, slope, home, ends):  # type: ignore[no-untyped-def]
    """Put the pieces on one side of the memory of input k into zones, from row on; gives their number.

    home : (p,) outputs at the last voltage
    """
    rest, low, high, size, cells, node, beyond = plane
    count, x, tip, last, _ = memory
    top, pieces, at = count[k] - 1, 0, home.copy()
    s = top if (top % 2 == 0) == rises else top + 1
    turn, origin = (x[k, s], tip[k, s]) if s <= top else (last[k], home)
    z, i, side = last[k], level_below(last[k], low[k], size[k], cells[k]), 1 if rises else 0
    end_of_plane = high[k] if rises else low[k]
    while pieces < most and z != end_of_plane:
        limit = x[k, s - 1] if s > 0 else end_of_plane
        level = low[k] + (i + side) * size[k] if i + side < cells[k] else high[k]
        until = min(level, limit) if rises else max(level, limit)
        if until > z if rises else until < z:
            begin = branch(k, turn, origin, rises, i, low, size, cells, node, value, slope)
            for o in range(at.shape[0]):
                w[k, row + pieces].zone_slope[o] = slope[o]
                w[k, row + pieces].zone_start[o] = value[o] - slope[o] * (begin - rest[k])
                at[o] = value[o] + slope[o] * (until - begin)
            w[k, row + pieces].zone_end = (until if rises else z) - rest[k]
            pieces, z = pieces + 1, until
        if until == limit and s > 1:  # a turn is wiped out, with the one after it
            s -= 2
            turn, origin = x[k, s], tip[k, s]
        if until == level:
            i += 1 if rises else -1
    ends[k, side] = z - rest[k]
    if pieces < most:
        for o in range(at.shape[0]):
            w[k, row + pieces].zone_slope[o] = beyond[k, side, o]
            w[k, row + pieces].zone_start[o] = at[o] - beyond[k, side, o] * (end_of_plane - rest[k])
        w[k, row + pieces].zone_end = z - rest[k]
        pieces, ends[k, side] = pieces + 1, np.inf if rises else -np.inf
    return pieces

"""Compiled time loops of exact inverses that treat each input of a sample as dead-zones.

The map of a sample is piecewise linear in each voltage and has no memory within the sample. It is given to
the walk of ``inverse_kernel`` as dead-zones beside a single play of threshold and weight 0.

* Preisach planes: seen from its memory, the output of an input is a polygon in its voltage: it rises along
  one branch and falls along another, each straight from level to level, and changes branch where a turn is
  wiped out. At first the map holds the two pieces about the last voltage alone; only where they do not hold
  the solution is all of it made.
* Rate-dependent plays: the thresholds of a sample are known before it; plays stand still between p - R and
  p + R and follow outside.
"""

import numpy as np

from hammerstein.compensators.exact.inverse_kernel import ask, drift, walk
from hammerstein.compiled import compiled, helper
from hammerstein.hysteresis.preisach_kernels import branch, level_below, moved
from hammerstein.hysteresis.rate_dependent_kernels import next_rate, threshold


@compiled(error_model="numpy")
def respond_exact_preisach(  # type: ignore[no-untyped-def]
    reference, a, b, gain, away, w, here, plane, memory, first, stop, drive
):
    """Drive (m, N) whose model output is the reference (p, N), from sample first up to stop.

    The drive is overwritten there, the memory updated.

    a, b, gain, away : linear block behind it, as for ``respond_exact``
    plane : rest, low, high, size, cells, node, beyond of the forward loop
    memory : count, x, tip, last of it; the last voltages stand in the tables
    """
    rest, low, high, size, cells, node, _ = plane
    (count, x, tip, last), sent = memory, w["x"][:, 0].copy()
    m, p = drive.shape[0], reference.shape[0]
    new, off = np.empty(away.shape[0]), False
    value, slope, ends = np.empty(p), np.empty(p), np.empty((m, 2))
    for s in range(away.shape[0]):
        off = off or away[s] != 0.0
    for t in range(first, stop):
        ask(reference, t, gain, away, off, here)
        for most in (1, w.shape[1]):
            for k in range(m):
                _map(w, here, k, most, plane, memory, sent[k], value, slope, ends)
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
def _map(w, here, k, most, plane, memory, sent, value, slope, ends):  # type: ignore[no-untyped-def]
    """Put the map of input k into its zones, so many pieces on each side at most, and where it stands.

    sent : its last voltage
    ends : (m, 2) lowest and highest voltage that the map holds, overwritten
    """
    rest, low, high, size, cells, node, _ = plane
    count, x, tip, last = memory
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
    w[k, down - 1].zone_end = min(max(sent, low[k] - rest[k]), high[k] - rest[k])
    up = _side(w, k, down, most, True, plane, memory, value, slope, home, ends)
    w[k, down + up - 1].zone_end = np.inf
    w[k, 0].end, w[k, 0].x, w[k, 0].d = 1, sent, 1.0 if rises else -1.0
    here[k].count, here[k].wanted, here[k].ramp, here[k].fixed = 1, sent, 1.0, -1


@helper(error_model="numpy")
def _side(w, k, row, most, rises, plane, memory, value, slope, home, ends):  # type: ignore[no-untyped-def]
    """Put the pieces on one side of the memory of input k into zones, from row on; gives their number.

    home : (p,) outputs at the last voltage
    """
    rest, low, high, size, cells, node, beyond = plane
    count, x, tip, last = memory
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


@compiled(error_model="numpy")
def respond_exact_rate(reference, a, b, gain, x, w, here, grid, bank, memory, first, stop, drive):  # type: ignore[no-untyped-def]
    """Drive (m, N) whose model output is the reference (p, N), from sample first up to stop.

    The drive is overwritten there, plays and rates are updated.

    a, b, gain, x : linear block behind it, as for ``respond_exact``; the others as for the forward loop
    grid : sample time and poles; bank : n, r, b, lam and w of the plays; memory : plays, last voltages, rates
    """
    (sample_time, pole), (n, r, grow, lam, weights), (plays, last, rate) = grid, bank, memory
    m, p = drive.shape[0], reference.shape[0]
    new, away = np.empty(x.shape[0]), False
    reach, (events, bend) = np.zeros(r.shape), np.empty((2, 2 * r.shape[1]))
    owner, order = np.empty(2 * r.shape[1], np.int64), np.arange(2 * r.shape[1])
    for s in range(x.shape[0]):
        away = away or x[s] != 0.0
    for t in range(first, stop):
        for k in range(m):
            next_rate(k, sample_time, pole, last, rate)
            for i in range(n[k]):
                reach[k, i] = threshold(k, i, r, grow, lam, rate)
            _zones_of(w, k, n[k], plays, reach, weights, events, owner, bend, order)
            here[k].wanted = w[k, 0].x
        ask(reference, t, gain, x, away, here)
        walk(False, 0, w, here)
        for o in range(p):
            away = away or (here[o].missed != 0.0 and x.shape[0] > 0)
        for k in range(m):
            u = here[k].u
            drive[k, t] = u
            for i in range(n[k]):
                plays[k, i] = max(u - reach[k, i], min(u + reach[k, i], plays[k, i]))
            last[k, 1], last[k, 0] = last[k, 0], u
        if away:
            away = drift(reference, t, a, b, x, new, w, here)


@helper(error_model="numpy")
def _zones_of(w, k, n, plays, reach, weights, events, owner, bend, order):  # type: ignore[no-untyped-def]
    """Put the map of one sample of input k into its zones: at their ends a play is let go or taken up."""
    rows, count = weights.shape[2], 0
    for i in range(n):
        if reach[k, i] > 0.0:  # a play of threshold 0 never stands still
            events[count], events[count + 1] = plays[k, i] - reach[k, i], plays[k, i] + reach[k, i]
            owner[count], owner[count + 1] = i, i
            bend[count], bend[count + 1] = -1.0, 1.0
            count += 2
    _sort(events, count, order)
    for o in range(rows):
        slope, begin = 0.0, 0.0
        for i in range(n):
            slope += weights[k, i, o]
            begin += weights[k, i, o] * reach[k, i]
        w[k, 0].zone_slope[o], w[k, 0].zone_start[o] = slope, begin
    for z in range(count):
        event, i = events[order[z]], owner[order[z]]
        w[k, z].zone_end = event
        for o in range(rows):
            change = bend[order[z]] * weights[k, i, o]
            w[k, z + 1].zone_slope[o] = w[k, z].zone_slope[o] + change
            w[k, z + 1].zone_start[o] = w[k, z].zone_start[o] - change * event
    w[k, count].zone_end = np.inf


@helper()
def _sort(events, count, order):  # type: ignore[no-untyped-def]
    """Sort the first ``count`` entries of order by event; equal events by their numbers.

    The previous order only affects the time this takes: it hardly changes from sample to sample.
    """
    if count != order.shape[0]:
        for i in range(order.shape[0]):
            order[i] = i
    for i in range(1, count):
        now, j = order[i], i - 1
        event = events[now]
        while j >= 0 and (events[order[j]] > event or (events[order[j]] == event and order[j] > now)):
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = now

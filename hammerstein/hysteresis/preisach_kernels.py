"""Compiled time loop of the Preisach model on a plane of square cells.

The memory of an input is the staircase of its dominant turns, the oldest first: x[0] is the low end of the
plane, then highest and lowest turns in alternation, each inside the two before it. Turns with even numbers
are lowest ones, so that an even top means that the input rises from it. With the Everett function E, the
weight of the triangle between two voltages, a branch is

    rising from b:   y = tip + E(u, b),      falling from a:   y = tip - E(a, u)

``tip`` is the output at the turn. When the input returns to a turn, that turn and the next one are wiped out,
and the branch before continues from its own tip. E is known at the levels and bilinear between them (linear
on the
cells of the diagonal), so that a branch is a straight line between two levels. A sample costs one line; a
level or a turn, a new one.

Sources: Mayergoyz, Mathematical Models of Hysteresis (1991), chapter 1 (staircase, Everett function).
"""

import numpy as np

from hammerstein.compiled import compiled, helper


@compiled()
def respond_preisach(  # type: ignore[no-untyped-def]
    u, rest, low, high, size, cells, node, beyond, count, x, tip, last, first, stop, y
):
    """Outputs of the staircases; the memory is updated in place.

    u : (m, N), counted from rest (m,); low, high, size, cells : (m,) ends of each plane, width of a cell
    node : (m, n+1, n+1, p) Everett function at the levels
    beyond : (m, 2, p) slopes below and above the plane
    count : (m,) turns; x : (m, turn); tip : (m, turn, p); last : (m,) voltage within the plane
    y : (p, N), overwritten from sample first up to stop
    """
    p = y.shape[0]
    value, slope = np.empty(p), np.empty(p)
    y[:, first:stop] = 0.0
    for k in range(u.shape[0]):
        top, i = count[k] - 1, level_below(last[k], low[k], size[k], cells[k])
        begin = branch(k, x[k, top], tip[k, top], top % 2 == 0, i, low, size, cells, node, value, slope)
        for t in range(first, stop):
            whole = u[k, t] + rest[k]
            z = min(max(whole, low[k]), high[k])
            if z != last[k]:
                before = top
                top = moved(k, z, top, begin, value, slope, x, tip, last)
                now = level_below(z, low[k], size[k], cells[k])
                if top != before or now != i:
                    i = now
                    begin = branch(
                        k, x[k, top], tip[k, top], top % 2 == 0, i, low, size, cells, node, value, slope
                    )
            past = whole - z
            for o in range(p):
                y[o, t] += value[o] + slope[o] * (z - begin)
                if past != 0.0:
                    y[o, t] += beyond[k, 1 if past > 0.0 else 0, o] * past
        count[k] = top + 1


@helper()
def level_below(z, low, size, cells):  # type: ignore[no-untyped-def]
    """Number of the cell that holds a voltage of the plane."""
    return min(np.int64((z - low) / size), cells - 1)


@helper()
def branch(k, turn, tip, rises, i, low, size, cells, node, value, slope):  # type: ignore[no-untyped-def]
    """Line of a branch of input k in cell i: output value + slope (u - begin); returns begin.

    turn, tip : where the branch begins, and the outputs (p,) there; value, slope : (p,), overwritten
    """
    j = level_below(turn, low[k], size[k], cells[k])
    share = (turn - (low[k] + j * size[k])) / size[k]
    if i == j or (i < j) == rises:  # in the cell of the turn itself
        for o in range(value.shape[0]):
            value[o], slope[o] = tip[o], node[k, j + 1, j, o] / size[k]
        return turn
    near, far = (i, i + 1) if rises else (i + 1, i)
    for o in range(value.shape[0]):
        if rises:
            here = (1.0 - share) * node[k, near, j, o] + share * node[k, near, j + 1, o]
            there = (1.0 - share) * node[k, far, j, o] + share * node[k, far, j + 1, o]
            value[o] = tip[o] + here
        else:
            here = (1.0 - share) * node[k, j, near, o] + share * node[k, j + 1, near, o]
            there = (1.0 - share) * node[k, j, far, o] + share * node[k, j + 1, far, o]
            value[o] = tip[o] - here
        slope[o] = (there - here) / size[k]
    return low[k] + near * size[k]


@helper()
def moved(k, z, top, begin, value, slope, x, tip, last):  # type: ignore[no-untyped-def]
    """Move input k to another voltage of the plane, with storage and wiping-out of turns; returns the top.

    begin, value, slope : the line on which it stands
    """
    rises = z > last[k]
    if rises == (top % 2 == 1):  # it turns
        if top + 1 == x.shape[1]:
            top = forgotten(k, top, x, tip)
        top += 1
        x[k, top] = last[k]
        for o in range(value.shape[0]):
            tip[k, top, o] = value[o] + slope[o] * (last[k] - begin)
    way = 1.0 if rises else -1.0
    while top > 0 and way * (z - x[k, top - 1]) >= 0.0:
        top -= 2
    last[k] = z
    return max(top, 0)


@helper()
def forgotten(k, top, x, tip):  # type: ignore[no-untyped-def]
    """Remove the two consecutive turns with the smallest corner of the staircase; returns the top."""
    least, area = 1, np.inf
    for s in range(1, top - 1):
        own = abs(x[k, s + 2] - x[k, s]) * abs(x[k, s + 1] - x[k, s - 1])
        if own < area:
            least, area = s, own
    for s in range(least, top - 1):
        x[k, s] = x[k, s + 2]
        for o in range(tip.shape[2]):
            tip[k, s, o] = tip[k, s + 2, o]
    return top - 2

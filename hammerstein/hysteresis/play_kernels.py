"""Compiled time loops of the play operators.

The textbook loop (``play_bank``) updates every operator in every sample. The turning-point form below gives
the same outputs at a cost a sample that does not grow with the number of operators.

The operators of one input share one grid of increasing thresholds r[0] < r[1] < ... . Neighbouring operators
that were last engaged together form a *segment*: operators ``start..end-1`` with outputs

    p[i] = x - d r[i],      d = +1 rising, -1 falling, 0 never engaged since the start

and the segments form a stack: the top one begins at operator 0, the bottom one ends at the last operator.
Moving the input in one direction engages a prefix of the grid; the prefix becomes the new top segment
and wipes out the segments that it covers (the wiping-out property of Prandtl-Ishlinskii models). Below it
lies a segment (x', d') whose operator k engages when

    direction (u - x') > (1 - direction d') r[k]

With the first k operators engaged, the output is a line in u that starts at the tip of that segment, the
point (x', y') where it was last on top:

    y = y' + W[k] (u - x') - (direction - d') R[k]

    W[k] = w[0] + ... + w[k-1],   R[k] = w[0] r[0] + ... + w[k-1] r[k-1]

So a sample costs one line; an engagement, one search in the grid and one new line; a reversal, one push and a
few pops. No reversal touches all operators. The tips follow from the stack alone, from the bottom upwards. A
signal cut in pieces therefore gives the same numbers to the last bit.

In the turning-point form, a turn costs as much as updating fifty operators. An input with
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

Between two calls its memory is still a stack, with one segment for each operator and d = 0.

Source: Brokate and Sprekels, Hysteresis and Phase Transitions (1996), chapter 2 (play operator, memory).
"""

import numpy as np

from hammerstein.compiled import at, compiled, helper

# A habit that these loops owe half of their speed to, beside the unsigned index: helpers use every array on
# each way through them, and take arrays one by one, not in tuples: then Numba proves that it need not count
# references to them.

BLOCK = 2048  # samples of all inputs and outputs that stay in the processor's cache together


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


@compiled()
def play_bank(u, r, plays, first, stop, p):  # type: ignore[no-untyped-def]
    """Outputs of every play: u (N,), r (n,), plays (n,) updated, p (n, N) overwritten from first to stop."""
    for i in range(r.shape[0]):
        now = plays[i]
        for t in range(first, stop):
            now = max(u[at(t)] - r[i], min(u[at(t)] + r[i], now))
            p[i, at(t)] = now
        plays[i] = now


@helper()
def first_at_least(level, where, r, guide):  # type: ignore[no-untyped-def]
    """First operator with r[i] >= level, for a level from 0 to the largest threshold.

    where : level times the scale of ``search_guide``; guide : (levels,) of one input
    """
    i = guide[at(np.int64(where))]
    i += np.int64(r[at(i)] < level)  # without a branch: nobody can predict it in a noisy signal
    last = r.shape[0] - 1
    while r[at(i)] < level:  # rare: thresholds closer together than the steps of the guide
        middle = (i + 1 + last) // 2
        if r[at(middle)] < level:
            i = middle
        else:
            i, last = i + 1, middle
    return i


@compiled(inline="always")
def move(i, u, r, w, rw, count, end, x, d, below, v):  # type: ignore[no-untyped-def]
    """Move input i to u and add its outputs to v (p,); its stack is updated in place.

    This form is for laws that compute the next sample from this one. ``below`` is the contribution of the
    segments under each one. The output is W[k] x - d R[k] + below, with x, d, below and k = end of the top
    segment. The function takes whole arrays and an index and makes no calls, because rows and calls would
    cost more than the rest.

    r : (m, n_max) thresholds; w, rw : (m, n_max+1, p) partial sums of weights and of weights times thresholds
    count : (m,); end, x, d : (m, n_max+1) the stacks; below : (m, n_max+1, p)
    """
    top = count[i] - 1
    gap = u - x[i, at(top)]
    direction = 1.0 if gap > 0.0 else -1.0
    if direction * gap <= (1.0 - direction * d[i, at(top)]) * r[i, 0]:  # at rest: it moves to where it is
        u, direction = x[i, at(top)], d[i, at(top)]
    same = d[i, at(top)] == direction
    base, k = (top - 1, end[i, at(top)]) if same else (top, 0)
    while base >= 0 and _wipes_out(i, u, direction, base, r, end, x, d):
        k = end[i, at(base)]
        base -= 1
    held, s = (1.0, base) if base >= 0 else (0.0, 0)
    last = end[i, at(s)]
    gap, factor = direction * (u - x[i, at(s)]), 1.0 - direction * d[i, at(s)]
    k = _engaged(i, gap, factor, r, k, last if base >= 0 else k)
    new = base + 1
    kept = same and new == top and k == end[i, at(top)]
    for o in range(v.shape[0]):
        if not kept:
            rest = x[i, at(s)] * (w[i, at(last), at(o)] - w[i, at(k), at(o)])
            rest -= d[i, at(s)] * (rw[i, at(last), at(o)] - rw[i, at(k), at(o)])
            below[i, at(new), at(o)] = held * (below[i, at(s), at(o)] + rest)
        line = w[i, at(k), at(o)] * u - direction * rw[i, at(k), at(o)]
        v[at(o)] += line + below[i, at(new), at(o)]
    x[i, at(new)], d[i, at(new)], end[i, at(new)] = u, direction, k
    count[i] = new + 1


@helper()
def _wipes_out(i, u, direction, s, r, end, x, d):  # type: ignore[no-untyped-def]
    """Whether moving input i to u engages the last operator of segment s."""
    reach = (1.0 - direction * d[i, at(s)]) * r[i, at(end[i, at(s)] - 1)]
    return direction * (u - x[i, at(s)]) > reach


@helper()
def _engaged(i, gap, factor, r, k, end):  # type: ignore[no-untyped-def]
    """First operator in k..end that a gap does not engage: factor r[i] >= gap (galloping search)."""
    low, high, step = k, end, 1
    while low < high:
        middle = min(low + step, high) - 1
        if factor * r[i, at(middle)] < gap:
            low, step = middle + 1, 2 * step
        else:
            high, step = middle, max(1, (middle - low) // 2)
    return low


@helper()
def _direction(u, r, x, d, top):  # type: ignore[no-untyped-def]
    """+1 or -1 on the way to u, and whether operator 0 rests, as it does within its dead zone."""
    gap = u - x[at(top)]
    direction = 1.0 if gap > 0.0 else -1.0
    return direction, direction * gap <= (1.0 - direction * d[at(top)]) * r[0]


@helper()
def _base(u, direction, r, top, end, x, d):  # type: ignore[no-untyped-def]
    """Uppermost segment that moving to u does not wipe out, and how many operators move above it."""
    same = d[at(top)] == direction
    s = top - 1 if same else top
    k = end[at(top)] if same else 0
    while s > 0 and direction * (u - x[at(s)]) > (1.0 - direction * d[at(s)]) * r[at(end[at(s)] - 1)]:
        k = end[at(s)]
        s -= 1
    return s, k


@compiled()
def respond_turning_points(  # type: ignore[no-untyped-def]
    u, r, guide, scale, n, lines, w, count, end, x, d, below, window, begin, finish, y, outputs
):
    """Turning-point form: the same outputs as the textbook loop; the memory is updated in place.

    u : (m, N), from sample begin up to finish; r : (m, n_max); guide, scale : ``search_guide``; n : (m,)
    lines : (m, n_max+1, 2 p) W of each output, then R of each output; w : (m, n_max, p) weights
    count : (m,); end, x, d : (m, n_max+1); below : (m, n_max+1, p), see ``move``
    window : (m, columns), see above; y : (p, N), overwritten
    outputs : p zeros in a tuple: a number of outputs that the compiler knows, for it unrolls their loops

    Returns finish, or the first sample of the block in which it met an input that is not finite.
    """
    m, height = u.shape[0], r.shape[1] + 2
    ends, xs, ds = np.empty((m, height), np.int64), np.empty((m, height)), np.empty((m, height))
    tips, plays = np.empty((m, height, len(outputs))), np.empty((m, height))
    kept = np.empty((GROUP, min(WINDOW, finish - begin)))
    for k in range(m):
        load(n[k], lines[k], count[k], end[k], x[k], d[k], ends[k], xs[k], ds[k], tips[k], outputs)
        plays_of(r[k], count[k], ends[k], xs[k], ds[k], plays[k])
    for start in range(begin, finish, BLOCK):
        stop = min(start + BLOCK, finish)
        y[:, start:stop] = 0.0
        for k in range(m):
            if not _finite(u[k], start, stop):
                return start
            if n[k] > 0:
                count[k] = respond_block(
                    u[k], start, stop, r[k], guide[k], scale[k], lines[k], w[k], count[k],
                    ends[k], xs[k], ds[k], tips[k], plays[k], window[k], kept, y, outputs,
                )  # fmt: skip
    for k in range(m):
        if window[k, BUSY]:
            count[k] = stack_of(plays[k], lines[k], ends[k], xs[k], ds[k], tips[k], outputs)
        _save(lines[k], count[k], ends[k], xs[k], ds[k], end[k], x[k], d[k], below[k])
    return finish


@helper()
def load(n, lines, count, end, x, d, ends, xs, ds, tips, outputs):  # type: ignore[no-untyped-def]
    """Copy a stack onto n operators at rest, and follow its tips from the bottom upwards."""
    ends[0], xs[0], ds[0] = n, 0.0, 0.0
    tips[0] = 0.0
    for s in range(count):
        ends[s + 1], xs[s + 1], ds[s + 1] = end[s], x[s], d[s]
        way, turn = xs[s + 1] - xs[s], ds[s + 1] - ds[s]
        for o in range(len(outputs)):
            tips[s + 1, o] = _line(way, turn, end[s], o, s, lines, tips, outputs)


@helper()
def plays_of(r, top, end, x, d, plays):  # type: ignore[no-untyped-def]
    """Outputs of all operators of a stack, from top to bottom."""
    first = 0
    for s in range(top, -1, -1):
        for i in range(first, end[s]):
            plays[i] = x[s] - d[s] * r[i]
        first = end[s]


@helper()
def stack_of(plays, lines, end, x, d, tip, outputs):  # type: ignore[no-untyped-def]
    """Stack of plays, one segment per operator; returns its top."""
    n = end[0]
    for s in range(n):
        end[s + 1], x[s + 1], d[s + 1] = n - s, plays[n - 1 - s], 0.0
        for o in range(len(outputs)):
            tip[s + 1, o] = _line(x[s + 1] - x[s], 0.0, n - s, o, s, lines, tip, outputs)
    return n


@helper()
def _save(lines, count, ends, xs, ds, end, x, d, below):  # type: ignore[no-untyped-def]
    """Copy the stack back without its floor, and add up what lies below each segment."""
    p = below.shape[1]
    for s in range(count):
        end[s], x[s], d[s] = ends[s + 1], xs[s + 1], ds[s + 1]
        for o in range(p):
            below[s, o] = 0.0
            if s > 0:
                slope = lines[end[s - 1], o] - lines[end[s], o]
                moment = lines[end[s - 1], p + o] - lines[end[s], p + o]
                below[s, o] = below[s - 1, o] + (x[s - 1] * slope - d[s - 1] * moment)


@helper()
def _finite(u, start, stop):  # type: ignore[no-untyped-def]
    """Whether all samples from start to stop are finite."""
    if np.isfinite(_sum(u, start, stop)):
        return True
    bad = 0
    for t in range(start, stop):  # a sum of finite samples may overflow
        bad += not np.isfinite(u[at(t)])
    return bad == 0


@helper(fastmath={"reassoc"})
def _sum(u, start, stop):  # type: ignore[no-untyped-def]
    """Sum in any order, for a question that does not depend on its last digits."""
    total = 0.0
    for t in range(start, stop):
        total += u[at(t)]
    return total


@compiled()  # by itself, for the closed loop has it too
def respond_block(  # type: ignore[no-untyped-def]
    u, start, stop, r, guide, scale, lines, w, top, end, x, d, tip, plays, window, kept, y, outputs
):
    """Add to y what one input contributes from start to stop, in the form it is in; returns its top."""
    t = start
    while t < stop:
        if window[BUSY]:
            t = respond_busy(u, t, stop, r, w, end[0], plays, window, kept, y, outputs)
            if not window[BUSY]:
                top = stack_of(plays, lines, end, x, d, tip, outputs)
        else:
            t, top = _respond_branches(
                u, t, stop, r, guide, scale, lines, top, end, x, d, tip, window, y, outputs
            )
            if window[BUSY]:
                plays_of(r, top, end, x, d, plays)
    return top


@helper()
def _respond_branches(  # type: ignore[no-untyped-def]
    u, start, stop, r, guide, scale, lines, top, end, x, d, tip, window, y, outputs
):
    """Add to y from start to stop, or to the turn that begins the busy form; return that sample and the top.

    Each turn of the outer loop is one branch, each turn of the inner one a line of it or one sample that
    engages operators. ``level`` is the threshold that a sample reaches on its branch.

    It is one function for speed. With the rest of a branch in a helper, inlined or not, it takes up to 2.7
    times as long, because references are counted anew on each branch. With only the innermost search in a
    helper, it takes up to 1.25 times as long.
    """
    t, seen, turns, rested = start, int(window[SEEN]) - start, int(window[TURNS]), window[RESTED]
    while t < stop:
        direction, rests = _direction(u[at(t)], r, x, d, top)
        if rests:
            if u[at(t)] != x[at(top)]:  # a voltage that stays is no turn, and no matter where it is cut
                rested = 1.0
            for o in range(len(outputs)):
                y[at(o), at(t)] += tip[at(top), at(o)]
            t += 1
            continue
        if direction != d[at(top)] or rested != 0.0:
            turns += 1
            rested = 0.0
            if t + seen >= LOOK:
                if turns * TURN > end[0] * (t + seen):
                    window[:] = 0.0
                    window[BUSY], window[LAST], window[BEFORE] = 1.0, x[at(top)], x[at(top)]
                    return t, top
                seen, turns = -t, 0
        base, k = _base(u[at(t)], direction, r, top, end, x, d)
        x0, turn, unit, reach = _branch(direction, base, r, end, x, d)
        top = base + 1
        rate = scale * unit
        way = u[at(t)] - x0
        level = unit * way
        limit = reach
        if base > 0:
            # Half of the smallest number is 0: a voltage that moves engages operator 0 all the same.
            k = max(k, 1, first_at_least(max(level, 0.0), max(rate * way, 0.0), r, guide))
            limit = min(r[at(k)], reach)
        for o in range(len(outputs)):
            value = _line(way, turn, k, o, base, lines, tip, outputs)
            tip[at(top), at(o)] = value
            y[at(o), at(t)] += value
        turned = t
        t += 1
        while t < stop:
            way = u[at(t)] - x0
            level = unit * way
            if level > limit:
                if level > reach:
                    break
                k = first_at_least(level, rate * way, r, guide)
                limit = r[at(k)]
                for o in range(len(outputs)):
                    y[at(o), at(t)] += _line(way, turn, k, o, base, lines, tip, outputs)
                t += 1
            elif direction * u[at(t)] < direction * u[at(t - 1)]:
                break
            else:
                first, now = t, direction * u[at(t)]
                t += 1
                while t < stop:
                    last, now = now, direction * u[at(t)]
                    if now < last or unit * (u[at(t)] - x0) > limit:
                        break
                    t += 1
                for o in range(len(outputs)):  # ``_line``, with what is constant taken out of the loop
                    slope, moment = lines[at(k), at(o)], turn * lines[at(k), at(len(outputs) + o)]
                    begin = tip[at(base), at(o)]
                    for i in range(first, t):
                        y[at(o), at(i)] += begin + (slope * (u[at(i)] - x0) - moment)
        x[at(top)], d[at(top)], end[at(top)] = u[at(t - 1)], direction, k
        if t > turned + 1:
            for o in range(len(outputs)):
                tip[at(top), at(o)] = _line(x[at(top)] - x0, turn, k, o, base, lines, tip, outputs)
    window[SEEN], window[TURNS], window[RESTED] = stop + seen, turns, rested
    return stop, top


@helper()
def _branch(direction, base, r, end, x, d):  # type: ignore[no-untyped-def]
    """What is constant on a branch: where it begins, its turn, threshold per volt, level that ends it."""
    turn = direction - d[at(base)]
    unit = 0.5 * direction if turn == 2.0 * direction else direction
    reach = r[at(end[at(base)] - 1)]
    if turn == 0.0:
        reach = 0.0
    if base == 0:
        reach = np.inf
    return x[at(base)], turn, unit, reach


@helper()
def _line(way, turn, k, o, base, lines, tip, outputs):  # type: ignore[no-untyped-def]
    """Output o a way u - x' from the tip of the base, with the first k operators engaged."""
    return tip[at(base), at(o)] + (lines[at(k), at(o)] * way - turn * lines[at(k), at(len(outputs) + o)])


@compiled()
def threshold_derivatives(p, before, sign, d):  # type: ignore[no-untyped-def]
    """dp/dr of every play: -1 after it was last moved upwards, 1 after downwards, 0 before it was moved.

    p : (n, N) outputs of the plays; before : (n,) outputs before the first sample
    sign : (n,) derivatives before the first sample, updated in place; d : (n, N) derivatives, overwritten
    """
    for i in range(p.shape[0]):
        last, now = before[i], sign[i]
        for t in range(p.shape[1]):
            if p[i, t] > last:
                now = -1.0
            elif p[i, t] < last:
                now = 1.0
            last = p[i, t]
            d[i, t] = now
        sign[i] = now

"""Compiled solver of Gamma(U) = Y in one sample: a finite walk over the affine pieces of the model.

The smallest threshold r_0 of each input is split off: play(u; r) is play(q; r - r_0) with q = play(u; r_0),
so the model is another one, whose smallest thresholds are 0, behind one play an input. It is solved for q
first; then u = q + r_0 while q rises, q - r_0 while it falls.

Seen from its memory, the output of every input is a polygon in q_k: rising from the last q_k or falling from
it, straight between two engagements (see ``hysteresis.kernels`` for the stack of segments that says where).
In one box of pieces the model is J q + c, column k of J being the slope of input k. The walk (Katzenelson's
method) aims at q* = J^-1 (y - c), goes there in a straight line, stops where the first input reaches the
end of its piece, lets that input change its piece, and aims again, until q* lies inside. Where all
determinants of J have one sign it ends after finitely many pieces; the last value is the affine solution
itself, so no error accumulates. At a corner the input of least index goes first (Murty's rule).

An input that would leave its range stands still at the range, and takes one equation with it. The range is
that of u, so that q has another one in each direction: it may rise up to HIGH = u_high - r_0 and fall down to
LOW = u_low + r_0. Where the actuator starts beyond one of them it can move the other way only.

Sources: Katzenelson, Bell System Technical Journal 44 (1965) 1605-1620; Fujisawa and Kuh, SIAM Journal on
Applied Mathematics 22 (1972) 307-328 (one sign suffices); Murty, Opsearch 11 (1974) 123-130 (least
index).
"""

from __future__ import annotations

import numpy as np

from hammerstein.compensators.exact.pieces import (
    ABOUT,
    AIM,
    AT,
    COUNT,
    DEPTH,
    FAR,
    FIXED,
    GAIN,
    HAND,
    HERE,
    HIGH,
    INVERSE,
    JACOBIAN,
    LEFT,
    LOW,
    MISSED,
    NEAR,
    NOW,
    PLAY,
    QUALITY,
    RAMP,
    REACH,
    SIGMA,
    SOFT,
    STACK,
    STILL,
    TOTAL,
    WANTED,
    Q,
    U,
    X,
    Y,
    first_piece,
    jacobian,
    next_piece,
    output,
    previous_piece,
    push,
)
from hammerstein.compensators.kernels import from_rest, to_sent
from hammerstein.compiled import compiled
from hammerstein.hysteresis.play_kernels import at

GONE = 1e-12


@compiled(error_model="numpy")
def respond_exact(reference, virtual, a, b, gain, x, w, first, stop, drive):  # type: ignore[no-untyped-def]
    """Drive (m, N) whose model output is the reference (p, N), from sample first up to stop.

    The drive is overwritten there, the memory updated.
    Behind a linear block (a (n, n), b (n, p)), x (n,) is how far its state is from the one that belongs to
    the reference, as it is after the range was reached; ``reference - gain x`` is asked for until it is not.
    """
    p = reference.shape[0]
    new = np.empty(x.shape[0])
    away = False
    for s in range(x.shape[0]):
        away = away or x[s] != 0.0
    ready = prepare(w)
    for t in range(first, stop):
        for o in range(p):
            w[HERE, o, NOW, Y] = reference[o, at(t)]
            if away:
                for s in range(x.shape[0]):
                    w[HERE, o, NOW, Y] -= gain[o, s] * x[s]
        if not (ready and stay(w)):
            ready = walk(ready, virtual, w)
            for o in range(p):
                away = away or (w[HERE, o, NOW, MISSED] != 0.0 and x.shape[0] > 0)
        for k in range(drive.shape[0]):
            drive[k, at(t)] = w[HERE, k, NOW, U]
        if away:
            away = drift(reference, t, a, b, x, new, w)


@compiled(error_model="numpy")
def step_exact(sample, frame, table, stack, hand):  # type: ignore[no-untyped-def]
    """Voltages as they are sent (m,), stack and hand after one sample (p,), and whether all is finite.

    frame : (4, m) origin of the reference, working point, lowest and highest voltage
    table : of the design; stack, hand : the memory; nothing of these is written to
    """
    m, p = table.shape[1], sample.shape[0]
    w = loaded(table, stack, hand)
    reference, drive, sent = np.empty((p, 1)), np.empty((m, 1)), np.empty(m)
    none, away = np.empty((0, 0)), np.empty(0)
    sound = from_rest(sample, frame, reference)
    if sound:
        respond_exact(reference, m - p, none, np.empty((0, p)), np.empty((p, 0)), away, w, 0, 1, drive)
        sound = to_sent(drive, frame, sent)
    after, held = np.empty(stack.shape), np.empty(hand.shape)
    unloaded(w, after, held)
    return sent, after, held, sound


@compiled(error_model="numpy")
def loaded(table, stack, hand):  # type: ignore[no-untyped-def]
    """Copy of the table of a design with the memory in it."""
    w = table.copy()
    for k in range(w.shape[1]):
        for s in range(stack.shape[1]):
            for c in range(stack.shape[2]):
                w[STACK, k, s, c] = stack[k, s, c]
        for c in range(hand.shape[1]):
            w[HERE, k, HAND, c] = hand[k, c]
    return w


@compiled(error_model="numpy")
def unloaded(w, stack, hand):  # type: ignore[no-untyped-def]
    """Put the memory of a table into stack and hand."""
    for k in range(w.shape[1]):
        for s in range(stack.shape[1]):
            for c in range(stack.shape[2]):
                stack[k, s, c] = w[STACK, k, s, c]
        for c in range(hand.shape[1]):
            hand[k, c] = w[HERE, k, HAND, c]


@compiled(error_model="numpy")
def drift(reference, t, a, b, x, new, w):  # type: ignore[no-untyped-def]
    """Move the distance x of the linear block by one sample; False once it is gone."""
    for s in range(x.shape[0]):
        new[s] = 0.0
        for q in range(x.shape[0]):
            new[s] += a[s, q] * x[q]
        for o in range(reference.shape[0]):
            new[s] += b[s, o] * (w[HERE, o, NOW, Y] + w[HERE, o, NOW, MISSED] - reference[o, at(t)])
    largest = 0.0
    for s in range(x.shape[0]):
        largest = max(largest, abs(new[s]))
    for s in range(x.shape[0]):
        x[s] = new[s] if largest > GONE else 0.0
    return largest > GONE


@compiled(error_model="numpy")
def prepare(w):  # type: ignore[no-untyped-def]
    """Put the walk where the memory is; True where ``stay`` may start from there."""
    ready = True
    for k in range(w.shape[1]):
        w[HERE, k, NOW, FIXED] = -1.0
        w[HERE, k, NOW, U] = w[HERE, k, HAND, WANTED] + w[HERE, k, HAND, RAMP] * w[HERE, k, ABOUT, PLAY]
        ready = first_piece(w, k, 0.0) and ready
        if w[HERE, k, ABOUT, SOFT] > 0.0 and w[HERE, k, HAND, RAMP] != w[HERE, k, NOW, SIGMA]:
            ready = False
    jacobian(w)
    return ready and w[HERE, 0, NOW, QUALITY] == 2.0


@compiled(error_model="numpy")
def stay(w):  # type: ignore[no-untyped-def]
    """Solve within the pieces of the last sample; False, and no memory changed, where they do not hold q."""
    m = w.shape[1]
    for k in range(m):
        q = 0.0
        for o in range(m):
            q += w[HERE, k, INVERSE, o] * (w[HERE, o, NOW, Y] - w[HERE, o, NOW, TOTAL])
        w[HERE, k, NOW, AIM] = q
        d = w[HERE, k, NOW, SIGMA]
        if d * (q - w[HERE, k, NOW, Q]) < -w[HERE, k, ABOUT, STILL] or d * (q - w[HERE, k, NOW, REACH]) > 0.0:
            return False
    for k in range(m):
        d, q = w[HERE, k, NOW, SIGMA], w[HERE, k, NOW, AIM]
        if d * (q - w[HERE, k, NOW, Q]) > 0.0:
            w[HERE, k, NOW, Q] = q
            w[HERE, k, NOW, NEAR] = q
            w[HERE, k, NOW, U] = q + d * w[HERE, k, ABOUT, PLAY]
            w[STACK, k, int(w[HERE, k, HAND, COUNT]) - 1, X] = q
            w[HERE, k, HAND, WANTED] = q
        w[HERE, k, NOW, MISSED] = 0.0
    return True


@compiled(error_model="numpy")
def walk(ready, virtual, w):  # type: ignore[no-untyped-def]
    """Solve one sample from the memory, whatever it takes; drive and memory are those of what was reached.

    ready : whether the walk stands at the memory already. Returns what ``prepare`` does.
    """
    m = w.shape[1]
    exact = True
    while True:
        if not ready:
            for k in range(m):
                first_piece(w, k, 0.0)
            jacobian(w)
        exact = _to_target(w) and exact
        if not _fix_one(virtual, w):
            break
        exact = ready = False
    whole = exact
    for k in range(m):
        moved, lags = _commit(w, k)
        exact = exact and not lags
        whole = whole and moved and not lags
    if whole:
        # The pieces of the walk are those of the memory now, and so are the Jacobian and its inverse.
        for k in range(m):
            w[HERE, k, NOW, NEAR] = w[HERE, k, NOW, Q]
            w[HERE, k, NOW, DEPTH] = w[HERE, k, NOW, MISSED] = 0.0
        return w[HERE, 0, NOW, QUALITY] == 2.0
    ready = prepare(w)
    for o in range(m):
        w[HERE, o, NOW, MISSED] = 0.0 if exact else output(w, o) - w[HERE, o, NOW, Y]
    return ready


@compiled(error_model="numpy")
def _aim(w):  # type: ignore[no-untyped-def]
    """Aim of the present pieces, J^-1 (y - c), corrected once against a poorly conditioned J."""
    m = w.shape[1]
    for k in range(m):
        aim = 0.0
        for o in range(m):
            aim += w[HERE, k, INVERSE, o] * (w[HERE, o, NOW, Y] - w[HERE, o, NOW, TOTAL])
        w[HERE, k, NOW, AIM] = aim
    for o in range(m):
        left = w[HERE, o, NOW, Y] - w[HERE, o, NOW, TOTAL]
        for k in range(m):
            left -= w[HERE, o, JACOBIAN, k] * w[HERE, k, NOW, AIM]
        w[HERE, o, NOW, LEFT] = left
    for k in range(m):
        more = 0.0
        for o in range(m):
            more += w[HERE, k, INVERSE, o] * w[HERE, o, NOW, LEFT]
        w[HERE, k, NOW, AIM] += more


@compiled()
def most_pieces(w):  # type: ignore[no-untyped-def]
    """Pieces after which a walk is given up; one in a model with an inverse ends far sooner."""
    return 64 + 8 * w.shape[1] * w.shape[2]


@compiled(error_model="numpy")
def _to_target(w):  # type: ignore[no-untyped-def]
    """Walk to the target from the first pieces; False where the model lets no walk get there."""
    m = w.shape[1]
    for _ in range(most_pieces(w)):
        if w[HERE, 0, NOW, QUALITY] == 0.0:
            return False
        _aim(w)
        first, share = _first_to_leave(w)
        if first == m:
            for k in range(m):
                near, far = w[HERE, k, NOW, NEAR], w[HERE, k, NOW, FAR]
                w[HERE, k, NOW, Q] = min(max(w[HERE, k, NOW, AIM], min(near, far)), max(near, far))
            return True
        onwards = w[HERE, first, NOW, SIGMA] * (w[HERE, first, NOW, AIM] - w[HERE, first, NOW, Q]) > 0.0
        for k in range(m):
            w[HERE, k, NOW, Q] += share * (w[HERE, k, NOW, AIM] - w[HERE, k, NOW, Q])
        if onwards:
            next_piece(w, first)
        else:
            previous_piece(w, first)
        jacobian(w)
    return False


@compiled(error_model="numpy")
def _first_to_leave(w):  # type: ignore[no-untyped-def]
    """Input that leaves its piece first on the way to the aim, or m if none, and the share until then."""
    first, share = w.shape[1], 1.0
    for k in range(w.shape[1]):
        sigma, q = w[HERE, k, NOW, SIGMA], w[HERE, k, NOW, Q]
        along = sigma * (w[HERE, k, NOW, AIM] - q)
        room = sigma * (w[HERE, k, NOW, FAR] - q if along > 0.0 else q - w[HERE, k, NOW, NEAR])
        way = abs(along)
        if way > room + w[HERE, k, ABOUT, STILL] and max(room, 0.0) < share * way:
            first, share = k, max(room, 0.0) / way
    return first, share


@compiled(error_model="numpy")
def _fix_one(virtual, w):  # type: ignore[no-untyped-def]
    """Fix the input that is furthest outside its range at the range; False where none is outside.

    It takes one row with it: a row without an output if there is one, else the output it moves most.
    """
    m = w.shape[1]
    worst, excess = -1, 0.0
    for k in range(m):
        low, high = _ends(w, k)
        outside = max(w[HERE, k, NOW, Q] - high, low - w[HERE, k, NOW, Q])
        if w[HERE, k, NOW, FIXED] < 0.0 and outside > max(excess, w[HERE, k, ABOUT, STILL]):
            worst, excess = k, outside
    if worst < 0:
        return False
    row, most = -1, -1.0
    for o in range(m):
        gain = w[HERE, worst, ABOUT, GAIN + o]
        size = gain + (1e12 if o >= m - virtual and gain > 0.0 else 0.0)
        taken = False
        for k in range(m):
            taken = taken or w[HERE, k, NOW, FIXED] == o
        if not taken and size > most:
            row, most = o, size
    w[HERE, worst, NOW, FIXED] = row
    low, high = _ends(w, worst)
    w[HERE, worst, NOW, AT] = high if w[HERE, worst, NOW, Q] > high else low
    return True


@compiled(error_model="numpy")
def _ends(w, k):  # type: ignore[no-untyped-def]
    """Least and largest q that input k can get to from its memory."""
    last = w[STACK, k, int(w[HERE, k, HAND, COUNT]) - 1, X]
    return min(w[HERE, k, ABOUT, LOW], last), max(w[HERE, k, ABOUT, HIGH], last)


@compiled(error_model="numpy")
def _commit(w, k):  # type: ignore[no-untyped-def]
    """Put the end of the walk of input k into the memory, and its drive.

    Returns whether the input moved, and whether its smallest play lags behind a soft jump.
    """
    last = w[STACK, k, int(w[HERE, k, HAND, COUNT]) - 1, X]
    q, (low, high) = w[HERE, k, NOW, Q], _ends(w, k)
    if q > high - w[HERE, k, ABOUT, STILL]:
        q = high
    elif q < low + w[HERE, k, ABOUT, STILL]:
        q = low
    lags = False
    if w[HERE, k, ABOUT, SOFT] > 0.0:
        step = 2.0 * (q - w[HERE, k, HAND, WANTED]) / w[HERE, k, ABOUT, SOFT]
        w[HERE, k, HAND, RAMP] = min(max(w[HERE, k, HAND, RAMP] + step, -1.0), 1.0)
        w[HERE, k, HAND, WANTED] = q
        if w[HERE, k, HAND, RAMP] != w[HERE, k, NOW, SIGMA]:
            u = q + w[HERE, k, HAND, RAMP] * w[HERE, k, ABOUT, PLAY]
            q = max(u - w[HERE, k, ABOUT, PLAY], min(u + w[HERE, k, ABOUT, PLAY], last))
            lags = True
    moved = abs(q - last) > w[HERE, k, ABOUT, STILL] or (q != last and q in (low, high))
    if moved:
        while w[HERE, k, NOW, SIGMA] * (q - w[HERE, k, NOW, NEAR]) < 0.0:
            previous_piece(w, k)
        w[HERE, k, NOW, Q] = q
        push(w, k)
        if w[HERE, k, ABOUT, SOFT] == 0.0:
            w[HERE, k, HAND, RAMP] = w[HERE, k, NOW, SIGMA]
            w[HERE, k, HAND, WANTED] = q
    beyond = last < w[HERE, k, ABOUT, LOW] or last > w[HERE, k, ABOUT, HIGH]
    if beyond and w[HERE, k, NOW, FIXED] >= 0.0 and not moved:
        # It cannot move that way from where it started: the voltage goes to the end of the range.
        end = w[HERE, k, ABOUT, LOW] - w[HERE, k, ABOUT, PLAY]
        if last > w[HERE, k, ABOUT, HIGH]:
            end = w[HERE, k, ABOUT, HIGH] + w[HERE, k, ABOUT, PLAY]
        w[HERE, k, HAND, RAMP] = (end - w[HERE, k, HAND, WANTED]) / w[HERE, k, ABOUT, PLAY]
    w[HERE, k, NOW, U] = w[HERE, k, HAND, WANTED] + w[HERE, k, HAND, RAMP] * w[HERE, k, ABOUT, PLAY]
    return moved, lags

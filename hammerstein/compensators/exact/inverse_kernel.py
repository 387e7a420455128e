"""Compiled solver of Gamma(U) = Y in one sample: a finite walk over the affine pieces of the model.

The smallest threshold r_0 of each input is split off: play(u; r) is play(q; r - r_0) with q = play(u; r_0),
so the model is another one, whose smallest thresholds are 0, behind one play an input. It is solved for q
first; then u = q + r_0 while q rises, q - r_0 while it falls.

Seen from its memory, the output of every input is a polygon in q_k: rising from the last q_k or falling from
it, straight between two engagements (the stack of segments of ``hysteresis.play_kernels`` says where).
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

import numpy as np

from hammerstein.compensators.exact.piece_kernels import (
    axes_of,
    first_piece,
    jacobian,
    loaded,
    next_piece,
    output,
    previous_piece,
    push,
    unloaded,
)
from hammerstein.compensators.kernels import from_rest, to_sent
from hammerstein.compiled import at, compiled, helper

GONE = 1e-12
"""State of a recovery [um] that counts as zero."""


@compiled(error_model="numpy")
def respond_exact(reference, virtual, a, b, gain, x, w, here, first, stop, drive):  # type: ignore[no-untyped-def]
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
    ready = resume(w, here)
    for t in range(first, stop):
        ask(reference, t, gain, x, away, here)
        if not (ready and stay(w, here)):
            ready = walk(ready, virtual, w, here)
            for o in range(p):
                away = away or (here[o].missed != 0.0 and x.shape[0] > 0)
        for k in range(drive.shape[0]):
            drive[k, at(t)] = here[k].u
        if away:
            away = drift(reference, t, a, b, x, new, w, here)


@compiled(error_model="numpy")
def step_exact(sample, frame, table, about, stack, hand):  # type: ignore[no-untyped-def]
    """Voltages as they are sent (m,), stack and hand after one sample (p,), and whether all is finite.

    frame : (4, m) origin of the reference, working point, lowest and highest voltage
    table : of the design; stack, hand : the memory; nothing of these is written to
    """
    m, p = table.shape[0], sample.shape[0]
    w, here = loaded(table, about, stack, hand)
    reference, drive, sent = np.empty((p, 1)), np.empty((m, 1)), np.empty(m)
    none, away = np.empty((0, 0)), np.empty(0)
    sound = from_rest(sample, frame, reference)
    if sound:
        respond_exact(reference, m - p, none, np.empty((0, p)), np.empty((p, 0)), away, w, here, 0, 1, drive)
        sound = to_sent(drive, frame, sent)
    after, held = np.empty(stack.shape), np.empty(hand.shape)
    unloaded(w, here, after, held)
    return sent, after, held, sound


@helper(error_model="numpy", forceinline=True)
def ask(reference, t, gain, x, away, here):  # type: ignore[no-untyped-def]
    """Put the target of sample t into the rows; with a linear block off by x, the target that returns it."""
    for o in range(reference.shape[0]):
        here[o].y = reference[o, at(t)]
        if away:
            for s in range(x.shape[0]):
                here[o].y -= gain[o, s] * x[s]


@helper(error_model="numpy")
def drift(reference, t, a, b, x, new, w, here):  # type: ignore[no-untyped-def]
    """Move the distance x of the linear block by one sample; False once it is gone."""
    for s in range(x.shape[0]):
        new[s] = 0.0
        for q in range(x.shape[0]):
            new[s] += a[s, q] * x[q]
        for o in range(reference.shape[0]):
            new[s] += b[s, o] * (here[o].y + here[o].missed - reference[o, at(t)])
    largest = 0.0
    for s in range(x.shape[0]):
        largest = max(largest, abs(new[s]))
    for s in range(x.shape[0]):
        x[s] = new[s] if largest > GONE else 0.0
    return largest > GONE


@helper(error_model="numpy")
def resume(w, here):  # type: ignore[no-untyped-def]
    """Start the walk at the memory; True where ``stay`` may start from there."""
    ready = True
    for k in range(axes_of(here)):
        here[k].fixed = -1
        here[k].u = here[k].wanted + here[k].ramp * here[k].play
        ready = first_piece(w, here, k, 0.0) and ready
        if here[k].soft > 0.0 and here[k].ramp != here[k].sigma:
            ready = False
    jacobian(here)
    return ready and here[0].quality == 2


@helper(error_model="numpy", forceinline=True)
def stay(w, here):  # type: ignore[no-untyped-def]
    """Solve within the pieces of the last sample; False, with unchanged memory, if they do not contain q."""
    m = axes_of(here)
    for k in range(m):
        q = 0.0
        for o in range(m):
            q += here[k].inverse[o] * (here[o].y - here[o].total)
        here[k].aim = q
        d = here[k].sigma
        if d * (q - here[k].q) < -here[k].still or d * (q - here[k].reach) > 0.0:
            return False
    for k in range(m):
        d, q = here[k].sigma, here[k].aim
        if d * (q - here[k].q) > 0.0:
            here[k].q = q
            here[k].near = q
            here[k].u = q + d * here[k].play
            w[k, here[k].count - 1].x = q
            here[k].wanted = q
        here[k].missed = 0.0
    return True


@helper(error_model="numpy")
def walk(ready, virtual, w, here):  # type: ignore[no-untyped-def]
    """Solve one sample from the memory in as many steps as needed, and update drive and memory.

    ready : whether the walk is already at the memory. Returns what ``resume`` returns.
    """
    m = axes_of(here)
    exact = True
    while True:
        if not ready:
            for k in range(m):
                first_piece(w, here, k, 0.0)
            jacobian(here)
        exact = _to_target(w, here) and exact
        if not _fix_one(virtual, w, here):
            break
        exact = ready = False
    whole = exact
    for k in range(m):
        moved, lags = _commit(w, here, k)
        exact = exact and not lags
        whole = whole and moved and not lags
    if whole:
        # The pieces of the walk are those of the memory now, and so are the Jacobian and its inverse.
        for k in range(m):
            here[k].near = here[k].q
            here[k].missed = 0.0
            here[k].depth = 0
        return here[0].quality == 2
    ready = resume(w, here)
    for o in range(m):
        here[o].missed = 0.0 if exact else output(w, here, o) - here[o].y
    return ready


@helper(error_model="numpy", forceinline=True)
def _aim(w, here):  # type: ignore[no-untyped-def]
    """Aim of the present pieces, J^-1 (y - c), corrected once against a poorly conditioned J."""
    m = axes_of(here)
    for k in range(m):
        aim = 0.0
        for o in range(m):
            aim += here[k].inverse[o] * (here[o].y - here[o].total)
        here[k].aim = aim
    for o in range(m):
        left = here[o].y - here[o].total
        for k in range(m):
            left -= here[o].jacobian[k] * here[k].aim
        here[o].left = left
    for k in range(m):
        more = 0.0
        for o in range(m):
            more += here[k].inverse[o] * here[o].left
        here[k].aim += more


@helper()
def most_pieces(w):  # type: ignore[no-untyped-def]
    """Pieces after which a walk is abandoned; with an inverse, it ends far sooner."""
    return 64 + 8 * w.shape[0] * w.shape[1]


@helper(error_model="numpy", forceinline=True)
def _to_target(w, here):  # type: ignore[no-untyped-def]
    """Walk to the target from the first pieces; False where the model lets no walk get there."""
    m = axes_of(here)
    for _ in range(most_pieces(w)):
        if here[0].quality == 0:
            return False
        _aim(w, here)
        first, share = _first_to_leave(w, here)
        if first == m:
            for k in range(m):
                near, far = here[k].near, here[k].far
                here[k].q = min(max(here[k].aim, min(near, far)), max(near, far))
            return True
        onwards = here[first].sigma * (here[first].aim - here[first].q) > 0.0
        for k in range(m):
            here[k].q += share * (here[k].aim - here[k].q)
        if onwards:
            next_piece(w, here, first)
        else:
            previous_piece(w, here, first)
        jacobian(here)
    return False


@helper(error_model="numpy", forceinline=True)
def _first_to_leave(w, here):  # type: ignore[no-untyped-def]
    """Input that leaves its piece first on the way to the aim, or m if none, and the share until then."""
    first, share = axes_of(here), 1.0
    for k in range(axes_of(here)):
        sigma, q = here[k].sigma, here[k].q
        along = sigma * (here[k].aim - q)
        room = sigma * (here[k].far - q if along > 0.0 else q - here[k].near)
        way = abs(along)
        if way > room + here[k].still and max(room, 0.0) < share * way:
            first, share = k, max(room, 0.0) / way
    return first, share


@helper(error_model="numpy", forceinline=True)
def _fix_one(virtual, w, here):  # type: ignore[no-untyped-def]
    """Fix the input that is furthest outside its range at the range; False where none is outside.

    It takes one row with it: a row without an output if there is one, else the output it moves most.
    """
    m = axes_of(here)
    worst, excess = -1, 0.0
    for k in range(m):
        low, high = _ends(w, here, k)
        outside = max(here[k].q - high, low - here[k].q)
        if here[k].fixed < 0 and outside > max(excess, here[k].still):
            worst, excess = k, outside
    if worst < 0:
        return False
    row, most = -1, -1.0
    for o in range(m):
        gain = here[worst].gain[o]
        size = gain + (1e12 if o >= m - virtual and gain > 0.0 else 0.0)
        taken = False
        for k in range(m):
            taken = taken or here[k].fixed == o
        if not taken and size > most:
            row, most = o, size
    here[worst].fixed = row
    low, high = _ends(w, here, worst)
    here[worst].at = high if here[worst].q > high else low
    return True


@helper(error_model="numpy", forceinline=True)
def _ends(w, here, k):  # type: ignore[no-untyped-def]
    """Least and largest q that input k can get to from its memory."""
    at = here[k]
    last = w[k, at.count - 1].x
    return min(at.low, last), max(at.high, last)


@helper(error_model="numpy", forceinline=True)
def _commit(w, here, k):  # type: ignore[no-untyped-def]
    """Put the end of the walk of input k into the memory, and its drive.

    Returns whether the input moved, and whether its smallest play lags behind a soft jump.
    """
    at = here[k]
    last = w[k, at.count - 1].x
    q, (low, high) = at.q, _ends(w, here, k)
    if q > high - at.still:
        q = high
    elif q < low + at.still:
        q = low
    lags = False
    if at.soft > 0.0:
        step = 2.0 * (q - at.wanted) / at.soft
        at.ramp = min(max(at.ramp + step, -1.0), 1.0)
        at.wanted = q
        if at.ramp != at.sigma:
            u = q + at.ramp * at.play
            q = max(u - at.play, min(u + at.play, last))
            lags = True
    moved = abs(q - last) > at.still or (q != last and q in (low, high))
    if moved:
        while at.sigma * (q - at.near) < 0.0:
            previous_piece(w, here, k)
        at.q = q
        push(w, here, k)
        if at.soft == 0.0:
            at.ramp = at.sigma
            at.wanted = q
    beyond = last < at.low or last > at.high
    if beyond and at.fixed >= 0 and not moved:
        # It cannot move that way from where it started: the voltage goes to the end of the range.
        end = at.low - at.play
        if last > at.high:
            end = at.high + at.play
        at.ramp = (end - at.wanted) / at.play
    at.u = at.wanted + at.ramp * at.play
    return moved, lags

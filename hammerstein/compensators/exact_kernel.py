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

An input that would leave its range stands still at the range, and takes one equation with it.

Sources: Katzenelson, Bell System Technical Journal 44 (1965) 1605-1620; Fujisawa and Kuh, SIAM Journal on
Applied Mathematics 22 (1972) 307-328 (one sign suffices); Murty, Linear Algebra and its Applications 9
(1974) 133-140 (least index).

Everything stands in a few tables, first index the input k (or the row o), last index one of the columns
named below; what has one entry a row o stands in the columns from that name on. Few arguments make the
compiled calls cheap.

    grid (m, n_max+1, 1+2m)    R: threshold of operator j; SLOPE, SLOPE+m: sums of w and w r below operator j
    about (m, 4+m)             PLAY: r_0; BOUND: largest |q|; SOFT: ramp of the jump; STILL: no movement;
                               GAIN: size of what input k does to each row
    stack (m, n_max+2, 3+m)    the law's memory, a segment an entry: END, X, D; BELOW: what lies deeper
    hand (m, 3)                also memory: COUNT of segments, WANTED q, RAMP of the jump from -1 to 1
    now (m, 16+m)              where a walk stands; follows from the memory between two samples
    passed (m, n_max+2, 3)     pieces that the walk has passed: PREFIX, OWNER, NEAR
    matrix (3, m, 2m)          J, its inverse, and the elimination
"""

from __future__ import annotations

import numpy as np
from numba import njit

SINGULAR, POOR = 1e-14, 1e3
GONE = 1e-12

R, SLOPE = 0, 1
PLAY, BOUND, SOFT, STILL, GAIN = 0, 1, 2, 3, 4
END, X, D, BELOW = 0, 1, 2, 3
COUNT, WANTED, RAMP = 0, 1, 2
# Of an input: the piece (engaged operators, segment that owns the next one, where it begins and ends, how
# many pieces lie behind), q and its aim, the row taken at the range and where, the drive.
PREFIX, OWNER, NEAR, FAR, SIGMA, DEPTH, Q, AIM, FIXED, AT, U = range(11)
# Of a row: target, sum of the constants, what is left, what the memory has more than the target. Of the
# first row alone: whether the Jacobian is singular (0), inverted poorly (1) or well (2).
Y, TOTAL, LEFT, MISSED, QUALITY = range(11, 16)
CONSTANT = 16


@njit(cache=True, nogil=True, error_model="numpy")
def respond_exact(  # type: ignore[no-untyped-def]
    reference, virtual, a, b, gain, x, grid, about, stack, hand, now, passed, matrix, drive
):
    """Drive (m, N), overwritten, whose model output is the reference (p, N); the memory is updated.

    Behind a linear block (a (n, n), b (n, p)), x (n,) is how far its state is from the one that belongs to
    the reference, as it is after the range was reached; ``reference - gain x`` is asked for until it is not.
    """
    p = reference.shape[0]
    new = x.copy()
    away = np.abs(x).sum() > 0.0
    ready = prepare(grid, about, stack, hand, now, matrix)
    for t in range(reference.shape[1]):
        for o in range(p):
            now[o, Y] = reference[o, t]
            if away:
                for s in range(x.shape[0]):
                    now[o, Y] -= gain[o, s] * x[s]
        if not (ready and stay(about, stack, hand, now, matrix)):
            ready = walk(ready, virtual, grid, about, stack, hand, now, passed, matrix)
            for o in range(p):
                away = away or (now[o, MISSED] != 0.0 and x.shape[0] > 0)
        for k in range(drive.shape[0]):
            drive[k, t] = now[k, U]
        if away:
            away = _drift(reference, t, a, b, x, new, now)


@njit(cache=True, nogil=True, error_model="numpy")
def _drift(reference, t, a, b, x, new, now):  # type: ignore[no-untyped-def]
    """Move the distance x of the linear block by one sample; False once it is gone."""
    for s in range(x.shape[0]):
        new[s] = 0.0
        for q in range(x.shape[0]):
            new[s] += a[s, q] * x[q]
        for o in range(reference.shape[0]):
            new[s] += b[s, o] * (now[o, Y] + now[o, MISSED] - reference[o, t])
    largest = 0.0
    for s in range(x.shape[0]):
        largest = max(largest, abs(new[s]))
    for s in range(x.shape[0]):
        x[s] = new[s] if largest > GONE else 0.0
    return largest > GONE


@njit(cache=True, nogil=True, error_model="numpy")
def prepare(grid, about, stack, hand, now, matrix):  # type: ignore[no-untyped-def]
    """Put the walk where the memory is; True where ``stay`` may start from there."""
    ready = True
    for k in range(now.shape[0]):
        now[k, FIXED] = -1.0
        now[k, U] = hand[k, WANTED] + hand[k, RAMP] * about[k, PLAY]
        ready = _first_piece(grid, stack, hand, now, matrix, k, 0.0) and ready
        if about[k, SOFT] > 0.0 and hand[k, RAMP] != now[k, SIGMA]:
            ready = False
    _jacobian(now, matrix)
    return ready and now[0, QUALITY] == 2.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def stay(about, stack, hand, now, matrix):  # type: ignore[no-untyped-def]
    """Solve within the pieces of the last sample; False, and no memory changed, where they do not hold q."""
    m = now.shape[0]
    for k in range(m):
        q = 0.0
        for o in range(m):
            q += matrix[1, k, o] * (now[o, Y] - now[o, TOTAL])
        now[k, AIM] = q
        d = now[k, SIGMA]
        if d * (q - now[k, Q]) < -about[k, STILL] or d * (q - now[k, FAR]) > 0.0 or abs(q) > about[k, BOUND]:
            return False
    for k in range(m):
        d, q = now[k, SIGMA], now[k, AIM]
        if d * (q - now[k, Q]) > 0.0:
            now[k, Q] = q
            now[k, NEAR] = q
            now[k, U] = q + d * about[k, PLAY]
            stack[k, int(hand[k, COUNT]) - 1, X] = q
            hand[k, WANTED] = q
        now[k, MISSED] = 0.0
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def walk(ready, virtual, grid, about, stack, hand, now, passed, matrix):  # type: ignore[no-untyped-def]
    """Solve one sample from the memory, whatever it takes; drive and memory are those of what was reached.

    ready : whether the walk stands at the memory already. Returns what ``prepare`` does.
    """
    m = now.shape[0]
    exact = True
    while True:
        if not ready:
            for k in range(m):
                _first_piece(grid, stack, hand, now, matrix, k, 0.0)
            _jacobian(now, matrix)
        exact = _to_target(grid, about, stack, hand, now, passed, matrix) and exact
        if not _fix_one(virtual, about, now):
            break
        exact = ready = False
    whole = exact
    for k in range(m):
        moved, lags = _commit(grid, about, stack, hand, now, passed, matrix, k)
        exact = exact and not lags
        whole = whole and moved and not lags
    if whole:
        # The pieces of the walk are those of the memory now, and so are the Jacobian and its inverse.
        for k in range(m):
            now[k, DEPTH], now[k, NEAR], now[k, MISSED] = 0.0, now[k, Q], 0.0
        return now[0, QUALITY] == 2.0
    ready = prepare(grid, about, stack, hand, now, matrix)
    for o in range(m):
        now[o, MISSED] = 0.0 if exact else _output(grid, stack, hand, o) - now[o, Y]
    return ready


@njit(cache=True, nogil=True, error_model="numpy")
def _first_piece(grid, stack, hand, now, matrix, k, direction):  # type: ignore[no-untyped-def]
    """Piece of input k that begins at its memory, in a direction or (0) in that of the last movement.

    False where the input never moved.
    """
    top = int(hand[k, COUNT]) - 1
    d = stack[k, top, D]
    if direction == 0.0:
        direction = d if d != 0.0 else 1.0
    now[k, SIGMA] = direction
    now[k, DEPTH] = 0.0
    now[k, Q] = now[k, NEAR] = stack[k, top, X]
    if d == direction:
        now[k, PREFIX], now[k, OWNER] = stack[k, top, END], top - 1
    else:
        now[k, PREFIX], now[k, OWNER] = 1.0, top if stack[k, top, END] > 1.0 else top - 1
    _describe(grid, stack, now, matrix, k)
    return d != 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _describe(grid, stack, now, matrix, k):  # type: ignore[no-untyped-def]
    """End of the piece of input k, and what it adds to every row: slope q + constant."""
    m = now.shape[0]
    i, j, direction = int(now[k, OWNER]), int(now[k, PREFIX]), now[k, SIGMA]
    now[k, FAR] = direction * np.inf
    if i >= 0:
        now[k, FAR] = stack[k, i, X] + direction * (1.0 - direction * stack[k, i, D]) * grid[k, j, R]
    for o in range(m):
        matrix[0, o, k] = grid[k, j, SLOPE + o]
        below = _below(grid, stack, m, k, i, j, o)
        now[k, CONSTANT + o] = below - direction * grid[k, j, SLOPE + m + o]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _below(grid, stack, m, k, i, j, o):  # type: ignore[no-untyped-def]
    """What the operators from j on add to row o while segment i and those under it stand still."""
    value = 0.0
    if i >= 0:
        end = int(stack[k, i, END])
        line = stack[k, i, X] * (grid[k, end, SLOPE + o] - grid[k, j, SLOPE + o])
        knee = stack[k, i, D] * (grid[k, end, SLOPE + m + o] - grid[k, j, SLOPE + m + o])
        value = stack[k, i, BELOW + o] + line - knee
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def _next_piece(grid, stack, now, passed, matrix, k):  # type: ignore[no-untyped-def]
    """Input k passes the end of its piece: the next operators engage."""
    depth, i = int(now[k, DEPTH]), int(now[k, OWNER])
    for field in range(3):
        passed[k, depth, field] = now[k, field]
    now[k, DEPTH] = depth + 1
    now[k, Q] = now[k, NEAR] = now[k, FAR]
    # A segment of the same direction is caught up with as a whole: its memory is wiped out.
    now[k, PREFIX] = stack[k, i, END] if stack[k, i, D] == now[k, SIGMA] else now[k, PREFIX] + 1.0
    if now[k, PREFIX] == stack[k, i, END]:
        now[k, OWNER] = i - 1
    _describe(grid, stack, now, matrix, k)


@njit(cache=True, nogil=True, error_model="numpy")
def _previous_piece(grid, stack, hand, now, passed, matrix, k):  # type: ignore[no-untyped-def]
    """Input k turns back over the beginning of its piece; from the memory itself it turns around."""
    depth = int(now[k, DEPTH]) - 1
    if depth < 0:
        _first_piece(grid, stack, hand, now, matrix, k, -now[k, SIGMA])
    else:
        now[k, Q] = now[k, NEAR]
        now[k, DEPTH] = depth
        for field in range(3):
            now[k, field] = passed[k, depth, field]
        _describe(grid, stack, now, matrix, k)


@njit(cache=True, nogil=True, error_model="numpy")
def _jacobian(now, matrix):  # type: ignore[no-untyped-def]
    """Sum of the constants and inverse of the Jacobian of the present pieces."""
    m = now.shape[0]
    for o in range(m):
        total = 0.0
        for k in range(m):
            total += now[k, CONSTANT + o]
        now[o, TOTAL] = total
    for k in range(m):
        o = int(now[k, FIXED])
        if o >= 0:
            now[o, TOTAL] = now[o, Y] - now[k, AT]
            for i in range(m):
                matrix[0, o, i] = 1.0 if i == k else 0.0
    now[0, QUALITY] = _invert(matrix)


@njit(cache=True, nogil=True, error_model="numpy")
def _invert(matrix):  # type: ignore[no-untyped-def]
    """Inverse of the Jacobian by elimination with row exchange, and its quality (see QUALITY)."""
    m = matrix.shape[1]
    a, inverse, z = 0, 1, 2
    largest = 0.0
    for i in range(m):
        for j in range(m):
            matrix[z, i, j] = matrix[a, i, j]
            matrix[z, i, m + j] = 1.0 if i == j else 0.0
            largest = max(largest, abs(matrix[a, i, j]))
    for j in range(m):
        best = j
        for i in range(j + 1, m):
            if abs(matrix[z, i, j]) > abs(matrix[z, best, j]):
                best = i
        if abs(matrix[z, best, j]) <= SINGULAR * largest:
            return 0.0
        if best != j:
            for c in range(2 * m):
                matrix[z, j, c], matrix[z, best, c] = matrix[z, best, c], matrix[z, j, c]
        for i in range(m):
            if i != j and matrix[z, i, j] != 0.0:
                factor = matrix[z, i, j] / matrix[z, j, j]
                for c in range(j, 2 * m):
                    matrix[z, i, c] -= factor * matrix[z, j, c]
    size = 0.0
    for i in range(m):
        for j in range(m):
            matrix[inverse, i, j] = matrix[z, i, m + j] / matrix[z, i, i]
            size = max(size, abs(matrix[inverse, i, j]))
    return 2.0 if m * m * size * largest < POOR else 1.0


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _aim(now, matrix):  # type: ignore[no-untyped-def]
    """Aim of the present pieces, J^-1 (y - c), corrected once so that it does not suffer from J's condition."""
    m = now.shape[0]
    for k in range(m):
        aim = 0.0
        for o in range(m):
            aim += matrix[1, k, o] * (now[o, Y] - now[o, TOTAL])
        now[k, AIM] = aim
    for o in range(m):
        left = now[o, Y] - now[o, TOTAL]
        for k in range(m):
            left -= matrix[0, o, k] * now[k, AIM]
        now[o, LEFT] = left
    for k in range(m):
        more = 0.0
        for o in range(m):
            more += matrix[1, k, o] * now[o, LEFT]
        now[k, AIM] += more


@njit(cache=True, nogil=True, error_model="numpy")
def _to_target(grid, about, stack, hand, now, passed, matrix):  # type: ignore[no-untyped-def]
    """Walk to the target from the first pieces; False where the model lets no walk get there."""
    m = now.shape[0]
    for _ in range(64 + 8 * m * grid.shape[1]):
        if now[0, QUALITY] == 0.0:
            return False
        _aim(now, matrix)
        first, share = _first_to_leave(about, now)
        if first < 0:
            for k in range(m):
                low, high = min(now[k, NEAR], now[k, FAR]), max(now[k, NEAR], now[k, FAR])
                now[k, Q] = min(max(now[k, AIM], low), high)
            return True
        onwards = now[first, SIGMA] * (now[first, AIM] - now[first, Q]) > 0.0
        for k in range(m):
            now[k, Q] += share * (now[k, AIM] - now[k, Q])
        if onwards:
            _next_piece(grid, stack, now, passed, matrix, first)
        else:
            _previous_piece(grid, stack, hand, now, passed, matrix, first)
        _jacobian(now, matrix)
    return False


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _first_to_leave(about, now):  # type: ignore[no-untyped-def]
    """Input that leaves its piece first on the way to the aim, or -1, and the share of the way until then."""
    first, share = np.int64(-1), 1.0
    for k in range(now.shape[0]):
        sigma = now[k, SIGMA]
        along = sigma * (now[k, AIM] - now[k, Q])
        room = sigma * (now[k, FAR] - now[k, Q]) if along > 0.0 else sigma * (now[k, Q] - now[k, NEAR])
        way = abs(along)
        if way > room + about[k, STILL] and max(room, 0.0) < share * way:
            first, share = k, max(room, 0.0) / way
    return first, share


@njit(cache=True, nogil=True, error_model="numpy")
def _fix_one(virtual, about, now):  # type: ignore[no-untyped-def]
    """Fix the input that is furthest outside its range at the range; False where none is outside.

    It takes one row with it: a row without an output if there is one, else the output it moves most.
    """
    m = now.shape[0]
    worst, excess = -1, 0.0
    for k in range(m):
        outside = abs(now[k, Q]) - about[k, BOUND]
        if now[k, FIXED] < 0.0 and outside > max(excess, about[k, STILL]):
            worst, excess = k, outside
    if worst < 0:
        return False
    row, most = -1, -1.0
    for o in range(m):
        gain = about[worst, GAIN + o]
        size = gain + (1e12 if o >= m - virtual and gain > 0.0 else 0.0)
        taken = False
        for k in range(m):
            taken = taken or now[k, FIXED] == o
        if not taken and size > most:
            row, most = o, size
    now[worst, FIXED] = row
    now[worst, AT] = about[worst, BOUND] if now[worst, Q] > 0.0 else -about[worst, BOUND]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _commit(grid, about, stack, hand, now, passed, matrix, k):  # type: ignore[no-untyped-def]
    """Put the end of the walk of input k into the memory, and its drive.

    Returns whether the input moved, and whether its smallest play lags behind a soft jump.
    """
    last = stack[k, int(hand[k, COUNT]) - 1, X]
    q = min(max(now[k, Q], -about[k, BOUND]), about[k, BOUND])
    lags = False
    if about[k, SOFT] > 0.0:
        step = 2.0 * (q - hand[k, WANTED]) / about[k, SOFT]
        hand[k, RAMP] = min(max(hand[k, RAMP] + step, -1.0), 1.0)
        hand[k, WANTED] = q
        if hand[k, RAMP] != now[k, SIGMA]:
            u = q + hand[k, RAMP] * about[k, PLAY]
            q = max(u - about[k, PLAY], min(u + about[k, PLAY], last))
            lags = q != hand[k, WANTED]
    moved = abs(q - last) > about[k, STILL]
    if moved:
        while now[k, SIGMA] * (q - now[k, NEAR]) < 0.0:
            _previous_piece(grid, stack, hand, now, passed, matrix, k)
        now[k, Q] = q
        _push(grid, stack, hand, now, k)
        if about[k, SOFT] == 0.0:
            hand[k, RAMP] = now[k, SIGMA]
            hand[k, WANTED] = q
    now[k, U] = hand[k, WANTED] + hand[k, RAMP] * about[k, PLAY]
    return moved, lags


@njit(cache=True, nogil=True, error_model="numpy")
def _push(grid, stack, hand, now, k):  # type: ignore[no-untyped-def]
    """Make the piece that input k stands on the top segment of its stack."""
    m = now.shape[0]
    owner = int(now[k, OWNER])
    new = owner + 1
    for o in range(m):
        stack[k, new, BELOW + o] = _below(grid, stack, m, k, owner, int(now[k, PREFIX]), o)
    stack[k, new, END] = now[k, PREFIX]
    stack[k, new, X] = now[k, Q]
    stack[k, new, D] = now[k, SIGMA]
    hand[k, COUNT] = new + 1


@njit(cache=True, nogil=True, error_model="numpy")
def _output(grid, stack, hand, o):  # type: ignore[no-untyped-def]
    """Output of the memory in row o."""
    m = stack.shape[0]
    output = 0.0
    for k in range(m):
        top = int(hand[k, COUNT]) - 1
        j = int(stack[k, top, END])
        line = grid[k, j, SLOPE + o] * stack[k, top, X] - stack[k, top, D] * grid[k, j, SLOPE + m + o]
        output += line + stack[k, top, BELOW + o]
    return output

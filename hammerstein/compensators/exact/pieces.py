"""The affine pieces of plays and dead-zones seen from their memory, for the walk of ``exact_kernel``.

Everything stands in one array ``w[table, k, row, column]``, for one argument makes the compiled calls cheap.
k is the input (or the row o of the model); what has one entry a row o stands in the columns from its name on.

    GRID     row j: R, threshold of operator j; SLOPE, SLOPE+m, sums of w and of w r below operator j
    STACK    the law's memory, a segment a row: END, X, D; BELOW, what lies deeper
    PASSED   pieces that a walk has passed: PREFIX, OWNER, NEAR, ZONE
    ZONES    row z: TOP, where zone z of the dead-zones ends; SLOPE, SLOPE+m, slope and intercept of its line;
             without dead-zones there is one, of infinite length and slope 0
    HERE     row HAND     also memory: COUNT of segments, WANTED q, RAMP of the jump from -1 to 1
             row ABOUT    PLAY, r_0; LOW, HIGH, least q that falls and largest that rises; SOFT, ramp of the
                          jump; STILL, no movement;
                          GAIN, size of what input k does to each row
             row NOW      where a walk stands; follows from the memory between two samples
             rows JACOBIAN, INVERSE, SCRATCH of the elimination, a row o each
"""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled

SINGULAR, POOR = 1e-14, 1e3

GRID, STACK, PASSED, HERE, ZONES = range(5)
HAND, ABOUT, NOW, JACOBIAN, INVERSE, SCRATCH = range(6)
R, SLOPE = 0, 1
TOP = 0
PLAY, LOW, HIGH, SOFT, STILL, GAIN = 0, 1, 2, 3, 4, 5
END, X, D, BELOW = 0, 1, 2, 3
COUNT, WANTED, RAMP = 0, 1, 2
# Of an input: the piece (engaged operators, segment that owns the next one, where it begins, zone of the
# dead-zones, where it ends, how many pieces lie behind), q and its aim, the row taken at the range and
# where, the drive.
PREFIX, OWNER, NEAR, ZONE, FAR, SIGMA, DEPTH, Q, AIM, FIXED, AT, U = range(12)
KEPT = 4  # of them stand in PASSED
# Of a row: target, sum of the constants, what is left, what the memory has more than the target. Of the
# first row alone: whether the Jacobian is singular (0), inverted poorly (1) or well (2).
Y, TOTAL, LEFT, MISSED, QUALITY = range(12, 17)
# Of an input: how far its piece goes within the range. CONSTANT has one entry a row.
REACH, CONSTANT = 17, 18


@compiled(error_model="numpy")
def first_piece(w, k, direction):  # type: ignore[no-untyped-def]
    """Piece of input k that begins at its memory, in a direction or (0) in that of the last movement.

    False where the input never moved.
    """
    top = int(w[HERE, k, HAND, COUNT]) - 1
    d = w[STACK, k, top, D]
    if direction == 0.0:
        direction = d if d != 0.0 else 1.0
    w[HERE, k, NOW, SIGMA] = direction
    w[HERE, k, NOW, DEPTH] = 0.0
    w[HERE, k, NOW, Q] = w[HERE, k, NOW, NEAR] = w[STACK, k, top, X]
    if d == direction:
        w[HERE, k, NOW, PREFIX] = w[STACK, k, top, END]
        w[HERE, k, NOW, OWNER] = top - 1
    else:
        w[HERE, k, NOW, PREFIX] = 1.0
        w[HERE, k, NOW, OWNER] = top if w[STACK, k, top, END] > 1.0 else top - 1
    w[HERE, k, NOW, ZONE] = _zone(w, k, w[STACK, k, top, X], direction)
    _describe(w, k)
    return d != 0.0


@compiled(error_model="numpy")
def _zone(w, k, q, direction):  # type: ignore[no-untyped-def]
    """Zone of input k that begins at q, or holds it, on the way in a direction."""
    z = 0
    while q > w[ZONES, k, z, TOP] or (q == w[ZONES, k, z, TOP] and direction > 0.0):
        z += 1
    return z


@compiled(error_model="numpy")
def _zone_end(w, k):  # type: ignore[no-untyped-def]
    """Where input k leaves its zone of the dead-zones on its way."""
    z = int(w[HERE, k, NOW, ZONE])
    if w[HERE, k, NOW, SIGMA] > 0.0:
        return w[ZONES, k, z, TOP]
    return w[ZONES, k, z - 1, TOP] if z > 0 else -np.inf


@compiled(error_model="numpy")
def _describe(w, k):  # type: ignore[no-untyped-def]
    """End of the piece of input k, and what it adds to every row: slope q + constant."""
    m = w.shape[1]
    i, j, direction = int(w[HERE, k, NOW, OWNER]), int(w[HERE, k, NOW, PREFIX]), w[HERE, k, NOW, SIGMA]
    w[HERE, k, NOW, FAR] = direction * np.inf
    if i >= 0:
        gap = (1.0 - direction * w[STACK, k, i, D]) * w[GRID, k, j, R]
        w[HERE, k, NOW, FAR] = w[STACK, k, i, X] + direction * gap
    end = _zone_end(w, k)
    if direction * (end - w[HERE, k, NOW, FAR]) < 0.0:
        w[HERE, k, NOW, FAR] = end
    if direction > 0.0:
        w[HERE, k, NOW, REACH] = min(w[HERE, k, NOW, FAR], w[HERE, k, ABOUT, HIGH])
    else:
        w[HERE, k, NOW, REACH] = max(w[HERE, k, NOW, FAR], w[HERE, k, ABOUT, LOW])
    z = int(w[HERE, k, NOW, ZONE])
    for o in range(m):
        w[HERE, o, JACOBIAN, k] = w[GRID, k, j, SLOPE + o] + w[ZONES, k, z, SLOPE + o]
        below = _below(w, m, k, i, j, o) + w[ZONES, k, z, SLOPE + m + o]
        w[HERE, k, NOW, CONSTANT + o] = below - direction * w[GRID, k, j, SLOPE + m + o]


@compiled(error_model="numpy")
def _below(w, m, k, i, j, o):  # type: ignore[no-untyped-def]
    """What the operators from j on add to row o while segment i and those under it stand still."""
    value = 0.0
    if i >= 0:
        end = int(w[STACK, k, i, END])
        line = w[STACK, k, i, X] * (w[GRID, k, end, SLOPE + o] - w[GRID, k, j, SLOPE + o])
        knee = w[STACK, k, i, D] * (w[GRID, k, end, SLOPE + m + o] - w[GRID, k, j, SLOPE + m + o])
        value = w[STACK, k, i, BELOW + o] + line - knee
    return value


@compiled(error_model="numpy")
def next_piece(w, k):  # type: ignore[no-untyped-def]
    """Input k passes the end of its piece: the next operators engage, or it enters another zone."""
    depth, i = int(w[HERE, k, NOW, DEPTH]), int(w[HERE, k, NOW, OWNER])
    for field in range(KEPT):
        w[PASSED, k, depth, field] = w[HERE, k, NOW, field]
    w[HERE, k, NOW, DEPTH] = depth + 1
    w[HERE, k, NOW, Q] = w[HERE, k, NOW, NEAR] = w[HERE, k, NOW, FAR]
    if _zone_end(w, k) == w[HERE, k, NOW, FAR]:
        w[HERE, k, NOW, ZONE] += w[HERE, k, NOW, SIGMA]
        _describe(w, k)
        return
    # A segment of the same direction is caught up with as a whole: its memory is wiped out.
    same = w[STACK, k, i, D] == w[HERE, k, NOW, SIGMA]
    w[HERE, k, NOW, PREFIX] = w[STACK, k, i, END] if same else w[HERE, k, NOW, PREFIX] + 1.0
    if w[HERE, k, NOW, PREFIX] == w[STACK, k, i, END]:
        w[HERE, k, NOW, OWNER] = i - 1
    _describe(w, k)


@compiled(error_model="numpy")
def previous_piece(w, k):  # type: ignore[no-untyped-def]
    """Input k turns back over the beginning of its piece; from the memory itself it turns around."""
    depth = int(w[HERE, k, NOW, DEPTH]) - 1
    if depth < 0:
        first_piece(w, k, -w[HERE, k, NOW, SIGMA])
    else:
        w[HERE, k, NOW, Q] = w[HERE, k, NOW, NEAR]
        w[HERE, k, NOW, DEPTH] = depth
        for field in range(KEPT):
            w[HERE, k, NOW, field] = w[PASSED, k, depth, field]
        _describe(w, k)


@compiled(error_model="numpy")
def push(w, k):  # type: ignore[no-untyped-def]
    """Make the piece that input k stands on the top segment of its stack."""
    m = w.shape[1]
    owner = int(w[HERE, k, NOW, OWNER])
    new = owner + 1
    for o in range(m):
        w[STACK, k, new, BELOW + o] = _below(w, m, k, owner, int(w[HERE, k, NOW, PREFIX]), o)
    w[STACK, k, new, END] = w[HERE, k, NOW, PREFIX]
    w[STACK, k, new, X] = w[HERE, k, NOW, Q]
    w[STACK, k, new, D] = w[HERE, k, NOW, SIGMA]
    w[HERE, k, HAND, COUNT] = new + 1


@compiled(error_model="numpy")
def output(w, o):  # type: ignore[no-untyped-def]
    """Output of the memory in row o."""
    m = w.shape[1]
    total = 0.0
    for k in range(m):
        top = int(w[HERE, k, HAND, COUNT]) - 1
        j = int(w[STACK, k, top, END])
        line = w[GRID, k, j, SLOPE + o] * w[STACK, k, top, X]
        line -= w[STACK, k, top, D] * w[GRID, k, j, SLOPE + m + o]
        total += line + w[STACK, k, top, BELOW + o]
        z = _zone(w, k, w[STACK, k, top, X], 0.0)
        total += w[ZONES, k, z, SLOPE + m + o] + w[ZONES, k, z, SLOPE + o] * w[STACK, k, top, X]
    return total


@compiled(error_model="numpy")
def jacobian(w):  # type: ignore[no-untyped-def]
    """Sum of the constants and inverse of the Jacobian of the present pieces."""
    m = w.shape[1]
    for o in range(m):
        total = 0.0
        for k in range(m):
            total += w[HERE, k, NOW, CONSTANT + o]
        w[HERE, o, NOW, TOTAL] = total
    for k in range(m):
        o = int(w[HERE, k, NOW, FIXED])
        if o >= 0:
            w[HERE, o, NOW, TOTAL] = w[HERE, o, NOW, Y] - w[HERE, k, NOW, AT]
            for i in range(m):
                w[HERE, o, JACOBIAN, i] = 1.0 if i == k else 0.0
    w[HERE, 0, NOW, QUALITY] = _invert(w)


@compiled(error_model="numpy")
def _invert(w):  # type: ignore[no-untyped-def]
    """Inverse of the Jacobian by elimination with row exchange, and its quality (see QUALITY)."""
    m = w.shape[1]
    largest = 0.0
    for i in range(m):
        for j in range(m):
            w[HERE, i, SCRATCH, j] = w[HERE, i, JACOBIAN, j]
            w[HERE, i, SCRATCH, m + j] = 1.0 if i == j else 0.0
            largest = max(largest, abs(w[HERE, i, JACOBIAN, j]))
    for j in range(m):
        best = j
        for i in range(j + 1, m):
            if abs(w[HERE, i, SCRATCH, j]) > abs(w[HERE, best, SCRATCH, j]):
                best = i
        if abs(w[HERE, best, SCRATCH, j]) <= SINGULAR * largest:
            return 0.0
        if best != j:
            for c in range(2 * m):
                held = w[HERE, j, SCRATCH, c]
                w[HERE, j, SCRATCH, c] = w[HERE, best, SCRATCH, c]
                w[HERE, best, SCRATCH, c] = held
        for i in range(m):
            if i != j and w[HERE, i, SCRATCH, j] != 0.0:
                factor = w[HERE, i, SCRATCH, j] / w[HERE, j, SCRATCH, j]
                for c in range(j, 2 * m):
                    w[HERE, i, SCRATCH, c] -= factor * w[HERE, j, SCRATCH, c]
    size = 0.0
    for i in range(m):
        for j in range(m):
            w[HERE, i, INVERSE, j] = w[HERE, i, SCRATCH, m + j] / w[HERE, i, SCRATCH, i]
            size = max(size, abs(w[HERE, i, INVERSE, j]))
    return 2.0 if m * m * size * largest < POOR else 1.0

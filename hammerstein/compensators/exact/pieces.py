"""The affine pieces of plays and dead-zones seen from their memory, for the walk of ``kernel``.

k is an input, or the row o of the model. Two arrays hold it all, for few arguments make the compiled calls
cheap, and most functions are put into their callers (``forceinline``): a call costs as much as what they do.
One is ``here[k]``, a record of names (``HERE``):

    of the design    play r_0; low, high, least q that falls and largest that rises; soft, ramp of the jump;
                     still, no movement
    also memory      count of segments; wanted q; ramp of the jump, from -1 to 1
    the piece        prefix, engaged operators; owner, the segment of the next one; near, far, where it begins
                     and ends; zone of the dead-zones; reach, how far it goes within the range; sigma, its
                     direction; depth, how many pieces lie behind
    the walk         q, where it stands; aim; fixed, at: the row taken at the range, and where; u, the drive
    of the row k     y, the target; total of the constants; left of the target; missed, what the memory has
                     more than the target
    of the first     quality of the inverse Jacobian: singular (0), poor (1) or good (2)

The other is ``w[table, k, row, column]``; what has one entry a row o stands in the columns from its name on:

    GRID     row j: R, threshold of operator j; SLOPE, SLOPE+m, sums of w and of w r below operator j
    STACK    the law's memory, a segment a row: END, X, D; BELOW, what lies deeper
    PASSED   pieces that a walk has passed: PREFIX, OWNER, NEAR, ZONE
    ZONES    row z: TOP, where zone z of the dead-zones ends; SLOPE, SLOPE+m, slope and intercept of its line;
             without dead-zones there is one, of infinite length and slope 0
    SQUARE   rows JACOBIAN, INVERSE, SCRATCH of the elimination: of row k; CONSTANT, GAIN: what the piece of
             input k adds to each row, and the size of what it does to each

What an input moves between two samples follows from ``hand``, the memory of each: COUNT, WANTED, RAMP.
"""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled

SINGULAR, POOR = 1e-14, 1e3

GRID, STACK, PASSED, ZONES, SQUARE = range(5)
R, SLOPE = 0, 1
TOP = 0
END, X, D, BELOW = range(4)
PREFIX, OWNER, NEAR, ZONE = range(4)
JACOBIAN, INVERSE, SCRATCH, CONSTANT, GAIN = range(5)
COUNT, WANTED, RAMP = range(3)
HERE = np.dtype(
    [
        (name, np.float64)
        for name in (
            *("play", "low", "high", "soft", "still"),
            *("count", "wanted", "ramp"),
            *("prefix", "owner", "near", "far", "zone", "reach", "sigma", "depth"),
            *("q", "aim", "fixed", "at", "u"),
            *("y", "total", "left", "missed", "quality"),
        )
    ],
    align=True,
)


@compiled(error_model="numpy", forceinline=True)
def first_piece(w, here, k, direction):  # type: ignore[no-untyped-def]
    """Piece of input k that begins at its memory, in a direction or (0) in that of the last movement.

    False where the input never moved.
    """
    at = here[k]
    top = int(at.count) - 1
    d = w[STACK, k, top, D]
    if direction == 0.0:
        direction = d if d != 0.0 else 1.0
    at.sigma = direction
    at.depth = 0.0
    at.q = at.near = w[STACK, k, top, X]
    if d == direction:
        at.prefix = w[STACK, k, top, END]
        at.owner = top - 1
    else:
        at.prefix = 1.0
        at.owner = top if w[STACK, k, top, END] > 1.0 else top - 1
    at.zone = _zone(w, k, w[STACK, k, top, X], direction)
    _describe(w, here, k)
    return d != 0.0


@compiled(error_model="numpy")
def _zone(w, k, q, direction):  # type: ignore[no-untyped-def]
    """Zone of input k that begins at q, or holds it, on the way in a direction."""
    z = 0
    while q > w[ZONES, k, z, TOP] or (q == w[ZONES, k, z, TOP] and direction > 0.0):
        z += 1
    return z


@compiled(error_model="numpy", forceinline=True)
def _zone_end(w, here, k):  # type: ignore[no-untyped-def]
    """Where input k leaves its zone of the dead-zones on its way."""
    at = here[k]
    z = int(at.zone)
    if at.sigma > 0.0:
        return w[ZONES, k, z, TOP]
    return w[ZONES, k, z - 1, TOP] if z > 0 else -np.inf


@compiled(error_model="numpy", forceinline=True)
def _describe(w, here, k):  # type: ignore[no-untyped-def]
    """End of the piece of input k, and what it adds to every row: slope q + constant."""
    at = here[k]
    m = w.shape[1]
    i, j, direction = int(at.owner), int(at.prefix), at.sigma
    at.far = direction * np.inf
    if i >= 0:
        gap = (1.0 - direction * w[STACK, k, i, D]) * w[GRID, k, j, R]
        at.far = w[STACK, k, i, X] + direction * gap
    end = _zone_end(w, here, k)
    if direction * (end - at.far) < 0.0:
        at.far = end
    if direction > 0.0:
        at.reach = min(at.far, at.high)
    else:
        at.reach = max(at.far, at.low)
    z = int(at.zone)
    for o in range(m):
        w[SQUARE, o, JACOBIAN, k] = w[GRID, k, j, SLOPE + o] + w[ZONES, k, z, SLOPE + o]
        below = _below(w, m, k, i, j, o) + w[ZONES, k, z, SLOPE + m + o]
        w[SQUARE, k, CONSTANT, o] = below - direction * w[GRID, k, j, SLOPE + m + o]


@compiled(error_model="numpy", forceinline=True)
def _below(w, m, k, i, j, o):  # type: ignore[no-untyped-def]
    """What the operators from j on add to row o while segment i and those under it stand still."""
    value = 0.0
    if i >= 0:
        end = int(w[STACK, k, i, END])
        line = w[STACK, k, i, X] * (w[GRID, k, end, SLOPE + o] - w[GRID, k, j, SLOPE + o])
        knee = w[STACK, k, i, D] * (w[GRID, k, end, SLOPE + m + o] - w[GRID, k, j, SLOPE + m + o])
        value = w[STACK, k, i, BELOW + o] + line - knee
    return value


@compiled(error_model="numpy", forceinline=True)
def next_piece(w, here, k):  # type: ignore[no-untyped-def]
    """Input k passes the end of its piece: the next operators engage, or it enters another zone."""
    at = here[k]
    depth, i = int(at.depth), int(at.owner)
    w[PASSED, k, depth, PREFIX], w[PASSED, k, depth, OWNER] = at.prefix, at.owner
    w[PASSED, k, depth, NEAR], w[PASSED, k, depth, ZONE] = at.near, at.zone
    at.depth = depth + 1
    at.q = at.near = at.far
    if _zone_end(w, here, k) == at.far:
        at.zone += at.sigma
        _describe(w, here, k)
        return
    # A segment of the same direction is caught up with as a whole: its memory is wiped out.
    same = w[STACK, k, i, D] == at.sigma
    at.prefix = w[STACK, k, i, END] if same else at.prefix + 1.0
    if at.prefix == w[STACK, k, i, END]:
        at.owner = i - 1
    _describe(w, here, k)


@compiled(error_model="numpy", forceinline=True)
def previous_piece(w, here, k):  # type: ignore[no-untyped-def]
    """Input k turns back over the beginning of its piece; from the memory itself it turns around."""
    at = here[k]
    depth = int(at.depth) - 1
    if depth < 0:
        first_piece(w, here, k, -at.sigma)
    else:
        at.q = at.near
        at.depth = depth
        at.prefix, at.owner = w[PASSED, k, depth, PREFIX], w[PASSED, k, depth, OWNER]
        at.near, at.zone = w[PASSED, k, depth, NEAR], w[PASSED, k, depth, ZONE]
        _describe(w, here, k)


@compiled(error_model="numpy", forceinline=True)
def push(w, here, k):  # type: ignore[no-untyped-def]
    """Make the piece that input k stands on the top segment of its stack."""
    at = here[k]
    m = w.shape[1]
    owner = int(at.owner)
    new = owner + 1
    for o in range(m):
        w[STACK, k, new, BELOW + o] = _below(w, m, k, owner, int(at.prefix), o)
    w[STACK, k, new, END] = at.prefix
    w[STACK, k, new, X] = at.q
    w[STACK, k, new, D] = at.sigma
    at.count = new + 1


@compiled(error_model="numpy")
def output(w, here, o):  # type: ignore[no-untyped-def]
    """Output of the memory in row o."""
    m = w.shape[1]
    total = 0.0
    for k in range(m):
        top = int(here[k].count) - 1
        j = int(w[STACK, k, top, END])
        line = w[GRID, k, j, SLOPE + o] * w[STACK, k, top, X]
        line -= w[STACK, k, top, D] * w[GRID, k, j, SLOPE + m + o]
        total += line + w[STACK, k, top, BELOW + o]
        z = _zone(w, k, w[STACK, k, top, X], 0.0)
        total += w[ZONES, k, z, SLOPE + m + o] + w[ZONES, k, z, SLOPE + o] * w[STACK, k, top, X]
    return total


@compiled(error_model="numpy", forceinline=True)
def jacobian(w, here):  # type: ignore[no-untyped-def]
    """Sum of the constants and inverse of the Jacobian of the present pieces."""
    m = w.shape[1]
    for o in range(m):
        total = 0.0
        for k in range(m):
            total += w[SQUARE, k, CONSTANT, o]
        here[o].total = total
    for k in range(m):
        o = int(here[k].fixed)
        if o >= 0:
            here[o].total = here[o].y - here[k].at
            for i in range(m):
                w[SQUARE, o, JACOBIAN, i] = 1.0 if i == k else 0.0
    here[0].quality = _invert(w, here)


@compiled(error_model="numpy", forceinline=True)
def _invert(w, here):  # type: ignore[no-untyped-def]
    """Inverse of the Jacobian by elimination with row exchange, and its quality (see QUALITY)."""
    m = w.shape[1]
    largest = 0.0
    for i in range(m):
        for j in range(m):
            w[SQUARE, i, SCRATCH, j] = w[SQUARE, i, JACOBIAN, j]
            w[SQUARE, i, SCRATCH, m + j] = 1.0 if i == j else 0.0
            largest = max(largest, abs(w[SQUARE, i, JACOBIAN, j]))
    for j in range(m):
        best = j
        for i in range(j + 1, m):
            if abs(w[SQUARE, i, SCRATCH, j]) > abs(w[SQUARE, best, SCRATCH, j]):
                best = i
        if abs(w[SQUARE, best, SCRATCH, j]) <= SINGULAR * largest:
            return 0.0
        if best != j:
            for c in range(2 * m):
                held = w[SQUARE, j, SCRATCH, c]
                w[SQUARE, j, SCRATCH, c] = w[SQUARE, best, SCRATCH, c]
                w[SQUARE, best, SCRATCH, c] = held
        for i in range(m):
            if i != j and w[SQUARE, i, SCRATCH, j] != 0.0:
                factor = w[SQUARE, i, SCRATCH, j] / w[SQUARE, j, SCRATCH, j]
                for c in range(j, 2 * m):
                    w[SQUARE, i, SCRATCH, c] -= factor * w[SQUARE, j, SCRATCH, c]
    size = 0.0
    for i in range(m):
        for j in range(m):
            w[SQUARE, i, INVERSE, j] = w[SQUARE, i, SCRATCH, m + j] / w[SQUARE, i, SCRATCH, i]
            size = max(size, abs(w[SQUARE, i, INVERSE, j]))
    return 2.0 if m * m * size * largest < POOR else 1.0

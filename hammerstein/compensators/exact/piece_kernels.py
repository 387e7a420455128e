"""The affine pieces of plays and dead-zones seen from their memory, for the walk of ``inverse_kernel``.

k is an input, or the row o of the model. Two arrays hold it all, for few arguments make the compiled calls
cheap, and most functions are put into their callers (``forceinline``): a call costs as much as what they do.
One is ``here[k]``, the record of an input (``of_inputs``):

    of the design    play r_0; low, high, least q that falls and largest that rises; soft, ramp of the jump;
                     still, no movement; gain, size of what it does to each row
    also memory      count of segments; wanted q; ramp of the jump, from -1 to 1
    the piece        prefix, engaged operators; owner, the segment of the next one; near, far, where it begins
                     and ends; zone of the dead-zones; reach, how far it goes within the range; sigma, its
                     direction; depth, how many pieces lie behind; constant, what it adds to each row
    the walk         q, where it stands; aim; fixed, at: the row taken at the range, and where; u, the drive
    of the row k     y, the target; total of the constants; left of the target; missed, what the memory has
                     more than the target; jacobian, inverse, scratch of the elimination
    of the first     quality of the inverse Jacobian: singular (0), poor (1) or good (2)

The other is ``w[k, row]``, four tables side by side (``of_rows``):

    operator j       r, its threshold; slope, moment: sums of w and of w r below it, for each row of the model
    segment i        end, x, d: the law's memory; below, what lies deeper
    piece passed     prefix, owner, near, zone
    zone z           zone_end, where it ends; zone_slope, zone_start: its line. Without dead-zones there is
                     one, of infinite length and slope 0

Both are made for a number of inputs, which the compiler therefore knows: it unrolls the loops over them.

What an input moves between two samples follows from ``hand``, the memory of each: COUNT, WANTED, RAMP; its
segments from ``stack``: END, X, D and, from BELOW on, what lies deeper.
"""

from functools import cache
from typing import Any

import numpy as np

from hammerstein.compiled import compiled, helper

SINGULAR, POOR = 1e-14, 1e3
"""Pivot, in parts of the largest, of a singular matrix; and the condition number of a poor one."""

END, X, D, BELOW = range(4)
COUNT, WANTED, RAMP = range(3)


@cache  # one object for every law: numba looks an array up by that
def of_inputs(m: int) -> np.dtype[Any]:
    """Record of one of m inputs, ``here``."""
    whole = ("count", "prefix", "owner", "zone", "depth", "fixed", "quality")
    real = (
        *("play", "low", "high", "soft", "still", "wanted", "ramp"),
        *("near", "far", "reach", "sigma", "q", "aim", "at", "u", "y", "total", "left", "missed"),
    )
    each = ("gain", "constant", "jacobian", "inverse")
    names: list[Any] = [(name, np.int64) for name in whole] + [(name, np.float64) for name in real]
    names += [(name, np.float64, (m,)) for name in each] + [("scratch", np.float64, (2 * m,))]
    return np.dtype(names, align=True)


@cache
def of_rows(m: int) -> np.dtype[Any]:
    """Row of the tables of m inputs, ``w``."""
    whole = ("end", "prefix", "owner", "zone")
    names: list[Any] = [(name, np.int64) for name in whole]
    names += [(name, np.float64) for name in ("r", "x", "d", "near", "zone_end")]
    each = ("slope", "moment", "below", "zone_slope", "zone_start")
    return np.dtype(names + [(name, np.float64, (m,)) for name in each], align=True)


@helper(error_model="numpy", forceinline=True)
def axes_of(here):  # type: ignore[no-untyped-def]
    """Number of inputs, as the compiler knows it."""
    return len(here[0].gain)


@compiled(error_model="numpy")
def loaded(table, about, stack, hand):  # type: ignore[no-untyped-def]
    """Copies of the tables of a design with the memory in them."""
    w, here = table.copy(), about.copy()
    for k in range(axes_of(here)):
        for s in range(stack.shape[1]):
            w[k, s].end, w[k, s].x, w[k, s].d = int(stack[k, s, END]), stack[k, s, X], stack[k, s, D]
            for o in range(axes_of(here)):
                w[k, s].below[o] = stack[k, s, BELOW + o]
        here[k].count = int(hand[k, COUNT])
        here[k].wanted, here[k].ramp = hand[k, WANTED], hand[k, RAMP]
    return w, here


@compiled(error_model="numpy")
def unloaded(w, here, stack, hand):  # type: ignore[no-untyped-def]
    """Put the memory of the tables of a run into stack and hand."""
    for k in range(axes_of(here)):
        for s in range(stack.shape[1]):
            stack[k, s, END], stack[k, s, X], stack[k, s, D] = w[k, s].end, w[k, s].x, w[k, s].d
            for o in range(axes_of(here)):
                stack[k, s, BELOW + o] = w[k, s].below[o]
        hand[k, COUNT], hand[k, WANTED], hand[k, RAMP] = here[k].count, here[k].wanted, here[k].ramp


@helper(error_model="numpy", forceinline=True)
def first_piece(w, here, k, direction):  # type: ignore[no-untyped-def]
    """Piece of input k from its memory on, in a direction, or (0) in that of the last movement.

    False where the input never moved.
    """
    at = here[k]
    top = at.count - 1
    d = w[k, top].d
    if direction == 0.0:
        direction = d if d != 0.0 else 1.0
    at.sigma = direction
    at.depth = 0
    at.q = at.near = w[k, top].x
    if d == direction:
        at.prefix = w[k, top].end
        at.owner = top - 1
    else:
        at.prefix = 1
        at.owner = top if w[k, top].end > 1 else top - 1
    at.zone = _zone(w, k, w[k, top].x, direction)
    _describe(w, here, k)
    return d != 0.0


@helper(error_model="numpy")
def _zone(w, k, q, direction):  # type: ignore[no-untyped-def]
    """Zone of input k that begins at q, or holds it, on the way in a direction."""
    z = 0
    while q > w[k, z].zone_end or (q == w[k, z].zone_end and direction > 0.0):
        z += 1
    return z


@helper(error_model="numpy", forceinline=True)
def _zone_end(w, here, k):  # type: ignore[no-untyped-def]
    """Where input k leaves its zone of the dead-zones on its way."""
    at = here[k]
    z = at.zone
    if at.sigma > 0.0:
        return w[k, z].zone_end
    return w[k, z - 1].zone_end if z > 0 else -np.inf


@helper(error_model="numpy", forceinline=True)
def _describe(w, here, k):  # type: ignore[no-untyped-def]
    """End of the piece of input k, and what it adds to every row: slope q + constant."""
    at = here[k]
    m = axes_of(here)
    i, j, direction = at.owner, at.prefix, at.sigma
    at.far = direction * np.inf
    if i >= 0:
        gap = (1.0 - direction * w[k, i].d) * w[k, j].r
        at.far = w[k, i].x + direction * gap
    end = _zone_end(w, here, k)
    if direction * (end - at.far) < 0.0:
        at.far = end
    if direction > 0.0:
        at.reach = min(at.far, at.high)
    else:
        at.reach = max(at.far, at.low)
    z = at.zone
    for o in range(m):
        here[o].jacobian[k] = w[k, j].slope[o] + w[k, z].zone_slope[o]
        below = _below(w, k, i, j, o) + w[k, z].zone_start[o]
        here[k].constant[o] = below - direction * w[k, j].moment[o]


@helper(error_model="numpy", forceinline=True)
def _below(w, k, i, j, o):  # type: ignore[no-untyped-def]
    """What the operators from j on add to row o while segment i and the segments below it do not move."""
    value = 0.0
    if i >= 0:
        end = w[k, i].end
        line = w[k, i].x * (w[k, end].slope[o] - w[k, j].slope[o])
        knee = w[k, i].d * (w[k, end].moment[o] - w[k, j].moment[o])
        value = w[k, i].below[o] + line - knee
    return value


@helper(error_model="numpy", forceinline=True)
def next_piece(w, here, k):  # type: ignore[no-untyped-def]
    """Input k passes the end of its piece: the next operators engage, or it enters another zone."""
    at = here[k]
    depth, i = at.depth, at.owner
    w[k, depth].prefix, w[k, depth].owner = at.prefix, at.owner
    w[k, depth].near, w[k, depth].zone = at.near, at.zone
    at.depth = depth + 1
    at.q = at.near = at.far
    if _zone_end(w, here, k) == at.far:
        at.zone += at.sigma
        _describe(w, here, k)
        return
    # A segment of the same direction is caught up with as a whole: its memory is wiped out.
    same = w[k, i].d == at.sigma
    at.prefix = w[k, i].end if same else at.prefix + 1
    if at.prefix == w[k, i].end:
        at.owner = i - 1
    _describe(w, here, k)


@helper(error_model="numpy", forceinline=True)
def previous_piece(w, here, k):  # type: ignore[no-untyped-def]
    """Input k returns past the beginning of its piece; at the memory it reverses."""
    at = here[k]
    depth = at.depth - 1
    if depth < 0:
        first_piece(w, here, k, -at.sigma)
    else:
        at.q = at.near
        at.depth = depth
        at.prefix, at.owner = w[k, depth].prefix, w[k, depth].owner
        at.near, at.zone = w[k, depth].near, w[k, depth].zone
        _describe(w, here, k)


@helper(error_model="numpy", forceinline=True)
def push(w, here, k):  # type: ignore[no-untyped-def]
    """Push the current piece of input k onto its stack."""
    at = here[k]
    m = axes_of(here)
    owner = at.owner
    new = owner + 1
    for o in range(m):
        w[k, new].below[o] = _below(w, k, owner, at.prefix, o)
    w[k, new].end = at.prefix
    w[k, new].x = at.q
    w[k, new].d = at.sigma
    at.count = new + 1


@helper(error_model="numpy")
def output(w, here, o):  # type: ignore[no-untyped-def]
    """Output of the memory in row o."""
    m = axes_of(here)
    total = 0.0
    for k in range(m):
        top = here[k].count - 1
        j = w[k, top].end
        line = w[k, j].slope[o] * w[k, top].x
        line -= w[k, top].d * w[k, j].moment[o]
        total += line + w[k, top].below[o]
        z = _zone(w, k, w[k, top].x, 0.0)
        total += w[k, z].zone_start[o] + w[k, z].zone_slope[o] * w[k, top].x
    return total


@helper(error_model="numpy", forceinline=True)
def jacobian(here):  # type: ignore[no-untyped-def]
    """Sum of the constants and inverse of the Jacobian of the present pieces."""
    m = axes_of(here)
    for o in range(m):
        total = 0.0
        for k in range(m):
            total += here[k].constant[o]
        here[o].total = total
    for k in range(m):
        o = here[k].fixed
        if o >= 0:
            here[o].total = here[o].y - here[k].at
            for i in range(m):
                here[o].jacobian[i] = 1.0 if i == k else 0.0
    here[0].quality = _invert(here)


@helper(error_model="numpy", forceinline=True)
def _invert(here):  # type: ignore[no-untyped-def]
    """Inverse of the Jacobian by elimination with row exchange, and its quality (see above)."""
    m = axes_of(here)
    largest = 0.0
    for i in range(m):
        for j in range(m):
            here[i].scratch[j] = here[i].jacobian[j]
            here[i].scratch[m + j] = 1.0 if i == j else 0.0
            largest = max(largest, abs(here[i].jacobian[j]))
    for j in range(m):
        best = j
        for i in range(j + 1, m):
            if abs(here[i].scratch[j]) > abs(here[best].scratch[j]):
                best = i
        if abs(here[best].scratch[j]) <= SINGULAR * largest:
            return 0
        if best != j:
            for c in range(2 * m):
                held = here[j].scratch[c]
                here[j].scratch[c] = here[best].scratch[c]
                here[best].scratch[c] = held
        for i in range(m):
            if i != j and here[i].scratch[j] != 0.0:
                factor = here[i].scratch[j] / here[j].scratch[j]
                for c in range(j, 2 * m):
                    here[i].scratch[c] -= factor * here[j].scratch[c]
    size = 0.0
    for i in range(m):
        for j in range(m):
            here[i].inverse[j] = here[i].scratch[m + j] / here[i].scratch[i]
            size = max(size, abs(here[i].inverse[j]))
    return 2 if m * m * size * largest < POOR else 1

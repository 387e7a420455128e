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
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

SINGULAR = 1e-14


class Grid(NamedTuple):
    """The model as the walk wants it, square, with smallest thresholds of 0. Index k is an input, o a row.

    n : (m,) operators; r : (m, n_max) thresholds [V]; slope, moment : (m, n_max+1, m) partial sums of w, w r
    gain : (m, m) size of what input k does to row o; virtual : number of rows at the end without an output
    play : (m,) r_0 [V]; bound : (m,) largest |q| [V]; softening : (m,) ramp of the jump [V]
    still : change of q that counts as none [V]
    """

    n: Any
    r: Any
    slope: Any
    moment: Any
    gain: Any
    virtual: int
    play: Any
    bound: Any
    softening: Any
    still: float


class Memory(NamedTuple):
    """What the law remembers, updated in place: the stack of segments of every input and the jump's ramp.

    count : (m,); end, x, d : (m, n_max+1); below : (m, n_max+1, m); wanted, ramp : (m,)
    """

    count: Any
    end: Any
    x: Any
    d: Any
    below: Any
    wanted: Any
    ramp: Any


class Walk(NamedTuple):
    """Scratch of one walk; nothing in it outlives a sample but what follows from the memory alone.

    y : (m,) target; u : (m,) drive; missed : (m,) what the drive's output has more than the target
    q, aim : (m,); sigma, near, far : (m,) direction of a piece and where it begins and ends
    prefix, owner, depth : (m,) engaged operators, segment of the next one, pieces passed
    passed_prefix, passed_owner, passed_near : (m, n_max+2) the pieces passed
    jacobian, inverse : (m, m); constant : (m, m) by input and row; total, left : (m,)
    fixed : (m,) row that an input at its range took, or -1; scratch : (m, 2 m); ready : (1,)
    """

    y: Any
    u: Any
    missed: Any
    q: Any
    aim: Any
    sigma: Any
    near: Any
    far: Any
    prefix: Any
    owner: Any
    depth: Any
    passed_prefix: Any
    passed_owner: Any
    passed_near: Any
    jacobian: Any
    inverse: Any
    constant: Any
    total: Any
    left: Any
    fixed: Any
    scratch: Any
    ready: Any

    @classmethod
    def of(cls, m: int, width: int) -> Walk:
        """Scratch for m inputs whose stacks are ``width`` high."""

        def reals(*shape: int) -> Any:
            return np.zeros(shape)

        def integers(*shape: int) -> Any:
            return np.zeros(shape, np.int64)

        return cls(
            y=reals(m),
            u=reals(m),
            missed=reals(m),
            q=reals(m),
            aim=reals(m),
            sigma=reals(m),
            near=reals(m),
            far=reals(m),
            prefix=integers(m),
            owner=integers(m),
            depth=integers(m),
            passed_prefix=integers(m, width + 1),
            passed_owner=integers(m, width + 1),
            passed_near=reals(m, width + 1),
            jacobian=reals(m, m),
            inverse=reals(m, m),
            constant=reals(m, m),
            total=reals(m),
            left=reals(m),
            fixed=integers(m),
            scratch=reals(m, 2 * m),
            ready=np.zeros(1, np.bool_),
        )


@njit(cache=True, nogil=True)
def respond_exact(reference, g, s, w, drive):  # type: ignore[no-untyped-def]
    """Drive (m, N), overwritten, whose model output is the reference (p, N)."""
    p = reference.shape[0]
    prepare(g, s, w)
    for t in range(reference.shape[1]):
        for o in range(p):
            w.y[o] = reference[o, t]
        if not (w.ready[0] and stay(g, s, w)):
            walk(g, s, w)
        for k in range(drive.shape[0]):
            drive[k, t] = w.u[k]


@njit(cache=True, nogil=True)
def prepare(g, s, w):  # type: ignore[no-untyped-def]
    """Pieces, Jacobian and its inverse as they follow from the memory; whether ``stay`` may use them."""
    w.ready[0] = True
    for k in range(w.q.shape[0]):
        top = s.count[k] - 1
        _first_piece(g, s, w, k, s.d[k, top] if s.d[k, top] != 0.0 else 1.0)
        w.fixed[k] = -1
        if s.d[k, top] == 0.0 or (g.softening[k] > 0.0 and s.ramp[k] != s.d[k, top]):
            w.ready[0] = False
    if w.ready[0]:
        w.ready[0] = _aim(g, w)


@njit(cache=True, nogil=True, inline="always")
def stay(g, s, w):  # type: ignore[no-untyped-def]
    """Solve within the pieces of the last sample; False, and nothing changed, where they do not hold q."""
    m = w.q.shape[0]
    _solve(w)
    for k in range(m):
        d = w.sigma[k]
        q = w.aim[k]
        if d * (q - w.q[k]) < -g.still or d * q > d * w.far[k] or abs(q) > g.bound[k]:
            return False
    for k in range(m):
        if w.sigma[k] * (w.aim[k] - w.q[k]) > 0.0:
            w.q[k] = w.aim[k]
            s.x[k, s.count[k] - 1] = w.aim[k]
            s.wanted[k] = w.aim[k]
            w.u[k] = w.aim[k] + w.sigma[k] * g.play[k]
        w.missed[k] = 0.0
    return True


@njit(cache=True, nogil=True)
def walk(g, s, w):  # type: ignore[no-untyped-def]
    """Solve one sample from the memory, whatever it takes; memory and drive are those of what was reached."""
    m = w.q.shape[0]
    for k in range(m):
        w.fixed[k] = -1
    exact = True
    for _ in range(m + 1):
        for k in range(m):
            top = s.count[k] - 1
            _first_piece(g, s, w, k, s.d[k, top] if s.d[k, top] != 0.0 else 1.0)
        exact = _to_target(g, s, w) and exact
        if not _fix_one(g, w):
            break
        exact = False
    for k in range(m):
        exact = _commit(g, s, w, k) and exact
    prepare(g, s, w)
    for o in range(m):
        w.missed[o] = 0.0
    if not exact:
        _miss(g, s, w)


@njit(cache=True, nogil=True)
def _first_piece(g, s, w, k, direction):  # type: ignore[no-untyped-def]
    """Piece of input k that begins at its memory in a direction."""
    top = s.count[k] - 1
    w.sigma[k] = direction
    w.depth[k] = 0
    w.q[k] = s.x[k, top]
    w.near[k] = s.x[k, top]
    if s.d[k, top] == direction:
        w.prefix[k] = s.end[k, top]
        w.owner[k] = top - 1
    else:
        w.prefix[k] = 1
        w.owner[k] = top if s.end[k, top] > 1 else top - 1
    _describe(g, s, w, k)


@njit(cache=True, nogil=True)
def _describe(g, s, w, k):  # type: ignore[no-untyped-def]
    """End of the piece of input k, and what it adds to every row: slope q + constant."""
    i, j, direction = w.owner[k], w.prefix[k], w.sigma[k]
    if i < 0:
        w.far[k] = direction * np.inf
    else:
        w.far[k] = s.x[k, i] + direction * (1.0 - direction * s.d[k, i]) * g.r[k, j]
    for o in range(w.q.shape[0]):
        w.jacobian[o, k] = g.slope[k, j, o]
        w.constant[k, o] = _below(g, s, k, i, j, o) - direction * g.moment[k, j, o]


@njit(cache=True, nogil=True, inline="always")
def _below(g, s, k, i, j, o):  # type: ignore[no-untyped-def]
    """What the operators from j on add to row o while segment i and those under it stand still."""
    if i < 0:
        return 0.0
    end = s.end[k, i]
    line = s.x[k, i] * (g.slope[k, end, o] - g.slope[k, j, o])
    return s.below[k, i, o] + line - s.d[k, i] * (g.moment[k, end, o] - g.moment[k, j, o])


@njit(cache=True, nogil=True)
def _next_piece(g, s, w, k):  # type: ignore[no-untyped-def]
    """Input k passes the end of its piece: the next operators engage."""
    depth, i = w.depth[k], w.owner[k]
    w.passed_prefix[k, depth] = w.prefix[k]
    w.passed_owner[k, depth] = i
    w.passed_near[k, depth] = w.near[k]
    w.depth[k] = depth + 1
    w.near[k] = w.far[k]
    # A segment of the same direction is caught up with as a whole: its memory is wiped out.
    w.prefix[k] = s.end[k, i] if s.d[k, i] == w.sigma[k] else w.prefix[k] + 1
    if w.prefix[k] == s.end[k, i]:
        w.owner[k] = i - 1
    _describe(g, s, w, k)


@njit(cache=True, nogil=True)
def _previous_piece(g, s, w, k):  # type: ignore[no-untyped-def]
    """Input k turns back over the beginning of its piece; from the memory itself it turns around."""
    if w.depth[k] == 0:
        _first_piece(g, s, w, k, -w.sigma[k])
        return
    depth = w.depth[k] - 1
    w.depth[k] = depth
    w.prefix[k] = w.passed_prefix[k, depth]
    w.owner[k] = w.passed_owner[k, depth]
    w.near[k] = w.passed_near[k, depth]
    _describe(g, s, w, k)


@njit(cache=True, nogil=True)
def _aim(g, w):  # type: ignore[no-untyped-def]
    """Jacobian, its inverse and the constants of the present pieces; False where it is singular."""
    m = w.q.shape[0]
    for o in range(m):
        total = 0.0
        for k in range(m):
            total += w.constant[k, o]
        w.total[o] = total
    for k in range(m):
        o = w.fixed[k]
        if o >= 0:
            for i in range(m):
                w.jacobian[o, i] = 0.0
            w.jacobian[o, k] = 1.0
    return _invert(w.jacobian, w.inverse, w.scratch)


@njit(cache=True, nogil=True)
def _invert(a, inverse, z):  # type: ignore[no-untyped-def]
    """Inverse of a (m, m) by elimination with row exchange; False where a is singular."""
    m = a.shape[0]
    largest = 0.0
    for i in range(m):
        for j in range(m):
            z[i, j] = a[i, j]
            z[i, m + j] = 1.0 if i == j else 0.0
            largest = max(largest, abs(a[i, j]))
    for j in range(m):
        best = j
        for i in range(j + 1, m):
            if abs(z[i, j]) > abs(z[best, j]):
                best = i
        if abs(z[best, j]) <= SINGULAR * largest:
            return False
        for c in range(2 * m):
            z[j, c], z[best, c] = z[best, c], z[j, c]
        for i in range(m):
            factor = z[i, j] / z[j, j]
            if i != j and factor != 0.0:
                for c in range(j, 2 * m):
                    z[i, c] -= factor * z[j, c]
    for i in range(m):
        for j in range(m):
            inverse[i, j] = z[i, m + j] / z[i, i]
    return True


@njit(cache=True, nogil=True, inline="always")
def _solve(w):  # type: ignore[no-untyped-def]
    """Aim of the present pieces, J^-1 (y - c), corrected once so that it does not depend on J's condition."""
    m = w.q.shape[0]
    for k in range(m):
        aim = 0.0
        for o in range(m):
            aim += w.inverse[k, o] * (w.y[o] - w.total[o])
        w.aim[k] = aim
    for o in range(m):
        left = w.y[o] - w.total[o]
        for k in range(m):
            left -= w.jacobian[o, k] * w.aim[k]
        w.left[o] = left
    for k in range(m):
        for o in range(m):
            w.aim[k] += w.inverse[k, o] * w.left[o]


@njit(cache=True, nogil=True)
def _to_target(g, s, w):  # type: ignore[no-untyped-def]
    """Walk from the first pieces to the target; False where the model lets no walk get there."""
    m = w.q.shape[0]
    steps = 64
    for k in range(m):
        steps += 8 * g.n[k]
    for _ in range(steps):
        if not _aim(g, w):
            return False
        _aim_at_target(g, w)
        first, share = _first_to_leave(g, w)
        for k in range(m):
            w.q[k] = w.aim[k] if share >= 1.0 else w.q[k] + share * (w.aim[k] - w.q[k])
        if first < 0:
            for k in range(m):
                w.q[k] = _between(w.q[k], w.near[k], w.far[k])
            return True
        if w.sigma[first] * (w.aim[first] - w.q[first]) > 0.0:
            w.q[first] = w.far[first]
            _next_piece(g, s, w, first)
        else:
            w.q[first] = w.near[first]
            _previous_piece(g, s, w, first)
        for k in range(m):
            if w.fixed[k] >= 0:
                for i in range(m):
                    w.jacobian[w.fixed[k], i] = 0.0
    return False


@njit(cache=True, nogil=True, inline="always")
def _between(value, one, other):  # type: ignore[no-untyped-def]
    return min(max(value, min(one, other)), max(one, other))

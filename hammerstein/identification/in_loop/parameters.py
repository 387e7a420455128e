"""All parameters of plays inside the loop of a linear block, as one vector for a search, and where it starts.

It starts from linear dynamics of the records, with plays of their signals, and goes on with more of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array, Complex, Indices
from hammerstein.dynamics import LinearBlock
from hammerstein.dynamics.feedback_block import InputProducts
from hammerstein.dynamics.feedback_hysteresis import FeedbackHysteresisDynamics
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, play
from hammerstein.identification.in_loop.kernels import follow
from hammerstein.quantities import number_of

SEARCHED = ("A", "B", "C", "D", "E", "F", "G", "H", "c", "K")
LEAST_THRESHOLD = 1e-4
"""Smallest threshold, to keep it positive."""


class SettledPeriod(NamedTuple):
    """One settled period of a record: voltages (m, N) and positions (p, N).

    weight : what an error of it counts, a number or (p, 1)
    warm : samples of the same voltages that a simulation runs through before; 0 for a record from rest
    """

    u: Array
    y: Array
    weight: float | Array
    warm: int = 1500

    @property
    def sent(self) -> Array:
        """Voltages (m, warm + N) from the start of a simulation."""
        return np.take(self.u, np.arange(-self.warm, self.u.shape[1]), axis=1, mode="wrap")

    def left(self, simulated: Array) -> Array:
        """Weighted error (p, N) of a simulation about its mean: the history of a record adds an offset."""
        with np.errstate(all="ignore"):  # a simulation may diverge, and its error is then not finite
            error = self.y - simulated
            return np.asarray(self.weight * (error - error.mean(axis=1, keepdims=True)))


@dataclass(frozen=True, eq=False)
class LoopParameters:
    """Parameters of a block with plays inside its loop, on one sample grid.

        x+ = A x + B u + E w,  z = F x + G u + H w,  y = C x + D u
        w_i = sum over j of c_ij (p_ij - beta_ij z_i) + sum over j of K_ij product_j

    p_ij is the play of z_i with threshold r_ij. beta is held: the linear part of a play, which A, B, E, F
    and G explain, so that c changes the loop little.

    A : (n / 2, 2, 2) blocks; B : (n, m); C : (p, n); D : (p, m)
    E : (n, v h), F : (v h, n), G : (v h, m) of each of v moves in a sample, see ``FeedbackBlock``
    H : (h, h) what the second z takes of the first w; (0, h) where the plays move once
    c, r, beta : (h, J); K : (h, M) weights of products of z_i / limit_i, each held within 1
    factors : (M, 3) which z_i a product is of, h where there is none; limit : (h,)
    """

    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    F: Array
    G: Array
    H: Array
    c: Array
    K: Array
    r: Array
    beta: Array
    limit: Array
    factors: Indices

    def vector(self) -> Array:
        """Return all free parameters (P,): entries, weights, and logarithms of thresholds."""
        parts = [getattr(self, name).ravel() for name in SEARCHED]
        return np.concatenate([*parts, np.log(self.r).ravel()])

    def at(self, vector: Array) -> LoopParameters:
        """Return the block whose ``vector`` this is."""
        found, first = {}, 0
        for name in SEARCHED:
            like = getattr(self, name)
            found[name] = vector[first : first + like.size].reshape(like.shape).copy()
            first += like.size
        r = np.maximum(np.exp(vector[first:]), LEAST_THRESHOLD).reshape(self.r.shape)
        return replace(self, **found, r=r)

    def tables(self) -> tuple[Indices, Indices]:
        """For every parameter, the entry of the trajectory that it multiplies, and the row of the product.

        See ``kernels.differentiate``.
        """
        (n, m), (h, plays), (p, rows) = self.B.shape, self.r.shape, (len(self.C), len(self.F))
        x, u, products = np.arange(n), n + np.arange(m), np.arange(self.K.shape[1])
        stride = 2 * h + h * plays + len(products) + 1
        w = n + m + (stride * np.arange(self.moves)[:, None] + np.arange(h)).ravel()
        each, z, out = np.arange(h * plays), n + np.arange(rows), n + rows + h + np.arange(p)
        late, own = z[h:], n + rows + np.arange(h)
        pairs = np.repeat(x.reshape(-1, 2), 2, axis=0).ravel()
        table = [
            (pairs, np.repeat(x, 2)),
            (np.tile(u, n), np.repeat(x, m)),
            (np.tile(x, p), np.repeat(out, n)),
            (np.tile(u, p), np.repeat(out, m)),
            (np.tile(w, n), np.repeat(x, rows)),
            (np.tile(x, rows), np.repeat(z, n)),
            (np.tile(u, rows), np.repeat(z, m)),
            (np.tile(w[:h], len(late)), np.repeat(late, h)),
            (n + m + h + each, np.repeat(own, plays)),
            (np.tile(n + m + h + h * plays + products, h), np.repeat(own, len(products))),
            (-1 - each, np.zeros_like(each)),
        ]
        source, target = (np.concatenate(column) for column in zip(*table, strict=True))
        return source.astype(np.int64), target.astype(np.int64)

    def full(self) -> Array:
        """Return A (n, n)."""
        n = len(self.B)
        found = np.zeros((n, n))
        for b, block in enumerate(self.A):
            found[2 * b : 2 * b + 2, 2 * b : 2 * b + 2] = block
        return found

    @property
    def moves(self) -> int:
        """Number of moves of the plays per sample."""
        return 1 + bool(len(self.H))

    def path(self, u: Array, warm: int) -> tuple[Array, np.ndarray[Any, Any]]:
        """Return path and hits of a periodic input (m, N); see ``kernels.follow``."""
        (n, m), (h, plays) = self.B.shape, self.r.shape
        path = np.empty((warm + u.shape[1], n + m + self.moves * (2 * h + h * plays + self.K.shape[1] + 1)))
        hits = np.empty((len(path), self.moves * h, plays), dtype=np.int8)
        late = np.pad(self.H, ((len(self.F) - len(self.H), 0), (0, 0)))
        inner = np.hstack([self.F, self.G, late])
        matrices = (self.A, self.B, self.E, inner, self.c, self.K, self.beta, self.r)
        follow(*matrices, self.factors, self.limit, np.ascontiguousarray(u), warm, path, hits)
        return path, hits

    def simulate(self, u: Array, warm: int) -> Array:
        """Outputs (p, N) of a periodic input (m, N) after ``warm`` samples of it; they may diverge."""
        n = len(self.B)
        with np.errstate(all="ignore"):
            return np.asarray(self.C @ self.path(u, warm)[0][warm:, :n].T + self.D @ u)

    def fastest(self, margin: float) -> tuple[Array, Array]:
        """Excess of poles of the loop over 1 - margin, and its derivatives (poles, P).

        They are those of every amplitude on the way from rest, where no play moves, to the largest, where all
        do: the narrowest of each z move first, of all z together and of each z alone. Were only the largest
        bounded, a model could hum at rest; were they bounded together only, one path could hum alone.
        """
        order = np.argsort(np.argsort(self.r, axis=1), axis=1)
        ladder = [(order < moved).astype(np.float64) for moved in range(self.r.shape[1] + 1)]
        if (h := len(self.r)) > 1:
            ladder += [step * own for step in ladder[1:] for own in np.eye(h)[:, :, None]]
        found = [self._beyond(1.0 - margin, moving) for moving in ladder]
        return np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found])

    def _beyond(self, bound: float, moving: Array) -> tuple[Array, Array]:
        """The same for plays of which some move (h, J)."""
        k = (self.c * (moving - self.beta)).sum(axis=1)
        h = len(k)
        inner = k[:, None] * self.F[:h]
        late = k[:, None] * (self.F[h:] + self.H @ inner) if len(self.H) else self.F[h:]
        poles, right = np.linalg.eig(self.full() + self.E @ np.vstack([inner, late]))
        left = np.linalg.inv(right)
        chosen = np.flatnonzero((np.abs(poles) > bound) & (poles.imag >= 0.0))
        rows = [self._moved(poles[i], left[i], right[:, i], k, moving) for i in chosen]
        size = len(self.vector())
        return np.abs(poles[chosen]) - bound, np.array(rows).reshape(len(chosen), size)

    def _moved(self, pole: complex, left: Complex, right: Complex, k: Array, moving: Array) -> Array:
        """Derivative (P,) of the absolute value of a pole."""
        n = len(self.B)
        turned = np.conj(pole) / abs(pole)
        h, seen, pushed = len(k), self.F @ right, left @ self.E
        k = np.tile(k, self.moves)
        if len(self.H):
            seen[h:] += self.H @ (k * seen)[:h]
            pushed[:h] += (k * pushed)[h:] @ self.H
        zeros = {name: np.zeros(getattr(self, name).shape, dtype=complex) for name in (*SEARCHED, "r")}
        zeros["A"] = np.einsum("bi,bj->bij", left.reshape(n // 2, 2), right.reshape(n // 2, 2))
        zeros["E"], zeros["F"] = np.outer(left, k * seen), np.outer(k * pushed, right)
        zeros["H"] = np.outer((k * pushed)[h:], (k * seen)[:h])
        zeros["c"] = (moving - self.beta) * (pushed * seen).reshape(-1, h).sum(axis=0)[:, None]
        return np.concatenate([(turned * part).real.ravel() for part in zeros.values()])

    def dynamics(self, sample_time_s: float) -> FeedbackHysteresisDynamics:
        """Return the block as the dynamics of a model."""
        none, h = Pair(np.zeros(1), np.zeros(1)), range(len(self.r))
        pairs = tuple(tuple(self._pair(i) if i == k else none for k in h) for i in h)
        matrices = {name: getattr(self, name) for name in "BCDEFGH"} | {"A": self.full()}
        return FeedbackHysteresisDynamics.of(
            PrandtlIshlinskii(pairs),
            sample_time_s=sample_time_s,
            products=InputProducts(self.K, self.limit, self.factors),
            **matrices,
        )

    def describe(self) -> str:
        """Short description of its size."""
        h, plays = self.r.shape
        products = f", {self.K.shape[1]} products" if self.K.size else ""
        often = ", twice per sample" * (self.moves - 1)
        return f"order {len(self.B)}, {number_of(h, 'path')} of {plays} plays in the loop{products}{often}"

    def _pair(self, i: int) -> Pair:
        """Plays of z_i, the straight part at threshold 0; plays that came to one threshold are one."""
        r, place = np.unique(self.r[i], return_inverse=True)
        weights = np.bincount(place, self.c[i])
        straight = -(self.c[i] * self.beta[i]).sum()
        return Pair(np.concatenate([[0.0], r]), np.concatenate([[straight], weights]))

    def plain(self) -> dict[str, Any]:
        """Return all parameters as plain JSON."""
        return {one.name: getattr(self, one.name).tolist() for one in fields(self)}

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> LoopParameters:
        """Return the parameters of ``plain``; KeyError, TypeError or ValueError for anything else."""
        numbers: dict[str, Any] = {one.name: np.array(plain[one.name], float) for one in fields(cls)}
        numbers["H"] = numbers["H"].reshape(-1, len(numbers["r"]))
        numbers["factors"] = numbers["factors"].reshape(-1, 3).astype(np.int64)
        numbers["K"] = numbers["K"].reshape(len(numbers["r"]), -1)
        return cls(**numbers)


THRESHOLDS = (0.1, 0.3, 0.8, 1.8)
"""Initial thresholds of a path, in parts of the largest rms of its z."""
COUPLING = 0.3
"""Part of the position in the z of a path at first, beside the voltage. The charge of a stack follows
u + T x / C, where the position has a part of T^2 / (K C): 0.2 to 0.5. From the position alone, searches
ended in other minima."""
BEYOND = 1.2
"""Limit of a z in products, as a part of the largest one."""


def linear_start(block: LinearBlock, periods: Sequence[SettledPeriod]) -> LoopParameters:
    """Parameters that reproduce a linear block, with one inactive path of plays for each input.

    The z of a path is the voltage and ``COUPLING`` of the position in the coordinates of the inputs, as the
    charge of a stack follows both. Its hysteresis acts like the input; the search finds its gain.
    """
    to_blocks = _coordinates(block.A)
    a = np.linalg.solve(to_blocks, block.A @ to_blocks)
    b, c = np.linalg.solve(to_blocks, block.B), block.C @ to_blocks
    back = np.linalg.pinv(block.response(0.0)[0].real)
    pairs = [a[k : k + 2, k : k + 2] for k in range(0, len(a), 2)]
    h, m = 0, b.shape[1]
    none = LoopParameters(
        np.array(pairs),
        b,
        c,
        block.D,
        E=np.zeros((len(a), h)),
        F=np.zeros((h, len(a))),
        G=np.zeros((h, m)),
        H=np.zeros((0, h)),
        c=np.zeros((h, len(THRESHOLDS))),
        K=np.zeros((h, 0)),
        r=np.zeros((h, len(THRESHOLDS))),
        beta=np.zeros((h, len(THRESHOLDS))),
        limit=np.ones(h),
        factors=np.zeros((0, 3), dtype=np.int64),
    )
    return with_paths(none, b, COUPLING * back @ c, COUPLING * back @ block.D + np.eye(m), periods)


def with_paths(
    found: LoopParameters, e: Array, f: Array, g: Array, periods: Sequence[SettledPeriod]
) -> LoopParameters:
    """Parameters with more paths of weight 0; their z are scaled to an rms of 1.

    e : (n, more); f : (more, n); g : (more, m)
    """
    two = found.moves - 1
    z = _largest(found, f, g, periods)
    size = z.std(axis=1)[:, None] + 1e-300
    z, h = z / size, len(found.r)
    places = np.linspace(0.0, len(THRESHOLDS) - 1, found.r.shape[1])
    grid = np.tile(np.exp(np.interp(places, range(len(THRESHOLDS)), np.log(THRESHOLDS))), (len(z), 1))
    beta = _straight(z, grid)
    factors = np.where(found.factors == h, h + len(e.T), found.factors)
    return replace(
        found,
        E=np.hstack([found.E[:, :h], e, found.E[:, h:], *[e] * two]),
        F=np.vstack([found.F[:h], f / size, found.F[h:], *[f / size @ found.full()] * two]),
        G=np.vstack([found.G[:h], g / size, found.G[h:], *[(f @ found.B + g) / size] * two]),
        H=np.pad(found.H, ((0, len(z) * two), (0, len(z)))),
        c=np.vstack([found.c, np.zeros(beta.shape)]),
        K=np.vstack([found.K, np.zeros((len(beta), found.K.shape[1]))]),
        r=np.vstack([found.r, grid]),
        beta=np.vstack([found.beta, beta]),
        limit=np.concatenate([found.limit, BEYOND * np.abs(z).max(axis=1)]),
        factors=factors,
    )


def with_plays(found: LoopParameters, periods: Sequence[SettledPeriod]) -> LoopParameters:
    """Parameters with additional plays of weight 0, between and around those of every path."""
    r = np.sort(found.r, axis=1)
    wide = np.hstack([r[:, :1] ** 2 / r[:, 1:2], r, r[:, -1:] ** 2 / r[:, -2:-1]])
    more = np.sqrt(wide[:, 1:] * wide[:, :-1])
    beta = _straight(_largest(found, found.F[: len(r)], found.G[: len(r)], periods), more)
    numbers = {"r": more, "c": np.zeros(more.shape), "beta": beta}
    return replace(found, **{name: np.hstack([getattr(found, name), own]) for name, own in numbers.items()})


def with_band(
    found: LoopParameters, low: float, high: float, periods: Sequence[SettledPeriod]
) -> LoopParameters | None:
    """Parameters with an additional path per input, coupled only to the modes of a band [rad/sample].

    None where the band holds no mode.
    """
    angles = np.array([np.abs(np.angle(np.linalg.eigvals(block))).max() for block in found.A])
    within = np.repeat((angles >= low) & (angles < high), 2)
    if not within.any():
        return None
    m = found.B.shape[1]
    return with_paths(found, found.B * within[:, None], found.F[:m] * within, np.zeros((m, m)), periods)


def with_ends(found: LoopParameters) -> LoopParameters:
    """Parameters whose plays also move at the end of a sample, after the effect of their first w."""
    return replace(
        found,
        E=np.hstack([0.5 * found.E, 0.5 * found.E]),
        F=np.vstack([found.F, found.F @ found.full()]),
        G=np.vstack([found.G, found.F @ found.B + found.G]),
        H=found.F @ found.E,
    )


def with_products(found: LoopParameters) -> LoopParameters:
    """Parameters with all products of two and three z of the first paths, of weight 0."""
    m, h = found.B.shape[1], len(found.r)
    several = [itertools.combinations_with_replacement(range(m), count) for count in (2, 3)]
    rows = [[*some, *[h] * (3 - len(some))] for each in several for some in each]
    return replace(found, factors=np.array(rows, dtype=np.int64), K=np.zeros((h, len(rows))))


def _largest(found: LoopParameters, f: Array, g: Array, periods: Sequence[SettledPeriod]) -> Array:
    """Signals z (more, sample) of the period that moves most."""
    period = max(periods, key=lambda one: float(np.var(one.y)))
    path, _ = found.path(period.u, period.warm)
    return np.asarray(f @ path[period.warm :, : len(found.B)].T + g @ period.u)


def _straight(z: Array, r: Array) -> Array:
    """Linear parts (h, J) of the plays r (h, J) of periodic signals z (h, sample)."""
    twice = np.hstack([z, z])
    plays = np.stack([play(row, own)[:, z.shape[1] :] for row, own in zip(twice, r, strict=True)])
    return np.asarray((plays @ z[:, :, None])[:, :, 0] / (z * z).sum(axis=1)[:, None])


def _coordinates(a: Array) -> Array:
    """Real coordinates in which a matrix has blocks of two rows: a pair of poles, or two real ones."""
    poles, vectors = np.linalg.eig(a)
    real = np.flatnonzero(np.abs(poles.imag) <= 1e-12 * np.abs(poles))
    pairs = [
        part
        for vector in vectors[:, poles.imag > 1e-12 * np.abs(poles)].T
        for part in (vector.real, vector.imag)
    ]
    return np.array([*pairs, *(vectors[:, i].real for i in real)]).T

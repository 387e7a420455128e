"""Start of a search for plays in a loop: linear dynamics of the records, with plays of their signals."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.hysteresis import play
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.search import SettledPeriod

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

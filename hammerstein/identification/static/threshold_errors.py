"""Standard errors of fitted thresholds, from the joint problem of thresholds and weights.

Near the best thresholds r and slopes c of an output the readings are

    y ~ offset + X c + sum over j of d_j w_j D_j,

X the differences of the plays, D_j the derivative of play j by its threshold, d_j the error of r_j, and s^2
the mean square of what is left, noise and misfit alike. With the slopes eliminated, each output tells of d by

    I_o = diag(w) (D'D - D'X K X'D) diag(w) / s^2,      K = Z (Z' X'X Z)^-1 Z'

(Z: the slopes that no bound holds). All outputs share the thresholds: cov d = (sum of I_o)^-1. The slopes
follow a given d by -K X'D diag(w) d; the rest of their error is that for given thresholds. Holds for errors
that are independent from sample to sample, and where d is small against the distance of neighbours; linear
dynamics behind the static block are taken as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from hammerstein.arrays import Array
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, ThresholdCovariance, WeightCovariance
from hammerstein.hysteresis.covariance import triangle
from hammerstein.identification.static.normal_equations import Moments, squares_left
from hammerstein.identification.static.static_block import StaticFit
from hammerstein.identification.static.threshold_search import Grids, ThresholdTask, split

ROOM = 0.5
"""Part of the way to its neighbour that a threshold's standard error may take, or its place is open."""


def with_threshold_errors(task: ThresholdTask, fit: StaticFit) -> StaticFit:
    """Put the errors of fitted thresholds, which all outputs share, into a static block.

    The standard errors of the weights become those beside unknown thresholds.

    Parameters
    ----------
    task : records and the path behind the static block
    fit : the block with the fitted thresholds
    """
    block = fit.hysteresis
    grids = tuple(pair.thresholds_v for pair in block.pairs[0])
    assert block.weight_covariance is not None  # what a static fit gives
    told = [
        _told_by(moment, grids, row, known)
        for moment, row, known in zip(
            task.moments(grids, with_derivatives=True), block.pairs, block.weight_covariance, strict=True
        )
    ]
    spread, held = _spread(np.sum([information for information, _ in told], axis=0), grids)
    found = ThresholdCovariance(triangle(spread), tuple(follow for _, follow in told), held)
    joint = PrandtlIshlinskii(block.pairs, block.weight_covariance, found)
    assert joint.weight_errors is not None  # as both covariances are known
    rows = zip(block.pairs, joint.weight_errors, strict=True)
    pairs = tuple(_with_errors(row, split(errors, grids)) for row, errors in rows)
    return replace(fit, hysteresis=replace(joint, pairs=pairs))


def _told_by(
    moment: Moments, grids: Grids, row: Sequence[Pair], known: WeightCovariance
) -> tuple[Array, Array]:
    """What one output tells of the thresholds [1/V^2], and how its weights follow them [um/V^2]."""
    n = len(moment.gram) // 2
    weights = np.concatenate([pair.weights_um_per_v for pair in row])
    sums = block_diag(*[np.tri(len(grid)) for grid in grids])  # from weights to slopes
    gram, mixed = moment.gram[:n, :n], moment.gram[:n, n:] * weights
    left = squares_left(gram, moment.cross[:n, 0], float(moment.power[0]), sums @ weights)
    variance = left / max(moment.freedom - n + known.slopes_at_bound, 1)
    if variance == 0.0:
        return np.diag(np.full(n, np.inf)), np.zeros((n, n))
    drag = sums @ (known.covariance / variance) @ sums.T @ mixed
    alone = moment.gram[n:, n:] * np.outer(weights, weights)
    return (alone - mixed.T @ drag) / variance, -np.linalg.solve(sums, drag)


def _spread(information: Array, grids: Grids) -> tuple[Array, tuple[int, ...]]:
    """Matrix S (threshold, threshold) [V], S S^T the covariance of those that are told, and which are not.

    A threshold of 0 stands at its end and has no error. Of those whose error reaches too far towards a
    neighbour the one that reaches farthest is held, and the others are judged again.
    """
    r = np.concatenate(grids)
    room = np.concatenate([_room(grid) for grid in grids])
    spread: Array = np.zeros((len(r), len(r)))
    held: list[int] = []
    free = np.flatnonzero((r > 0.0) & np.isfinite(np.diag(information)))
    while free.size:
        own = _inverse_root(information[np.ix_(free, free)])
        reaches = np.linalg.norm(own, axis=1) / room[free]
        worst = int(np.argmax(reaches))
        if reaches[worst] <= ROOM:
            spread[np.ix_(free, free)] = own
            break
        held.append(int(free[worst]))
        free = np.delete(free, worst)
    return spread, tuple(sorted(held))


def _inverse_root(information: Array) -> Array:
    """Matrix S with S S^T the inverse; infinite rows where nothing is told of a threshold."""
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    if not size.all():
        return np.diag(np.where(size > 0.0, 0.0, np.inf))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    return np.asarray(vectors / np.sqrt(np.maximum(values, np.finfo(float).eps)) / size[:, None])


def _room(grid: Array) -> Array:
    """Distance (threshold,) to the nearest neighbour, or to 0 [V]."""
    gaps = np.diff(grid, prepend=0.0, append=np.inf)
    return np.minimum(np.where(grid > 0.0, gaps[:-1], np.inf), gaps[1:])


def _with_errors(row: Sequence[Pair], errors: Sequence[Array]) -> tuple[Pair, ...]:
    """Pairs of one output with the standard errors of their weights."""
    each = zip(row, errors, strict=True)
    return tuple(Pair(pair.thresholds_v, pair.weights_um_per_v, error) for pair, error in each)

"""The loop from a voltage through its rate back to itself, in the inverse of rate-dependent plays."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array


def stability_gain(weights: Array, growth_s: Array, poles: Array, sample_time_s: float) -> Array:
    """How far the loop of each input is from ringing up (m,): stable below 1; inf where nothing is known.

    On a branch the inverse gives ``u[k] = ... + B rho[k]`` with ``B = J^-1 N``; column k of J sums the
    weights of the plays of input k that move, that of N the weights times their growth. Any plays may move
    together with the first. With one input the closed loop has the poles of

        z^2 - (a + beta) z + beta = 0,      beta = b (1 - a) / T,   b = sum of w_i b_i / sum of w_i,

    stable while ``-(1 + a) / 2 < beta < 1``. With weights of both signs b leaves the range of the b_i. With
    several inputs, ``B = diag(b) + E``; a column of E of size e (1 - a) / T = eps moves an eigenvalue by no
    more, and a disc of radius eps about beta lies in the stable region while ``beta + 2 eps / (1 + a) < 1``
    and ``eps - beta < (1 + a) / 2``.

    Parameters
    ----------
    weights : (input, play, output) [um/V] of a square model, which has an inverse
    growth_s : (input, play) growth, not falling [s]
    poles : (input,) a of the low-passes of the rate
    sample_time_s : T [s]

    Source: Gershgorin's discs in the coordinates of the mean slopes; this work's.
    """
    first = weights[:, 0].T
    mean = 0.5 * (first + weights.sum(axis=1).T)
    ends, across, kept = [], [], []
    for k, own_weights in enumerate(weights):
        shares = np.linalg.solve(mean, own_weights.T)
        own, others = shares[k], np.delete(shares, k, axis=0)
        low, high = _mean_growth(own, growth_s[k])
        off = np.maximum(np.abs(growth_s[k] - low), np.abs(growth_s[k] - high))
        across.append(float((np.abs(others) * off).sum()))
        sides = [
            others[:, 0] + sign * np.maximum(sign * others[:, 1:], 0.0).sum(axis=1) for sign in (1.0, -1.0)
        ]
        most = np.maximum(np.abs(sides[0]), np.abs(sides[1])).sum()
        kept.append(own[0] + np.minimum(own[1:], 0.0).sum() - most)
        ends.append((min(low, 0.0), max(high, 0.0)))
    if min(kept) <= 0.0:
        return np.full(len(weights), np.inf)
    scale, half = (1.0 - poles) / sample_time_s, 0.5 * (1.0 + poles)
    (low, high), around = scale * np.array(ends).T, scale * np.array(across) / min(kept)
    return np.asarray(np.maximum(high + around / half, (around - low) / half))


def _mean_growth(weights: Array, growth_s: Array) -> tuple[float, float]:
    """Least and greatest weighted mean growth over all plays that may move with the first.

    Where the mean is greatest, plays of positive weight move that grow more than it does, and of negative
    weight that grow less; where it is least, the others.
    """
    if weights[0] + np.minimum(weights[1:], 0.0).sum() <= 0.0:
        return -np.inf, np.inf
    number = np.arange(len(weights))
    last = number >= np.arange(1, len(weights) + 1)[:, None]  # (split, play): those that grow most
    means = []
    for moving in (last == (weights > 0.0), last == (weights <= 0.0)):
        moving[:, 0] = True
        means.append((moving @ (weights * growth_s)) / (moving @ weights))
    return float(np.min(means)), float(np.max(means))

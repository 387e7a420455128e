"""Noise and quantisation of a measured signal, estimated without a reference."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

ORDERS = range(2, 9)
"""Orders of difference tried. Each passes white noise alike and removes more of a smooth signal."""

SMALLEST_SWING = 1e-3
"""Part of the range under which a reversal is no turn of the experiment, however clean the signal."""


LARGEST_BAND = 0.25
"""Part of the range above which a swing is one, however rough the signal: a switching voltage is no noise."""


def noise_rms(x: ArrayLike) -> float:
    """Rms value of the white noise on a sampled smooth signal.

    The difference of order k of white noise has the variance binomial(2 k, k) times that of the noise, while
    a smooth signal fades with every order:

        noise = min over k of median |difference_k| / (0.6745 sqrt(binomial(2 k, k)))

    The median excludes corners (triangles, reversals of a hysteretic output). Quantisation that moves with
    the signal counts as noise.

    Parameters
    ----------
    x : (sample,) any unit

    Returns
    -------
    rms value in the unit of x; 0 for fewer than 20 samples

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> x = np.sin(np.linspace(0.0, 50.0, 4000)) + 0.01 * rng.standard_normal(4000)
    >>> round(noise_rms(x), 4)
    0.0101
    """
    difference = np.diff(np.asarray(x, dtype=np.float64))
    if difference.size < 19:
        return 0.0
    levels = []
    for order in ORDERS:
        difference = np.diff(difference)
        scale = 0.6745 * math.sqrt(math.comb(2 * order, order))
        levels.append(float(np.median(np.abs(difference))) / scale)
    return min(levels)


def quantum(x: ArrayLike) -> float:
    """Step of the lattice on which all samples lie; 0 if there is none.

    Parameters
    ----------
    x : (sample,) any unit

    Returns
    -------
    step in the unit of x

    Examples
    --------
    >>> round(quantum([0.0, 0.04, 0.12, 0.08, 0.2]), 9)
    0.04
    >>> quantum([0.0, 0.04, 0.11, 0.085, 0.2])
    0.0
    """
    levels = np.unique(np.asarray(x, dtype=np.float64))
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.ptp(levels)] if gaps.size else gaps
    if gaps.size < 2:
        return 0.0
    steps = gaps / gaps.min()
    on_lattice = bool(np.all(np.abs(steps - np.round(steps)) < 0.05))
    return float(gaps.min()) if on_lattice else 0.0


def dead_band(x: ArrayLike) -> float:
    """Smallest swing that cannot be noise, quantisation or a rounding error; a quarter of the range at most.

    Two samples of white noise out of N differ by hardly more than 2 sqrt(2 ln N) of its rms value, and a
    converter flickers by one step.

    Parameters
    ----------
    x : (sample,) any unit

    Returns
    -------
    swing in the unit of x
    """
    x = np.asarray(x, dtype=np.float64)
    extremes = 2.0 * (math.sqrt(2.0 * math.log(max(x.size, 2))) + 1.0)
    span = float(np.ptp(x)) if x.size else 0.0
    return min(max(extremes * noise_rms(x), 1.5 * quantum(x), SMALLEST_SWING * span), LARGEST_BAND * span)

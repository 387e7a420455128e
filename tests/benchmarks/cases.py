"""Signals and models that the benchmarks share."""

import numpy as np

from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

SAMPLE_TIME_S = 5e-5


def with_operators(n, axes=2):
    """A model of n operators a pair: the published one at 15, else an even grid and positive weights."""
    if n == 15 and axes == 2:
        return HammersteinModel.load("duo_bimorph_static").hysteresis
    r, rng = np.linspace(0.07, 9.7, n), np.random.default_rng(n)
    rows = [[Pair(r, rng.uniform(0.0, 12.0 / n, n)) for _ in range(axes)] for _ in range(axes)]
    return PrandtlIshlinskii(rows)


def sines(samples, axes=2):
    """50 Hz, 10 V, each axis with its own phase (axis, sample)."""
    t = np.arange(samples) * SAMPLE_TIME_S
    return 10.0 * np.sin(2 * np.pi * 50.0 * t + np.arange(axes)[:, None])


def walk(samples, axes=2):
    """A random walk within the range: every other sample is a reversal, most of them small."""
    steps = np.random.default_rng(2).uniform(-0.5, 0.5, (axes, samples))
    return 10.0 - np.abs((np.cumsum(steps, axis=1) + 10.0) % 40.0 - 20.0)


def noise(samples, axes=2):
    """White noise: two samples of three are a reversal."""
    return np.random.default_rng(1).uniform(-10.0, 10.0, (axes, samples))

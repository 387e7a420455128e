"""A signal that visits what a law can meet: sines, random walks, noise, plateaus, saturation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.export.request import ForwardModel
from hammerstein.model import HammersteinModel

SAMPLES = 2000  # of the table that is shipped
DIGITS = 6  # after the point: what a sine is in the last bits differs between machines
BEYOND = 1.6  # times the reach, where it saturates


def entering(block: Law[Any] | ForwardModel, model: HammersteinModel, samples: int, seed: int = 1) -> Array:
    """Signal (axis, sample) for a law [um], or for the model itself [V]."""
    limits = block.range
    if isinstance(block, ForwardModel):
        middle, half = 0.5 * (limits.low_v + limits.high_v), 0.5 * limits.span_v
    else:
        middle, half = _reach(block, model)
    whole = np.concatenate(list(_waves(len(middle), samples, seed)), axis=1)[:, :samples]
    signal = middle[:, None] + half[:, None] * whole
    if isinstance(block, ForwardModel):
        signal = np.clip(signal, limits.low_v[:, None], limits.high_v[:, None])
    return np.asarray(np.round(signal, DIGITS) + 0.0)  # no negative zero


def adverse(block: Law[Any] | ForwardModel, model: HammersteinModel, samples: int) -> Array:
    """Many such signals one after the other, each with other walks, noise and plateaus (axis, sample)."""
    times = -(-samples // SAMPLES)
    parts = [entering(block, model, SAMPLES, seed) for seed in range(2, 2 + times)]
    return np.concatenate(parts, axis=1)[:, :samples]


def _reach(law: Law[Any], model: HammersteinModel) -> tuple[Array, Array]:
    """Middle and half width (p,) of where the actuator can go, counted from its start [um]."""
    limits = law.range
    ends = np.stack([limits.start_v, limits.low_v, limits.high_v], axis=1)
    rows = []
    for k in range(len(ends)):
        drive = np.repeat(limits.start_v[:, None], 3, axis=1)
        drive[k] = ends[k]
        rows.append(model.static_response(drive)[0])
    moved = np.array(rows)[:, :, 1:] - np.array(rows)[:, :, :1]
    low, high = moved.min(axis=2).min(axis=0), moved.max(axis=2).max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)


def _waves(axes: int, samples: int, seed: int) -> Iterator[Array]:
    """Parts within -1 to 1, but for the saturated one."""
    rng, n = Uniform(seed), -(-samples // 6)
    turn = 2.0 * np.pi * np.arange(n) / n
    rates = 3.0 + 2.0 * np.arange(axes)[:, None]
    yield 0.8 * np.sin(rates * turn) * np.minimum(1.0, 2.0 * turn / np.pi)
    yield 0.9 * np.sin(np.cumsum(rng.of(axes, n) / 8.0, axis=1))
    yield 0.7 * rng.of(axes, n)
    yield np.repeat(0.8 * rng.of(axes, -(-n // 25)), 25, axis=1)[:, :n]
    yield BEYOND * np.sin((rates - 1.5) * turn)
    yield 0.9 * np.cos(7.0 * turn) * (1.0 - turn / (2.0 * np.pi)) * np.ones((axes, 1))


class Uniform:
    """Numbers from -1 to 1 that no version of NumPy changes: the raw words of a generator."""

    def __init__(self, seed: int):
        self._words = np.random.PCG64(seed)

    def of(self, axes: int, samples: int) -> Array:
        """Numbers (axis, sample)."""
        words = np.asarray(self._words.random_raw(axes * samples), dtype=np.uint64) >> np.uint64(11)
        return (2.0 * words.astype(np.float64) * 2.0**-53 - 1.0).reshape(axes, samples)


STARTS, ROUNDS, LENGTH = 8, 80, 60  # of a random search: begins, changes of each, length of a drive
LEVELS = 40  # from the middle to the reach, and a quarter of that beyond it


def worst_case_step(operations: Callable[[Array], int], reach: Array) -> tuple[int, int]:
    """Most operations of a step that a climbing search finds, and the samples it tried.

    The search changes sequences of levels in a few samples at a time, and keeps a change if the most
    expensive step is no cheaper. Jumps after many turns are expensive. Every other search only jumps to the
    ends of the reach, because the longest jumps cost most with parallel blocks.

    Parameters
    ----------
    operations : operations of the most expensive step of a signal (axis, sample) from the start
    reach : (axis,) largest value of each axis
    """
    rng, axes, worst = Uniform(seed=11), len(reach), 0

    def levels(samples: int) -> Array:
        return np.asarray(np.round(1.25 * LEVELS * rng.of(axes, samples)) / LEVELS)

    for start in range(STARTS):
        best, most = levels(LENGTH), 0
        for _ in range(ROUNDS):
            trial = best.copy()
            where = (0.5 * LENGTH * (rng.of(1, 3)[0] + 1.0)).astype(np.int64)
            jumps = levels(len(where))
            trial[:, where] = 1.25 * np.sign(jumps) if start % 2 else jumps
            found = operations(reach[:, None] * trial)
            if found >= most:
                best, most = trial, found
        worst = max(worst, most)
    return worst, STARTS * ROUNDS * LENGTH

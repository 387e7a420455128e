"""Motion from the initial position to the start of a path."""

from __future__ import annotations

import math

import numpy as np

from hammerstein.arrays import Array
from hammerstein.signals import smooth_step

SHORTEST_S, LONGEST_S = 0.02, 1.0
"""A stage rings for less than the first; nobody waits for more than the second."""
PEAK = 10.0 / math.sqrt(3.0)
"""Largest acceleration of a fifth-order step of size and duration 1."""
TURNED = 4.0
"""Largest acceleration of a fifth-order way to velocity 1 in duration 1, at most."""
SMOOTH = 0.5
"""Third difference of the beginning of a path, in parts of the second, up to which it has an acceleration."""
AT_REST = 1e-9
"""Start of a path, in parts of its largest position, that is rounding."""


def lead_in(reference_um: Array, sample_time_s: float) -> Array:
    """Positions (p, N) from 0 at rest to the beginning of a path (p, samples) [um].

    A fifth-order polynomial that ends with the velocity of the path, and with its acceleration where the path
    begins smoothly: a jump of the acceleration would ring at half the sample rate in the inverse of a
    resonance. Its acceleration stays within the largest one of the path, as far as that takes neither less
    than 0.02 s nor more than 1 s. No sample for a path that begins where the actuator rests.

    Examples
    --------
    >>> way = lead_in(np.full((1, 100), 8.0), 1e-3)
    >>> way.shape, way[0, [0, 500, 999]].round(3).tolist()
    ((1, 1000), [0.0, 4.0, 8.0])
    """
    start = reference_um[:, 0]
    velocity, acceleration = _beginning(reference_um, sample_time_s)
    bend = np.abs(np.diff(reference_um, 2, axis=1)).max(initial=0.0) / sample_time_s**2
    largest = float(np.abs(reference_um).max())
    if largest == 0.0 or (not (np.abs(start) > AT_REST * largest).any() and not _moves(reference_um)):
        return np.zeros((len(start), 0))
    distance, speed = float(np.abs(start).max()), float(np.abs(velocity).max())
    asked = max(math.sqrt(PEAK * distance / bend), TURNED * speed / bend) if bend > 0.0 else LONGEST_S
    samples = math.ceil(min(max(asked, SHORTEST_S), LONGEST_S) / sample_time_s)
    x = np.arange(samples) / samples
    turn, bow = x**3 * (-4.0 + x * (7.0 - 3.0 * x)), 0.5 * x**3 * (1.0 - x) ** 2
    last_s = samples * sample_time_s
    ends = np.multiply.outer(velocity, last_s * turn) + np.multiply.outer(acceleration, last_s**2 * bow)
    return np.asarray(start[:, None] * smooth_step(x) + ends)


def _beginning(reference_um: Array, sample_time_s: float) -> tuple[Array, Array]:
    """Velocity (p,) [um/s] and acceleration (p,) [um/s^2] at the first sample of a path (p, N).

    They are those of a cubic through its first four samples. A corner or noise there shows in its third
    difference: then the velocity is that of the first step, and the acceleration zero.
    """
    first = np.diff(reference_um[:, :2])[:, 0]
    if reference_um.shape[1] < 4:
        return first / sample_time_s, np.zeros(len(first))
    second, third = (np.diff(reference_um[:, :4], order)[:, 0] for order in (2, 3))
    smooth = np.abs(third) < SMOOTH * np.abs(second)
    velocity = first + np.where(smooth, third / 3.0 - second / 2.0, 0.0)
    return velocity / sample_time_s, np.where(smooth, second - third, 0.0) / sample_time_s**2


def _moves(reference_um: Array) -> bool:
    """Whether a path begins at the velocity that it has a sample later, not from rest."""
    first = np.abs(np.diff(reference_um[:, :3], axis=1))
    return bool(first.size and (first[:, 0] > 0.5 * first[:, -1]).any())

"""Motion added to a path: a lead-in from the initial position, and detours to reach holds from one side."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.signals import smooth_step

SHORTEST_S, LONGEST_S = 0.02, 1.0
"""Shortest and longest lead-in [s]: a stage rings for less than the first."""
PEAK = 10.0 / math.sqrt(3.0)
"""Largest acceleration of a fifth-order step of size and duration 1."""
TURNED = 4.0
"""Bound of the acceleration of a fifth-order transition to velocity 1 in duration 1."""
SMOOTH = 0.5
"""Third difference of the beginning of a path over the second, up to which it has an acceleration."""
GOES_ON = 0.1
"""Second step of a path over the first, from which both are motion; a jump has none, noise may."""
OUTSIDE = 0.02
"""Part of the range of a path and 0 by which a lead-in may leave it before a shorter one is tried."""
AT_REST = 1e-9
"""Start of a path, in parts of its largest position, up to which it is rounding."""


def lead_in(reference_um: Array, sample_time_s: float) -> Array:
    """Positions (p, N) from 0 at rest to the beginning of a path (p, samples) [um].

    A fifth-order polynomial that ends with the velocity of the path, and with its acceleration where the path
    begins smoothly: a jump of the acceleration would ring at half the sample rate in the inverse of a
    resonance. Its acceleration stays within the largest one of the path, as far as that takes neither less
    than 0.02 s nor more than 1 s; to a smooth path it is shorter where 0.02 s would leave the path's range.
    No sample for a path that begins where the actuator rests.

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
    low, high = (np.minimum(reference_um.min(axis=1), 0.0), np.maximum(reference_um.max(axis=1), 0.0))
    found, least = np.zeros((len(start), 0)), math.inf
    duration_s = min(max(asked, SHORTEST_S), LONGEST_S)
    shortest_s = min(asked, LONGEST_S) if acceleration.any() else duration_s  # no resonance follows a corner
    while least > OUTSIDE * float((high - low).max()) and duration_s >= shortest_s:
        way = _way(start, velocity, acceleration, math.ceil(duration_s / sample_time_s), sample_time_s)
        outside = float(np.maximum(low[:, None] - way, way - high[:, None]).max())
        if outside < least:
            found, least = way, outside
        duration_s *= 0.5
    return found


def _way(start_um: Array, velocity: Array, acceleration: Array, samples: int, sample_time_s: float) -> Array:
    """Fifth-order way (p, samples) from 0 at rest to a position, velocity and acceleration (p,)."""
    x, last_s = np.arange(samples) / samples, samples * sample_time_s
    turn, bow = x**3 * (-4.0 + x * (7.0 - 3.0 * x)), 0.5 * x**3 * (1.0 - x) ** 2
    ends = np.multiply.outer(velocity, last_s * turn) + np.multiply.outer(acceleration, last_s**2 * bow)
    return np.asarray(start_um[:, None] * smooth_step(x) + ends)


def _beginning(reference_um: Array, sample_time_s: float) -> tuple[Array, Array]:
    """Velocity (p,) [um/s] and acceleration (p,) [um/s^2] at the first sample of a path (p, N).

    They are those of a cubic through its first four samples. A corner or noise there shows in its third
    difference: then the velocity is that of the first step, and the acceleration zero. A first step that the
    next one does not go on with is a jump from rest.
    """
    first = np.diff(reference_um[:, :2])[:, 0]
    if reference_um.shape[1] < 4:
        return first / sample_time_s, np.zeros(len(first))
    second, third = (np.diff(reference_um[:, :4], order)[:, 0] for order in (2, 3))
    smooth = np.abs(third) < SMOOTH * np.abs(second)
    jump = (first + second) * np.sign(first) < GOES_ON * np.abs(first)
    velocity = np.where(smooth, first + third / 3.0 - second / 2.0, np.where(jump, 0.0, first))
    return velocity / sample_time_s, np.where(smooth, second - third, 0.0) / sample_time_s**2


def _moves(reference_um: Array) -> bool:
    """Whether a path begins at the velocity that it has a sample later, not from rest."""
    first = np.abs(np.diff(reference_um[:, :3], axis=1))
    return bool(first.size and (first[:, 0] > 0.5 * first[:, -1]).any())


SHORTEST_HOLD_S, LONGEST_DETOUR_S = 0.08, 1.0
"""Shortest hold that has a detour, and its longest detour [s]; a detour takes at most half of a hold."""
STILL = 1e-9
"""Largest change between two samples of a hold, in parts of the largest position of the path."""


@dataclass(frozen=True, eq=False)
class Approach:
    """A path with detours, and their number for each output.

    path_um : (p, N) path with detours [um]
    distance_um : (p,) length of each detour [um], negative for an approach from below
    detours, right, short : (p,) number of holds with a detour, of holds that the path itself reaches from the
        right side, and of holds that are too short for a detour
    """

    path_um: Array
    distance_um: Array
    detours: tuple[int, ...]
    right: tuple[int, ...]
    short: tuple[int, ...]

    def statement(self, outputs: Sequence[str]) -> str:
        """State how many holds of each output are reached from which side."""
        parts = []
        for o, name in enumerate(outputs):
            if not self.distance_um[o]:
                continue
            side = "below" if self.distance_um[o] < 0.0 else "above"
            reached = f"{name} {self.detours[o] + self.right[o]} from {side}, {self.detours[o]} by a detour"
            missed = f", {self.short[o]} not (shorter than {SHORTEST_HOLD_S:g} s)" if self.short[o] else ""
            parts.append(reached + missed)
        return f"Holds reached from one side: {'; '.join(parts)}."


def approached(reference_um: Array, distance_um: Sequence[float], sample_time_s: float) -> Approach:
    """Reach every hold of a path from one side: go past it first, and come back.

    A hold is a part of at least 0.08 s in which an output does not move. Unless the output has already moved
    towards it for the whole distance from the right side, the first half of the hold goes to
    ``hold + distance`` and back, by two fifth-order steps. The times of the path stay as they are.

    Parameters
    ----------
    reference_um : (p, N) path
    distance_um : of each output, or of all [um]; below zero for an approach from below, zero for an output
        that has no backlash. It must be more than the backlash
    sample_time_s : of the path

    Raises
    ------
    InputError : a distance that is none, or a path without holds

    Examples
    --------
    >>> path = np.repeat([[5.0, 2.0]], 200, axis=1)
    >>> found = approached(path, [-1.0], 1e-3)
    >>> found.path_um[0, [0, 50, 100, 199]].tolist(), found.path_um.min(), found.detours
    ([5.0, 4.0, 5.0, 5.0], np.float64(1.0), (2,))
    """
    p = len(reference_um)
    distance = np.array(distance_um, dtype=np.float64)
    if len(distance) not in (1, p) or not (np.isfinite(distance).all() and distance.any()):
        what = f"needs a distance other than 0 for all outputs, or one for each of {p}"
        raise InputError("--approach-side", what)
    distance = np.broadcast_to(distance, p)
    each = zip(reference_um, distance.tolist(), strict=True)
    found = (_of_output(row, away, sample_time_s) for row, away in each)
    rows, detours, right, short = zip(*found, strict=True)
    if not (any(detours) or any(right)):
        what = f"has no effect: no output of the path is constant for {SHORTEST_HOLD_S:g} s"
        raise InputError("--approach-side", what)
    return Approach(np.stack(rows), distance, detours, right, short)


def _of_output(row: Array, away: float, sample_time_s: float) -> tuple[Array, int, int, int]:
    """One output with its detours, and how many holds have one, need none and are too short."""
    bent, counts = row.copy(), [0, 0, 0]
    ready, before = False, 0
    for first, end in _holds(row) if away else ():
        ready = _moved_towards(row[before : first + 1], away, ready)
        before = end - 1
        if ready:
            counts[1] += 1
        elif (end - first) * sample_time_s < SHORTEST_HOLD_S:
            counts[2] += 1
        else:
            samples = min((end - first) // 2, int(LONGEST_DETOUR_S / sample_time_s))
            x = np.arange(samples) / samples
            bent[first : first + samples] += away * smooth_step(np.asarray(1.0 - np.abs(2.0 * x - 1.0)))
            ready = True
            counts[0] += 1
    return bent, counts[0], counts[1], counts[2]


def _holds(row: Array) -> Iterator[tuple[int, int]]:
    """First sample and end of each part in which an output does not move for three samples or more."""
    still = np.abs(np.diff(row)) <= STILL * max(float(np.abs(row).max()), 1e-12)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    for first, last in edges.reshape(-1, 2).tolist():
        if last - first >= 2:
            yield first, last + 1


def _moved_towards(way: Array, away: float, ready: bool) -> bool:
    """Whether the output has moved from the right side for the whole distance, at the end of a way."""
    steps = -np.sign(away) * np.diff(way)
    wrong = np.flatnonzero(steps < 0.0)
    if not wrong.size:
        return ready or bool(steps.sum() >= abs(away))
    return bool(steps[wrong[-1] + 1 :].sum() >= abs(away))

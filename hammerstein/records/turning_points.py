"""Turning points of a voltage, and small excursions on larger branches."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Indices

ORDERS = range(2, 9)
"""Orders of difference that are tried; higher ones remove more of a smooth signal."""

SMALLEST_SWING = 1e-3
"""Smallest reversal that is a turn, in parts of the range, however clean the signal."""


LARGEST_BAND = 0.25
"""Swing that is never noise, in parts of the range: a switching voltage looks rough."""


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
    """Quantisation step of all samples; 0 if there is none.

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


MINOR_SHARE = 0.5
"""Largest excursion on a branch, in parts of the adjacent swing; larger ones are cycles."""


def turning_points(u_v: ArrayLike, band_v: float | None = None) -> Indices:
    """Samples at which a voltage turns, with the two ends of the record as first and last.

    A reversal counts when the voltage has moved back by more than the dead band; the turning point is the
    extreme sample before that. Noise, quantisation and plateaus therefore make no turns. The first and the
    last entry are the extremes with which the record begins and ends.

    Parameters
    ----------
    u_v : (sample,) voltage [V]
    band_v : dead band [V]; taken from the noise and the quantisation of the voltage if not given

    Returns
    -------
    (point,) sample numbers from 0, increasing

    Examples
    --------
    >>> turning_points([0.0, 1.0, 2.0, 1.99, 2.1, 1.0, -1.0, -1.0, 0.5], band_v=0.1)
    array([0, 4, 6, 8])
    """
    u = np.asarray(u_v, dtype=np.float64)
    band = dead_band(u) if band_v is None else band_v
    candidates = _local_extremes(u)
    values = u[candidates].tolist()
    turns: list[int] = []
    low = high = direction = 0
    for i, value in enumerate(values):
        if value > values[high]:
            high = i
        if value < values[low]:
            low = i
        if direction >= 0 and values[high] - value > band:
            turns.append(high)
            direction, low, high = -1, i, i
        elif direction <= 0 and value - values[low] > band:
            turns.append(low)
            direction, low, high = 1, i, i
    turns.append(high if direction > 0 else low if direction < 0 else len(values) - 1)
    return np.unique(candidates[[0, *turns] if direction == 0 else turns])


def _local_extremes(u: Array) -> Indices:
    """Both ends and every sample at which the difference changes its sign (first of a plateau)."""
    if u.size < 2:
        return np.arange(u.size)
    difference = np.diff(u)
    moving = np.flatnonzero(difference)
    up = difference[moving] > 0
    turns = moving[:-1][up[1:] != up[:-1]] + 1 if moving.size else moving
    return np.concatenate([[0], turns, [u.size - 1]]).astype(np.int64)


class Excursion(NamedTuple):
    """A closed piece of a voltage record: from ``start`` to ``turn`` and back to the starting level."""

    start: int
    turn: int
    stop: int
    minor: bool


class Cycles(NamedTuple):
    """The closed pieces of one voltage record, in the order in which they start.

    Parameters
    ----------
    points : samples at which the voltage turns, both ends of the record included
    excursions : cycles of the experiment and minor loops on their branches
    band_v : dead band that was used [V]
    """

    points: tuple[int, ...]
    excursions: tuple[Excursion, ...]
    band_v: float


def find_cycles(u_v: ArrayLike) -> Cycles:
    """Cut a voltage record into cycles, from turning point to the next but one, and minor loops.

    The period need not be known nor constant. The way from rest to the first turning point belongs to
    no cycle, unless the record begins at the level of a turning point; the same holds for its end. A minor
    loop is an excursion of at most half the swing beside it: it ends where the voltage regains the level at
    which it began (return-point memory).

    Parameters
    ----------
    u_v : (sample,) voltage [V]

    Examples
    --------
    >>> u = np.interp(np.arange(13.0), [0, 2, 6, 10, 12], [0, 2, -2, 2, 0])
    >>> [tuple(e) for e in find_cycles(u).excursions]
    [(2, 6, 10, False)]
    """
    u = np.asarray(u_v, dtype=np.float64)
    band = dead_band(u)
    points = turning_points(u, band).tolist()
    main, minor = _without_minor(u, points, band)
    return Cycles(tuple(points), tuple(sorted([*_main_cycles(u, main, band), *minor])), band)


def _without_minor(u: Array, points: list[int], band: float) -> tuple[list[int], list[Excursion]]:
    """Turns of the main cycles, and the minor loops taken out (four-point rule of rainflow counting)."""
    kept: list[int] = []
    minor: list[Excursion] = []
    for point in points:
        kept.append(point)
        while len(kept) >= 4:
            before, a, b, after = kept[-4:]
            swing = abs(u[b] - u[a])
            beside = abs(u[a] - u[before]), abs(u[after] - u[b])
            if swing > MINOR_SHARE * max(beside) or swing > min(beside) + band:
                break
            minor.append(Excursion(a, b, _return(u, a, b, after), minor=True))
            del kept[-3:-1]
    return kept, minor


def _return(u: Array, start: int, turn: int, limit: int) -> int:
    """First sample after the turn at which the voltage has regained its level at the start."""
    branch = u[turn : limit + 1]
    back = branch >= u[start] if u[turn] < u[start] else branch <= u[start]
    return turn + int(np.argmax(back)) if back.any() else limit


def _main_cycles(u: Array, points: list[int], band: float) -> list[Excursion]:
    """One excursion for every second turn; an end of the record counts as a turn if it has a turn's level."""
    last = len(points) - 1
    if last < 2:
        return []
    first = 0 if _same_level(u, points[0], points[1], points[2], band) else 1
    whole = last if _same_level(u, points[last], points[last - 1], points[last - 2], band) else last - 1
    return [
        Excursion(points[i], points[i + 1], points[i + 2], minor=False) for i in range(first, whole - 1, 2)
    ]


def _same_level(u: Array, a: int, turn: int, b: int, band: float) -> bool:
    return abs(float(u[a] - u[b])) <= max(band, 0.01 * abs(float(u[turn] - u[b])))

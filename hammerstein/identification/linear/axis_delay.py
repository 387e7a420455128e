"""The delay of axes behind the thresholds found, to a part of a sample."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.identification.known_sensor import KnownSensor
from hammerstein.identification.linear.axis_search import GUESS_SAMPLES, TINY, FirstGuess, thinning
from hammerstein.identification.linear.axis_steps import ROUGHLY, Point, refine
from hammerstein.identification.linear.axis_task import AxisTask
from hammerstein.identification.linear.delay import MOST_DELAY
from hammerstein.identification.static.history import liveliest
from hammerstein.identification.static.regressors import Start
from hammerstein.records.record import Record

CLEARLY_BETTER = 0.98
"""Part of the error under which another delay takes the place of the one found first."""
PART = 1.0 / 64.0
"""Parts of a sample to which a delay is told."""
MOST_MORE = 60.0
"""Logarithm of the ratio of squares from which one delay is as bad as any other."""
MOST_PARTS = 4
"""Most parts of a sample that are tried."""


def checked_delay(
    records: Sequence[Record],
    starts: Sequence[Start],
    grids: Sequence[Array],
    guess: FirstGuess,
    *,
    sensor: KnownSensor | None = None,
) -> FirstGuess:
    """Guess with the delay that is best with all thresholds; the guess itself if that is the one it has.

    The few thresholds of the search smooth the hysteresis, which looks like a delay of a sample or so. A part
    of a sample is taken where it leaves clearly less than whole ones.

    Parameters
    ----------
    records, starts : as for the search
    grids : thresholds of each input [V]
    guess : what the search has found; nothing is done if the delay was given
    sensor : what is known of it; nothing if not given
    """
    if not len(guess.delay_rms_um):
        return guess
    quick, begun = liveliest(records, starts, GUESS_SAMPLES)
    every = thinning(quick)

    def points(delay: float, begins: Sequence[Array]) -> list[Point]:
        tasks = [
            AxisTask(quick, begun, tuple(grids), o, shape, delay, sensor or KnownSensor(), every)
            for o, shape in enumerate(guess.shapes)
        ]
        return [refine(task, x, ROUGHLY) for task, x in zip(tasks, begins, strict=True)]

    best, found = best_delay(points, guess.delay_samples, guess.parameters)
    if best == guess.delay_samples:
        return guess
    return replace(guess, parameters=tuple(point.x for point in found), delay_samples=best)


def best_delay(
    points: Callable[[float, Sequence[Array]], list[Point]], first: float, begins: Sequence[Array]
) -> tuple[float, list[Point]]:
    """Delay [samples] that leaves the least, and all axes with it.

    points : all axes near given parameters with a delay; first, begins : where to begin
    """
    tried = {first: points(first, begins)}
    best = first
    for step in (-1, 1):
        while 0 <= best + step <= MOST_DELAY:
            there = tried[best + step] = points(best + step, [point.x for point in tried[best]])
            if not _clearly_better(there, tried[best]):
                break
            best = best + step
    part = _part_of_a_sample(points, tried, best)
    if _clearly_better(tried[part], tried[best]):
        best = part
    return best, tried[best]


def _clearly_better(new: Sequence[Point], old: Sequence[Point]) -> bool:
    return _log_rms(new) - _log_rms(old) < len(new) * math.log(CLEARLY_BETTER)


def _log_rms(points: Sequence[Point]) -> float:
    """Logarithm of the product of what is left of all outputs."""
    return sum(math.log(max(point.rms, TINY)) for point in points)


def _part_of_a_sample(
    points: Callable[[float, Sequence[Array]], list[Point]], tried: dict[float, list[Point]], whole: float
) -> float:
    """Delay within a sample of the best whole one that leaves the least, by parabolas through the squares.

    Every delay that is tried is added to ``tried``.
    """

    def squares(delay: float) -> float:
        more = 2.0 * (_log_rms(tried[delay]) - _log_rms(tried[whole])) / len(tried[whole])
        return math.exp(min(more, MOST_MORE))  # nothing at all may be left at the best one

    if whole == 0.0:
        tried[0.5] = points(0.5, [point.x for point in tried[whole]])
    near = [delay for delay in tried if abs(delay - whole) <= 1.0]
    for _ in range(MOST_PARTS):
        near = sorted(sorted(near, key=squares)[:3])
        if len(near) < 3:
            break
        bend, slope, _ = np.polyfit(np.array(near) - whole, [squares(delay) for delay in near], 2)
        lowest = whole - 0.5 * float(slope / bend) if bend > 0.0 else whole
        lowest = round(min(max(lowest, whole - 1.0, 0.0), whole + 1.0) / PART) * PART
        if lowest in tried:
            break
        tried[lowest] = points(lowest, [point.x for point in tried[min(near, key=squares)]])
        near.append(lowest)
    return min(tried, key=lambda delay: _log_rms(tried[delay]))

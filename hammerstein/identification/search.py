"""Searches that every fit uses: damped steps in several numbers, and the delay of the outputs in samples.

Steps are those of Levenberg and Marquardt: damping rises after a failed step and falls after a good one.
Source: Marquardt, Journal of the Society for Industrial and Applied Mathematics 11 (1963) 431-441.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import split_delay
from hammerstein.records.record import Record

LARGEST_CHANGE = 0.5
"""Change of a parameter up to which the normal equations are trusted."""
TINY = float(np.finfo(float).tiny)

P = TypeVar("P")


@dataclass(frozen=True)
class Damping:
    """How much steps are damped: first, by which factor less after a gain and more after none, and its ends.

    Beyond ``most`` the search is given up.
    """

    first: float = 1e-3
    less: float = 0.1
    more: float = 10.0
    least: float = 0.0
    most: float = math.inf


@dataclass(frozen=True, eq=False)
class Tried(Generic[P]):
    """One step: start, result, and whether it is better."""

    before: P
    there: P
    gained: bool

    @property
    def best(self) -> P:
        """Better one of both points."""
        return self.there if self.gained else self.before


def steps(
    begin: P, step: Callable[[P, float], P], cost: Callable[[P], float], damping: Damping
) -> Iterator[Tried[P]]:
    """Try steps from the last accepted one; the caller decides when the search has converged.

    Parameters
    ----------
    begin : initial point of the search
    step : next point from a point and a damping
    cost : error at a point, which must not grow; infinite at forbidden points
    """
    here, amount = begin, damping.first
    while amount <= damping.most:
        there = step(here, amount)
        tried = Tried(here, there, cost(there) < cost(here))
        yield tried
        here = tried.best
        amount = max(damping.less * amount, damping.least) if tried.gained else damping.more * amount


def damped_change(
    curvature: Array,
    pull: Array,
    damping: float,
    largest: float = LARGEST_CHANGE,
    least: float = TINY,
    rcond: float = 1e-12,
) -> Array:
    """Change of some parameters from their normal equations, each scaled by its own curvature.

    A parameter without an effect of its own stays unchanged.

    largest : change up to which the normal equations are trusted
    least : curvature that a parameter has at least; rcond : what counts as singular once all are scaled
    """
    told = np.diag(curvature) > TINY
    scale = np.sqrt(np.where(told, np.maximum(np.diag(curvature), least), 1.0))
    curvature, pull = np.where(np.outer(told, told), curvature, 0.0), np.where(told, pull, 0.0)
    scaled = curvature / np.outer(scale, scale) + damping * np.eye(len(scale))
    change = np.linalg.lstsq(scaled, pull / scale, rcond=rcond)[0] / scale
    return np.asarray(np.clip(change, -largest, largest))


MOST_DELAY = 5
"""Samples: later still, and the records were not started together."""
LONGER, CLEARLY = 0.01, 0.02
"""Part of the error that a longer delay must take away, and that a part of a sample must: hysteresis that is
followed with a few thresholds looks late, too."""
WORSE_DELAYS = 2
"""Delays in a row that leave more, after which no other one is tried."""
SAME_CLOCK = 0.01
"""Part by which sample times may differ that are one: the longest delay is then off by a twentieth of one."""
PART = 1.0 / 64.0
"""Resolution of a delay, in fractions of a sample."""
MOST_PARTS = 4
"""Most parts of a sample that are tried."""
MOST_MORE = 60.0
"""Logarithm of the ratio of squares from which one delay is as bad as any other."""
TINY = 1e-300
"""Keeps the logarithm of an exact fit finite."""

S = TypeVar("S")
Attempt = Callable[[float, S], tuple[Sequence[float], S]]
"""Function from a delay, and the fit of one nearby, to the residual rms of each output and the fit."""


def delay_in_samples(delay_s: float, sample_time_s: float) -> float:
    """Samples of a delay, whole ones without rounding.

    Examples
    --------
    >>> delay_in_samples(3e-4, 1e-4)
    3.0
    """
    whole, part_s = split_delay(delay_s, sample_time_s)
    return whole + part_s / sample_time_s


def alike_clocks(records: Sequence[Record]) -> bool:
    """Whether records have one sample time, as far as their clocks tell: then a delay is so many samples."""
    times = [record.sample_time_s for record in records]
    return max(times) <= (1.0 + SAME_CLOCK) * min(times)


def best_delay(attempt: Attempt[S], begin: S, *, first: float = 0.0, parts: bool = False) -> tuple[float, S]:
    """Shortest delay [samples] whose error is close to the minimum, and its fit.

    Everything is fitted again for each delay, because dynamics and hysteresis look like delays themselves.

    Parameters
    ----------
    attempt : see ``Attempt``; begin : initial guess of the first one
    first : delay that is tried first
    parts : whether fractions of a sample are tried, too

    Examples
    --------
    >>> best_delay(lambda delay, _: ([1.0 + abs(delay - 2.0)], None), None)
    (2.0, None)
    >>> best_delay(lambda delay, _: ([1.0 - 0.001 * delay], None), None)
    (0.0, None)
    """
    tried = {first: attempt(first, begin)}
    for step in (-1.0, 1.0):
        at, worse = first, 0
        while 0.0 <= at + step <= MOST_DELAY and worse < WORSE_DELAYS:
            tried[at + step], at = attempt(at + step, tried[at][1]), at + step
            worse = 0 if _least(tried) == at else worse + 1
    least = tried[_least(tried)][0]
    best = min(delay for delay, (rms, _) in tried.items() if not _better(least, rms, LONGER))
    if parts:
        part = _part_of_a_sample(attempt, tried, best)
        best = part if _better(tried[part][0], tried[best][0], CLEARLY) else best
    return best, tried[best][1]


def _better(new: Sequence[float], old: Sequence[float], part: float) -> bool:
    """Whether some errors are better than others by a part of them."""
    return _log_rms(new) - _log_rms(old) < len(new) * math.log(1.0 - part)


def _least(tried: Mapping[float, tuple[Sequence[float], Any]]) -> float:
    """Delay that leaves the least."""
    return min(tried, key=lambda delay: _log_rms(tried[delay][0]))


def _log_rms(rms: Sequence[float]) -> float:
    """Logarithm of the rms errors, multiplied over the outputs."""
    return sum(math.log(max(one, TINY)) for one in rms)


def _part_of_a_sample(
    attempt: Attempt[S], tried: dict[float, tuple[Sequence[float], S]], whole: float
) -> float:
    """Delay within a sample of the best whole one that leaves the least, by parabolas through the squares.

    Every delay that is tried is added to ``tried``.
    """

    def squares(delay: float) -> float:
        more = 2.0 * (_log_rms(tried[delay][0]) - _log_rms(tried[whole][0])) / len(tried[whole][0])
        return math.exp(min(more, MOST_MORE))  # nothing at all may be left at the best one

    if whole == 0.0:
        tried[0.5] = attempt(0.5, tried[whole][1])
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
        tried[lowest] = attempt(lowest, tried[min(near, key=squares)][1])
        near.append(lowest)
    return min(tried, key=lambda delay: _log_rms(tried[delay][0]))

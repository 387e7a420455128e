"""Levenberg-Marquardt search: damping rises after a failed step and falls after a good one.

Source: Marquardt, Journal of the Society for Industrial and Applied Mathematics 11 (1963) 431-441.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from hammerstein.arrays import Array

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

"""Hysteresis of any kind in the loop: all numbers at once, from simulated outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.dynamics import FeedbackBlock
from hammerstein.errors import IdentificationError
from hammerstein.identification.in_loop.search import SettledPeriod

FAR = 1e3
"""What a simulation that diverged counts as, in parts of the largest position."""
ROUNDS = 60
"""Most steps of a search: no trial gained in more of them."""
GAINED = 1e-5
"""Part of the sum of squares that a step must gain: less is rounding of differences beside noise."""


class Adjustable(Protocol):
    """A kind of hysteresis with numbers that a search may move, scaled so that 1 is a large change."""

    @property
    def free(self) -> Array:
        """Numbers (number,)."""
        ...

    def at(self, free: Array) -> Any:
        """Give the kind with other numbers."""
        ...


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A feedback block, and which of its numbers are searched.

    block : whose hysteresis is ``Adjustable``; its weights stay, as E scales what it gives
    entries : names of matrices, A to G, and which of their entries are free
    """

    block: FeedbackBlock
    entries: Mapping[str, Flags]

    def vector(self) -> Array:
        """Give all that is searched (number,): entries, then numbers of the kind."""
        own = [getattr(self.block, name)[free] for name, free in self.entries.items()]
        return np.concatenate([*own, cast(Adjustable, self.block.hysteresis).free])

    def at(self, vector: Array) -> OpenLoop:
        """Give the block whose ``vector`` this is."""
        found, first = {}, 0
        for name, free in self.entries.items():
            matrix = getattr(self.block, name).copy()
            matrix[free] = vector[first : (first := first + int(free.sum()))]
            found[name] = matrix
        gamma = cast(Adjustable, self.block.hysteresis).at(vector[first:])
        return replace(self, block=replace(self.block, hysteresis=gamma, **found))

    def error(self, period: SettledPeriod) -> Array:
        """What is left of a period (p, N), in its weight; large where the simulation diverges."""
        u = np.hstack([period.u[:, period.u.shape[1] - period.warm :], period.u])
        with np.errstate(all="ignore"):
            left = period.y - self.block.respond(u)[0][:, period.warm :]
        most = FAR * np.abs(period.y).max()
        return np.asarray(period.weight * np.clip(np.nan_to_num(left, nan=most), -most, most))


def fit_loop(
    start: OpenLoop,
    periods: Sequence[SettledPeriod],
    tell: Callable[[float], None] = lambda rms: None,
) -> OpenLoop:
    """Fit all free numbers at once to the simulated outputs, by Gauss-Newton steps in a trust region.

    The derivatives are differences, as a kind says nothing of its own. The hysteresis is stepped sample by
    sample, so that a period of 4096 samples costs about 0.1 s a number and step.

    Parameters
    ----------
    start : numbers near enough for the outputs to have the phase of the records
    periods : settled periods at several amplitudes
    tell : takes the rms of all weighted errors after every evaluation

    Raises
    ------
    IdentificationError : fewer samples than numbers

    Source: J. J. More, "The Levenberg-Marquardt algorithm", Lecture Notes in Mathematics 630 (1978).
    """
    from scipy.optimize import least_squares

    if sum(period.y.size for period in periods) < len(start.vector()):
        raise IdentificationError("the records have fewer samples than the loop has numbers; record longer")

    def left(vector: Array) -> Array:
        trial = start.at(vector)
        errors = np.concatenate([trial.error(period).ravel() for period in periods])
        tell(float(np.sqrt(np.mean(errors * errors))))
        return errors

    found = least_squares(left, start.vector(), x_scale="jac", max_nfev=ROUNDS, ftol=GAINED)
    return start.at(np.asarray(found.x))

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
    """Feedback block, and the entries of its matrices that are fitted.

    block : its hysteresis is ``Adjustable``; the weights stay fixed, because E scales their output
    entries : matrix names, A to G, and the free entries of each
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
        """Weighted prediction error of a period (p, N); large where the simulation diverges."""
        with np.errstate(all="ignore"):
            simulated = self.block.respond(period.sent)[0][:, period.warm :]
        most = FAR * np.abs(period.y).max()
        return period.left(np.clip(np.nan_to_num(simulated, nan=most), -most, most))


def fit_loop(
    start: OpenLoop, periods: Sequence[SettledPeriod], tell: Callable[[float], None] = lambda rms: None
) -> OpenLoop:
    """Fit all free parameters at once to the simulated outputs, by Gauss-Newton steps in a trust region.

    Derivatives are finite differences, because a kind has no derivatives of its own. The hysteresis is
    stepped sample by sample, so a period of 4096 samples costs about 0.1 s per parameter and step.

    Parameters
    ----------
    start : parameters close enough for the outputs to be in phase with the records
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

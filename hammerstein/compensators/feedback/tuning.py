"""Gains of a discrete PI(D) controller from the identified model, without trial on the actuator."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Complex
from hammerstein.compensators.feedback.loop import FeedbackLoop, Gains
from hammerstein.errors import SimulationError

LARGEST_SENSITIVITY = 1.6
"""Usual bounds of the largest sensitivity are 1.2 to 2 (Astrom and Hagglund, Advanced PID Control, 2006)."""
SHARES = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Ratios to the integral gain that are tried of the others, with 1 / (2 pi peak) as unit of time."""
MOST_TRIES, LITTLE, MUCH = 30, 0.98, 0.7
"""Each takes 2 to 30 % off the gains, the later ones more: a lower gain can be more sensitive at first."""


def tuned(loop: FeedbackLoop, derivative: bool = False) -> Gains:
    """Gains with the largest integral gain that keeps the sensitivity below 1.6 at every frequency.

    The controller of each output is searched over the ratios of its proportional and derivative to its
    integral gain; for each ratio the integral gain is raised until ``|1 / (1 + L)|`` first reaches 1.6 at
    some frequency for some slope. The loop of all outputs is then examined as it runs: the poles of the
    closed loop must lie inside the unit circle and the largest singular value of its sensitivity must stay
    below 1.6, for the extreme slopes of the hysteresis; where coupling spoils that, all gains are lowered. A
    lightly damped resonance is what limits them: without derivative, about ``2 zeta w_n`` over a margin.

    Parameters
    ----------
    loop : the actuator as the controller sees it
    derivative : search the derivative gain too (PID), else it is zero (PI)

    Raises
    ------
    SimulationError : no gain keeps the loop stable with that sensitivity

    Source: Astrom, Panagopoulos and Hagglund, Automatica 34 (1998) 585-601; the limit 2 zeta w_n: Fleming,
    Aphale and Moheimani, IEEE Transactions on Nanotechnology 9 (2010) 438-448.
    """
    outputs = range(loop.n_outputs)
    gains = Gains(*np.array([_one(loop, o, derivative) for o in outputs]).T)
    for tried in range(1, 1 + MOST_TRIES):
        sensitivity = loop.sensitivity(gains)
        if sensitivity <= LARGEST_SENSITIVITY and gains.integral_per_s.all():
            crossover = np.array([loop.crossover_hz(o, gains) for o in outputs])
            return replace(gains, crossover_hz=crossover, sensitivity=sensitivity)
        gains = gains.scaled(max(MUCH, min(LITTLE**tried, LARGEST_SENSITIVITY / sensitivity)))
    raise SimulationError(
        "No feedback gain makes the loop stable with a sensitivity below "
        f"{LARGEST_SENSITIVITY}: {loop.obstacle()} Give the gains yourself."
    )


def _one(loop: FeedbackLoop, o: int, derivative: bool) -> tuple[float, float, float]:
    """Proportional, integral and derivative gain of one output with the others open."""
    response = loop.alone(o)
    unit = 1.0 / (2.0 * np.pi * loop.peak_hz(o))
    best, ratios = 0.0, (0.0, 0.0)
    for share, second in itertools.product(SHARES, SHARES if derivative else (0.0,)):
        shape = 1.0 / loop.change + share * unit + second * unit * unit * loop.change
        gain = _largest_gain(response * shape)
        if gain > best:
            best, ratios = gain, (share * unit, second * unit * unit)
    return best * ratios[0], best, best * ratios[1]


def _largest_gain(loop: Complex) -> float:
    """First gain k from zero on at which ``|1 + k L| = 1 / 1.6`` for any entry of a loop; 0 where none is.

    That is the smaller root of ``|L|^2 k^2 + 2 Re(L) k + 1 - 1 / 1.6^2 = 0``. Gains below it pass -1 nowhere.
    """
    real, square = loop.real, np.abs(loop) ** 2
    within = real**2 - square * (1.0 - LARGEST_SENSITIVITY**-2)
    met = (real < 0.0) & (within >= 0.0)
    roots = (1.0 - LARGEST_SENSITIVITY**-2) / (-real[met] + np.sqrt(within[met]))
    return float(roots.min(initial=np.inf)) if met.any() else 0.0

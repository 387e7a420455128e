"""Gains of a discrete PI(D) controller from the identified model, without trial on the actuator."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.errors import SimulationError

LARGEST_SENSITIVITY = 1.6
LOWEST_GAIN_PER_S, GAINS_A_DECADE = 1e-1, 20
POINTS = 1500
SHARES = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0)


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of one controller an output; errors and corrections in um.

    correction = proportional e + integral_per_s (integral of e) + derivative_s (de/dt)

    proportional, integral_per_s, derivative_s : (p,)
    crossover_hz : (p,) frequency where the loop gain falls to 1, if it was computed
    """

    proportional: Array
    integral_per_s: Array
    derivative_s: Array
    crossover_hz: Array | None = None

    def statement(self) -> str:
        """Say what the gains are."""
        axes = []
        for o, ki in enumerate(self.integral_per_s):
            text = f"output {o + 1}: {ki:.4g} /s integral, {self.proportional[o]:.3g} proportional"
            if self.derivative_s[o]:
                text += f", {self.derivative_s[o]:.3g} s derivative"
            if self.crossover_hz is not None:
                text += f", loop gain 1 at {self.crossover_hz[o]:.3g} Hz"
            axes.append(text)
        return "Feedback gains: " + "; ".join(axes) + "."


def tuned(response: Complex, frequency_hz: Array, sample_time_s: float, derivative: bool = False) -> Gains:
    """Gains with the largest integral gain that keeps the sensitivity below 1.6 at every frequency.

    The controller of each output is searched over the ratios of its proportional and derivative to its
    integral gain; for each ratio the integral gain is raised from almost zero until
    ``|1 / (1 + L)|`` first passes 1.6 somewhere for some of the slopes. As the loop is stable at the lowest
    gain and -1 is never met on the way, it is stable at all gains passed. A lightly damped resonance is what
    limits it: without derivative, about ``2 zeta w_n`` over a margin.

    Parameters
    ----------
    response : (slope, frequency, p) from correction to reading of each output: slopes of the hysteresis over
        its gain, linear block, sensor, delay of the loop
    frequency_hz : (frequency,) up to half the sample rate, dense enough for the resonances
    sample_time_s : time between samples [s]
    derivative : search the derivative gain too (PID), else it is zero (PI)

    Raises
    ------
    SimulationError : not even the lowest gain keeps the sensitivity

    Source: Astrom, Panagopoulos and Hagglund, Automatica 34 (1998) 585-601; the limit 2 zeta w_n: Fleming,
    Aphale and Moheimani, IEEE Transactions on Nanotechnology 9 (2010) 438-448.
    """
    z: Complex = np.exp(-2j * np.pi * frequency_hz * sample_time_s)
    integral, change = sample_time_s / (1.0 - z), (1.0 - z) / sample_time_s
    outputs = range(response.shape[2])
    found = [_one(response[:, :, o], frequency_hz, integral, change, derivative) for o in outputs]
    proportional, per_s, derivative_s, crossover = np.array(found).T
    return Gains(proportional, per_s, derivative_s, crossover)


def _one(
    response: Complex, frequency_hz: Array, integral: Complex, change: Complex, derivative: bool
) -> tuple[float, float, float, float]:
    """Proportional, integral and derivative gain of one output, and its crossover."""
    gains = LOWEST_GAIN_PER_S * 10.0 ** (np.arange(6 * GAINS_A_DECADE) / GAINS_A_DECADE)
    peak = frequency_hz[int(np.argmax(np.abs(response).max(axis=0)[1:])) + 1]
    unit = 1.0 / (2.0 * np.pi * peak)
    best, chosen, shape = 0.0, (0.0, 0.0), integral
    for share, second in itertools.product(SHARES, SHARES if derivative else (0.0,)):
        ratios = (share * unit, second * unit * unit)
        controller = integral + ratios[0] + ratios[1] * change
        gain = _largest_gain(response * controller, gains)
        if gain > best:
            best, chosen, shape = gain, ratios, controller
    if best == 0.0:
        raise SimulationError(
            "No feedback gain keeps a safe distance from instability: the loop gain of the model is wrong in "
            "sign or its dynamics are not those of an actuator. Give the gains yourself."
        )
    above = np.flatnonzero(np.abs(response * shape).max(axis=0) * best >= 1.0)
    crossover = float(frequency_hz[above[-1]]) if len(above) else 0.0
    return best * chosen[0], best, best * chosen[1], crossover


def _largest_gain(loop: Complex, gains: Array) -> float:
    """Last of the rising gains before the sensitivity of a loop (slope, frequency) first passes its bound."""
    flat = loop.reshape(1, -1)
    for block in np.array_split(gains, len(gains) // GAINS_A_DECADE):
        closest = np.abs(1.0 + block[:, None] * flat).min(axis=1)
        bad = np.flatnonzero(closest < 1.0 / LARGEST_SENSITIVITY)
        if len(bad):
            index = int(np.searchsorted(gains, block[bad[0]])) - 1
            return float(gains[index]) if index >= 0 else 0.0
    return float(gains[-1])

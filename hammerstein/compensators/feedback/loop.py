"""Loop of a controller and an actuator: response, poles, sensitivity, and tuned gains."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hammerstein.arrays import Array, ByValue, Complex
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import SimulationError
from hammerstein.quantities import interval

POINTS = 800  # of the grid from a tenth of the slowest resonance to Nyquist
NEAREST, NARROW = 0.05, 0.06  # about a resonance: the first distance in half widths, ln of the ratio of two
SLOW = 60  # points down to a tenth of the slowest pole of the closed loop
SMALL = 0.3  # loop gain whose distance from -1 needs no closer look
DEEPEST, ROUNDS, CLOSER = 9, 3, 21
"""Refinement of the peaks of sensitivity: peaks, repetitions, points each; 1000 times finer in the end."""


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains of one controller per output; errors and corrections in um.

    correction = proportional e + integral_per_s (integral of e) + derivative_s (de/dt)

    proportional, integral_per_s, derivative_s : (p,)
    crossover_hz : (p,) frequency where the loop gain falls to 1, if it was computed
    sensitivity : largest singular value of the sensitivity at any frequency, if it was computed
    """

    proportional: Array
    integral_per_s: Array
    derivative_s: Array
    crossover_hz: Array | None = None
    sensitivity: float | None = None

    def scaled(self, factor: float) -> Gains:
        """Return all gains times a factor, without crossover and sensitivity."""
        return Gains(factor * self.proportional, factor * self.integral_per_s, factor * self.derivative_s)

    def fit(self, outputs: int) -> bool:
        """Whether every output has a finite value of each gain."""
        each = (self.proportional, self.integral_per_s, self.derivative_s)
        return all(np.shape(gain) == (outputs,) and bool(np.isfinite(gain).all()) for gain in each)

    def statement(self) -> str:
        """State the gains."""
        axes = []
        for o, ki in enumerate(self.integral_per_s):
            text = f"output {o + 1}: {ki:.4g} /s integral, {self.proportional[o]:.3g} proportional"
            if self.derivative_s[o]:
                text += f", {interval(self.derivative_s[o])} derivative"
            if self.crossover_hz is not None:
                text += f", loop gain 1 at {self.crossover_hz[o]:.3g} Hz"
            axes.append(text)
        peak = f"; sensitivity at most {self.sensitivity:.3g}" if self.sensitivity is not None else ""
        if self.sensitivity == np.inf:
            peak = "; with these gains the loop of the model is UNSTABLE"
        return "Feedback gains: " + "; ".join(axes) + f"{peak}."


@dataclass(frozen=True, eq=False)
class FeedbackLoop(ByValue):
    """The loop of each output's controller, from its correction to its reading.

        reading = S(z) G(z) z^-1 J G_0^+ correction

    The correction of a sample acts on the drive of the next sample. J are the slopes of the hysteresis, G_0
    is its gain.

    Parameters
    ----------
    plant : sensor behind the linear block on the sample grid, (p, p)
    slopes : (choice, p, p) extreme slopes J G_0^+ of the hysteresis over its gain
    """

    plant: LinearBlock
    slopes: Array

    @cached_property
    def frequency_hz(self) -> Array:
        """Frequencies of one ratio up to half the sample rate, and closer together close to each resonance.

        The half width of a resonance with a pole z is -ln|z| / T.
        """
        poles = np.linalg.eigvals(self.plant.A).astype(complex)
        slow = np.abs(poles - 1.0)
        slowest = min(slow[slow > 1e-12].min(initial=1.0), 1e-5 * np.pi)
        angles = [np.geomspace(0.1 * slowest, np.pi, POINTS)]
        for width, angle in zip(-np.log(np.maximum(np.abs(poles), 1e-3)), np.angle(poles), strict=True):
            if not 0.0 < width < 0.5 * angle:
                continue
            beside = np.geomspace(NEAREST * width, np.pi, int(np.log(np.pi / (NEAREST * width)) / NARROW))
            angles.append(np.concatenate([angle - beside, [angle], angle + beside]))
        every = np.unique(np.concatenate(angles))
        return np.asarray(every[(every > 0.0) & (every <= np.pi)] / (2.0 * np.pi * self.plant.sample_time_s))

    def _reading(self, frequency_hz: Array) -> Complex:
        """Response (frequency, p, p) from what the hysteresis should give to the reading."""
        return self._shift(frequency_hz)[:, None, None] * self.plant.response(frequency_hz)

    def _shift(self, frequency_hz: Array) -> Complex:
        """Delay of one sample, 1 / z."""
        return np.asarray(np.exp(-2j * np.pi * frequency_hz * self.plant.sample_time_s))

    def _controller(self, gains: Gains, frequency_hz: Array) -> Complex:
        """Response (frequency, p) of the controllers."""
        change = self.change(frequency_hz)[:, None]
        return np.asarray(gains.proportional + gains.integral_per_s / change + gains.derivative_s * change)

    def change(self, frequency_hz: Array) -> Complex:
        """Response of a difference of two samples over T."""
        return np.asarray((1.0 - self._shift(frequency_hz)) / self.plant.sample_time_s)

    def alone(self, o: int) -> Complex:
        """Response (slope, frequency) of one output to its own correction, at smallest and largest slope."""
        own = self.slopes[:, o, o]
        ends = self.slopes[[int(np.argmin(own)), int(np.argmax(own))], :, o]
        return np.asarray(ends @ self._reading(self.frequency_hz)[:, o].T)

    def crossover_hz(self, o: int, gains: Gains) -> float:
        """Highest frequency where the gain of a loop falls to 1; 0 if it never reaches 1.

        Between two frequencies of the grid the gain is a power of them. Below all of them the plant responds
        as at the first, to the controller ``kp + ki T / 2 - i ki / w``.
        """
        frequency, plant = self.frequency_hz, np.abs(self.alone(o)).max(axis=0)
        gain = plant * np.abs(self._controller(gains, frequency)[:, o])
        last = int(np.flatnonzero(gain >= 1.0).max(initial=-1))
        if last < 0:
            in_phase = gains.proportional[o] + 0.5 * self.plant.sample_time_s * gains.integral_per_s[o]
            return float(gains.integral_per_s[o] / (2.0 * np.pi * np.sqrt(plant[0] ** -2.0 - in_phase**2)))
        pair = slice(last, last + 2)
        return float(np.exp(np.interp(0.0, -np.log(gain[pair]), np.log(frequency[pair]))))

    def poles(self, gains: Gains, slope: Array) -> Complex:
        """Poles of the closed loop for one slope matrix (p, p).

        States are those of the plant, the correction of the last sample, the sum of the errors and the last
        error.
        """
        a, b, c, d = self.plant.A, self.plant.B, self.plant.C, self.plant.D
        n, p, step = len(a), self.plant.n_outputs, self.plant.sample_time_s
        none, one = np.zeros((p, p)), np.eye(p)
        error = np.hstack([-c, -d @ slope, none, none])
        total = np.hstack([np.zeros((p, n)), none, one, none])
        total = total + step * gains.integral_per_s[:, None] * error
        change = (error - np.hstack([np.zeros((p, n)), none, none, one])) / step
        correction = gains.proportional[:, None] * error + total + gains.derivative_s[:, None] * change
        moved = np.hstack([a, b @ slope, np.zeros((n, 2 * p))])
        return np.asarray(np.linalg.eigvals(np.vstack([moved, correction, total, error])))

    def sensitivity(self, gains: Gains) -> float:
        """Largest singular value of the sensitivity at any frequency and slope; inf if a loop is unstable."""
        poles = [self.poles(gains, slope) for slope in self.slopes]
        if any(np.abs(own).max() >= 1.0 for own in poles):
            return np.inf
        every = np.concatenate(poles)
        angles, turn = np.abs(np.angle(every)), 2.0 * np.pi * self.plant.sample_time_s
        slow = np.geomspace(0.1 * np.abs(1.0 - every).min() / turn, self.frequency_hz[0], SLOW)
        frequency = np.unique(np.concatenate([slow, self.frequency_hz, angles[angles > 0.0] / turn]))
        least = self._distance(gains, frequency)
        for _ in range(ROUNDS):
            inner = least[1:-1]
            low = 1 + np.flatnonzero((inner <= least[:-2]) & (inner <= least[2:]))
            low = low[np.argsort(least[low])[:DEEPEST]]
            between = [np.linspace(frequency[at - 1], frequency[at + 1], CLOSER) for at in low]
            beside = np.unique(np.concatenate([frequency[:0], *between]))
            frequency, order = np.unique(np.concatenate([frequency, beside]), return_index=True)
            least = np.concatenate([least, self._distance(gains, beside)])[order]
        return 1.0 / float(least.min())

    def _distance(self, gains: Gains, frequency_hz: Array) -> Array:
        """Least singular value of 1 + L over the slopes (frequency,): the distance of a lone loop from -1.

        Where L is small this is bounded by 1 - |L| without the singular values. A slope counts only where it
        could be nearer: |det| over what the other singular values multiply to at most, with that norm.
        """
        plant, controller = self._reading(frequency_hz), self._controller(gains, frequency_hz)
        bound = np.linalg.norm(plant, axis=(1, 2)) * np.abs(controller).max(axis=1)
        bound = bound * np.linalg.norm(self.slopes, axis=(1, 2)).max()
        least = np.maximum(1.0 - bound, 1.0 - SMALL)
        near, others = np.flatnonzero(bound > SMALL), self.plant.n_outputs - 1
        plant, controller = plant[near], controller[near, None, :]
        for slope in self.slopes:
            returned = np.eye(self.plant.n_outputs) + plant @ slope * controller
            most = (np.linalg.norm(returned, axis=(1, 2)) ** 2 / max(others, 1)) ** (0.5 * others)
            nearer = np.abs(np.linalg.det(returned)) < least[near] * most
            distance = np.linalg.svd(returned[nearer], compute_uv=False)[:, -1]
            least[near[nearer]] = np.minimum(least[near[nearer]], distance)
        return np.asarray(least)

    def obstacle(self) -> str:
        """Reasons that may prevent a stable loop, in words."""
        least = float(np.diagonal(self.slopes, axis1=1, axis2=2).min())
        if least <= 0.0:
            return (
                f"the slope of the hysteresis falls to {least:.3g} of its gain, and no gain is stable "
                "for both signs. Identify at a lower frequency, or with dynamics."
            )
        return (
            "the loop gain of the model has the wrong sign, its slopes couple the outputs too much, "
            "or its dynamics are not those of an actuator."
        )


LARGEST_SENSITIVITY = 1.6
"""Usual bounds of the largest sensitivity are 1.2 to 2 (Astrom and Hagglund, Advanced PID Control, 2006)."""
SHARES = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Ratios of the other gains to the integral gain that are tried, with 1 / (2 pi peak) as unit of time."""
MOST_TRIES, LITTLE, MUCH = 30, 0.98, 0.7
"""Reductions of all gains, 2 to 30 % each, growing: a lower gain can first increase the sensitivity."""


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
    outputs = range(loop.plant.n_outputs)
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
    peak_hz = float(loop.frequency_hz[int(np.argmax(np.abs(response).max(axis=0)))])
    unit, change = 1.0 / (2.0 * np.pi * peak_hz), loop.change(loop.frequency_hz)
    best, ratios = 0.0, (0.0, 0.0)
    for share, second in itertools.product(SHARES, SHARES if derivative else (0.0,)):
        shape = 1.0 / change + share * unit + second * unit * unit * change
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

"""Stacks at random, by the printed equations on a fine grid; imports nothing of ours.

u = V_h(q) + V_z,    q = C V_z + T x,    M x'' + D x' + K x = T V_z,    V_h a sum of stops of the charge

Source: M. Goldfarb and N. Celanovic, IEEE Control Systems 17(3), 1997, equations 1 to 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

FINE = 8
"""Steps of Runge's and Kutta's rule in a sample."""
PER_RESONANCE = 10.0
"""Samples in a period of the highest resonance."""
SLOW = 400
"""Samples of one slow loop, by which its width is measured."""


@dataclass(frozen=True, eq=False)
class Stacks:
    """Stacks, one an axis, and a stage that mixes what they move.

    numbers : (axis, 4) w = sqrt(K / M) [rad/s], damping ratio, T / K [um/V], coupling T^2 / (C K)
    thresholds, stiffnesses : (axis, stop) of the charge over C [V], and C times those of the stops
    mixed : (axis, axis) what each output sees of each stack
    """

    numbers: np.ndarray
    thresholds: np.ndarray
    stiffnesses: np.ndarray
    mixed: np.ndarray
    time_s: float

    @property
    def axes(self):
        return len(self.numbers)

    def position_um(self, u):
        """Outputs (axis, sample) from rest; the voltages are held over a sample."""
        own = [
            _moved(row, *self.numbers[i], self.thresholds[i], self.stiffnesses[i], self.time_s / FINE)
            for i, row in enumerate(u)
        ]
        return self.mixed @ np.array(own)


@numba.njit
def _charge(s, plays, r, k):
    """Root q of q + sum of k (q - p(q)) = s: Newton's steps on straight pieces end where they began."""
    q = s / (1.0 + k.sum())
    for _ in range(50):
        left, slope = q - s, 1.0
        for j in range(len(r)):
            if q - r[j] > plays[j]:
                left += k[j] * r[j]
            elif q + r[j] < plays[j]:
                left -= k[j] * r[j]
            else:
                left += k[j] * (q - plays[j])
                slope += k[j]
        step = left / slope
        q -= step
        if abs(step) < 1e-13 * (1.0 + abs(q)):
            break
    return q


@numba.njit
def _pushed(x, v, u, plays, w, zeta, gain, coupling, r, k):
    """Acceleration; all charges are over C, so that T x / C is coupling x / gain."""
    fed = coupling * x / gain
    q = _charge(u + fed, plays, r, k)
    return w * w * (gain * (q - fed) - x) - 2.0 * zeta * w * v


@numba.njit
def _move(s, plays, r, k):
    """Plays after every step: the voltage jumps between samples, and the last charge before it is a turn."""
    q = _charge(s, plays, r, k)
    for j in range(len(r)):
        plays[j] = max(q - r[j], min(q + r[j], plays[j]))


@numba.njit
def _moved(u, w, zeta, gain, coupling, r, k, h):
    y, plays = np.zeros(len(u)), np.zeros(len(r))
    x = v = 0.0
    for t in range(len(u)):
        y[t] = x
        _move(u[t] + coupling * x / gain, plays, r, k)
        for _ in range(FINE):
            a1 = _pushed(x, v, u[t], plays, w, zeta, gain, coupling, r, k)
            v2 = v + 0.5 * h * a1
            a2 = _pushed(x + 0.5 * h * v, v2, u[t], plays, w, zeta, gain, coupling, r, k)
            v3 = v + 0.5 * h * a2
            a3 = _pushed(x + 0.5 * h * v2, v3, u[t], plays, w, zeta, gain, coupling, r, k)
            v4 = v + h * a3
            a4 = _pushed(x + h * v3, v4, u[t], plays, w, zeta, gain, coupling, r, k)
            x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            _move(u[t] + coupling * x / gain, plays, r, k)
    return y


def width(stack, axis, amplitude_v):
    """Width of a slow loop over its range."""
    t = np.arange(2 * SLOW) / SLOW
    u = amplitude_v * np.sin(2.0 * np.pi * t)
    numbers = stack.numbers[axis].copy()
    numbers[0], numbers[1] = 2.0 * np.pi * 50.0, 0.7  # 1 s a loop: stiff and well damped
    x = _moved(u, *numbers, stack.thresholds[axis], stack.stiffnesses[axis], 1.0 / SLOW / FINE)[SLOW:]
    zero = SLOW // 2
    return abs(x[zero] - x[0]) / np.ptp(x)


def at_random(seed, per_resonance=PER_RESONANCE):
    """One to three axes, resonances of 200 to 2000 Hz, loops 5 to 20 % wide at 2.5 V; and the widths."""
    rng = np.random.default_rng(seed)
    axes = int(rng.integers(1, 4))
    highest = np.exp(rng.uniform(np.log(200.0), np.log(2000.0)))
    hertz = highest * rng.uniform(0.5, 1.0, size=axes)
    hertz[0] = highest
    hertz = np.maximum(hertz, 200.0)
    drawn = [rng.uniform(*ends, axes) for ends in ((0.01, 0.05), (0.5, 2.0), (0.2, 0.5))]
    numbers = np.stack([2.0 * np.pi * hertz, *drawn], axis=1)
    r = np.geomspace(0.05, 2.0, 6) * np.exp(rng.uniform(-0.2, 0.2, (axes, 6)))
    k = rng.uniform(0.3, 1.0, (axes, 6))
    mixed = np.eye(axes) + 0.1 * rng.uniform(-1.0, 1.0, (axes, axes)) * (1.0 - np.eye(axes))
    widths = rng.uniform(0.05, 0.20, axes)
    found = Stacks(numbers, r, k, mixed, 1.0 / per_resonance / highest)
    for i, wanted in enumerate(widths):
        low, high = 0.0, 4.0
        for _ in range(25):
            middle = 0.5 * (low + high)
            k_i = k.copy()
            k_i[i] *= middle
            trial = Stacks(numbers, r, k_i, mixed, found.time_s)
            low, high = (middle, high) if width(trial, i, 2.5) < wanted else (low, middle)
        k[i] *= middle
    return Stacks(numbers, r, k, mixed, found.time_s), widths

"""Made-up actuators and their records, in plain NumPy and SciPy; imports nothing of ours.

An actuator is plays, a bend of the branches, a creeping and lagging resonance, a delay, noise: what theory
says, sample by sample. Whatever identification finds is compared with these numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import cont2discrete, lfilter


@dataclass(frozen=True, eq=False)
class MadeUp:
    """An actuator: thresholds (input, operator) [V], weights (output, input, operator) [um/V].

    resonances_hz, damping : (output,), None where the output has none
    lag_s : time constant of a low-pass in front; creep : (gain, time constant) pairs, on every output
    delay_s : of the voltage; bend : part by which the output grows at the highest voltage
    before_v : (input, turn) voltages that it went through before the record, from its virgin state
    """

    thresholds_v: np.ndarray
    weights_um_per_v: np.ndarray
    low_v: float
    high_v: float
    rate_hz: float
    resonances_hz: tuple[float, ...] | None = None
    damping: tuple[float, ...] = ()
    lag_s: float = 0.0
    creep: tuple[tuple[float, float], ...] = ()
    delay_s: float = 0.0
    bend: float = 0.0
    noise_um: float = 0.0
    offset_um: float = 0.0

    @property
    def inputs(self):
        return len(self.thresholds_v)

    @property
    def outputs(self):
        return len(self.weights_um_per_v)

    def static_um(self, u, before_v=()):
        """Output of the plays (output, sample) after the voltages ``before_v`` (input, turn)."""
        low, high = self.low_v, self.high_v
        past = np.reshape(np.asarray(before_v, dtype=float), (self.inputs, -1))
        v = np.zeros((self.outputs, u.shape[1]))
        for k, r in enumerate(self.thresholds_v):
            voltage = np.concatenate([past[k], u[k]])
            last = np.zeros(len(r))
            plays = np.empty((len(r), len(voltage)))
            for i, value in enumerate(voltage):
                last = np.maximum(value - r, np.minimum(value + r, last))
                plays[:, i] = last
            v += self.weights_um_per_v[:, k] @ plays[:, past.shape[1] :]
        span = self.weights_um_per_v.sum(axis=2).max() * (high - low)
        return v + self.bend * v**2 / span

    def position_um(self, u, before_v=()):
        """True position (output, sample); the voltages are held from sample to sample."""
        v = self.static_um(u, before_v)
        start = v[:, :1]
        return np.array([self._linear(row, o) for o, row in enumerate(v - start)]) + self._settled() * start

    def record(self, u, generator, before_v=()):
        """What a sensor reads (output, sample)."""
        y = self.position_um(u, before_v) + self.offset_um
        return y + self.noise_um * generator.standard_normal(y.shape)

    def _settled(self):
        return 1.0 + sum(gain for gain, _ in self.creep)

    def _linear(self, v, o):
        a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
        if self.lag_s:
            a, b, c, d = series(a, b, c, d, *lag(self.lag_s))
        if self.resonances_hz is not None:
            a, b, c, d = series(a, b, c, d, *resonance(self.resonances_hz[o], self.damping[o]))
        if self.creep:
            a, b, c, d = series(a, b, c, d, *creeping(self.creep))
        whole = int(self.delay_s * self.rate_hz + 1e-9)
        fraction = self.delay_s * self.rate_hz - whole
        v = np.concatenate([np.zeros(whole), v[: len(v) - whole]])
        if len(a) == 0:
            before = np.concatenate([[0.0], v[:-1]])
            return (1.0 - fraction) * v + fraction * before
        return held(a, b, c, d, v, 1.0 / self.rate_hz, fraction)


def resonance(hz, damping):
    w = 2.0 * np.pi * hz
    a = np.array([[0.0, w], [-w, -2.0 * damping * w]])
    return a, np.array([[0.0], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def lag(time_s):
    return np.array([[-1.0 / time_s]]), np.array([[1.0 / time_s]]), np.ones((1, 1)), np.zeros((1, 1))


def creeping(modes):
    gains, times = np.array(modes).T
    return np.diag(-1.0 / times), 1.0 / times[:, None], gains[None], np.ones((1, 1))


def series(a1, b1, c1, d1, a2, b2, c2, d2):
    """Second block behind the first one."""
    a = np.block([[a1, np.zeros((len(a1), len(a2)))], [b2 @ c1, a2]])
    return a, np.vstack([b1, b2 @ d1]), np.hstack([d2 @ c1, c2]), d2 @ d1


def held(a, b, c, d, v, sample_time_s, fraction=0.0):
    """Response to an input held from sample to sample that comes late by a fraction of one: pole by pole."""
    late = np.concatenate([[0.0], v[:-1]])
    full, whole = cont2discrete((a, b, c, d), sample_time_s)[:2]
    rest, new = cont2discrete((a, b, c, d), (1.0 - fraction) * sample_time_s)[:2]
    old = whole - new  # what the older value does in the first part of a sample
    del rest
    poles, modes = np.linalg.eig(full)
    out = (c @ modes)[0]
    y = (1.0 - fraction) * d[0, 0] * v + fraction * d[0, 0] * late
    for pole, gain, i_new, i_old in zip(
        poles, out, np.linalg.solve(modes, new)[:, 0], np.linalg.solve(modes, old)[:, 0], strict=True
    ):
        y = y + np.real(gain * lfilter([0.0, 1.0], [1.0, -pole], i_new * v + i_old * late))
    return y


# Actuators --------------------------------------------------------------------------------------------------


def stage(seed=0, *, low_v=0.0, high_v=100.0, span_um=80.0, loop=0.14, plays=40, coupling=0.03, **fields):
    """Stage with two inputs and two outputs; the loop is so wide, in parts of its height, at half swing."""
    generator = np.random.default_rng(seed)
    half = 0.5 * (high_v - low_v)
    r = np.array([np.sort(np.append(0.0, generator.uniform(0.0, 1.0, plays - 1))) * half for _ in range(2)])
    w = np.zeros((2, 2, plays))
    for o in range(2):
        for k in range(2):
            w[o, k] = weights_of_loop(r[k], half, loop, generator)
            w[o, k] *= span_um * (1.0 if o == k else coupling) / (high_v - low_v)
    return MadeUp(
        r,
        w,
        low_v,
        high_v,
        **({"rate_hz": 10e3, "resonances_hz": (180.0, 210.0), "damping": (0.02, 0.02)} | fields),
    )


def weights_of_loop(r, half, loop, generator):
    """Weights that give a loop of unit slope, so wide in the middle, in parts of its height."""
    shape = generator.uniform(0.2, 1.0, len(r))
    shape[r == 0.0] = 0.0
    # settled loop of amplitude A: half height of a play A - r; at u = 0 its play stands at min(r, A - r)
    wide, high = shape @ np.minimum(r, half - r), shape @ (half - r)
    hard = loop * half / (wide - loop * (high - half * 0.0) + loop * high)
    w = shape * hard
    w[r == 0.0] = (half - w @ (half - r)) / half / max(np.count_nonzero(r == 0.0), 1)
    return w


# Voltages ---------------------------------------------------------------------------------------------------


def triangles(made, axis, cycles=5, hz=2.0, least=0.2):
    """Triangles of falling height on one axis, from the lowest voltage, the others at theirs."""
    samples = round(made.rate_hz / hz)
    half = np.arange(samples) / samples
    one = 1.0 - np.abs(2.0 * half - 1.0)
    heights = np.linspace(1.0, least, cycles)
    u = np.full((made.inputs, samples * cycles), made.low_v)
    u[axis] += (made.high_v - made.low_v) * np.concatenate([h * one for h in heights])
    return u


def sine(made, hz=20.0, cycles=10, share=0.8):
    """Both axes together, a quarter of a turn apart, from the lowest voltage."""
    t = np.arange(round(cycles * made.rate_hz / hz)) / made.rate_hz
    half = 0.5 * (made.high_v - made.low_v) * share
    rise = np.minimum(t * hz, 1.0)
    phase = 2.0 * np.pi * hz * t
    return made.low_v + half * rise * np.array([1.0 - np.cos(phase), 1.0 - np.cos(phase + 0.5 * np.pi)]) * [
        [1.0],
        [1.0],
    ]


def wander(made, generator, seconds=1.0, lowest_hz=1.0, highest_hz=40.0, tones=30, share=0.9):
    """A multisine on every axis, started softly from the lowest voltage."""
    t = np.arange(round(seconds * made.rate_hz)) / made.rate_hz
    u = np.empty((made.inputs, len(t)))
    for k in range(made.inputs):
        f = generator.uniform(lowest_hz, highest_hz, tones)
        x = np.sin(2.0 * np.pi * f[:, None] * t + generator.uniform(0.0, 6.3, (tones, 1))).sum(axis=0)
        x = (x - x.min()) / np.ptp(x)
        soft = np.minimum(t / (0.1 * seconds), 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t / (0.1 * seconds), 1.0))
        u[k] = made.low_v + share * (made.high_v - made.low_v) * x * soft
    return u


def without_plays(made):
    """The same actuator without hysteresis."""
    w = made.weights_um_per_v
    only = np.zeros_like(w)
    only[:, :, 0] = w.sum(axis=2)
    return replace(made, thresholds_v=np.zeros_like(made.thresholds_v), weights_um_per_v=only)

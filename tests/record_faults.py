"""Made-up records of one actuator, clean in many shapes or with one fault each, in plain NumPy."""

from functools import cache

import numpy as np

STEP_S = 1e-3
SAMPLES = 4000
TIME_S = STEP_S * np.arange(SAMPLES)
R_V = 100.0 * np.array([0.0, 0.02, 0.05, 0.1, 0.17, 0.25, 0.35, 0.45])
W_UM_PER_V = np.array([0.35, 0.08, 0.06, 0.05, 0.05, 0.05, 0.05, 0.05])
COUPLING = np.array([[1.0, 0.03], [-0.02, 0.9]])
"""Every output responds to every input through the same bank of plays, by these parts."""


def hysteresis(u):
    """Equation 4 with the same bank for every pair: what u (sample,) [V] makes of a bank at rest [um]."""
    plays, y = np.zeros(len(R_V)), np.empty(len(u))
    for k, voltage in enumerate(u):
        plays = np.maximum(voltage - R_V, np.minimum(voltage + R_V, plays))
        y[k] = W_UM_PER_V @ plays
    return y


def actuator(u, noise=1e-3, seed=0):
    """Readings (output, sample) of the two axes; noise in parts of the range."""
    y = COUPLING @ np.array([hysteresis(row) for row in np.atleast_2d(u)])
    span = np.ptp(y, axis=1).max()
    return y + noise * span * np.random.default_rng(seed).standard_normal(y.shape)


def sine(amplitude=50.0, hz=1.0, bias=0.0):
    return bias + amplitude * np.sin(2 * np.pi * hz * TIME_S)


def falling_triangles(top=100.0, low=0.0, cycles=5):
    """From ``low`` up to tops that fall to a fifth, and back each time."""
    tops = np.linspace(1.0, 0.2, cycles)
    corners = [*np.ravel([[low, low + (top - low) * part] for part in tops]).tolist(), low]
    return np.interp(np.linspace(0, len(corners) - 1, SAMPLES), np.arange(len(corners)), corners)


def decaying_sine(amplitude=50.0, hz=2.0):
    return amplitude * np.exp(-TIME_S / 1.5) * np.sin(2 * np.pi * hz * TIME_S)


def multisine(seed=0, amplitude=50.0, lines=12):
    rng = np.random.default_rng(seed)
    n = np.arange(1, lines + 1)
    u = np.sin(2 * np.pi * np.outer(TIME_S / 4.0, n) + rng.uniform(0, 2 * np.pi, lines)).sum(axis=1)
    return amplitude * u / np.abs(u).max()


def prbs(seed=0, amplitude=50.0, hold=7):
    """Two levels, each kept for a whole number of clocks."""
    bits = np.random.default_rng(seed).integers(0, 2, SAMPLES // hold + 1)
    return amplitude * np.repeat(2.0 * bits - 1.0, hold)[:SAMPLES]


def levels(seed=0, amplitude=50.0, hold=11):
    """Random levels, each kept for a while."""
    heights = np.random.default_rng(seed).uniform(-1.0, 1.0, SAMPLES // hold + 1)
    return amplitude * np.repeat(heights, hold)[:SAMPLES]


def holds(amplitude=50.0):
    """Ramps with a stop at both ends."""
    corners = amplitude * np.array([-1.0, 1.0, 1.0, -1.0, -1.0, -1.0])
    return np.interp(TIME_S % 1.0, [0.0, 0.2, 0.4, 0.7, 0.9, 1.0], corners)


def alone(u):
    """One record for each axis, in which it is driven alone."""
    return [np.array([u, 0 * u]), np.array([0 * u, u])]


SHAPES = {
    "sines": [alone(sine())[0], alone(sine(hz=1.5))[1], np.array([sine(hz=1.0), sine(40.0, hz=1.25)])],
    "falling triangles": alone(falling_triangles()),
    "falling triangles both ways": alone(falling_triangles(top=50.0, low=-50.0)),
    "decaying sines": alone(decaying_sine()),
    "multisine": [np.array([multisine(0), multisine(1)]), np.array([multisine(2), multisine(3)])],
    "prbs": [np.array([prbs(0), prbs(1)])],
    "random levels": [np.array([levels(0), levels(1)])],
    "one-sided": alone(sine(50.0, bias=50.0)),
    "biased": alone(sine(20.0, bias=60.0)),
    "starts in motion": [u[:, 700:] for u in alone(sine(hz=1.0))],
    "holds": alone(holds()),
}


def copied(records):
    """Voltages and displacements that may be changed."""
    return [u.copy() for u, _ in records], [y.copy() for _, y in records]


@cache
def measured(shape, noise=1e-3, seed=0):
    """Pairs of voltages and readings of a clean shape."""
    return [(u, actuator(u, noise, seed + k)) for k, u in enumerate(SHAPES[shape])]


def one_sample(us, ys):
    ys[0][0, 1233] = 200.0


def lost_cells(us, ys):
    ys[0][0, [500, 501, 502, 503, 504, 505, 2000]] = -9999.0


def lost_rows(us, ys):
    us[1][:, 2100:2103] = -9999.0
    ys[1][:, 2100:2103] = -9999.0


def drive_spike(us, ys):
    us[0][0, 2221] += 150.0


def drift(us, ys):
    for y in ys:
        y[0] += np.linspace(0.0, 5.0, y.shape[1])


def thermal_drift(us, ys):
    for y in ys:
        y[1] -= 4.0 * (1.0 - np.exp(-2.0 * np.arange(y.shape[1]) / y.shape[1]))


def clipped_command(us, ys):
    """The amplifier ends at 70 % of the range; the command does not know."""
    for k, u in enumerate(us):
        low, high = u.min(), u.max()
        ys[k][:] = actuator(np.clip(u, low, low + 0.7 * (high - low)), seed=k)


def clipped_reading(us, ys):
    for u in us:
        u[:] = np.clip(u, None, u.min() + 0.8 * np.ptp(u))


def saturation(us, ys):
    top = 0.7 * max(np.abs(y).max() for y in ys)
    for y in ys:
        y[:] = top * np.tanh(y / top)


def swapped(us, ys):
    us[:], ys[:] = [y.copy() for y in ys], [u.copy() for u in us]


def half_swapped(us, ys):
    """The second axis alone."""
    for u, y in zip(us, ys, strict=True):
        u[1], y[1] = y[1].copy(), u[1].copy()

"""Closed forms of linear blocks, written from textbooks; imports nothing of ours."""

import numpy as np


def second_order(frequency_hz, resonance_hz, damping_ratio):
    """Frequency response w_n^2 / (s^2 + 2 z w_n s + w_n^2)."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    w = 2 * np.pi * resonance_hz
    return w**2 / (s**2 + 2 * damping_ratio * w * s + w**2)


def first_order(frequency_hz, bandwidth_hz):
    """Frequency response 1 / (1 + s / w)."""
    return 1 / (1 + 1j * np.asarray(frequency_hz, dtype=float) / bandwidth_hz)


def creep(frequency_hz, gains, time_constants_s):
    """Frequency response 1 + sum of g / (1 + T s)."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    return 1 + sum(g / (1 + t * s) for g, t in zip(gains, time_constants_s, strict=True))


def second_order_step(time_s, resonance_hz, damping_ratio):
    """Step response of an underdamped second-order block of unit gain."""
    w, z = 2 * np.pi * resonance_hz, damping_ratio
    wd = w * np.sqrt(1 - z**2)
    t = np.asarray(time_s)
    return 1 - np.exp(-z * w * t) * (np.cos(wd * t) + z * w / wd * np.sin(wd * t))


def rms_of_sine_error(gain, amplitude):
    """RMS of A sin(wt) - |G| A sin(wt + arg G)."""
    return abs(1 - gain) * amplitude / np.sqrt(2)

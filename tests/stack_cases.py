"""A made-up stack in plain NumPy: plays, dead-zones, lag, resonance, slow modes; imports nothing of ours."""

from __future__ import annotations

from dataclasses import dataclass

import made_up
import numpy as np
import theory

RATE_HZ = 10_000.0
R = np.array([0.0, 1.7, 4.3, 8.1, 13.9, 21.0, 29.7, 41.3])
W = [0.42, 0.06, 0.05, 0.055, 0.07, 0.05, 0.08, 0.09]
Q = np.array([9.0, 22.0, 37.0, 51.0, 64.0, 78.0, 91.0])
B = [0.05, 0.04, -0.06, 0.05, -0.04, -0.07, -0.05]
LAG_S = 0.35e-3
RESONANCE_HZ, DAMPING = 734.0, 0.08
CREEP = ((0.035, 0.06), (0.05, 0.7))
NOISE_SHARE = 2e-4
"""Rms of the noise, in parts of the range."""


@dataclass(frozen=True, eq=False)
class Stack(made_up.MadeUp):
    """From 0 to 100 V; dead-zones beside the plays."""

    def static_um(self, u, before_v=()):
        past = np.reshape(np.asarray(before_v, dtype=float), (1, -1))
        whole = np.hstack([past, u])
        v = theory.asymmetric(whole, [[R]], [[W]], [[Q]], [[B]], [0.0])
        return v[:, past.shape[1] :]


def stack():
    return Stack(
        R[None], np.array(W)[None, None], 0.0, 100.0, RATE_HZ,
        resonances_hz=(RESONANCE_HZ,), damping=(DAMPING,), lag_s=LAG_S, creep=CREEP, offset_um=2.0,
    )  # fmt: skip


def voltages(hz, seconds):
    """Cycles between 0 V and tops that go down and up again, from 0 V on."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    top = np.interp(t / seconds, [0.0, 0.1, 0.55, 1.0], [1.0, 1.0, 0.25, 0.9])
    middle = np.interp(t / seconds, [0.0, 0.3, 0.55, 0.8, 1.0], [0.5, 0.5, 0.35, 0.6, 0.5])
    half = 50.0 * top * np.minimum(1.0, 2.0 * np.minimum(middle, 1.0 - middle))
    soft = np.minimum(1.0, 4.0 * hz * t)
    return (np.clip(100.0 * middle - half * np.cos(2.0 * np.pi * hz * t), 0.0, 100.0) * soft)[None]


def record_um(hz, seconds, seed):
    """Voltages (1, sample) and readings; it stood saturated, at 0 V after 100 V."""
    u = voltages(hz, seconds)
    y = stack().record(u, np.random.default_rng(seed), before_v=[[100.0, 0.0]])
    return u, y + NOISE_SHARE * np.ptp(y) * np.random.default_rng([7, seed]).standard_normal(y.shape)

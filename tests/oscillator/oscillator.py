"""Bouc-Wen oscillator of the literature, on a fine grid; imports nothing of ours.

m y'' + c y' + k y + z = u,    z' = alpha y' - beta (gamma |y'| z + delta y' |z|)

Source: J. P. Noel and M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity", Workshop on Nonlinear
System Identification Benchmarks (Brussels 2016): numbers, excitation, 750 Hz. There Newmark's rule at 15 kHz;
here Runge's and Kutta's at 30 kHz.
"""

from __future__ import annotations

import numba
import numpy as np

MASS, DAMPING, STIFFNESS = 2.0, 10.0, 5e4
ALPHA, BETA, GAMMA, DELTA = 5e4, 1e3, 0.8, -1.1
RATE_HZ, FINE = 750.0, 40
BAND_HZ = (5.0, 150.0)
SWEEP_N, SWEEP_HZ, SWEEP_HZ_PER_MIN = 40.0, (20.0, 50.0), 10.0


@numba.njit
def _rate(y, v, z, u):
    force = (u - DAMPING * v - STIFFNESS * y - z) / MASS
    return v, force, ALPHA * v - BETA * (GAMMA * abs(v) * z + DELTA * v * abs(z))


@numba.njit
def positions(u, step, every):
    """Positions [m] at every so many steps; u (2 n + 1,) at all halves of a step, from rest."""
    n = (len(u) - 1) // 2
    out = np.zeros(n // every)
    y = v = z = 0.0
    for i in range(n // every * every):
        if i % every == 0:
            out[i // every] = y
        a, b, c = u[2 * i], u[2 * i + 1], u[2 * i + 2]
        half = 0.5 * step
        y1, v1, z1 = _rate(y, v, z, a)
        y2, v2, z2 = _rate(y + half * y1, v + half * v1, z + half * z1, b)
        y3, v3, z3 = _rate(y + half * y2, v + half * v2, z + half * z2, b)
        y4, v4, z4 = _rate(y + step * y3, v + step * v3, z + step * z3, c)
        y += step / 6.0 * (y1 + 2.0 * y2 + 2.0 * y3 + y4)
        v += step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        z += step / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4)
    return out


def multisine(seed, rms_n, samples=4096, periods=3):
    """One settled period: forces [N] and positions [m] (samples,), all lines of the band, random phases."""
    rng = np.random.default_rng(seed)
    hz = np.arange(samples // 2 + 1) * RATE_HZ / samples
    lines = np.where(
        (hz >= BAND_HZ[0]) & (hz <= BAND_HZ[1]), np.exp(2j * np.pi * rng.uniform(size=hz.size)), 0
    )
    lines *= rms_n / np.fft.irfft(lines).std()
    finer = 2 * FINE
    fine = np.fft.irfft(np.pad(lines, (0, samples * finer // 2 + 1 - len(lines)))) * finer
    y = positions(np.concatenate([np.tile(fine, periods), fine[:1]]), 1.0 / RATE_HZ / FINE, FINE)
    return np.fft.irfft(lines), y[-samples:]


def sweep():
    """Sine of 40 N from 20 to 50 Hz at 10 Hz a minute, from rest: forces [N] and positions [m]."""
    hz_per_s, step = SWEEP_HZ_PER_MIN / 60.0, 1.0 / RATE_HZ / FINE
    samples = int((SWEEP_HZ[1] - SWEEP_HZ[0]) / hz_per_s * RATE_HZ)
    t = 0.5 * step * np.arange(2 * FINE * samples + 1)
    u = SWEEP_N * np.sin(2.0 * np.pi * (SWEEP_HZ[0] * t + 0.5 * hz_per_s * t * t))
    return u[: -1 : 2 * FINE], positions(u, step, FINE)

"""Compiled time loops of the compensators."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled
from hammerstein.hysteresis.play_kernels import at, move

# A step below this is no movement: two samples at equal distance from a peak differ in their last bits, and
# these differ from one machine to another; they must not decide when the jump at a reversal comes.
STILL_V = 1e-9


@compiled()
def respond_gain(reference, gain, base, low, high, first, stop, drive):  # type: ignore[no-untyped-def]
    """U = base + gain Y_r within the range, summed in the order of the outputs, however many samples.

    reference : (p, N); gain : (m, p) [V/um]; base, low, high : (m,) [V]
    drive : (m, N), overwritten from sample first up to stop
    """
    for t in range(first, stop):
        for k in range(gain.shape[0]):
            wanted = 0.0
            for o in range(gain.shape[1]):
                wanted += gain[k, o] * reference[o, at(t)]
            drive[k, at(t)] = min(max(wanted + base[k], low[k]), high[k])


@compiled()
def respond_inverse_multiplicative(  # type: ignore[no-untyped-def]
    reference,
    gain,
    pole,
    iterations,
    low,
    high,
    r,
    slope,
    moment,
    count,
    end,
    x,
    d,
    below,
    memory,
    first,
    stop,
    drive,
):
    """U[k] = K Y_r[k] + f[k],  f[k+1] = a f[k] + (1 - a) (U[k] - K Gamma(U[k])); a = 0: one-sample delay.

    Every pass is a step of the filter; with several in a sample, a is that of their time.

    reference : (p, N); gain : (m, p) [V/um]; pole : a; low, high : (m,) range of the drive [V]
    r, slope, moment : threshold grids and partial sums; count, end, x, d, below : play memory, updated
    memory : (m,) f, updated; drive : (m, N), overwritten from sample first up to stop
    """
    m, p = gain.shape
    v = np.empty(p)
    u = np.empty(m)
    for t in range(first, stop):
        for _ in range(iterations):
            for k in range(m):
                wanted = memory[k]
                for o in range(p):
                    wanted += gain[k, o] * reference[o, at(t)]
                u[k] = min(max(wanted, low[k]), high[k])
            v[:] = 0.0
            for k in range(m):
                move(k, u[k], r, slope, moment, count, end, x, d, below, v)
            for k in range(m):
                left = u[k]
                for o in range(p):
                    left -= gain[k, o] * v[o]
                memory[k] = pole * memory[k] + (1.0 - pole) * left
        for k in range(m):
            drive[k, at(t)] = u[k]


@compiled()
def respond_inverse_play(v, r, low, high, last, sign, first, stop, u):  # type: ignore[no-untyped-def]
    """Inverse of one play of threshold r an axis: u = v + r rising, v - r falling; jumps 2 r at a reversal.

    v : (m, N) wanted play outputs; r : (m,); last, sign : (m,) last v and direction, updated
    u : (m, N), overwritten from sample first up to stop, kept between low and high (m,)
    """
    for k in range(v.shape[0]):
        for t in range(first, stop):
            now = v[k, at(t)]
            if abs(now - last[k]) > STILL_V:
                sign[k] = 1.0 if now > last[k] else -1.0
                last[k] = now
            u[k, at(t)] = min(max(now + sign[k] * r[k], low[k]), high[k])

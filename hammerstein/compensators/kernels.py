"""Compiled time loops of the compensators."""

import numpy as np

from hammerstein.compiled import at, compiled, helper
from hammerstein.hysteresis.play_kernels import move, respond_turning_points

# A step below this is no movement: two samples at equal distance from a peak differ in their last bits, and
# these differ from one machine to another; they must not decide when the jump at a reversal comes.
STILL_V = 1e-9


@compiled()
def respond_gain(reference, gain, base, low, high, first, stop, drive):  # type: ignore[no-untyped-def]
    """U = base + gain Y_r within the range, summed in the order of the outputs for any number of samples.

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
def asked_for(gain, reference, t, memory, low, high, u):  # type: ignore[no-untyped-def]
    """Put U = K Y_r + f of sample t into u (m,), within the range."""
    for k in range(u.shape[0]):
        wanted = memory[k]
        for o in range(u.shape[0]):
            wanted += gain[k, o] * reference[o, at(t)]
        u[k] = min(max(wanted, low[k]), high[k])


@compiled()
def feed_back(gain, pole, u, v, memory):  # type: ignore[no-untyped-def]
    """Update f (m,) by one pass, after voltages u (m,) with output v (p,)."""
    for k in range(u.shape[0]):
        left = u[k]
        for o in range(v.shape[0]):
            left -= gain[k, o] * v[o]
        memory[k] = pole * memory[k] + (1.0 - pole) * left


@compiled()
def respond_inverse_multiplicative(reference, axes, law, bank, plays, memory, first, stop, drive):  # type: ignore[no-untyped-def]
    """U[k] = K Y_r[k] + f[k],  f[k+1] = a f[k] + (1 - a) (U[k] - K Gamma(U[k])); a = 0: one-sample delay.

    Every pass is a step of the filter; with several in a sample, a is that of their time.

    reference : (m, N); axes : m zeros in a tuple: a number that the compiler knows, for it unrolls loops
    law : gain (m, m) [V/um], a, iterations, and lowest and highest voltage (m,) of the drive [V]
    bank : threshold grids and partial sums; plays : count, end, x, d and below of their memory, updated
    memory : (m,) f, updated; drive : (m, N), overwritten from sample first up to stop
    """
    gain, pole, iterations, low, high = law
    r, slope, moment = bank
    count, end, x, d, below = plays
    m = len(axes)
    u, v = np.empty(m), np.empty(m)
    for t in range(first, stop):
        for _ in range(iterations):
            asked_for(gain, reference, t, memory, low, high, u)
            v[:] = 0.0
            for k in range(m):
                move(k, u[k], r, slope, moment, count, end, x, d, below, v)
            feed_back(gain, pole, u, v, memory)
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


@helper()
def to_sent(drive, frame, sent):  # type: ignore[no-untyped-def]
    """Write voltages (m, 1), relative to the working point, as absolute ones (m,); False if not finite.

    frame : (4, m) origin of the reference, working point, lowest and highest voltage
    """
    moved, sound = False, True
    for k in range(sent.shape[0]):
        moved = moved or frame[1, k] != 0.0
    for k in range(sent.shape[0]):
        sent[k] = drive[k, 0]
        if moved:
            sent[k] = min(max(sent[k] + frame[1, k], frame[2, k]), frame[3, k])
        sound = sound and np.isfinite(sent[k])
    return sound


@helper()
def from_rest(sample, frame, reference):  # type: ignore[no-untyped-def]
    """Write a sample (p,) from the start to reference (p, 1) from rest; False if not finite."""
    sound = True
    for o in range(sample.shape[0]):
        sound = sound and np.isfinite(sample[o])
        reference[o, 0] = sample[o] + frame[0, o]
    return sound


@compiled()
def step_gain(sample, frame, gain, limits):  # type: ignore[no-untyped-def]
    """Absolute voltages (m,) for one sample (p,), and whether all are finite.

    limits : (3, m) base, lowest and highest voltage of ``respond_gain``
    """
    m = gain.shape[0]
    reference, drive, sent = np.empty((sample.shape[0], 1)), np.empty((m, 1)), np.empty(m)
    sound = from_rest(sample, frame, reference)
    respond_gain(reference, gain, limits[0], limits[1], limits[2], 0, 1, drive)
    return sent, to_sent(drive, frame, sent) and sound


@compiled()
def step_inverse_multiplicative(  # type: ignore[no-untyped-def]
    sample, frame, axes, gain, pole, iterations, limits, r, slope, moment, count, end, x, d, below, memory
):
    """Absolute voltages (m,), memory after one sample (p,), and whether all are finite.

    limits : (2, m) lowest and highest voltage of the law; the others as for the loop; none is written to
    """
    m = gain.shape[0]
    reference, drive, sent = np.empty((sample.shape[0], 1)), np.empty((m, 1)), np.empty(m)
    plays = (count.copy(), end.copy(), x.copy(), d.copy(), below.copy())
    after = memory.copy()
    sound = from_rest(sample, frame, reference)
    if sound:
        law, bank = (gain, pole, iterations, limits[0], limits[1]), (r, slope, moment)
        respond_inverse_multiplicative(reference, axes, law, bank, plays, after, 0, 1, drive)
        sound = to_sent(drive, frame, sent)
    return sent, plays, after, sound


@compiled()
def step_decoupled(  # type: ignore[no-untyped-def]
    sample, frame, limits, r, guide, scale, n, lines, w, outputs, count, end, x, d, below, window, last, sign
):
    """Absolute voltages (m,), memory after one sample (m,), and whether all are finite.

    limits : (3, m) jump, lowest and highest voltage of ``respond_inverse_play``
    r to outputs : plays of the inverse; count to sign : the memory; none is written to
    """
    m = sample.shape[0]
    reference, v, drive = np.empty((m, 1)), np.empty((m, 1)), np.empty((m, 1))
    plays = (count.copy(), end.copy(), x.copy(), d.copy(), below.copy(), window.copy())
    turned, way, sent = last.copy(), sign.copy(), np.empty(m)
    sound = from_rest(sample, frame, reference)
    if sound:
        respond_turning_points(reference, r, guide, scale, n, lines, w, *plays, 0, 1, v, outputs)
        respond_inverse_play(v, limits[0], limits[1], limits[2], turned, way, 0, 1, drive)
        sound = to_sent(drive, frame, sent)
    return sent, plays, turned, way, sound

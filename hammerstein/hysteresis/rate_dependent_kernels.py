"""Compiled time loops of plays whose thresholds grow with the rate."""

from __future__ import annotations

import numpy as np

from hammerstein.compiled import compiled

ROOT_TWO, LOG_TWO = 1.4142135623730951, 0.6931471805599453
DOUBLINGS = 128
SERIES = tuple(1.0 / n for n in range(23, 0, -2))
"""Coefficients of artanh(s) / s in s^2, the highest power first: for |s| < 0.172 all that a double tells."""


@compiled()
def log_of_one_and(x):  # type: ignore[no-untyped-def]
    """Give log(1 + x) for x from 0 to 2^128 by sums and products alone: every machine gives the same bits.

    1 + x = 2^e (1 + f) with 1 + f up to the root of 2; log(1 + f) = 2 artanh(f / (2 + f)).
    """
    power, doubled = 1.0, 0.0
    for _ in range(DOUBLINGS):
        if 1.0 + x <= ROOT_TWO * power:
            break
        power *= 2.0
        doubled += 1.0
    f = (x - (power - 1.0)) / power
    s = f / (2.0 + f)
    total = 0.0
    for term in SERIES:
        total = term + s * s * total
    return doubled * LOG_TWO + 2.0 * (s * total)


@compiled()
def next_rate(k, sample_time, pole, last, rate):  # type: ignore[no-untyped-def]
    """Move the filtered rate of input k on by one sample; ``last`` holds its last two voltages."""
    slope = (last[k, 0] - last[k, 1]) / sample_time
    rate[k] = pole[k] * rate[k] + (1.0 - pole[k]) * slope


@compiled()
def size_of(k, lam, rate):  # type: ignore[no-untyped-def]
    """Give g(rate) of input k: |rate| or, where lambda is given, log(1 + lambda |rate|) / lambda."""
    size = abs(rate[k])
    if lam[k] > 0.0:
        size = log_of_one_and(lam[k] * size) / lam[k]
    return size


@compiled()
def threshold(k, i, r, b, lam, rate):  # type: ignore[no-untyped-def]
    """R = r + b g(rate)."""
    return r[k, i] + b[k, i] * size_of(k, lam, rate)


@compiled()
def respond_rate_dependent(  # type: ignore[no-untyped-def]
    u, sample_time, pole, n, r, b, lam, w, plays, last, rate, first, stop, y
):
    """Sum of all plays, each with the threshold of its sample.

    u : (m, N); pole, lam : (m,); n : (m,) plays; r, b : (m, n_max); w : (m, n_max, p)
    plays : (m, n_max), last : (m, 2), rate : (m,), updated in place
    y : (p, N), overwritten from sample first up to stop
    """
    y[:, first:stop] = 0.0
    for k in range(u.shape[0]):
        for t in range(first, stop):
            next_rate(k, sample_time, pole, last, rate)
            for i in range(n[k]):
                reach = threshold(k, i, r, b, lam, rate)
                plays[k, i] = max(u[k, t] - reach, min(u[k, t] + reach, plays[k, i]))
                for o in range(y.shape[0]):
                    y[o, t] += w[k, i, o] * plays[k, i]
            last[k, 1], last[k, 0] = last[k, 0], u[k, t]


@compiled()
def play_outputs(u, sample_time, pole, r, b, lam, plays, last, rate, p):  # type: ignore[no-untyped-def]
    """Outputs of each play of one input: p (n, N), overwritten; the rest as above with m = 1."""
    size = np.empty(u.shape[1])
    for t in range(u.shape[1]):
        next_rate(0, sample_time, pole, last, rate)
        size[t] = size_of(0, lam, rate)
        last[0, 1], last[0, 0] = last[0, 0], u[0, t]
    for i in range(r.shape[1]):  # play after play: each writes what lies side by side in memory
        held = plays[0, i]
        for t in range(u.shape[1]):
            reach = r[0, i] + b[0, i] * size[t]
            held = max(u[0, t] - reach, min(u[0, t] + reach, held))
            p[i, t] = held
        plays[0, i] = held

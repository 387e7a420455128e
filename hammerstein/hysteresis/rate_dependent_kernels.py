"""Compiled time loops of plays whose thresholds grow with the rate."""

import numpy as np

from hammerstein.compiled import compiled, helper

CHUNK = 1024
"""Samples of one play after the other: what they add to stays in the cache."""
ROOT_TWO, LOG_TWO = 1.4142135623730951, 0.6931471805599453
"""Precision of a double."""
DOUBLINGS = 128
"""2^128 is beyond every rate in thresholds."""
SERIES = tuple(1.0 / n for n in range(23, 0, -2))
"""Coefficients of artanh(s) / s in s^2, the highest power first: for |s| < 0.172 all that a double tells."""


@helper()
def log_of_one_and(x):  # type: ignore[no-untyped-def]
    """Return log(1 + x) for x from 0 to 2^128 by sums and products alone: every machine gives the same bits.

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


@helper()
def next_rate(k, sample_time, pole, last, rate):  # type: ignore[no-untyped-def]
    """Update the filtered rate of input k by one sample; ``last`` holds its last two voltages."""
    slope = (last[k, 0] - last[k, 1]) / sample_time
    rate[k] = pole[k] * rate[k] + (1.0 - pole[k]) * slope


@helper()
def size_of(k, lam, rate):  # type: ignore[no-untyped-def]
    """Return g(rate) of input k: |rate| or, where lambda is given, log(1 + lambda |rate|) / lambda."""
    size = abs(rate[k])
    if lam[k] > 0.0:
        size = log_of_one_and(lam[k] * size) / lam[k]
    return size


@helper()
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
    size, p = np.empty(min(CHUNK, stop - first)), np.empty(min(CHUNK, stop - first))
    for begin in range(first, stop, CHUNK):
        end = min(begin + CHUNK, stop)
        for k in range(u.shape[0]):
            _sizes(k, u, sample_time, pole, lam, last, rate, begin, end, size)
            for i in range(n[k]):
                plays[k, i] = _played(u[k], r[k, i], b[k, i], size, plays[k, i], begin, end, p)
                for o in range(y.shape[0]):
                    weight = w[k, i, o]
                    for t in range(begin, end):
                        y[o, t] += weight * p[t - begin]


@compiled()
def play_outputs(u, sample_time, pole, r, b, lam, plays, last, rate, p):  # type: ignore[no-untyped-def]
    """Outputs of each play of one input: p (n, N), overwritten; the rest as above with m = 1."""
    size = np.empty(u.shape[1])
    _sizes(0, u, sample_time, pole, lam, last, rate, 0, u.shape[1], size)
    for i in range(r.shape[1]):
        plays[0, i] = _played(u[0], r[0, i], b[0, i], size, plays[0, i], 0, u.shape[1], p[i])


@helper()
def _sizes(k, u, sample_time, pole, lam, last, rate, begin, end, size):  # type: ignore[no-untyped-def]
    """Return size (end - begin,) the g(rate) of each sample of input k, and move its memory on."""
    for t in range(begin, end):
        next_rate(k, sample_time, pole, last, rate)
        size[t - begin] = size_of(k, lam, rate)
        last[k, 1], last[k, 0] = last[k, 0], u[k, t]


@helper()
def _played(u, r, b, size, held, begin, end, p):  # type: ignore[no-untyped-def]
    """Return p (end - begin,) the outputs of one play, which begins at ``held``, and where it ends.

    Play after play: each writes what lies side by side in memory.
    """
    for t in range(begin, end):
        reach = r + b * size[t - begin]
        held = max(u[t] - reach, min(u[t] + reach, held))
        p[t - begin] = held
    return held

"""Compiled time loop of a path that goes round."""

import math

import numpy as np

from hammerstein.compiled import at, compiled

# Of the sine's power series behind its first term: within a quarter turn the next one is below 1e-18.
C3, C5, C7, C9, C11, C13, C15, C17, C19, C21 = ((-1) ** n / math.factorial(2 * n + 1) for n in range(1, 11))


@compiled()
def go_round(time_s, radius, frequency_hz, turns, path):  # type: ignore[no-untyped-def]
    """Go round: x = R cos(2 pi (f t + turns)), y = R sin(2 pi (f t + turns)).

    time_s : (N,) [s]; radius : R; frequency_hz : f [Hz]; turns : at time 0; path : (2, N), overwritten
    """
    _sine(time_s, radius, frequency_hz, turns + 0.25, path[0])
    _sine(time_s, radius, frequency_hz, turns, path[1])


@compiled()
def _sine(time_s, size, frequency_hz, turns, wave):  # type: ignore[no-untyped-def]
    """One wave (N,). Whole turns are taken off without an error; four samples are worked out at once.

    A function of the mathematics library is called sample by sample, and its last bits are the machine's.
    """
    for t in range(wave.shape[0]):
        part = frequency_hz * time_s[at(t)]
        part = (part - np.rint(part)) + turns
        part -= np.rint(part)
        part = min(max(part, -0.5 - part), 0.5 - part)  # the same sine, at most a quarter turn from zero
        x = 2.0 * np.pi * part
        z = x * x
        series = C13 + z * (C15 + z * (C17 + z * (C19 + z * C21)))
        series = C3 + z * (C5 + z * (C7 + z * (C9 + z * (C11 + z * series))))
        wave[at(t)] = size * (x + x * (z * series))

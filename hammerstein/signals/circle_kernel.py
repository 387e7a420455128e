"""Compiled time loop of a path that goes round."""

from __future__ import annotations

import math

import numpy as np

from hammerstein.compiled import compiled

at = np.uint64  # an index of unsigned type is not tested for Python's counting from the end


@compiled()
def go_round(time_s, radius, rate, phase, path):  # type: ignore[no-untyped-def]
    """Go round: x = R cos(rate t + phase), y = R sin(rate t + phase), the two of one angle found together.

    time_s : (N,) [s]; radius : R; rate, phase : [rad/s], [rad]; path : (2, N), overwritten
    """
    for t in range(time_s.shape[0]):
        angle = rate * time_s[at(t)] + phase
        path[0, at(t)], path[1, at(t)] = radius * math.cos(angle), radius * math.sin(angle)

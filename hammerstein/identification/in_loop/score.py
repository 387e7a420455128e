"""Error of a simulation in the metric of the public benchmark of the fine steering mirror."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array

LEFT_OUT = 100
"""Samples of a record that do not count."""


def benchmark_rms(simulated: Array, measured: Array) -> float:
    """Root mean square of all errors of one level, all records, channels and samples together.

    The first LEFT_OUT samples of every record do not count.

    Parameters
    ----------
    simulated, measured : (record, channel, sample) positions of one unit

    Source: M. Floren, github.com/merijnfloren/fsm-benchmark-data (2026).
    """
    errors = (measured - simulated)[..., LEFT_OUT:]
    return float(np.sqrt(np.mean(errors * errors)))

"""Samples by which the outputs come late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock, split_delay
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import Thresholds, fit_static
from hammerstein.records.record import Record

MOST_DELAY = 5
DELAY_GAIN = 0.01
"""Part by which a longer delay must lower the error, or the shorter one is kept."""


def delay_in_samples(delay_s: float, sample_time_s: float) -> float:
    """Samples of a delay, whole ones without rounding.

    Examples
    --------
    >>> delay_in_samples(3e-4, 1e-4)
    3.0
    """
    whole, part_s = split_delay(delay_s, sample_time_s)
    return whole + part_s / sample_time_s


def shortest_delay(rms_um: Array) -> int:
    """Shortest delay whose error is within one percent of the least.

    Parameters
    ----------
    rms_um : (delay, output) rms errors [um]

    Examples
    --------
    >>> shortest_delay(np.array([[2.0, 1.0], [1.0, 0.5], [0.999, 0.5]]))
    1
    """
    size = np.maximum(rms_um.max(axis=0), np.finfo(float).tiny)
    relative = np.sqrt(np.mean((rms_um / size) ** 2, axis=1))
    return int(np.flatnonzero(relative <= (1.0 + DELAY_GAIN) * relative.min())[0])


def static_delay(
    records: Sequence[Record],
    thresholds_v: Thresholds,
    starts: Sequence[Start],
    through: Sequence[LinearBlock] | None = None,
) -> tuple[int, Array]:
    """Delay under which a static block explains the records best, and the errors (delay, output) [um].

    Hysteresis looks like lag, so that a correlation would always find a delay; here every candidate is
    judged with its own static block. Dynamics that are left out are counted as delay; ``through``, the
    sensor of each record, is not.
    """
    rms = [
        fit_static(
            records, thresholds_v, solver="least_squares", starts=starts, delay_samples=d, through=through
        ).rms_um
        for d in range(MOST_DELAY + 1)
    ]
    return shortest_delay(np.array(rms)), np.array(rms)

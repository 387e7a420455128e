"""The mean cycle of a periodic record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError


def settled_cycle(
    signal: ArrayLike, frequency_hz: float, sample_time_s: float, phases: int, *, skip_cycles: int = 0
) -> Array:
    """One mean cycle of a periodic record, also where the period is no whole number of samples.

    Every sample is put into the bin of its phase; signal and phase are averaged in each bin, and the mean
    cycle is read off at the bin centres.

    Parameters
    ----------
    signal : (axis, sample) a record that starts at phase 0
    frequency_hz : frequency of the cycle [Hz]
    sample_time_s : time between samples [s]
    phases : number of samples of the mean cycle
    skip_cycles : cycles at the start that have not settled; the first one never has if the actuator
        started from rest

    Returns
    -------
    (axis, phase) mean over the remaining whole cycles, from phase 0

    Raises
    ------
    IdentificationError : less than one whole cycle left, or fewer than two samples a cycle

    Examples
    --------
    At 150 Hz a cycle has 133.33 samples of 50 us:

    >>> u = np.sin(2.0 * np.pi * 150.0 * 50e-6 * np.arange(1200))
    >>> cycle = settled_cycle([u], 150.0, 50e-6, 400)
    >>> bool(np.allclose(cycle[0], np.sin(2.0 * np.pi * np.arange(400) / 400), atol=1e-12))
    True
    """
    values = np.atleast_2d(np.asarray(signal, dtype=np.float64))
    cycles_a_sample = frequency_hz * sample_time_s
    whole = int(np.floor(values.shape[1] * cycles_a_sample + 1e-9))
    if whole <= skip_cycles or not 0.0 < cycles_a_sample <= 0.5:
        raise IdentificationError(
            f"a record of {values.shape[1]} samples of {sample_time_s:g} s holds {whole} whole cycles at "
            f"{frequency_hz:g} Hz; at least {skip_cycles + 1} of two samples or more are needed"
        )
    first, stop = (int(np.ceil(c / cycles_a_sample - 1e-9)) for c in (skip_cycles, whole))
    position = phases * ((np.arange(first, stop) * cycles_a_sample) % 1.0)
    nearest = np.round(position).astype(np.int64)
    offset, bins = position - nearest, nearest % phases
    count = np.bincount(bins, minlength=phases)
    filled = np.flatnonzero(count)
    where = filled + np.bincount(bins, offset, phases)[filled] / count[filled]
    mean = [np.bincount(bins, row[first:stop], phases)[filled] / count[filled] for row in values]
    return np.array([np.interp(np.arange(phases), where, row, period=phases) for row in mean])

"""Linear-phase low-pass of a reference that is known ahead."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError

LONGEST_FILTER = 100_000
"""Taps; two seconds of a path at 50 kHz."""


def low_pass_taps(filter_hz: float | None, sample_time_s: float) -> Array:
    """Linear-phase low-pass of odd length, 60 dB or more, from 0.7 to 1.3 of its bandwidth; one tap: none."""
    if filter_hz is None:
        return np.ones(1)
    from scipy.signal import firwin, kaiserord

    nyquist = 0.5 / sample_time_s
    if not 0.0 < filter_hz < nyquist / 1.3:
        raise InputError(
            "filter_hz", f"must be between 0 and {nyquist / 1.3:g} Hz at this sample time, not {filter_hz:g}"
        )
    length, beta = kaiserord(66.0, 0.6 * filter_hz / nyquist)
    if length > LONGEST_FILTER:
        least = filter_hz * length / LONGEST_FILTER
        raise InputError(
            "filter_hz",
            f"{filter_hz:g} Hz needs a filter of {length:.3g} samples of {sample_time_s:g} s, but at "
            f"most {LONGEST_FILTER} are allowed; use {least:.3g} Hz or more, or a longer sample time",
        )
    return np.asarray(firwin(length | 1, filter_hz / nyquist, window=("kaiser", beta)), dtype=np.float64)


def filtered_by(taps: Array, raw: Array) -> Array:
    """Reference (p, N) behind the filter, shorter by its length less one."""
    from hammerstein.compensators.preview.preview_kernel import filtered
    from hammerstein.compiled import spans

    if len(taps) == 1:
        return raw
    raw = np.ascontiguousarray(raw)
    out = np.empty((raw.shape[0], raw.shape[1] - len(taps) + 1))
    for first, stop in spans(out.shape[1], taps.size * len(out)):
        filtered(taps, raw, first, stop, out)
    return out

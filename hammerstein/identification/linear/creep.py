"""Creep from a slow record, behind a known static block."""

import math

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import CreepMode
from hammerstein.errors import IdentificationError

APART = 1e-6
"""Smallest singular value of the regressors, in parts of the largest: below it, two modes have one time, and
gains that cancel."""


def fit_creep(v_um: Array, y_um: Array, sample_time_s: float, modes: int) -> tuple[CreepMode, ...]:
    """Slow modes between the output of a static block and the reading of one axis.

        y = a0 v + sum over i of a_i f_i + offset,   f_i = v / (1 + T_i s),   g_i = a_i / a0

    with v one sample late: the actuator responds to a held voltage within a sample, not at its first instant.

    The weights a are linear once the time constants are fixed (variable projection: Golub and Pereyra,
    Inverse Problems 19 (2003) R1); v is held over each sample, so f is exact on the grid.

    Parameters
    ----------
    v_um : (sample,) output of the static block from rest [um]
    y_um : (sample,) reading [um]
    sample_time_s : time between samples [s]
    modes : number of slow modes

    Returns
    -------
    the modes, fastest first

    Raises
    ------
    IdentificationError : the record does not separate the modes
    """
    from scipy.optimize import least_squares

    fast = np.concatenate([[0.0], v_um[:-1]])
    span = len(v_um) * sample_time_s
    begin = np.log(span * np.geomspace(0.005, 0.5, modes))
    limits = (math.log(10.0 * sample_time_s), math.log(10.0 * span))

    def regressors(log_times: Array) -> Array:
        slow = [_slow(v_um, math.exp(x), sample_time_s) for x in log_times]
        return np.stack([fast, *slow, np.ones_like(v_um)])

    def residual(log_times: Array) -> Array:
        columns = regressors(log_times)
        weights, *_ = np.linalg.lstsq(columns.T, y_um, rcond=None)
        return np.asarray(y_um - weights @ columns)

    found = least_squares(residual, begin, bounds=limits, x_scale=1.0, xtol=1e-6, ftol=1e-10)
    columns = regressors(found.x)
    weights, _, rank, _ = np.linalg.lstsq(columns.T, y_um, rcond=APART)
    if rank < len(columns) or weights[0] <= 0.0:
        raise IdentificationError(
            f"a slow record of {span:g} s does not identify {modes} creep modes; record longer or fit fewer"
        )
    order = np.argsort(found.x)
    gains = weights[1:-1] / weights[0]
    return tuple(CreepMode(gain=float(gains[i]), time_constant_s=float(math.exp(found.x[i]))) for i in order)


def _slow(v: Array, time_constant_s: float, sample_time_s: float) -> Array:
    """First-order lag of a held signal."""
    from scipy.signal import lfilter

    pole = math.exp(-sample_time_s / time_constant_s)
    return np.asarray(lfilter([0.0, 1.0 - pole], [1.0, -pole], v))

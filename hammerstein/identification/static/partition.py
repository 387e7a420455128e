"""Placement of the thresholds of the play operators (paper, appendix and remark 5.1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError

Indices = NDArray[np.int64]


def thresholds_uniform_in_time(
    amplitude_v: float, operators: int, samples_per_half_cycle: float
) -> tuple[Array, Indices]:
    """Thresholds at equal time steps along the rising half of a sine, as the published ones.

        s_j = j floor(N / (n + 1)) - 1,   r_j = A / 2 (1 - cos(pi s_j / N)),   j = 1 .. n

    The rising half cycle has N samples, and s counts them from the lower tip. One node more, s_{n+1}, is the
    top of the partition: the closed form needs the output there.

    Parameters
    ----------
    amplitude_v : amplitude A of the sine [V]
    operators : number n of thresholds
    samples_per_half_cycle : N; it need not be whole

    Returns
    -------
    thresholds_v : (operator,) [V]
    nodes : (operator + 1,) samples from the lower tip

    Raises
    ------
    IdentificationError : fewer samples in a half cycle than nodes

    Examples
    --------
    The published thresholds (paper, eq. 12), found at 50 Hz with samples of 50 us:

    >>> r, nodes = thresholds_uniform_in_time(10.0, 15, 200)
    >>> [round(float(v), 2) for v in r[:4]], int(nodes[-1])
    ([0.07, 0.32, 0.74, 1.3], 191)
    """
    nodes = nodes_uniform_in_time(operators, samples_per_half_cycle)
    thresholds = 0.5 * amplitude_v * (1.0 - np.cos(np.pi * nodes[:-1] / samples_per_half_cycle))
    return thresholds, nodes


def nodes_uniform_in_time(operators: int, samples_per_half_cycle: float) -> Indices:
    """Samples (operator + 1,) of the partition from the lower tip; see ``thresholds_uniform_in_time``."""
    _refuse_count(operators)
    spacing = math.floor(samples_per_half_cycle / (operators + 1))
    if spacing < 1:
        raise IdentificationError(
            f"the rising half of a cycle has {samples_per_half_cycle:g} samples, too few for "
            f"{operators} operators; use {_fewer(samples_per_half_cycle)}a lower frequency or a "
            "higher sampling rate, or thresholds uniform in voltage"
        )
    return spacing * np.arange(1, operators + 2, dtype=np.int64) - 1


def thresholds_uniform_in_voltage(amplitude_v: float, operators: int) -> Array:
    """Thresholds at equal voltage steps from 0 to below the amplitude: r_j = (j - 1) A / n, j = 1 .. n.

    Parameters
    ----------
    amplitude_v : amplitude A of the input [V]
    operators : number n of thresholds

    Returns
    -------
    (operator,) thresholds [V]

    Examples
    --------
    >>> thresholds_uniform_in_voltage(8.0, 4)
    array([0., 2., 4., 6.])
    """
    _refuse_count(operators)
    return amplitude_v * np.arange(operators) / operators


def _refuse_count(operators: int) -> None:
    if operators < 1:
        raise IdentificationError(f"{operators} operators are not a model; use at least one")


def _fewer(samples_per_half_cycle: float) -> str:
    """The most operators there may be, where that is one at least."""
    most = math.floor(samples_per_half_cycle) - 1
    return f"at most {most} operators, " if most > 0 else ""

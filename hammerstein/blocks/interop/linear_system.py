"""Matrices of any linear system of python-control."""

from __future__ import annotations

from typing import Any

import control
import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError

Matrices = tuple[Array, Array, Array, Array, float | None]


def matrices_of(system: Any) -> Matrices:
    """A (n, n), B (n, m), C (p, n), D (p, m), and the sample time [s]; None for continuous time.

    Raises
    ------
    InputError : not a state space or transfer function, or one that no state space has
    """
    if isinstance(system, control.FrequencyResponseData):
        raise InputError(
            "linear system",
            (
                "is a frequency response, which has no state; first fit a transfer function or a state "
                "space to it"
            ),
        )
    if not isinstance(system, control.StateSpace | control.TransferFunction):
        kind = type(system).__name__
        raise InputError(
            "linear system", f"is a {kind}; give a control.StateSpace or control.TransferFunction"
        )
    space = system if isinstance(system, control.StateSpace) else _realised(system)
    n, m, p = space.nstates, space.ninputs, space.noutputs
    shapes = ((n, n), (n, m), (p, n), (p, m))
    a, b, c, d = (
        np.asarray(np.reshape(matrix, shape), dtype=np.float64)
        for matrix, shape in zip((space.A, space.B, space.C, space.D), shapes, strict=True)
    )
    return a, b, c, d, _sample_time(system)


def _sample_time(system: Any) -> float | None:
    if not system.isdtime(strict=True):
        return None
    if system.dt is True:
        raise InputError("linear system", "is discrete without a sample time; set its dt in s")
    return float(system.dt)


def _realised(system: control.TransferFunction) -> control.StateSpace:
    """State space of a transfer function, element by element: no library beyond SciPy is needed."""
    from scipy.linalg import block_diag

    columns = []
    for i in range(system.ninputs):
        a, b, c, d = zip(*(_element(system, o, i) for o in range(system.noutputs)), strict=True)
        columns.append((block_diag(*a), np.vstack(b), block_diag(*c), np.vstack(d)))
    a, b, c, d = zip(*columns, strict=True)
    return control.ss(block_diag(*a), block_diag(*b), np.hstack(c), np.hstack(d), system.dt)


def _element(system: control.TransferFunction, output: int, input_: int) -> tuple[Array, ...]:
    from scipy.signal import tf2ss

    above, below = (np.trim_zeros(np.atleast_1d(x[output][input_]), "f") for x in (system.num, system.den))
    n = len(below) - 1
    if len(above) > n + 1:
        raise InputError(
            "linear system",
            "is improper: the order of a numerator exceeds that of its denominator; add poles",
        )
    if n == 0:
        gain = np.array([[above[0] / below[0] if len(above) else 0.0]])
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), gain
    matrices = tf2ss(above if len(above) else [0.0], below)
    shapes = ((n, n), (n, 1), (1, n), (1, 1))
    return tuple(np.reshape(x, shape) for x, shape in zip(matrices, shapes, strict=True))

"""Words for arrays, and arrays that nobody can write to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Array:
    """Copy of some numbers that nobody can write to."""
    array = np.array(values, dtype=np.float64)
    freeze(array)
    return array


def freeze_fields(value: object, *names: str) -> None:
    """Let fields of a frozen value be ``frozen`` copies of what was given; None stays."""
    for name in names:
        given = getattr(value, name)
        object.__setattr__(value, name, None if given is None else frozen(given))


def freeze(*arrays: NDArray[Any]) -> None:
    """Let nobody write to these arrays."""
    for array in arrays:
        array.flags.writeable = False

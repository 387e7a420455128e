"""Words for arrays, and arrays that nobody can write to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Rows = NDArray[np.int64]
Flags = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Array:
    """Copy of some numbers that nobody can write to."""
    array = np.array(values, dtype=np.float64)
    freeze(array)
    return array


def freeze(*arrays: NDArray[Any]) -> None:
    """Let nobody write to these arrays."""
    for array in arrays:
        array.flags.writeable = False

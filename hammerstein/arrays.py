"""Words for arrays, and arrays that nobody can write to."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
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


class ByValue:
    """A frozen value with arrays in it: equal to one of its class all of whose fields are equal.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True, eq=False)
    ... class Loop(ByValue):
    ...     u_v: Array
    >>> Loop(np.zeros(2)) == Loop(np.zeros(2)), Loop(np.zeros(2)) == Loop(np.ones(2))
    (True, False)
    """

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self) or not is_dataclass(self):
            return self is other
        return all(_equal(getattr(self, one.name), getattr(other, one.name)) for one in fields(self))

    def __hash__(self) -> int:
        return hash(type(self))  # arrays have none, and such values are no keys of large tables


def _equal(one: Any, other: Any) -> bool:
    """Whether two fields are equal, arrays and tuples of arrays as well."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return bool(one == other)

"""Plain data, as states save it, in a vector of constant length and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError

LIMBS, BITS = 4, 32  # a lone whole number, such as the state of a random generator, has up to 128 bits


@dataclass(frozen=True)
class Leaf:
    """One value of some plain data: its keys, how it becomes numbers, and how numbers become it."""

    keys: tuple[str | int, ...]
    length: int
    numbers: Callable[[Any], Array]
    value: Callable[[Array], Any]


class Packing:
    """Where each number of some plain data stands in a vector.

    The vector holds the difference to the data it was made from: zero is that data. The difference is exact
    where that data holds zeros and whole numbers, as a state at rest does.

    Parameters
    ----------
    like : dictionaries, and lists of them, of numbers, lists of numbers, and words; all that is packed
        has its shape

    Examples
    --------
    >>> packing = Packing({"count": [1, 2], "x": [[0.0, 0.0]]})
    >>> vector = packing.pack({"count": [1, 4], "x": [[0.5, 0.0]]})
    >>> vector
    array([0. , 2. , 0.5, 0. ])
    >>> packing.unpack(vector)
    {'count': array([1, 4]), 'x': array([[0.5, 0. ]])}
    """

    def __init__(self, like: dict[str, Any]):
        self._leaves = tuple(_leaves(like, ()))
        self._origin = np.concatenate([np.zeros(0), *(f.numbers(_at(like, f.keys)) for f in self._leaves)])

    @property
    def length(self) -> int:
        """Numbers in the vector."""
        return len(self._origin)

    def pack(self, data: dict[str, Any]) -> Array:
        """Vector (length,) of some data."""
        pieces = [leaf.numbers(_at(data, leaf.keys)) for leaf in self._leaves]
        if any(len(p) != leaf.length for p, leaf in zip(pieces, self._leaves, strict=True)):
            raise InputError("state", "does not belong to this block: the number of values differs")
        return np.asarray(np.concatenate([np.zeros(0), *pieces]) - self._origin)

    def unpack(self, vector: Array) -> dict[str, Any]:
        """Data of a vector (length,); arrays stand for lists."""
        values, data, first = vector + self._origin, dict[Any, Any](), 0
        for leaf in self._leaves:
            inner = data
            for key in leaf.keys[:-1]:
                inner = inner.setdefault(key, {})
            inner[leaf.keys[-1]] = leaf.value(values[first : first + leaf.length])
            first += leaf.length
        return {key: _with_lists(value) for key, value in data.items()}


def _with_lists(data: Any) -> Any:
    """The same with lists in place of dictionaries whose keys are numbers."""
    if not isinstance(data, dict):
        return data
    inner = {key: _with_lists(value) for key, value in data.items()}
    return list(inner.values()) if 0 in inner else inner


def _at(data: Any, keys: tuple[str | int, ...]) -> Any:
    for key in keys:
        data = data[key]
    return data


def _leaves(data: Any, keys: tuple[str | int, ...]) -> Iterator[Leaf]:
    parts = isinstance(data, list | tuple) and any(isinstance(part, dict) for part in data)
    nothing = isinstance(data, dict) and not data  # what a block without memory remembers
    if isinstance(data, str) or (keys and nothing):
        yield Leaf(keys, 0, lambda _: np.zeros(0), lambda _: data)
    elif parts or isinstance(data, dict):
        for key, value in enumerate(data) if parts else data.items():
            yield from _leaves(value, (*keys, key))
    elif isinstance(data, int):
        yield Leaf(keys, LIMBS, _limbs, _whole)
    else:
        array = np.asarray(data)
        whole, shape = np.issubdtype(array.dtype, np.integer), array.shape

        def value(numbers: Array) -> Any:
            shaped = numbers.reshape(shape)
            return np.rint(shaped).astype(np.int64) if whole else shaped

        yield Leaf(keys, array.size, lambda given: np.asarray(given, dtype=np.float64).ravel(), value)


def _limbs(whole: int) -> Array:
    """Whole number as digits of 32 bits, each of which a float holds exactly."""
    return np.array([float(whole >> BITS * limb & 2**BITS - 1) for limb in range(LIMBS)])


def _whole(limbs: Array) -> int:
    return sum(round(limb) << BITS * place for place, limb in enumerate(limbs.tolist()))

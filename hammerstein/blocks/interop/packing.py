"""Plain data, as states save it, in a vector of constant length and back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError

LIMBS, BITS = 4, 32  # a lone whole number, such as the state of a random generator, has up to 128 bits


class Packing:
    """Position of each number of plain data in a vector.

    The vector is the difference from the data that it was made from, so zero is that data. The difference is
    exact for zeros and whole numbers, as in a state at rest.

    Parameters
    ----------
    like : dictionaries, and lists of them, of numbers, lists of numbers, and words; all packed data must have
        this shape

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
        pieces = list(_numbers(like))
        self._sizes = [piece.size for piece in pieces]
        self._like, self._origin = _filled(like, iter(pieces)), np.concatenate([np.zeros(0), *pieces])

    @property
    def length(self) -> int:
        """Numbers in the vector."""
        return len(self._origin)

    def pack(self, data: dict[str, Any]) -> Array:
        """Vector (length,) of some data."""
        pieces = list(_numbers(data))
        if [piece.size for piece in pieces] != self._sizes:
            raise InputError("state", "does not belong to this block: the number of values differs")
        return np.asarray(np.concatenate([np.zeros(0), *pieces]) - self._origin)

    def unpack(self, vector: Array) -> dict[str, Any]:
        """Data of a vector (length,); arrays stand for lists."""
        pieces = np.split(vector + self._origin, np.cumsum(self._sizes))
        found: dict[str, Any] = _filled(self._like, iter(pieces))
        return found


def _parts(data: Any) -> Sequence[Any] | None:
    """What stands in a dictionary, or in a list of them; None of anything else."""
    if isinstance(data, dict):
        return list(data.values())
    several = isinstance(data, list | tuple) and any(isinstance(part, dict) for part in data)
    return data if several else None


def _numbers(data: Any) -> Iterator[Array]:
    """Numbers of each value in some data, one after the other; words have none."""
    parts = _parts(data)
    if parts is not None:
        for part in parts:
            yield from _numbers(part)
    elif isinstance(data, int):
        yield _limbs(data)
    elif not isinstance(data, str):
        yield np.asarray(data, dtype=np.float64).ravel()


def _filled(like: Any, pieces: Iterator[Array]) -> Any:
    """Data of the shape of some other, with these numbers in it."""
    parts = _parts(like)
    if parts is not None:
        filled = [_filled(part, pieces) for part in parts]
        return dict(zip(like, filled, strict=True)) if isinstance(like, dict) else filled
    if isinstance(like, str):
        return like
    numbers, array = next(pieces), np.asarray(like)
    if isinstance(like, int):
        return _whole(numbers)
    shaped = numbers.reshape(array.shape)
    return np.rint(shaped).astype(np.int64) if np.issubdtype(array.dtype, np.integer) else shaped


def _limbs(whole: int) -> Array:
    """Whole number as digits of 32 bits, each of which a float holds exactly."""
    return np.array([float(whole >> BITS * limb & 2**BITS - 1) for limb in range(LIMBS)])


def _whole(limbs: Array) -> int:
    return sum(round(limb) << BITS * place for place, limb in enumerate(limbs.tolist()))

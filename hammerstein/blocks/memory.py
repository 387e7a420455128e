"""State of a block between two samples, convertible to plain data and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from hammerstein.errors import InputError


@dataclass(frozen=True, eq=False)
class Memory:
    """State of a block between two samples; JSON keeps it to the last bit.

    A block's own memory derives from this as a frozen dataclass of arrays, numbers, other memories and tuples
    of them. A block that remembers nothing has this one itself.

    Examples
    --------
    >>> @dataclass(frozen=True, eq=False)
    ... class Held(Memory):
    ...     last_v: np.ndarray
    >>> before = Held(np.zeros(2))
    >>> before.restored({"last_v": [0.5, 1.0]}).as_dict()
    {'last_v': [0.5, 1.0]}
    """

    def as_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers."""
        return {name: _plain(getattr(self, name)) for name in self._names()}

    def restored(self, data: dict[str, Any]) -> Self:
        """Memory of the same shape as this one from what its ``as_dict`` gave.

        Raises InputError for what lacks a part of it.
        """
        missing = [name for name in self._names() if name not in data]
        if missing:
            what = f"has no {', '.join(missing)}: it belongs to another block, or to another version"
            raise InputError("memory", f"{what}; start at rest")
        return self._with(lambda name, own: _shaped(own, data[name]))

    def copy(self) -> Self:
        """Return an independent copy."""
        return self._with(lambda _, own: own.copy() if isinstance(own, np.ndarray | Memory) else own)

    def _names(self) -> tuple[str, ...]:
        """Names of its parts, known once a class: a loop in Python copies a memory at every sample."""
        return self.__match_args__

    def _with(self, value: Callable[[str, Any], Any]) -> Self:
        return type(self)(*[value(name, getattr(self, name)) for name in self._names()])


def _plain(own: Any) -> Any:
    if isinstance(own, Memory):
        return own.as_dict()
    if isinstance(own, tuple):
        return [_plain(part) for part in own]
    return own.tolist() if isinstance(own, np.ndarray) else own


def _shaped(own: Any, data: Any) -> Any:
    """Plain data as what stands in its place: of that type, an array of that shape."""
    if isinstance(own, Memory):
        return own.restored(data)
    if isinstance(own, tuple):
        return tuple(_shaped(part, given) for part, given in zip(own, data, strict=True))
    return np.array(data, dtype=own.dtype).reshape(own.shape) if isinstance(own, np.ndarray) else data

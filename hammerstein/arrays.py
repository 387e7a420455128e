"""Array types, read-only arrays, and the parts in which loops work through signals."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Array:
    """Read-only copy of some numbers."""
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


def rows_of(signals: ArrayLike) -> Array:
    """Signals (axis, sample) as compiled loops take them: contiguous, and copied where they are read-only.

    For read-only arrays numba would compile each loop once more.
    """
    rows = np.ascontiguousarray(np.atleast_2d(np.asarray(signals, dtype=np.float64)))
    return rows if rows.flags.writeable else rows.copy()


def times(matrix: Array, signals: Array) -> Array:
    """Product of a matrix (q, h) and signals (h,) or (h, sample), each sample to the same last bit alone."""
    return np.asarray((matrix.reshape(*matrix.shape, *[1] * (signals.ndim - 1)) * signals).sum(axis=1))


def transfer(A: Array, B: Array, C: Array, D: Array | Complex, z: Complex) -> Complex:
    """C (z I - A)^-1 B + D (point, output, input) at points z (point,)."""
    states = np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(z), *B.shape)))
    return np.asarray(C @ states + D)


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
    if isinstance(one, tuple | list) and isinstance(other, tuple | list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.array_equal(one, other)
    return bool(one == other)


PAGE = 2**21
"""Bytes of a large page of memory."""
KEPT = 15 * PAGE
"""Bytes of the largest piece of memory that glibc lends again without giving it back to the system."""


def allocate_wires(rows: int, samples: int) -> Array:
    """Memory (row, sample) for long signals, not yet written to, in the way that costs the system least.

    What is new from the system is cleared page by page as it is first written to, which takes as long as
    a few passes over it. A smaller piece is what the run before has left, where the library of the system
    keeps that. A larger one lies on large pages, which the system gives at once.
    """
    numbers, page = rows * samples, PAGE // 8
    if 8 * numbers < KEPT:
        _keep()
        return np.empty((rows, samples))
    piece = np.empty((numbers // page + 2) * page)
    first = -piece.ctypes.data % PAGE // 8
    return piece[first : first + numbers].reshape(rows, samples)


@cache
def _keep() -> None:
    """Let glibc keep what is freed: up to twice the largest piece that it has seen freed, up to 32 MB."""
    np.empty(KEPT // 8)


SPAN, LEAST = 2**25, 2**5
"""Multiplications of one call, a tenth of a second, and the least that a sample counts for."""


def spans(samples: int, products: int = LEAST) -> Iterator[tuple[int, int]]:
    """First sample and end of each part of a signal that a loop works through in one call.

    Between two calls Python answers Ctrl-C, which it cannot while a loop runs. A loop that carries its state
    on gives the same numbers to the last bit, however its signal is cut.

    Parameters
    ----------
    samples : length of the signal
    products : multiplications that a sample takes, about

    Examples
    --------
    >>> list(spans(3_000_000))
    [(0, 1048576), (1048576, 2097152), (2097152, 3000000)]
    """
    length = max(1, SPAN // max(products, LEAST))
    for first in range(0, samples, length):
        yield first, min(first + length, samples)


def padded(rows: Sequence[Array], width: int, fill: float) -> Array:
    """Read-only rows of one width, filled up at their ends."""
    return frozen([np.pad(row, (0, width - len(row)), constant_values=fill) for row in rows])


def filled(loop: Callable[..., object], *given: Any, shape: tuple[int, int], products: int = LEAST) -> Array:
    """Array (row, sample) that a compiled loop fills in ``spans``.

    loop : takes what is given, first sample and end of a part, and the array
    """
    rows = np.empty(shape)
    for first, stop in spans(shape[1], products):
        loop(*given, first, stop, rows)
    return rows

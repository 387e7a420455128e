"""Memory for long signals, in the way that costs the system least."""

from __future__ import annotations

from functools import cache

import numpy as np

from hammerstein.arrays import Array

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

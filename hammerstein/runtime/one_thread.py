"""Linear algebra on one thread: its sums depend on nothing else, and small matrices wait for no other."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_LOCK = threading.Lock()
_within: list[Any] = []
"""Everybody who is within now; the first holds what was before, for whoever leaves last."""


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra has one thread meanwhile, whatever the caller's settings; may decorate a function.

    Sums of several threads end in other last bits, and threads that wait for each other make the small
    matrices of a draw several times dearer. The command line asks for one thread before NumPy is loaded.
    Where several are within at once, as runs of a study are, the last one puts back what was before.
    """
    import scipy.linalg  # noqa: F401  # brings a library of its own: only what is loaded is limited
    from threadpoolctl import threadpool_limits

    with _LOCK:
        _within.append(_within[0] if _within else threadpool_limits(1, "blas"))
    try:
        yield
    finally:
        with _LOCK:
            limits = _within.pop()
            if not _within:
                limits.restore_original_limits()

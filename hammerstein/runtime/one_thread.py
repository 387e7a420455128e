"""Linear algebra on one thread: its sums depend on nothing else, and small matrices wait for no other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Linear algebra has one thread meanwhile, whatever the caller's settings; may decorate a function.

    Sums of several threads end in other last bits, and threads that wait for each other make the small
    matrices of a draw several times dearer. The command line asks for one thread before NumPy is loaded.
    """
    import scipy.linalg  # noqa: F401  # brings a library of its own: only what is loaded is limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, "blas"):
        yield

"""The least memory that the numeric libraries need, checked before they load.

Under a smaller limit OpenBLAS spins inside its own loader, where no signal reaches Python.
"""

from hammerstein.errors import SimulationError

SMALLEST_BYTES = 1e9
"""Addresses that a command takes: with 0.7 GB `compensate` and `identify` fail in a library, with this
they run."""


def refuse_small_limit() -> None:
    """Refuse to start under a limit on addresses (``ulimit -v``) in which the libraries cannot load.

    Raises SimulationError with the limit and the least one that works.
    """
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:
        return  # Windows has no such limit
    limit = getrlimit(RLIMIT_AS)[0]
    if limit != RLIM_INFINITY and limit < SMALLEST_BYTES:
        raise SimulationError(
            f"memory is limited to {limit / 1e6:.0f} MB (ulimit -v), and the numeric libraries need "
            f"{SMALLEST_BYTES / 1e6:.0f} MB; raise the limit"
        )

"""One writer at a time: a lock that the system takes back from a process that dies."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from hammerstein.errors import InputError

PATIENCE_S = 30.0
"""A report is written in less; who holds the lock longer hangs."""
PAUSE_S = 0.05
"""Between two looks, below what a person notices."""
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP)


@contextmanager
def locked(
    path: Path, patience_s: float | None = None, busy: tuple[str, str] | None = None
) -> Iterator[None]:
    """Hold a lock file inside the block; it is made first, and removed at the end.

    On a file system without locks nothing is held.

    Parameters
    ----------
    path : the lock file, in a folder that exists
    patience_s : how long to wait for another process; ``PATIENCE_S`` if not given
    busy : source and words of the error where that one is not done by then

    Raises
    ------
    InputError : another run holds the lock for longer than that
    OSError : the file cannot be made
    """
    lock = FileLock(path, timeout=PATIENCE_S if patience_s is None else patience_s)
    try:
        lock.acquire(poll_interval=PAUSE_S)
    except Timeout:
        source, what = busy or (str(path.parent), "another run is writing there")
        raise InputError(source, f"{what}; wait for it, or choose another place") from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    try:
        yield
    finally:
        if sys.platform != "win32":  # which does not remove what is open
            with contextlib.suppress(OSError):
                os.unlink(path)
        lock.release()
        if sys.platform == "win32":
            with contextlib.suppress(OSError):
                os.unlink(path)

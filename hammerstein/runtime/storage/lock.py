"""One writer at a time: a lock that the system takes back from a process that dies."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hammerstein.errors import InputError

PATIENCE_S = 30.0
PAUSE_S = 0.05
LOCK = "lock"
_TAKEN = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)


@contextmanager
def locked(room: Path) -> Iterator[None]:
    """Hold a folder for this process; it is made first, and removed at the end if nothing else is in it.

    Raises
    ------
    InputError : another run keeps it for longer than anyone should wait
    OSError : it cannot be made
    """
    handle = _taken(room)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if sys.platform == "win32":  # which does not remove what is open
                os.close(handle)
                os.unlink(room / LOCK)
            else:
                os.unlink(room / LOCK)
                os.close(handle)
            room.rmdir()


def _taken(room: Path) -> int:
    """Handle of the lock file, locked, and still the one that has the name."""
    until = time.monotonic() + PATIENCE_S
    while True:
        with contextlib.suppress(FileNotFoundError):  # another one has just removed the folder
            room.mkdir(exist_ok=True)
            handle = os.open(room / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
            if _try(handle) and _is_named(handle, room / LOCK):
                return handle
            os.close(handle)
        if time.monotonic() > until:
            raise InputError(
                str(room.parent), "another run is writing there; wait for it, or choose another place"
            )
        time.sleep(PAUSE_S)


def _is_named(handle: int, path: Path) -> bool:
    """Whether the file still has its name; Windows takes none from a file that is open."""
    if sys.platform == "win32":
        return True
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _try(handle: int) -> bool:
    """Take the lock, if nobody else has it; a file system without locks has one writer at a time."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno not in _TAKEN
    return True

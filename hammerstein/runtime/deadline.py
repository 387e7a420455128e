"""Ctrl-C is answered in time, wherever the process is: in a compiled loop, in LAPACK, in a file.

Python calls a signal's handler between two of its own instructions. While the main thread is inside compiled
code there are none, for minutes if it must be. The system's part of the handler does run: it writes the
signal's number to a pipe. A thread that waits there ends the process when the main thread does not do it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hammerstein.files import discard_unfinished

PATIENCE_S = 1.2
ENDING = {int(s) for s in signal.Signals if s.name in ("SIGINT", "SIGTERM", "SIGHUP")}
LEAVE = b"\0"


@contextmanager
def ended_in_time(say: Callable[[], None], code: int) -> Iterator[None]:
    """End the process when a signal that asks for it has not been answered in time.

    Parameters
    ----------
    say : tells a person that it was interrupted; called from another thread
    code : exit code
    """
    if os.name == "nt" or threading.current_thread() is not threading.main_thread():
        yield  # the pipe must be a socket there, and only the main thread hears of signals
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_wait, args=(reader, say, code), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.write(writer, LEAVE)


def _wait(reader: int, say: Callable[[], None], code: int) -> None:
    """Wait for a signal; from then on the process has only so long, even to clean up behind it."""
    while (got := os.read(reader, 1)) != LEAVE:
        if got[0] not in ENDING:
            continue
        threading.Event().wait(PATIENCE_S)
        discard_unfinished()
        for process in multiprocessing.active_children():
            process.kill()
        say()
        os._exit(code)

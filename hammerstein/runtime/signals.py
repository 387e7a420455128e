"""End of the program at a signal, at any point: in its first line, in LAPACK, while writing.

Python calls the handler of a signal between two of its own instructions. Compiled code has none, sometimes
for minutes. The part of the handler in C does run: it writes the number of the signal to a socket. A thread
that waits for this socket ends the process.
"""

import os
import signal
import socket
import sys
import threading
from collections.abc import Container

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
INTERRUPTED = 130
"""128 + 2, what shells give for SIGINT."""
TOLD = b"interrupted; finished files are kept, and nothing is half-written\n"
CLEAR_LINE_SHOW_CURSOR = b"\r\x1b[2K\x1b[?25h"
"""A terminal with a bar of progress has neither in order."""

uninterrupted = threading.RLock()
"""Lock for sections that must complete before the end."""


def end_when_asked() -> None:
    """End the process at Ctrl-C, SIGTERM and a closed terminal; signals that nohup ignores stay ignored."""
    reader, writer = socket.socketpair()  # no pipe: Windows writes to sockets alone
    asked = [n for n in signal.Signals if n.name in NAMES and signal.getsignal(n) is not signal.SIG_IGN]
    threading.Thread(target=_wait, args=(reader, writer, asked), daemon=True).start()
    writer.setblocking(False)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    for number in asked:
        signal.signal(number, lambda *_: None)


def _wait(reader: socket.socket, writer: socket.socket, asked: Container[int]) -> None:
    """End the process when it is asked to; ``writer`` is open for as long as this waits."""
    while reader.recv(1)[0] not in asked:
        pass
    with uninterrupted:
        end()


def end() -> None:
    """End at once, without half-written files; worker processes end as well and remove theirs.

    Nothing is imported here, because two threads that import at the same time may wait for each other
    forever. A module that is not loaded needs no clean-up.
    """
    if files := sys.modules.get("hammerstein.files"):
        files.discard_unfinished()
    try:
        os.write(2, CLEAR_LINE_SHOW_CURSOR * os.isatty(2) + TOLD)
    finally:
        os._exit(INTERRUPTED)

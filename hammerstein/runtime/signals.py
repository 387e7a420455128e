"""How the program leaves when it is asked to, wherever it is: in its first line, in LAPACK, in a file.

Nothing else is loaded with this module. Python calls a signal's handler between two of its own instructions.
While the main thread is inside compiled code there are none, for minutes if it must be. The system's part of
the handler does run: it writes the signal's number to a socket. A thread that waits there ends the process
when the main thread does not do it.
"""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from time import sleep
from typing import Any

NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
INTERRUPTS = tuple(number for number in signal.Signals if number.name in NAMES)
INTERRUPTED = 130
LEFT = "interrupted; what was finished is written, and nothing else"
PATIENCE_S = 1.2
LEAVE = b"\0"


def leave_on_interrupts() -> None:
    """Let Ctrl-C, SIGTERM and a closed terminal end the process at once; what nohup ignores stays so."""
    for number in INTERRUPTS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, leave)


def leave(*_: object) -> None:
    """End at once: nothing is being written, or somebody asks for the second time."""
    try:
        os.write(2, LEFT.encode() + b"\n")
    finally:
        os._exit(INTERRUPTED)


def once(act: Callable[[], None]) -> Callable[[], None]:
    """Give the same act, which only the first caller does; others wait for its end, but not for ever."""
    import threading

    lock, done = threading.Lock(), threading.Event()

    def act_once() -> None:
        if lock.acquire(timeout=PATIENCE_S):
            try:
                if not done.is_set():
                    act()
                done.set()
            finally:
                lock.release()

    return act_once


@contextmanager
def dropped_in_silence(kind: type[BaseException]) -> Iterator[None]:
    """Let nothing be said of exceptions of a kind that Python drops.

    A signal may come in a destructor, or in a callback: the import system has one for every module. What is
    raised there goes nowhere, and a traceback is printed.
    """
    unraisable, uncaught = sys.unraisablehook, sys.excepthook

    def of_python(dropped: Any) -> None:
        if not issubclass(dropped.exc_type, kind):
            unraisable(dropped)

    def of_compiled_code(raised: type[BaseException], *rest: Any) -> None:
        if not issubclass(raised, kind):
            uncaught(raised, *rest)

    sys.unraisablehook, sys.excepthook = of_python, of_compiled_code
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = unraisable, uncaught


@contextmanager
def ended_in_time(say: Callable[[], None]) -> Iterator[None]:
    """End the process when a signal that asks for it has not been answered in time.

    Parameters
    ----------
    say : tells a person that it was interrupted; called from another thread
    """
    import socket
    import threading

    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread gets signals
        return
    reader, writer = socket.socketpair()  # no pipe: Windows writes to sockets alone
    with writer:
        writer.setblocking(False)
        before = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=_wait, args=(reader, say), daemon=True).start()
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)
            with suppress(OSError):  # the other end is closed once a signal has come
                writer.send(LEAVE)


def _wait(reader: Any, say: Callable[[], None]) -> None:
    """Wait for a signal; from then on the process has only so long, even to clean up behind it.

    Nothing is imported here: of two threads that import at once, each may wait for the other for ever, as
    where Python 3.11 forgets the lock of a module in the middle of taking another, and the main thread
    imports most of what it needs just now. What is not loaded has nothing to be cleaned up.
    """
    ending = {int(number) for number in INTERRUPTS}
    with reader:
        while (got := reader.recv(1)) not in (LEAVE, b""):
            if got[0] in ending:
                break
        else:
            return
        sleep(PATIENCE_S)  # the socket stays open: more signals may come
        _loaded("hammerstein.files", "discard_unfinished", tuple)()
        for process in _loaded("multiprocessing.process", "active_children", tuple)():
            process.kill()
        say()
        os._exit(INTERRUPTED)


def _loaded(module: str, name: str, otherwise: Callable[[], Any]) -> Callable[[], Any]:
    """A function of a module, if that is loaded."""
    found: Callable[[], Any] = getattr(sys.modules.get(module), name, otherwise)
    return found

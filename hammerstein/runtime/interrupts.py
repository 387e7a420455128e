"""Ctrl-C, SIGTERM and the end of the terminal held back while something must not be left in the middle."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hammerstein.runtime.signals import INTERRUPTS


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the end; threads other than the main one never see them.

    The handlers are exchanged and not the signals masked: a mask holds for one thread, and another one would
    take the signal to the main thread all the same.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[signal.Signals] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(signal.Signals(number)))
        for number in INTERRUPTS
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for number in dict.fromkeys(came):
            signal.raise_signal(number)

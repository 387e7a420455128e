"""Processes beside this one, which begin with the libraries loaded."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from typing import TypeVar

from hammerstein.files import discard_unfinished

T = TypeVar("T")

ENDED = 143
GARBAGE = (50_000, 20, 50)
"""How seldom garbage is searched: figures are many small objects, and most of them stay until the end."""
PATIENCE_S = 3.0

LOADED_ONCE = (
    "hammerstein.commands.cli",
    "hammerstein.experiment.simulated_identification",
    "hammerstein.reporting.figures.write",
    "hammerstein.reporting.page",
    "control",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
    "pandas",
    "scipy.signal",
)
"""What every run needs and takes seconds to load."""


def side_by_side(tasks: Iterable[Callable[[], T]], processes: int) -> Iterator[T]:
    """Results of the tasks in the order in which they end; the first ones begin first.

    Where it is left early, as by Ctrl-C, the tasks that still run are stopped.
    """
    with _pool(processes) as pool:
        try:
            with _deferred_interrupts():  # one in the middle would leave a process that nobody knows
                waiting = [pool.submit(task) for task in tasks]
            for future in as_completed(waiting):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _stop(multiprocessing.active_children())
            raise


def begin_loading() -> None:
    """Let the libraries be loaded beside what this process does before it needs the others."""
    if not _has_server():
        return
    from multiprocessing import forkserver

    multiprocessing.set_forkserver_preload(list(LOADED_ONCE))
    with _ignored_interrupts():
        forkserver.ensure_running()


@contextmanager
def _deferred_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait until the end, where the system can."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """A process begun here never hears of Ctrl-C: it ends with this one, without a traceback of its own."""
    if threading.current_thread() is not threading.main_thread():  # others may not touch the handlers
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _has_server() -> bool:
    """Whether one server can load the libraries and fork every process."""
    return "forkserver" in multiprocessing.get_all_start_methods()


def _pool(processes: int) -> ProcessPoolExecutor:
    begin_loading()
    context = multiprocessing.get_context("forkserver" if _has_server() else None)
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_ready)


def _ready() -> None:
    """Make a new process ready.

    Ctrl-C is for its parent, which then ends it. The libraries stay for good, so that the search for garbage
    can pass them by.
    """
    gc.freeze()
    gc.set_threshold(*GARBAGE)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)


def _leave(*_: object) -> None:
    """End at once, wherever the process is, without a half-written file; an exception could be swallowed."""
    discard_unfinished()
    os._exit(ENDED)


def _stop(processes: Sequence[BaseProcess]) -> None:
    """End processes, by force where they do not hear."""
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(PATIENCE_S)
        if process.is_alive():
            process.kill()

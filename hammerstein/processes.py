"""Processes beside this one, which begin with the libraries loaded."""

from __future__ import annotations

import gc
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

T = TypeVar("T")

LOADED_ONCE = (
    "hammerstein.cli",
    "hammerstein.characterise",
    "hammerstein.figures.write",
    "hammerstein.markdown",
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
        waiting = [pool.submit(task) for task in tasks]
        try:
            for future in as_completed(waiting):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def begin_loading() -> None:
    """Let the libraries be loaded beside what this process does before it needs the others."""
    if _has_server():
        from multiprocessing import forkserver

        multiprocessing.set_forkserver_preload(list(LOADED_ONCE))
        forkserver.ensure_running()


def _has_server() -> bool:
    """Whether one server can load the libraries and fork every process."""
    return "forkserver" in multiprocessing.get_all_start_methods()


def _pool(processes: int) -> ProcessPoolExecutor:
    begin_loading()
    context = multiprocessing.get_context("forkserver" if _has_server() else None)
    return ProcessPoolExecutor(processes, mp_context=context, initializer=_ready)


def _ready() -> None:
    """Make a new process ready.

    Ctrl-C and the end of the parent stop it: no half-written file, no traceback. The libraries stay for good,
    so that the search for garbage can pass them by.
    """
    gc.freeze()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit())

"""Start of worker processes with loaded libraries, and their end."""

import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from multiprocessing.context import BaseContext

from hammerstein.errors import tell_notices
from hammerstein.files import discard_unfinished
from hammerstein.runtime.resources import keep_freed_memory, one_blas_thread

ENDED = 143  # 128 + 15, what shells give for SIGTERM
GARBAGE = (50_000, 20, 50)
"""Threshold of garbage collection: figures are many small objects, and most of them stay until the end."""

FOR_RUNS = (
    "hammerstein.experiment.draws",
    "hammerstein.experiment.simulated_identification",
    "hammerstein.experiment.study",
    "numba",
    "scipy.signal",
)
"""Modules that every run needs, without its report."""

LOADED_ONCE = (
    *FOR_RUNS,
    "hammerstein.commands.cli",
    "hammerstein.reporting.figures.write",
    "hammerstein.reporting.run_page",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
    "pandas",
)
"""Modules that a run with report needs and that take seconds to load."""


_BEGINNING = threading.Lock()
_FOR_GOOD = ExitStack()
"""What a process holds until its end."""


def begin_loading(names: Sequence[str] = LOADED_ONCE) -> None:
    """Load libraries in the background before this process needs workers.

    names : modules; those of the first call in a process are loaded once, others by each who needs them
    """
    if not _has_server():
        return
    from multiprocessing import forkserver

    multiprocessing.set_forkserver_preload(loaded_beforehand(names))
    with _ignored_interrupts(), _imports_from_where_this_does():
        forkserver.ensure_running()


def loaded_beforehand(names: Sequence[str] = LOADED_ONCE) -> list[str]:
    """Modules that the server loads before it forks.

    On macOS nothing: the system's linear algebra, which NumPy uses there and tries out when it is loaded,
    does not survive a fork (https://github.com/numpy/numpy/issues/5752).
    """
    return [] if sys.platform == "darwin" else list(names)


@contextmanager
def _imports_from_where_this_does() -> Iterator[None]:
    """A Python started here imports no module from the working folder, unless this process does.

    It is started with ``python -c``, which searches the working folder first; up to Python 3.12.7 and 3.13.0
    it does not inherit the path (https://github.com/python/cpython/issues/117378).
    """
    places = [place for place in sys.path if isinstance(place, str)]  # Python passes others by
    wanted = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(places)}
    with _BEGINNING:  # the environment is that of all threads
        before = {name: os.environ.get(name) for name in wanted}
        os.environ.update(wanted)
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


@contextmanager
def _ignored_interrupts() -> Iterator[None]:
    """A process started here ignores Ctrl-C: it ends with this one, without a traceback of its own."""
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


def context(names: Sequence[str] = LOADED_ONCE) -> BaseContext:
    """Start method of processes on this system, with these libraries loaded."""
    begin_loading(names)
    return multiprocessing.get_context("forkserver" if _has_server() else None)


def make_ready() -> None:
    """Make a new process ready.

    Ctrl-C is for its parent, which then ends it. Where the parent dies itself, it ends as well. The libraries
    stay for good, so that the search for garbage can pass them by.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_leave_with_the_parent, daemon=True).start()
    tell_notices()
    keep_freed_memory()
    _FOR_GOOD.enter_context(one_blas_thread())
    gc.freeze()
    gc.set_threshold(*GARBAGE)


def _leave_with_the_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # the end of its pipe comes however it dies
        _leave()


def _leave(*_: object) -> None:
    """End at once, wherever the process is, without a half-written file; an exception could be swallowed."""
    discard_unfinished()
    os._exit(ENDED)

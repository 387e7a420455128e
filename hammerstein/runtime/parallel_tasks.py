"""Independent tasks in parallel through ``concurrent.futures``: threads, processes or a cluster.

Processes start with loaded libraries.
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from queue import Empty, SimpleQueue
from typing import Any, ParamSpec, TypeVar

from hammerstein.errors import LostProcessError, tell_notices
from hammerstein.files import discard_unfinished
from hammerstein.runtime.resources import keep_freed_memory, one_blas_thread, processors

P = ParamSpec("P")
T = TypeVar("T")

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


PATIENCE_S = 3.0
"""Time for a process to end before it is killed [s]."""
TRIES = 2
"""Number of tolerated losses of a process."""
WHY_LOST = "The system does this if the memory is full: use fewer parallel runs (--jobs 1), or smaller ones."


class _Crew(Executor):
    """Threads that take one task after the other; the end of the program does not wait for them.

    Crews have the interface of ``concurrent.futures``, whose threads hold up the end of the program after
    Ctrl-C, and whose processes give up all tasks when one of them dies, and cannot be ended before Python
    3.14.

    Parameters
    ----------
    workers : how many work at a time; each begins when there is a task for it
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._tasks: SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Hand over a function with its arguments."""
        future: Future[T] = Future()
        self._tasks.put((future, partial(fn, *args, **kwargs)))
        if len(self._threads) < self.workers:
            self._threads.append(threading.Thread(target=self._serve, daemon=True))
            self._threads[-1].start()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End when all tasks are done; cancelled tasks that have not started are dropped."""
        if cancel_futures:
            with contextlib.suppress(Empty):
                while (left := self._tasks.get_nowait()) is not None:
                    left[0].cancel()
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads if wait else ():
            thread.join()

    def _coming(self) -> Iterator[tuple[Future[Any], Callable[[], Any]]]:
        """Tasks that nobody has cancelled."""
        while (found := self._tasks.get()) is not None:
            if found[0].set_running_or_notify_cancel():
                yield found

    def _serve(self) -> None:
        """Do what comes in this thread."""
        for future, task in self._coming():
            try:
                future.set_result(task())
            except BaseException as error:
                future.set_exception(error)


class Threads(_Crew):
    """Threads of this process; after an exception, the block does not wait for running tasks."""

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.shutdown(wait=kind is None, cancel_futures=kind is not None)


class Processes(_Crew):
    """Worker processes.

    If a process dies, for example because memory is full, its task is tried once more; then its future holds
    a LostProcessError. After an exception, such as Ctrl-C, running processes are ended.

    Parameters
    ----------
    workers : largest number of processes; each starts when there is a task for it
    loads : modules that are loaded once for all of them
    """

    def __init__(self, workers: int, loads: Sequence[str] = LOADED_ONCE) -> None:
        super().__init__(workers)
        self._loads = loads
        self._busy: set[_Worker] = set()
        self._lock = threading.Lock()
        self._closed = False
        begin_loading(loads)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when their work is done, or at once if the rest is cancelled."""
        if cancel_futures:
            with self._lock:
                self._closed = True
                for worker in self._busy:
                    worker.process.terminate()
        super().shutdown(wait, cancel_futures=cancel_futures)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.shutdown(cancel_futures=kind is not None)

    def _serve(self) -> None:
        """Let one process do what comes, and another one when that dies."""
        worker: _Worker | None = None
        for future, task in self._coming():
            try:
                worker = self._done(future, task, worker)
            except BaseException as error:  # of whatever kind: who waits for the task must know it
                worker = None
                future.set_exception(error)
        if worker is not None:
            worker.end()

    def _done(self, future: Future[Any], task: Callable[[], Any], worker: _Worker | None) -> _Worker | None:
        """Do a task; give the process that has done it, if it lives."""
        how = "was ended"
        for _ in range(TRIES):
            try:
                worker = self._begun(worker)
            except (EOFError, OSError):  # what begins the processes was ended itself; it comes again
                how = "could not start"
                continue
            if worker is None:
                break
            try:
                done, result = worker.outcome_of(task)
            except EOFError:
                self._free(worker)
                how, worker = worker.end(), None
                continue
            except Exception as error:  # the task cannot be sent
                done, result = False, error
            self._free(worker)
            (future.set_result if done else future.set_exception)(result)
            return worker
        future.set_exception(LostProcessError(f"its process {how}, twice. {WHY_LOST}"))
        return None

    def _begun(self, worker: _Worker | None) -> _Worker | None:
        """Process for a task; none where all are to end."""
        with self._lock:
            if self._closed:
                return None
            found = _Worker(self._loads) if worker is None else worker
            self._busy.add(found)
            return found

    def _free(self, worker: _Worker) -> None:
        with self._lock:
            self._busy.discard(worker)


class ProcessesAndThis(Processes):
    """Processes and this one, which starts first: one of the workers is a thread here.

    Nobody waits for that thread where the block is left by an exception.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers, FOR_RUNS)
        self._here: threading.Thread | None = None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all when their work is done, or the processes at once if the rest is cancelled."""
        super().shutdown(False, cancel_futures=cancel_futures)
        for thread in self._threads if wait else ():
            if thread is not self._here or not cancel_futures:
                thread.join()

    def _serve(self) -> None:
        with self._lock:
            mine = self._here is None
            if mine:
                self._here = threading.current_thread()
        if mine:
            _Crew._serve(self)
        else:
            super()._serve()


class _Worker:
    """A process that does one task after another."""

    def __init__(self, loads: Sequence[str]) -> None:
        self.connection, theirs = context(loads).Pipe()
        self.process = context(loads).Process(target=_work, args=(theirs,), daemon=True)  # type: ignore[attr-defined]  # every context has it
        self.process.start()
        theirs.close()

    def outcome_of(self, task: Callable[[], Any]) -> tuple[bool, Any]:
        """Whether a task was done, and its result, or its error; EOFError if the process has died."""
        try:
            self.connection.send(task)
            done, result = self.connection.recv()
        except OSError:
            raise EOFError from None
        return done, result

    def end(self) -> str:
        """End the process, which has no task or has died; give how it ended, in words."""
        self.connection.close()
        self.process.join(PATIENCE_S)
        if self.process.is_alive():
            self.process.kill()
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"was ended by {signal_name(-code)}"
        return f"ended with code {code}"


def signal_name(number: int) -> str:
    """Name of a signal; its number if Python has no name for it."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _work(connection: Connection) -> None:
    """Do what comes through the connection until it is closed."""
    make_ready()
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        connection.send(_outcome_of(task))


def _outcome_of(task: Callable[[], Any]) -> tuple[bool, Any]:
    try:
        return True, task()
    except Exception as error:
        error.add_note(traceback.format_exc())
        return False, error


Jobs = int | Executor
"""Threads of this process, or an executor of ``concurrent.futures`` whose workers take the work."""
Task = Callable[[], T] | Future[T]
AHEAD = 4
"""Tasks per worker that are running or completed ahead."""


def completed(result: T) -> Future[T]:
    """Return a known result as a finished task."""
    future: Future[T] = Future()
    future.set_result(result)
    return future


def workers_of(jobs: Jobs) -> int:
    """Number of tasks that run at a time."""
    if isinstance(jobs, int):
        return jobs
    return getattr(jobs, "workers", None) or processors()


def on_workers(jobs: Jobs) -> str:
    """Place of the work, for progress; empty for this process."""
    return "" if isinstance(jobs, int) else f" on {workers_of(jobs)} workers"


def in_order(
    tasks: Iterable[Task[T]], jobs: Jobs, finished: Callable[[int, T], Any] | None = None
) -> Iterator[T]:
    """Results of independent tasks in their order; a limit on running tasks keeps the memory flat.

    Parameters
    ----------
    tasks : functions without arguments, importable for an executor of processes; or known results
    jobs : threads, or an executor
    finished : called with the number and the value of each result as soon as it is known

    Raises
    ------
    the error of the first task, in this order, that fails; no further task is started then
    """
    if jobs == 1:
        for number, task in enumerate(tasks):
            result = task.result() if isinstance(task, Future) else task()
            if finished is not None:
                finished(number, result)
            yield result
        return
    ready: dict[int, Future[T]] = {}
    wanted = 0
    with Threads(jobs) if isinstance(jobs, int) else nullcontext(jobs) as executor:
        for batch in spread(tasks, executor, lambda: AHEAD * workers_of(jobs)):
            for number, future in batch:
                if finished is not None and future.exception() is None:
                    finished(number, future.result())
            ready.update(batch)
            while wanted in ready:
                yield ready.pop(wanted).result()
                wanted += 1


def spread(
    tasks: Iterable[Task[T]], executor: Executor, ahead: Callable[[], int]
) -> Iterator[list[tuple[int, Future[T]]]]:
    """Return numbers and futures of tasks as they finish; if the caller stops early, the rest is cancelled.

    Parameters
    ----------
    tasks : submitted in this order
    executor : executor for the tasks
    ahead : returns how far the last submitted task may be ahead of the first unfinished one
    """
    coming, under_way = enumerate(tasks), dict[Future[T], int]()
    following = next(coming, None)
    try:
        while under_way or following:
            while following and following[0] < min(under_way.values(), default=following[0]) + ahead():
                number, task = following
                under_way[task if isinstance(task, Future) else executor.submit(task)] = number
                following = next(coming, None)
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            yield sorted((under_way.pop(future), future) for future in done)
    finally:
        for future in under_way:
            future.cancel()

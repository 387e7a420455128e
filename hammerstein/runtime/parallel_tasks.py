"""Independent tasks side by side through ``concurrent.futures``: threads, processes or a cluster alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager, nullcontext
from typing import Any, ParamSpec, TypeVar

from hammerstein.runtime.resources import processors
from hammerstein.runtime.workers import Threads

P = ParamSpec("P")
T = TypeVar("T")

Jobs = int | Executor
"""Threads of this process, or an executor of ``concurrent.futures`` whose workers take the work."""
Task = Callable[[], T] | Future[T]
AHEAD = 4
"""Tasks a worker that are begun, or done and not yet wanted."""


class _Here(Executor):
    """Does each task at once, where it is handed over."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def completed(result: T) -> Future[T]:
    """Return a known result as a finished task."""
    future: Future[T] = Future()
    future.set_result(result)
    return future


def workers_of(jobs: Jobs) -> int:
    """How many tasks are worked on at a time."""
    if isinstance(jobs, int):
        return jobs
    return getattr(jobs, "workers", None) or processors()


def on_workers(jobs: Jobs) -> str:
    """Where work is done, for a person who watches; empty where it is this process."""
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
    ready: dict[int, Future[T]] = {}
    wanted = 0
    with _executor(jobs) as executor:
        for batch in spread(tasks, executor, lambda: 1 if jobs == 1 else AHEAD * workers_of(jobs)):
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


def _executor(jobs: Jobs) -> AbstractContextManager[Executor]:
    """Return an executor that ends with this block, or the given one, which does not."""
    if isinstance(jobs, Executor):
        return nullcontext(jobs)
    return _Here() if jobs == 1 else Threads(jobs)

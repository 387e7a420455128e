"""Tasks in processes side by side, of which any may die."""

from __future__ import annotations

import contextlib
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from hammerstein.runtime.interrupts import deferred_interrupts
from hammerstein.runtime.processes import context, make_ready

T = TypeVar("T")

PATIENCE_S = 3.0
TRIES = 2


def side_by_side(
    tasks: Sequence[Callable[[], T]], processes: int, lost: Callable[[int, str], T]
) -> Iterator[T]:
    """Results of the tasks in the order in which they end; the first ones begin first.

    A task whose process dies, as the system ends one when the memory is full, is tried once more. Where the
    results are left early, as by Ctrl-C, what still runs is stopped.

    Parameters
    ----------
    tasks : functions that another process can import, with their arguments
    processes : how many work at a time
    lost : gives the result of a task whose process died every time, from its number and how it died
    """
    waiting, tried = deque(range(len(tasks))), [0] * len(tasks)
    workers: list[_Worker] = []
    try:
        while waiting or any(worker.number is not None for worker in workers):
            _employ(workers, waiting, tasks, tried, processes)
            for worker in _heard(workers):
                number = worker.number
                assert number is not None
                try:
                    result = worker.result()
                except EOFError:
                    workers.remove(worker)
                    if tried[number] < TRIES:
                        waiting.appendleft(number)
                    else:
                        yield lost(number, worker.end())
                    continue
                yield result
    finally:
        _dismiss(workers)


class _Worker:
    """A process that does one task after another."""

    def __init__(self) -> None:
        self.number: int | None = None
        self.connection, theirs = context().Pipe()
        self.process = context().Process(target=_work, args=(theirs,), daemon=True)  # type: ignore[attr-defined]  # every context has it
        self.process.start()
        theirs.close()

    def begin(self, number: int, task: Callable[[], Any]) -> None:
        """Hand over a task."""
        self.number = number
        with contextlib.suppress(OSError):  # it has died; that is heard from its connection
            self.connection.send(task)

    def result(self) -> Any:
        """Result of the task; its own error, or EOFError if the process has died."""
        try:
            done, result = self.connection.recv()
        except OSError:
            raise EOFError from None
        self.number = None
        if not done:
            raise result
        return result

    def end(self) -> str:
        """How the process ended, in words."""
        self.process.join(PATIENCE_S)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"was ended by {signal.Signals(-code).name}"
        return f"ended with code {code}"


def _employ(
    workers: list[_Worker],
    waiting: deque[int],
    tasks: Sequence[Callable[[], Any]],
    tried: list[int],
    processes: int,
) -> None:
    """Give every task that waits to a process, as long as there are any."""
    free = [worker for worker in workers if worker.number is None]
    while waiting and (free or len(workers) < processes):
        if not free:
            with deferred_interrupts():  # one in the middle would leave a process that nobody knows
                free.append(_Worker())
                workers.append(free[0])
        number = waiting.popleft()
        tried[number] += 1
        free.pop().begin(number, tasks[number])


def _heard(workers: Sequence[_Worker]) -> list[_Worker]:
    """Busy processes that have answered, or died."""
    busy = {worker.connection: worker for worker in workers if worker.number is not None}
    return [busy[connection] for connection in wait(list(busy))]  # type: ignore[index]  # what was given


def _dismiss(workers: Sequence[_Worker]) -> None:
    """End all processes: those without a task by themselves, the others by force."""
    for worker in workers:
        worker.connection.close()
        if worker.number is not None:
            worker.process.terminate()
    for worker in workers:
        worker.process.join(PATIENCE_S)
        if worker.process.is_alive():
            worker.process.kill()


def _work(connection: Connection) -> None:
    """Do what comes through the connection until it is closed."""
    make_ready()
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        connection.send(_answer(task))


def _answer(task: Callable[[], Any]) -> tuple[bool, Any]:
    try:
        return True, task()
    except Exception as error:
        error.add_note(traceback.format_exc())
        return False, error

"""Workers of an existing Dask scheduler, behind the interface of ``concurrent.futures``.

A scheduler has its workers execute whatever a client sends: it belongs into a network that is trusted, or
behind TLS.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import pickle
import socket
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, ParamSpec, TypeVar

from hammerstein.errors import InputError, LostProcessError, Notice
from hammerstein.runtime.provenance import computes_with, processor

P = ParamSpec("P")
T = TypeVar("T")

OPTION = "--cluster"
PATIENCE_S = 5.0
CLOSING_S = 1.0
LOOK_S = 2.0
"""Time between two looks at which workers are there."""
LARGE = "100 MB"
"""Size of a task from which on Dask says that it is large."""


class Cluster(Executor):
    """Workers that take one task after the other.

    A task whose worker dies is given to another one by the scheduler, up to so many times as it allows
    (``distributed.scheduler.allowed-failures``). Workers may come and go.

    Parameters
    ----------
    client : of the scheduler
    address : of the scheduler, for messages
    """

    def __init__(self, client: Any, address: str) -> None:
        self.address = address
        self.workers = 0
        self._client = client
        self._expected = computes_with()
        self._closed, self._gone = threading.Event(), threading.Event()
        self._open: set[Future[Any]] = set()
        self._guard = threading.Lock()
        self._await_workers()
        self.elsewhere = self._checked()
        threading.Thread(target=self._look, daemon=True).start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Hand over a function that a worker can import, with its arguments."""
        task = pickle.dumps(partial(fn, *args, **kwargs), protocol=pickle.HIGHEST_PROTOCOL)
        future: Future[T] = Future()
        with self._guard:
            if self._gone.is_set() or self._client.status != "running":
                raise self._lost()
            self._open.add(future)
        try:
            inner = self._client.submit(_done, self._expected, task, pure=False)
            self._client.loop.add_callback(self._hand_over, future, inner)
        except Exception as error:  # closed since we looked
            raise self._lost() from error
        future.add_done_callback(lambda outer: inner.cancel() if outer.cancelled() else None)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; it goes on without."""
        self._closed.set()
        with contextlib.suppress(Exception):  # it may be lost
            self._client.close(timeout=CLOSING_S)

    async def _hand_over(self, future: Future[T], inner: Any) -> None:
        """Tell what has become of a task.

        Dask's own executor asks for the state after the result, when it may be lost again.
        """
        try:
            result = await inner
        except BaseException as error:
            if self._taken(future):
                future.set_exception(self._told(error))
        else:
            if self._taken(future):
                future.set_result(result)

    def _told(self, error: BaseException) -> BaseException:
        """An error of Dask in our own words; others as they are."""
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        if isinstance(error, (CancelledError, asyncio.CancelledError, CommClosedError)):
            return self._lost()
        if isinstance(error, KilledWorker):
            return LostProcessError(
                f"{error.allowed_failures + 1} workers died with the same task. The system ends a process "
                "when the memory is full: give the workers more, or less at once"
            )
        return error

    def _taken(self, future: Future[Any]) -> bool:
        """Whether it is for the caller to say what has become of a task: only once, and not if cancelled."""
        with self._guard:
            known = future in self._open
            self._open.discard(future)
        return known and future.set_running_or_notify_cancel()

    def _give_up(self) -> None:
        """Tell every task that the scheduler is lost.

        One that is handed over while the connection breaks is not told by Dask, and would be waited for.
        """
        self._gone.set()
        with self._guard:
            left = list(self._open)
        for future in left:
            if self._taken(future):
                future.set_exception(self._lost())

    def _lost(self) -> LostProcessError:
        return LostProcessError(
            f"the scheduler at {self.address} is lost; what was finished is kept, and the same command goes "
            "on from there"
        )

    def _await_workers(self) -> None:
        self.workers = self._threads()
        if not self.workers:
            warnings.warn(f"{self.address}: no worker is there yet; waiting for one", Notice, stacklevel=4)
            self._client.wait_for_workers(1)
            self.workers = self._threads()

    def _threads(self) -> int:
        """Tasks that the workers take at a time."""
        return sum(self._client.nthreads().values())

    def _checked(self) -> str:
        """What computes beside this type of processor; empty if nothing does.

        Raises InputError where a worker has other versions.
        """
        found = self._client.run(_versions_there, on_error="return")
        unlike = {worker: text for worker, one in found.items() if (text := _unlike(self._expected, one))}
        if unlike:
            worker, text = next(iter(unlike.items()))
            more = f", and {len(unlike) - 1} more" if len(unlike) > 1 else ""
            raise InputError(
                OPTION,
                f"the numbers of a worker would not be those of this machine ({worker}{more}): {text}. "
                "Install the same on both",
            )
        others = sorted({one["processor"] for one in found.values()} - {processor()})
        if not others:
            return ""
        warnings.warn(
            f"{self.address}: the workers have another type of processor than this machine; the last digits "
            "may differ, and their results are kept apart",
            Notice,
            stacklevel=4,
        )
        return hashlib.sha256("\n".join(others).encode()).hexdigest()

    def _look(self) -> None:
        """Count the workers, and say when none is left: the run waits for others."""
        while not self._closed.wait(LOOK_S):
            before = self.workers
            try:
                self.workers = self._threads()
            except Exception:
                return self._give_up()
            if before and not self.workers:
                warnings.warn(f"{self.address}: no worker is left; waiting for others", Notice, stacklevel=1)


@contextmanager
def joined(address: str) -> Iterator[Cluster]:
    """Workers of the scheduler at an address, as long as the block lasts.

    Raises
    ------
    InputError : nothing can be reached there, or a worker has other versions
    """
    try:
        import dask
        from distributed import Client
    except ImportError:
        what = "needs dask.distributed: pip install 'hammerstein-control[cluster]'"
        raise InputError(OPTION, what) from None
    _refuse_unreachable(address)
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told by us
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": LARGE}):
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        try:
            cluster = Cluster(client, address)
        except BaseException:
            with contextlib.suppress(Exception):
                client.close(timeout=CLOSING_S)
            raise
        with cluster:
            yield cluster


def _refuse_unreachable(address: str) -> None:
    """Refuse what is no address, where nobody listens, and who is no scheduler; within seconds."""
    from distributed.comm import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, place = parse_address(address)
        get_backend(scheme)
        host, port = parse_host_port(place)
    except ValueError as error:
        what = f"{address!r} is no address of a scheduler ({error}); give one such as tcp://10.0.0.1:8786"
        raise InputError(OPTION, what) from None
    try:
        socket.create_connection((host, port), PATIENCE_S).close()
    except (OSError, UnicodeError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        what = f"{address}: nobody answers ({reason}); is the scheduler running, and is this its address?"
        raise InputError(OPTION, what) from None
    try:
        kind = asyncio.run(asyncio.wait_for(_identity(address), PATIENCE_S)).get("type")
    except Exception as error:
        kind = type(error).__name__
    if kind != "Scheduler":
        raise InputError(
            OPTION,
            f"{address}: answers, but not as a Dask scheduler does ({kind}). Its port is mostly 8786; with "
            "TLS the address begins with tls://, and Dask's configuration names the certificates",
        )


async def _identity(address: str) -> Mapping[str, Any]:
    from distributed.core import rpc
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=PATIENCE_S, connection_args=arguments) as scheduler:
        found: Mapping[str, Any] = await scheduler.identity()
        return found


def _unlike(expected: Mapping[str, str], found: Mapping[str, str] | Exception) -> str:
    """Versions that are not those expected, in words; empty if all are."""
    if isinstance(found, Exception):
        return f"hammerstein {expected['hammerstein']} here, not usable there ({found})"
    return ", ".join(
        f"{name} {here} here, {found.get(name, 'none')} there"
        for name, here in expected.items()
        if found.get(name) != here
    )


@cache
def _versions_there() -> dict[str, str]:
    """Make a worker ready, and give its versions: sums of one thread depend on nothing."""
    import numpy  # noqa: F401  # each brings a library of its own, and only what is loaded is limited
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, "blas")  # for good: other tasks run beside ours
    return {**computes_with(), "processor": processor()}


def _done(expected: Mapping[str, str], task: bytes) -> Any:
    """Do a task on a worker; one that has joined since the start may have other versions."""
    if unlike := _unlike(expected, _versions_there()):
        raise InputError(OPTION, f"the numbers of a worker that has joined would not be ours: {unlike}")
    return pickle.loads(task)()

"""Workers of an existing Dask scheduler, behind the interface of ``concurrent.futures``.

A scheduler has its workers execute whatever a client sends: it belongs into a network that is trusted, or
behind TLS.
"""

import asyncio
import contextlib
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
from hammerstein.files import digest_of
from hammerstein.runtime.store import computes_with, processor

P = ParamSpec("P")
T = TypeVar("T")

OPTION = "--cluster"
PATIENCE_S = 5.0  # for the first answer of a scheduler
CLOSING_S = 1.0  # for a scheduler that may be gone
LOOK_S = 2.0
"""Interval of checks for the scheduler and its workers [s]."""
LARGE = "100 MB"
"""Size of a task from which Dask warns."""


class Cluster(Executor):
    """Workers of a cluster, one task at a time each.

    If a worker dies, the scheduler gives its task to another one, at most
    ``distributed.scheduler.allowed-failures`` times. Workers may come and go.

    Dask's own executor (``Client.get_executor``) is not used: it asks for the state of a task after its
    result, which raises a TypeError if the worker is gone, and it loses a task that was sent while the
    connection broke.

    Parameters
    ----------
    client : of the scheduler
    address : of the scheduler, for messages
    """

    def __init__(self, client: Any, address: str) -> None:
        self.address, self._client, self._closed = address, client, threading.Event()
        self._expected = tuple(computes_with().items())
        self.workers = self._threads()
        if not self.workers:
            self._tell("no worker is connected yet; waiting for one")
            client.wait_for_workers(1)
            self.workers = self._threads()
        self.elsewhere = self._processors_elsewhere()
        threading.Thread(target=self._look, daemon=True).start()

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Submit an importable function with its arguments."""
        task = pickle.dumps(partial(fn, *args, **kwargs), protocol=pickle.HIGHEST_PROTOCOL)
        future: Future[T] = Future()
        if self._client.status != "running":
            raise self._lost()
        try:
            inner = self._client.submit(_done, self._expected, task, pure=False)
            self._client.loop.add_callback(self._hand_over, future, inner)
        except Exception as error:  # closed since we looked
            raise self._lost() from error
        future.add_done_callback(lambda outer: inner.cancel() if outer.cancelled() else None)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Disconnect from the cluster, which keeps running."""
        self._closed.set()
        with contextlib.suppress(Exception):  # it may be lost
            self._client.close(timeout=CLOSING_S)

    async def _hand_over(self, future: Future[T], inner: Any) -> None:
        """Tell what has become of a task."""
        error = result = None
        try:
            result = await self._result_of(inner)
        except BaseException as raised:
            error = self._told(raised)
        if future.set_running_or_notify_cancel():
            future.set_result(result) if error is None else future.set_exception(error)  # type: ignore[arg-type]

    async def _result_of(self, inner: Any) -> Any:
        waiting = asyncio.ensure_future(inner)
        while not waiting.done() and self._client.status == "running":
            await asyncio.wait([waiting], timeout=LOOK_S)
        if not waiting.done():
            raise self._lost()
        return waiting.result()

    def _told(self, error: BaseException) -> BaseException:
        """An error of Dask in our own words; others as they are."""
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        if isinstance(error, (CancelledError, asyncio.CancelledError, CommClosedError)):
            return self._lost()
        if isinstance(error, KilledWorker):
            return LostProcessError(
                f"{error.allowed_failures + 1} workers died with the same task. The system ends a "
                "process if the memory is full: use workers with more memory, or smaller runs"
            )
        return error

    def _lost(self) -> LostProcessError:
        return LostProcessError(
            f"the scheduler at {self.address} is lost; finished work is kept, and the same command continues"
        )

    def _tell(self, what: str) -> None:
        warnings.warn(f"{self.address}: {what}", Notice, stacklevel=4)

    def _threads(self) -> int:
        """Tasks that the workers take at a time."""
        return sum(self._client.nthreads().values())

    def _processors_elsewhere(self) -> str:
        """What computes beside this type of processor; empty if nothing does.

        Raises InputError where a worker has other versions.
        """
        try:
            found = self._client.run(_prepared, self._expected)
        except ImportError as error:
            what = f"a worker cannot use hammerstein ({error}); install the same version on both"
            raise InputError(OPTION, what) from None
        others = sorted({*found.values()} - {processor()})
        if others:
            self._tell(
                "the workers have another type of processor than this machine; the last digits may "
                "differ, and their results are cached separately"
            )
        return digest_of(others) if others else ""

    def _look(self) -> None:
        """Count the workers, and report when there is none: the run then waits for others."""
        while not self._closed.wait(LOOK_S):
            before = self.workers
            try:
                self.workers = self._threads()
            except Exception:  # the scheduler is lost: who waits for a task is told
                return
            if before and not self.workers:
                self._tell("no worker is left; waiting for others")


@contextmanager
def joined(address: str) -> Iterator[Cluster]:
    """Workers of the scheduler at an address, within the block.

    Raises
    ------
    InputError : no scheduler answers there within seconds, or a worker has other versions
    """
    try:
        import dask
        from distributed import Client
    except ImportError:
        what = "needs dask.distributed: pip install 'hammerstein-control[cluster]'"
        raise InputError(OPTION, what) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told by us
    _refuse_unreachable(address)
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": LARGE}):
        client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        with contextlib.ExitStack() as failed:
            failed.callback(client.close, timeout=CLOSING_S)
            cluster = Cluster(client, address)
            failed.pop_all()
        with cluster:
            yield cluster


def _refuse_unreachable(address: str) -> None:
    """Raise an error if no scheduler answers in time; a client would wait forever for a silent port."""
    try:
        kind = asyncio.run(asyncio.wait_for(_identity(address), 2.0 * PATIENCE_S)).get("type")
        reason = "" if kind == "Scheduler" else f"it is a {kind}"
    except Exception as error:
        reason = str(error) or "it does not answer"
    if reason:
        raise InputError(
            OPTION,
            f"{address}: no Dask scheduler answers ({reason}). Is it running, and is this its "
            "address, such as tcp://10.0.0.1:8786? With TLS it begins with tls://, and Dask's "
            "configuration names the certificates",
        )


async def _identity(address: str) -> Mapping[str, Any]:
    from distributed.core import rpc
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    async with rpc(address, timeout=PATIENCE_S, connection_args=arguments) as scheduler:
        found: Mapping[str, Any] = await scheduler.identity()
        return found


@cache
def _prepared(expected: tuple[tuple[str, str], ...]) -> str:
    """Make a worker ready, whose sums then depend on no number of threads; give its type of processor.

    Raises InputError where its versions are not those that are expected.
    """
    found = computes_with()
    unlike = [
        f"{name} {here} here, {found.get(name)} there" for name, here in expected if found.get(name) != here
    ]
    if unlike:
        raise InputError(
            OPTION,
            "the results of a worker would differ from those of this machine "
            f"({socket.gethostname()}): {', '.join(unlike)}. Install the same versions on both",
        )
    import numpy  # noqa: F401  # each brings a library of its own, and only what is loaded is limited
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, "blas")  # for good: other tasks run beside ours
    return processor()


def _done(expected: tuple[tuple[str, str], ...], task: bytes) -> Any:
    """Do a task on a worker, which may have joined since the start."""
    _prepared(expected)
    return pickle.loads(task)()

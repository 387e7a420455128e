"""Time loops as machine code, kept on the disk: what was spoilt there is noticed and made anew.

Of several processes that need a loop, one compiles it; the others wait and find it.
"""

from __future__ import annotations

import gc
import hashlib
import inspect
import io
import os
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any

import numba
from numba.core import caching
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import register_jitable

from hammerstein.errors import Notice

types: Any = numba.types  # numba has no types
FunctionCache: Any = caching.FunctionCache
NullCache: Any = caching.NullCache
IndexDataCacheFile: Any = caching.IndexDataCacheFile

Loop = Callable[..., Any]

SPAN, LEAST = 2**25, 2**5
"""Multiplications of one call, a tenth of a second, and the least that a sample counts for."""

LEAN: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Nothing is made for C to call."""
CHECKED = ".checked"
"""In the names of the files, which are not those of numba alone."""
MARK = b"hammerstein sha256"
"""Stands at the end of each file, before the digest of what is above it."""
LONGEST_WAIT_S, PAUSE_S = 60.0, 0.02
"""For another process that compiles the same loop; none takes that long, unless it was halted."""


def compiled(reads: str = "", **options: Any) -> Callable[[Loop], Loop]:
    """Compile a loop when it is first used; other threads run meanwhile.

    Parameters
    ----------
    reads : names of arrays that may be frozen or not: the loop is compiled once, as one that cannot write
        to them. Of an array that is not named here, numba makes one loop for each.
    options : what ``numba.njit`` is told besides
    """

    def decorate(loop: Loop) -> Loop:
        dispatcher = numba.njit(nogil=True, **LEAN, **options)(loop)
        places = list(inspect.signature(loop).parameters)
        dispatcher.compile = _OnceFor(dispatcher, [places.index(name) for name in reads.split()])
        try:
            dispatcher._cache = _Cache(loop)
        except RuntimeError:  # as numba says that no folder can be written
            dispatcher._cache = _NoCache()
        return dispatcher  # type: ignore[no-any-return]  # numba has no types

    return decorate


def helper(**options: Any) -> Callable[[Loop], Loop]:
    """Let compiled loops call a function; in Python it stays what it is.

    What makes a compiled loop callable from Python costs the compiler as much as many a helper itself.

    options : what ``numba.njit`` is told besides
    """
    return register_jitable(**LEAN, **options)


@contextmanager
def uncollected() -> Iterator[None]:
    """Search for no garbage: where many small objects are made that stay, it takes a tenth of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _OnceFor:
    """Compiles a loop for types of its arguments, or finds what is compiled for others that stand for them.

    A number that its caller knows is a number, and an array that is only read is one that cannot be written.
    """

    def __init__(self, dispatcher: Any, reads: Sequence[int]) -> None:
        self.dispatcher, self.reads = dispatcher, reads
        self.compile = dispatcher.compile
        # What numba is told twice it finds ambiguous, and asks again at every call.
        self.known: set[tuple[Any, ...]] = set()

    def __call__(self, given: Sequence[Any]) -> Any:
        """Give the compiled loop for these types."""
        plain = [types.unliteral(one) for one in given]
        for i in self.reads:
            if isinstance(plain[i], types.Array):
                plain[i] = plain[i].copy(readonly=True)
        # Before the lock of the loop that of all threads: a loop that calls others compiles them as well.
        with global_compiler_lock, uncollected(), self.dispatcher._cache.by_one_process():
            entry = self.compile(tuple(plain))
        if plain != list(given) and tuple(given) not in self.known:
            self.known.add(tuple(given))
            self.dispatcher._insert([one._code for one in given], entry, False)
        return entry


def spans(samples: int, products: int = LEAST) -> Iterator[tuple[int, int]]:
    """First sample and end of each part of a signal that a loop works through in one call.

    Between two calls Python answers Ctrl-C, which it cannot while a loop runs. A loop that carries its state
    on gives the same numbers to the last bit, however its signal is cut.

    Parameters
    ----------
    samples : length of the signal
    products : multiplications that a sample takes, about

    Examples
    --------
    >>> list(spans(3_000_000))
    [(0, 1048576), (1048576, 2097152), (2097152, 3000000)]
    """
    length = max(1, SPAN // max(products, LEAST))
    for first in range(0, samples, length):
        yield first, min(first + length, samples)


class _NoCache(NullCache):  # type: ignore[misc]
    """Tells once, when there is something to keep, that nothing can be kept."""

    def by_one_process(self) -> AbstractContextManager[None]:
        """Each process compiles for itself."""
        return nullcontext()

    def save_overload(self, *_: object) -> None:
        _tell_once("compiled loops cannot be kept: set NUMBA_CACHE_DIR to a folder that can be written")


class _Cache(FunctionCache):  # type: ignore[misc]
    def __init__(self, loop: Callable[..., Any]) -> None:
        super().__init__(loop)
        plain: Any = vars(self)["_cache_file"]
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path,
            filename_base=f"{self._impl.filename_base}{CHECKED}",
            source_stamp=plain._source_stamp,
        )
        self._held = False

    @contextmanager
    def by_one_process(self) -> Iterator[None]:
        """Keep the processes apart that would compile this loop at the same time, where the system can."""
        if self._held:  # a loop that calls itself
            yield
            return
        handle = _locked(os.path.join(self._cache_path, f"{self._impl.filename_base}.lock"))
        self._held = True
        try:
            yield
        finally:
            self._held = False
            if handle is not None:
                os.close(handle)


def _locked(path: str) -> int | None:
    """Handle of a file that no other process has locked; None where that cannot be."""
    try:
        import fcntl

        os.makedirs(os.path.dirname(path), exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    except (ImportError, OSError):
        return None
    until = time.monotonic() + LONGEST_WAIT_S
    while time.monotonic() < until:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(PAUSE_S)
        except OSError:
            break
        else:
            return handle
    os.close(handle)
    return None


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc]
    """Files of one loop, each with a digest: machine code of which a byte has changed may do anything."""

    def save(self, key: Any, data: Any) -> None:
        """Keep a compiled loop, where that is possible."""
        try:
            super().save(key, data)
        except (OSError, _SpoiltError) as error:
            why = error.strerror if isinstance(error, OSError) else f"{error} cannot be replaced"
            _tell_once(f"compiled loops cannot be kept in {self._cache_path} ({why})")

    def load(self, key: Any) -> Any:
        """Give a compiled loop that was kept; None if there is none, or if it was spoilt."""
        found = None
        try:
            found = super().load(key)
        except _SpoiltError as error:
            _tell_once(f"compiled loops in {os.path.dirname(str(error))} were spoilt and are compiled again")
        while found is None and _waiting:
            _waiting.pop()()
        return found

    def _load_index(self) -> Any:
        try:
            file = io.BytesIO(_checked(self._index_path))
            if pickle.load(file) != self._version:
                return {}
            stamp, overloads = pickle.load(file)
        except FileNotFoundError:
            return {}
        except _SpoiltError:
            with suppress(OSError):
                os.unlink(self._index_path)
            raise
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        return pickle.loads(_checked(self._data_path(name)))

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        data = content.getvalue()
        with super()._open_for_write(filepath) as file:
            file.write(data + MARK + hashlib.sha256(data).digest())


class _SpoiltError(Exception):
    """A file that does not hold what was written."""


def _checked(path: str) -> bytes:
    """Bytes of a file, if they are those that were written."""
    if not os.path.isfile(path) and os.path.exists(path):
        raise _SpoiltError(path)
    with open(path, "rb") as file:
        content = file.read()
    data, mark, digest = content.rpartition(MARK)
    if not mark or hashlib.sha256(data).digest() != digest:
        raise _SpoiltError(path)
    return data


_told: set[str] = set()
_waiting: list[Callable[[], None]] = []


def told_before_compiling(say: Callable[[], None] | None) -> None:
    """Let a function be called before the next loop is compiled, once, or none: a person has to wait."""
    _waiting[:] = [] if say is None else [say]


def _tell_once(text: str) -> None:
    if text not in _told:
        _told.add(text)
        warnings.warn(text, Notice, stacklevel=2)

"""Time loops as machine code, kept on the disk for as long as no source of any loop changes.

Numba notices a changed file, but not a changed function that a loop takes from another file. The folder of
the kept loops is therefore named by all of those sources.
"""

import gc
import hashlib
import multiprocessing
import os
import shutil
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import filelock
import numba
import numpy as np
from numba.core import event as numba_events
from numba.core.errors import NumbaError
from numba.extending import register_jitable

from hammerstein.errors import Notice

config: Any = numba.config  # numba has no types
event: Any = numba_events

Loop = Callable[..., Any]

at = np.uint64
"""An index of unsigned type is not tested for Python's counting from the end; none of a loop is negative."""

LEAN: dict[str, Any] = {"no_cfunc_wrapper": True}
"""Nothing is made for C to call."""
PACKAGE = Path(__file__).parent
LOCK_TIMEOUT_S = 60.0
"""For another process that compiles the same loop; none takes that long, unless it was halted."""
UNUSED_S = 30 * 86400.0
"""Loops of other sources go after a month."""


def compiled(**options: Any) -> Callable[[Loop], Loop]:
    """Compile a loop when it is first used, and keep it; other threads run meanwhile.

    options : passed to ``numba.njit``
    """

    def decorate(loop: Loop) -> Loop:
        folder = _folder()
        as_options = {"nogil": True, **LEAN, **options}
        try:
            with _kept_in(folder):
                dispatcher = numba.njit(cache=folder is not None, **as_options)(loop)
        except RuntimeError:  # a folder within it belongs to somebody else
            folder, dispatcher = None, numba.njit(**as_options)(loop)
        name = f"{loop.__module__}.{loop.__qualname__}"
        dispatcher.compile = partial(_compile, dispatcher.compile, folder, name)
        return dispatcher  # type: ignore[no-any-return]  # numba has no types

    return decorate


def helper(**options: Any) -> Callable[[Loop], Loop]:
    """Let compiled loops call a function; in Python it stays what it is.

    What makes a compiled loop callable from Python costs the compiler as much as many a helper itself.

    options : passed to ``numba.njit``
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


def _compile(compile_it: Callable[[Any], Any], folder: Path | None, name: str, given: Any) -> Any:
    """Compile a loop for these types, or load it; of several processes that need it one compiles.

    Two that keep a loop for different types at once could otherwise take one for the other. A number that
    stands in the call, such as 0, is of its type: it is no reason to compile the loop once more.
    """
    given = tuple(map(numba.types.unliteral, given))
    if folder is None:
        _warn_once("compiled loops are not cached: set NUMBA_CACHE_DIR to a writable folder")
    with _alone(folder, name), uncollected():
        try:
            return compile_it(given)
        except NumbaError:
            raise
        except Exception as error:  # a full disk; a damaged file raises nearly anything
            if folder is None:
                raise
            reason = error
        with suppress(Exception):
            found = compile_it(given)  # compiled, and not kept
            _warn_once(f"compiled loops are not cached in {folder} ({reason})")
            return found
        shutil.rmtree(folder, ignore_errors=True)
        return compile_it(given)


_compiling = threading.RLock()
_keeping = threading.RLock()
"""Held while numba reads the folder, which another thread would put back meanwhile."""


@contextmanager
def _alone(folder: Path | None, name: str) -> Iterator[None]:
    """Hold the lock of a loop, where the system has one and nobody holds it for too long.

    One thread at a time asks for such locks, of which a compiling one may need several, and with a time
    limit: a loop of a user's own that calls these holds the compiler before.
    """
    with ExitStack() as held:
        if _compiling.acquire(timeout=LOCK_TIMEOUT_S):
            held.callback(_compiling.release)
        if folder is not None:
            lock = filelock.FileLock(folder / f"{name}.lock", timeout=LOCK_TIMEOUT_S, is_singleton=True)
            with suppress(OSError, NotImplementedError):  # Timeout is an OSError
                folder.mkdir(parents=True, exist_ok=True)
                held.enter_context(lock)
        yield


@contextmanager
def _kept_in(folder: Path | None) -> Iterator[None]:
    """Let numba keep what is decorated meanwhile in a folder; loops of others stay where they are."""
    with _keeping:
        before = config.CACHE_DIR
        config.CACHE_DIR = "" if folder is None else str(folder)
        try:
            yield
        finally:
            config.CACHE_DIR = before


@cache
def _folder() -> Path | None:
    """Folder for the loops of these sources; None where no folder can be written."""
    for place in _places():
        folder = place / f"loops-{_digest()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            probe = folder / f"{os.getpid()}.probe"
            probe.touch()
            probe.unlink()
        except OSError:
            continue
        os.utime(folder)
        for other in place.glob("loops-*"):
            with suppress(OSError):
                if time.time() - other.stat().st_mtime > UNUSED_S:
                    shutil.rmtree(other)
        return folder
    return None


def _places() -> Iterator[Path]:
    """Where loops may be kept: as the user says, beside the sources, or in the user's cache."""
    if config.CACHE_DIR:
        yield Path(config.CACHE_DIR)
        return
    yield PACKAGE / "__pycache__"
    with suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hammerstein"


def _digest() -> str:
    """Digest of every source that loops are compiled from: what is named ``kernel``, and this file."""
    files = [Path(__file__), *sorted(PACKAGE.rglob("*kernel*.py"))]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


class _Watch(numba_events.TimingListener):
    """Says once what is compiled and how long that took the last time; keeps how long it takes.

    Processes that work for another one are silent.
    """

    said = False

    def on_start(self, begun: Any) -> None:
        """Begin to compile a loop, or one that it calls."""
        if not self.said and multiprocessing.parent_process() is None:
            before = _last_time()
            known = f"last time this took {before:.0f} s" if before else "needed once after installation"
            loop = begun.data["dispatcher"].py_func.__name__
            _warn_once(f"compiling {loop} and other loops to machine code; {known}")
        self.said = True
        super().on_start(begun)  # type: ignore[no-untyped-call]  # numba has no types

    def on_end(self, ended: Any) -> None:
        """End it."""
        super().on_end(ended)  # type: ignore[no-untyped-call]
        with suppress(OSError):
            if self.done and (place := _note()) is not None:
                place.write_text(f"{self.duration:.1f}\n", encoding="utf-8")


event.register("numba:compile", _Watch())  # type: ignore[no-untyped-call]


def _note() -> Path | None:
    """File with how long compiling took, beside the folders of loops."""
    folder = _folder()
    return None if folder is None else folder.parent / "compiled_s.txt"


def _last_time() -> float | None:
    with suppress(OSError, ValueError):
        if (place := _note()) is not None:
            return float(place.read_text(encoding="utf-8"))
    return None


_told: set[str] = set()


def _warn_once(text: str) -> None:
    if text not in _told:
        _told.add(text)
        with suppress(Notice):  # where warnings are errors, the loop is compiled all the same
            warnings.warn(text, Notice, stacklevel=2)

"""Results of a run kept on the disk under a key of their contents, so that nothing is done twice.

An entry is plain JSON and raw arrays with a checksum: nothing in it can execute. It belongs to the user
alone, several runs may share the folder, and what was used longest ago goes when it grows too large.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
import struct
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError, Notice
from hammerstein.files import UNFINISHED, reason_of, write_atomic
from hammerstein.runtime.cache import folder_of_runs
from hammerstein.runtime.provenance import computed_by

LARGEST_MB = 2000
"""Of all entries together, if ``HAMMERSTEIN_CACHE_MB`` does not say otherwise; with 0 nothing is kept."""
LIMIT = "HAMMERSTEIN_CACHE_MB"
MOST_MB = 1e9
MEGABYTE = 1_000_000
LEFT = 0.8
"""Part of that which is left then."""
SHARE = 0.25
"""Part of it that one entry may have."""
FORSAKEN_S = 3600.0
"""Age of a half-written file whose process must be dead."""
MAGIC = b"hammerstein kept 1\n"
DTYPES = ("<f8", "<i8", "|b1", "|u1")
_LENGTHS = struct.Struct("<Q")


@dataclass(frozen=True, eq=False)
class Kept:
    """One entry: a JSON document and arrays of plain numbers by name."""

    document: Any
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


class Store:
    """Entries in a folder.

    folder : where they lie
    fresh : whether what was there before this store was opened is passed by
    elsewhere : what else computes, where it is not this machine alone
    problem : why nothing more is kept; empty as long as there is no reason
    """

    def __init__(
        self,
        folder: Path,
        fresh: bool = False,
        limit_bytes: float = LARGEST_MB * MEGABYTE,
        elsewhere: str = "",
    ) -> None:
        self.folder, self.fresh, self.limit_bytes, self.elsewhere = folder, fresh, limit_bytes, elsewhere
        self.problem = ""
        self._written: set[str] = set()
        self._unseen = limit_bytes  # bytes written since the folder was last measured: it never was

    def read(self, key: str) -> Kept | None:
        """Entry of a key; None if there is none, or none that is whole."""
        if self.fresh and key not in self._written:
            return None
        path = self._path(key)
        try:
            data = _read(path)
            entry = None if data is None else _parsed(data, key)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            text = f"{path}: what was kept was spoilt and is worked out again"
            warnings.warn(text, Notice, stacklevel=2)
            return None
        if entry is not None:
            with contextlib.suppress(OSError):
                os.utime(path)  # the least recently used goes first
        return entry

    def write(self, key: str, entry: Kept) -> None:
        """Keep an entry; where that cannot be done, it is left, and ``problem`` says why."""
        if self.problem:
            return
        data = _bytes(entry, key)
        if len(data) > SHARE * self.limit_bytes:
            return
        path = self._path(key)
        try:
            path.parent.mkdir(mode=0o700, exist_ok=True)
            write_atomic(path, data, private=True)
        except (InputError, OSError) as error:
            what = (
                reason_of(error) if isinstance(error, OSError) else error.mistakes[0].what.partition(";")[0]
            )
            self.problem = f"{self.folder}: results are not kept ({what}); the run goes on without"
            return
        self._written.add(key)
        self._unseen += len(data)
        if self._unseen > 0.1 * self.limit_bytes:
            self._unseen = 0
            self._shrink()

    def computed(self, elsewhere: str) -> Store:
        """Give the same store for what is worked out by other processors; nothing is taken for ours."""
        return Store(self.folder, self.fresh, self.limit_bytes, elsewhere) if elsewhere else self

    def _path(self, key: str) -> Path:
        if self.elsewhere:
            key = hashlib.sha256(f"{key} {self.elsewhere}".encode()).hexdigest()
        return self.folder / key[:2] / key[2:]

    def _shrink(self) -> None:
        """Remove what was used longest ago until there is room, and what dead processes have left."""
        found = []
        for path in self.folder.glob("??/*"):
            with contextlib.suppress(OSError):
                status = path.lstat()
                if not path.name.endswith(UNFINISHED):
                    found.append((status.st_mtime, status.st_size, path))
                elif time.time() - status.st_mtime > FORSAKEN_S:
                    path.unlink()
        total = sum(size for _, size, _ in found)
        if total <= self.limit_bytes:
            return
        for _, size, path in sorted(found):
            if total <= LEFT * self.limit_bytes:
                break
            with contextlib.suppress(OSError):
                path.unlink()
                total -= size


def key_of(kind: str, content: Any) -> str:
    """Key of what is worked out from plain JSON by these sources, libraries and processor.

    Parameters
    ----------
    kind : what is worked out
    content : everything that the result depends on beside them
    """
    return digest_of([kind, computed_by(), content])


def digest_of(content: Any) -> str:
    """Digest of plain JSON, in which the order of keys says nothing."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def opened(fresh: bool = False) -> tuple[Store | None, str]:
    """Give the store of this user, and why it is of no use; both are nothing where it was switched off.

    Parameters
    ----------
    fresh : whether what is there is passed by

    Raises InputError where ``HAMMERSTEIN_CACHE_MB`` is no size.
    """
    folder, limit_bytes = folder_of_runs(), _limit_bytes()
    if limit_bytes == 0.0:
        return None, ""
    if folder is None:
        switched_off = os.environ.get("HAMMERSTEIN_CACHE") == ""
        why = "" if switched_off else "no home folder: results are not kept; HAMMERSTEIN_CACHE names a place"
        return None, why
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = os.lstat(folder)
    except OSError as error:
        return None, _useless(folder, error)
    if not stat.S_ISDIR(status.st_mode) or not _is_private(status):
        return (
            None,
            f"{folder}: results are not kept, as others may write there; make it yours (chmod 700)",
        )
    return Store(folder.absolute(), fresh, limit_bytes), ""


def _limit_bytes() -> float:
    """How much may be kept in all."""
    text = os.environ.get(LIMIT) or str(LARGEST_MB)
    try:
        size = float(text)
    except ValueError:
        size = -1.0
    if not 0.0 <= size <= MOST_MB:
        raise InputError(LIMIT, f"{text!r} is no number of megabytes from 0 to {MOST_MB:g}")
    return size * MEGABYTE


def _useless(folder: Path, error: OSError | InputError) -> str:
    """Say that nothing can be kept, and why."""
    what = reason_of(error) if isinstance(error, OSError) else error.mistakes[0].what.partition(";")[0]
    return f"{folder}: results are not kept ({what}); the run goes on without"


def _is_private(status: os.stat_result) -> bool:
    """Whether a folder is this user's and nobody else may write there; not known on every system."""
    if not hasattr(os, "getuid"):
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _read(path: Path) -> bytes | None:
    """Bytes of an ordinary file; None if there is none."""
    flags = (
        os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    )
    try:
        handle = os.open(path, flags)
    except FileNotFoundError:
        return None
    with os.fdopen(handle, "rb") as file:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise ValueError("no ordinary file")
        return file.read()


def _bytes(entry: Kept, key: str) -> bytes:
    """An entry as bytes: mark, checksum, length of the head, head, arrays one after the other."""
    arrays = {name: _plain(array) for name, array in entry.arrays.items()}
    listed = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    head = json.dumps({"document": entry.document, "arrays": listed}).encode()
    raw: list[Any] = [array.reshape(-1).view(np.uint8).data for array in arrays.values()]
    body = [_LENGTHS.pack(len(head)), head, *raw]
    return b"".join([MAGIC, _checksum(key, *body), *body])  # one copy of the arrays, which may be large


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    plain = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    if plain.dtype.str not in DTYPES:
        raise TypeError(f"arrays of {array.dtype} are not kept")
    return plain


def _parsed(data: bytes, key: str) -> Kept:
    """Entry of these bytes; ValueError where they are not what was written under this key."""
    start = len(MAGIC) + hashlib.sha256().digest_size
    body = memoryview(data)[start:]
    if not data.startswith(MAGIC) or data[len(MAGIC) : start] != _checksum(key, body):
        raise ValueError("checksum")
    end = _LENGTHS.size + _LENGTHS.unpack_from(body)[0]
    head = json.loads(bytes(body[_LENGTHS.size : end]))
    arrays = {}
    for name, dtype, shape in head["arrays"]:
        if dtype not in DTYPES:
            raise ValueError("dtype")
        count = int(np.prod(shape, dtype=np.int64))
        arrays[name] = np.frombuffer(body, dtype, count, end).reshape(shape)
        end += arrays[name].nbytes
    return Kept(head["document"], arrays)


def _checksum(key: str, *body: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(key.encode())
    for part in body:
        digest.update(part)
    return digest.digest()

"""Store of results on disk, under a key of their inputs and provenance, to avoid repeated computation.

An entry is an .npz file of plain numbers with checksums; nothing in it can be executed. Only the user can
read it, and several runs may share the folder. When the folder grows too large, the least recently used
entries are removed.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import platform
import stat
import sys
import time
import uuid
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError, Notice
from hammerstein.files import UNFINISHED, digest_of, reason_of, write_atomic
from hammerstein.plugins import GROUP, kinds_of_others
from hammerstein.runtime.faults import version_of
from hammerstein.runtime.resources import folder_of_runs

PACKAGE = Path(__file__).parents[1]
LIBRARIES = (
    *("bokeh", "control", "jinja2", "markdown-it-py", "markupsafe", "matplotlib", "numba", "numpy", "pandas"),
    *("pillow", "pydantic", "scipy"),
)
NUMERICAL = ("numpy", "scipy", "numba", "control", "pydantic")
SOURCES = ("*.py", "*.json", "*.jinja", "*.css", "*.js")
SHIPPED = "shipped"
"""Folders of an installed package that are elsewhere in a checkout; results do not depend on them."""


def computed_by() -> str:
    """Hash of the package's sources, of the libraries' versions, of Python and of the type of processor.

    If all of these are equal, equal input gives equal bits, and a result may be reused.

    Where another package plugs in, every installed version counts, and the sources of that package; of kinds
    that this process has registered, the sources of their modules.
    """
    counted = {entry.module.partition(".")[0] for entry in _entries()}
    return _computed_by(tuple(k for k in kinds_of_others() if k.__module__.partition(".")[0] not in counted))


@lru_cache(maxsize=8)
def _computed_by(kinds: tuple[type, ...]) -> str:
    words = [sys.version, sys.platform, processor(), sources()]
    words += [f"{name} {version_of(name)}" for name in LIBRARIES]
    words += [f"{kind.__module__} {kind.__qualname__} {_source_of(kind)}" for kind in kinds]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _source_of(kind: type) -> str:
    """Hash of the source files that a kind comes with; where it has none, what no other process has."""
    module, top = sys.modules.get(kind.__module__), sys.modules.get(kind.__module__.partition(".")[0])
    place = getattr(module, "__file__", None)
    if place is None or not Path(place).is_file():
        return uuid.uuid4().hex
    folders = getattr(top, "__path__", ())
    files = {Path(place), *(file for folder in folders for file in Path(folder).rglob("*.py"))}
    return hashlib.sha256(b"".join(file.read_bytes() for file in sorted(files))).hexdigest()


def computes_with() -> dict[str, str]:
    """Versions, by name, that must be equal on two machines for equal numbers."""
    versions = {name: version_of(name) for name in NUMERICAL}
    own = {"hammerstein": version_of("hammerstein-control"), "sources of hammerstein": sources()[:12]}
    return {"python": platform.python_version(), **versions, **own}


@cache
def sources() -> str:
    """Hash of the sources of the package and its plug-ins."""
    digest = hashlib.sha256("\n".join(_plugged_in()).encode())
    files = [path for kind in SOURCES for path in PACKAGE.rglob(kind)]
    for path in sorted(path for path in files if SHIPPED not in path.relative_to(PACKAGE).parts):
        digest.update(f"\n{path.relative_to(PACKAGE)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def processor() -> str:
    """Type of the processor: compiled loops and linear algebra choose their instructions by it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    kept = {
        line.partition(":")[0].strip(): line for line in lines if line.startswith(("model name", "flags"))
    }
    return " ".join([platform.machine(), *kept.values()])


@cache
def _entries() -> tuple[metadata.EntryPoint, ...]:
    """What other packages plug in."""
    found = metadata.entry_points(group=GROUP)
    return tuple(entry for entry in found if not entry.value.startswith("hammerstein."))


def _plugged_in() -> Iterable[str]:
    """Installed versions, and sources of what plugs in; nothing where nothing does."""
    entries = _entries()
    if not entries:
        return
    yield from sorted(f"{found.name} {found.version}" for found in metadata.distributions())
    for top in sorted({entry.module.partition(".")[0] for entry in entries}):
        spec = find_spec(top)
        origin = Path(spec.origin) if spec is not None and spec.origin else None
        if origin is not None:
            files = origin.parent.rglob("*.py") if spec and spec.submodule_search_locations else [origin]
            yield from (f"{file} {hashlib.sha256(file.read_bytes()).hexdigest()}" for file in sorted(files))


LARGEST_MB = 2000
"""Default size of all entries; ``HAMMERSTEIN_CACHE_MB`` overrides it, and 0 disables the store."""
LIMIT = "HAMMERSTEIN_CACHE_MB"
MOST_MB = 1e9  # a petabyte: more is a slip
MEGABYTE = 1_000_000  # bytes
LEFT = 0.8
"""Part of the size that remains after a clean-up."""
SHARE = 0.25
"""Largest part of it for one entry."""
FORSAKEN_S = 3600.0
"""Age of a half-written file from which its process must have ended [s]."""
HEAD = "key and document"
"""Name of the array that holds these as JSON."""


@dataclass(frozen=True, eq=False)
class Kept:
    """One entry: a JSON document and arrays of plain numbers by name."""

    document: Any
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(eq=False)
class Store:
    """Entries in a folder.

    folder : folder of the entries
    fresh : whether older entries are ignored
    elsewhere : other machines that compute, if any
    problem : why no more entries are written; empty if there is no problem
    """

    folder: Path
    fresh: bool = False
    limit_bytes: float = LARGEST_MB * MEGABYTE
    elsewhere: str = ""
    problem: str = field(default="", init=False)

    def __post_init__(self) -> None:
        self._written: set[str] = set()
        self._unseen = self.limit_bytes  # bytes written since the folder was last measured: it never was

    def read(self, key: str) -> Kept | None:
        """Entry of a key; None if it is missing or damaged."""
        if self.fresh and key not in self._written:
            return None
        path = self._path(key)
        try:
            entry = _loaded(path, key)
        except FileNotFoundError:
            return None
        except Exception:  # a damaged file raises nearly anything
            warnings.warn(f"{path}: this cache entry was damaged and is computed again", Notice, stacklevel=2)
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # the least recently used goes first
        return entry

    def write(self, key: str, entry: Kept) -> None:
        """Write an entry; if that fails, ``problem`` says why."""
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
            self.problem = _useless(self.folder, error)
            return
        self._written.add(key)
        self._unseen += len(data)
        if self._unseen > 0.1 * self.limit_bytes:
            self._unseen = 0
            self._shrink()

    def computed(self, elsewhere: str) -> Store:
        """Return the same store for results of other processors; keys differ from those of this one."""
        return Store(self.folder, self.fresh, self.limit_bytes, elsewhere) if elsewhere else self

    def _path(self, key: str) -> Path:
        if self.elsewhere:
            key = digest_of([key, self.elsewhere])
        return self.folder / key[:2] / key[2:]

    def _shrink(self) -> None:
        """Remove the least recently used entries until there is room, and leftovers of dead processes."""
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
    """Key of a result computed from plain JSON by these sources, libraries and processor.

    Parameters
    ----------
    kind : kind of result
    content : everything else that the result depends on
    """
    return digest_of([kind, computed_by(), content])


def opened(fresh: bool = False) -> tuple[Store | None, str]:
    """Return the user's store, and the reason why it is unusable; both are empty if it is disabled.

    Parameters
    ----------
    fresh : whether what is there is passed by

    Raises InputError where ``HAMMERSTEIN_CACHE_MB`` is no size.
    """
    folder, limit_bytes = folder_of_runs(), _limit_bytes()
    if limit_bytes == 0.0:
        return None, ""
    if folder is None:
        if os.environ.get("HAMMERSTEIN_CACHE") == "":  # switched off
            return None, ""
        return None, "there is no home folder, so results are not cached; set HAMMERSTEIN_CACHE to a folder"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = os.lstat(folder)
    except OSError as error:
        return None, _useless(folder, error)
    if not stat.S_ISDIR(status.st_mode) or not _is_private(status):
        why = "results are not cached, because others may write there; make it yours (chmod 700)"
        return None, f"{folder}: {why}"
    return Store(folder.absolute(), fresh, limit_bytes), ""


def _limit_bytes() -> float:
    """How much may be kept in all."""
    text = os.environ.get(LIMIT) or str(LARGEST_MB)
    try:
        size = float(text)
    except ValueError:
        size = -1.0
    if not 0.0 <= size <= MOST_MB:
        raise InputError(LIMIT, f"{text!r} is not a number of megabytes from 0 to {MOST_MB:g}")
    return size * MEGABYTE


def _useless(folder: Path, error: OSError | InputError) -> str:
    """Say that nothing can be kept, and why."""
    what = reason_of(error) if isinstance(error, OSError) else error.mistakes[0].what.partition(";")[0]
    return f"{folder}: results are not cached ({what}); the run continues without"


def _is_private(status: os.stat_result) -> bool:
    """Whether a folder is this user's and nobody else may write there; not known on every system."""
    if not hasattr(os, "getuid"):
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _bytes(entry: Kept, key: str) -> bytes:
    """An entry as the bytes of an .npz file."""
    file, head = io.BytesIO(), json.dumps([key, entry.document]).encode()
    arrays: dict[str, Any] = {HEAD: np.frombuffer(head, np.uint8), **entry.arrays}
    np.savez(file, **arrays)
    return file.getvalue()


def _loaded(path: Path, key: str) -> Kept:
    """Entry of a file; an error of any kind where it is not what was written under this key."""
    if not stat.S_ISREG(path.lstat().st_mode):
        raise ValueError("no regular file")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as found:
        arrays = dict(found)
    own_key, document = json.loads(arrays.pop(HEAD).tobytes())
    if own_key != key:
        raise ValueError("key of another entry")
    return Kept(document, arrays)

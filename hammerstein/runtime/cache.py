"""Results kept on disk, so that the same work is not done twice.

They lie in the user's cache folder (``HAMMERSTEIN_CACHE`` names another, an empty value switches it off). A
result counts only for the very same source code and the very same arguments.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

COMPUTE = ("numpy", "scipy", "numba", "control")
"""Libraries whose version may change the last digits of a result, or more."""


def folder() -> Path | None:
    """Where results are kept; None if they are not."""
    named = os.environ.get("HAMMERSTEIN_CACHE")
    if named is not None:
        return Path(named) if named else None
    try:
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "hammerstein"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hammerstein"
    except RuntimeError:  # a user without a home
        return None


def folder_of_runs() -> Path | None:
    """Where the results of runs are kept; None if they are not."""
    place = folder()
    return None if place is None else place / "kept"


_made: dict[tuple[str, str], str] = {}
"""What this process has worked out for commands that pass by what was kept before them."""
MOST_MADE = 64


def known(function: Callable[..., str], *arguments: str | int, fresh: str = "") -> str | None:
    """Result of a function from texts and numbers to a text, if it was kept.

    fresh : name of a command that passes by what was kept before it; empty: nothing is passed by
    """
    if fresh:
        return _made.get((fresh, _key(function, arguments)))
    path = _path(function, arguments)
    return None if path is None else _read(path)


def keep(text: str, function: Callable[..., str], *arguments: str | int, fresh: str = "") -> None:
    """Keep the result of a function; a cache that cannot be written is no mistake of the user."""
    from hammerstein.errors import InputError
    from hammerstein.files import write_atomic

    if fresh:
        _made[fresh, _key(function, arguments)] = text
        for oldest in list(_made)[:-MOST_MADE]:
            _made.pop(oldest, None)
    path = _path(function, arguments)
    if path is not None:
        with contextlib.suppress(InputError):
            write_atomic(path, f"{_digest(text)}\n{text}")


def _path(function: Callable[..., str], arguments: tuple[str | int, ...]) -> Path | None:
    place = folder()
    return None if place is None else place / f"{_key(function, arguments)}.json"


def _key(function: Callable[..., str], arguments: tuple[str | int, ...]) -> str:
    text = repr((function.__qualname__, _code(), arguments))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _read(path: Path) -> str | None:
    """Give a result that was kept; None if there is none, or if it is not what was written."""
    from hammerstein.errors import InputError, Notice
    from hammerstein.files import read_limited

    if not os.path.lexists(path):
        return None
    try:
        digest, _, text = read_limited(path, "kept result").partition("\n")
        if digest == _digest(text):
            return text
        warnings.warn(f"{path}: the kept result was spoilt and is worked out again", Notice, stacklevel=2)
    except InputError as error:
        warnings.warn(f"{error}; the result is worked out again", Notice, stacklevel=2)
    return None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _versions() -> str:
    from importlib.metadata import version

    return " ".join(f"{name} {version(name)}" for name in COMPUTE)


@cache
def _code() -> str:
    """Hash of the package's sources and of the versions that compute."""
    digest: Any = hashlib.sha256(f"{sys.version} {sys.platform} {_versions()}".encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return str(digest.hexdigest())

"""Results kept on disk, so that the same work is not done twice.

They lie in the user's cache folder (``HAMMERSTEIN_CACHE`` names another, an empty value switches it off). A
result counts only for the very same source code and the very same arguments.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any


def folder() -> Path | None:
    """Where results are kept; None if they are not."""
    named = os.environ.get("HAMMERSTEIN_CACHE")
    if named is not None:
        return Path(named) if named else None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "hammerstein"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hammerstein"


def kept(function: Callable[..., str]) -> Callable[..., str]:
    """Give a function from texts and numbers to a text whose results are kept."""
    place = folder()
    if place is None:
        return function

    def remembered(*arguments: str | int) -> str:
        key = repr((function.__qualname__, _code(), arguments))
        path = place / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            result = function(*arguments)
        _store(path, result)
        return result

    return remembered


def _store(path: Path, text: str) -> None:
    """Keep a result; a cache that cannot be written is no mistake of the user."""
    from hammerstein.errors import InputError
    from hammerstein.files import write_atomic

    try:
        write_atomic(path, text)
    except InputError:
        return


@cache
def _code() -> str:
    """Hash of the package's sources and of the versions that compute."""
    import numpy as np
    import scipy

    digest: Any = hashlib.sha256(f"{np.__version__} {scipy.__version__}".encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return str(digest.hexdigest())

"""Reading with a limit and writing in one piece."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from hammerstein.errors import InputError

LARGEST_TEXT_BYTES = 50_000_000
_UNFINISHED: set[str] = set()


def read_limited(path: Path, what: str, limit: int = LARGEST_TEXT_BYTES) -> str:
    """Text of a file; InputError if it is missing, empty, larger than ``limit`` bytes or no UTF-8 text."""
    try:
        size = path.stat().st_size
        if size > limit:
            raise InputError(
                str(path), f"has {size / 1e6:.0f} MB, too large for a {what}; is it the right file?"
            )
        if size == 0:
            raise InputError(str(path), f"is empty; a {what} was expected")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(str(path), f"is not UTF-8 text; a {what} was expected") from None
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({_reason(error)})") from None


def is_there(path: Path) -> bool:
    """Whether something of this name exists, as far as anybody may know: no name is too long to ask for."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write under a temporary name and move into place; InputError if the folder cannot be written."""
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        _UNFINISHED.add(temporary)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
        _UNFINISHED.discard(temporary)
    except OSError as error:
        _discard(temporary)
        raise InputError(str(path), f"cannot be written ({_reason(error)}); choose another place") from None
    except BaseException:
        _discard(temporary)
        raise


def refuse_unwritable(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be made or written, before the work that would be lost; nothing is made.

    Parameters
    ----------
    option : what named the folder, such as ``--out``
    folder : where files are to go

    Raises
    ------
    InputError : names the folder that stands in the way
    """
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(option, f"{place} is a file, not a folder; choose another place")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"the folder {place} cannot be written; choose another place")


def discard_unfinished() -> None:
    """Remove what is half-written at this moment, for a process that ends at once."""
    for temporary in tuple(_UNFINISHED):
        _discard(temporary)


def _discard(temporary: str | None) -> None:
    if temporary is not None:
        _UNFINISHED.discard(temporary)
        with contextlib.suppress(OSError):
            os.unlink(temporary)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()

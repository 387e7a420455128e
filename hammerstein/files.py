"""Reading with a limit and writing in one piece."""

import contextlib
import hashlib
import itertools
import json
import os
import re
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from hammerstein.errors import InputError

LARGEST_TEXT_BYTES = 50_000_000  # a record of a million rows and five columns
DEEPEST = 100
"""Brackets in brackets that a file may have; readers that call themselves end somewhere beyond."""
_BRACKETS = re.compile(r"[\[\]{}]")
_QUOTED = re.compile(r'"(?:[^"\\\n]++|\\.)*+"?|\'[^\'\n]*+\'?')
UNFINISHED = ".hammerstein-part"
_UNFINISHED: dict[Path, Callable[[], None]] = {}


def refuse_size(path: Path, what: str, limit: int) -> None:
    """Refuse what is no file, is empty, or is larger than ``limit`` bytes; InputError."""
    try:
        found = path.stat()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({reason_of(error)})") from None
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "not a regular file"
        raise InputError(str(path), f"is {kind}; a {what} was expected")
    size = found.st_size
    if size > limit:
        raise InputError(str(path), f"has {size / 1e6:.0f} MB, too large for a {what}; is it the right file?")
    if size == 0:
        raise InputError(str(path), f"is empty; a {what} was expected")


def read_limited(path: Path, what: str, limit: int = LARGEST_TEXT_BYTES) -> str:
    """Text of a file.

    Raises InputError if it is missing, empty, larger than ``limit`` bytes, no UTF-8 text, or JSON with a
    key that is there twice.
    """
    refuse_size(path, what, limit)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        row = error.object.count(b"\n", 0, error.start) + 1
        told = f"row {row} is not UTF-8 text; a {what} was expected, saved as UTF-8"
        raise InputError(str(path), told) from None
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({reason_of(error)})") from None
    if _depth(text) > DEEPEST:
        raise InputError(
            str(path),
            f"has more than {DEEPEST} nested brackets; a {what} was expected, is it the right file?",
        )
    if text.lstrip().startswith("{"):
        with contextlib.suppress(ValueError):  # no JSON: who reads it says that
            json.loads(text, object_pairs_hook=partial(_refuse_repeated, path))
    return text


def _refuse_repeated(path: Path, pairs: list[tuple[str, Any]]) -> None:
    """Refuse an object of JSON with a key twice, of which readers would take the last; InputError."""
    twice = [name for name, count in Counter(name for name, _ in pairs).items() if count > 1]
    if twice:
        raise InputError(str(path), f"contains the key {twice[0]!r} twice in one object; delete one of them")


def _depth(text: str) -> int:
    """How many brackets stand in one another, those in quoted texts left out."""
    brackets = _BRACKETS.findall(_QUOTED.sub("", text))
    return max(itertools.accumulate(1 if found in "[{" else -1 for found in brackets), default=0)


def digest_of(content: Any) -> str:
    """Digest of plain JSON, in which the order of keys says nothing."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def digest_of_file(path: Path) -> str:
    """Digest of what a file holds, however large it is; OSError where it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_atomic(path: Path, content: str | bytes, private: bool = False) -> None:
    """Write under a temporary name and move into place.

    Parameters
    ----------
    path, content : where to, and what
    private : for the user's eyes alone, and worth no wait for the disk

    Raises
    ------
    InputError : the folder cannot be written, or the name is that of a link, a folder or a device
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = None
    try:
        refuse_no_file(str(path), path)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:100]}.", suffix=UNFINISHED)
        temporary = Path(name)
        register_cleanup(temporary, temporary.unlink)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            if not private:
                file.flush()
                os.fsync(file.fileno())
        if not private:
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(str(path), f"cannot be written ({reason_of(error)}); choose another place") from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
            drop_cleanup(temporary)


def refuse_no_file(source: str, path: Path) -> None:
    """Refuse the name of a link, a folder or a device where a file goes; InputError."""
    if path.is_symlink():
        raise InputError(
            source, f"{path} is a link to {os.path.realpath(path)}; give that file, or another name"
        )
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "not a regular file"
        raise InputError(source, f"{path} is {what}; give the name of a file")


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
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if place.is_symlink() and not place.exists():
        raise InputError(option, f"{place} is a link to nothing; choose another place")
    if not place.is_dir():
        raise InputError(option, f"{place} is a file, not a folder; choose another place")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"the folder {place} is not writable; choose another place")


def register_cleanup(place: Path, discard: Callable[[], None]) -> None:
    """Take note of a file or folder that is half-written, and of what removes it."""
    _UNFINISHED[place] = discard


def drop_cleanup(place: Path) -> None:
    """Take note that a file or folder is half-written no more."""
    _UNFINISHED.pop(place, None)


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove folders, as long as nothing is left in them."""
    for folder in folders:
        with contextlib.suppress(OSError):
            folder.rmdir()


def discard_unfinished() -> None:
    """Remove what is half-written at this moment, for a process that ends at once."""
    for discard in tuple(_UNFINISHED.values()):
        with contextlib.suppress(OSError):
            discard()


def reason_of(error: OSError) -> str:
    """What the system says, as words in a sentence."""
    return (error.strerror or str(error)).lower()

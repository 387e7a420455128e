"""Files of a folder that are replaced together, or not at all.

They are made in a hidden folder inside the one they are for, and when all are there, they are moved into
place. Who is stopped in between leaves a journal, and the next one who writes there finishes the exchange, or
undoes it where that cannot be done.
"""

import contextlib
import errno
import io
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from filelock import FileLock, Timeout

from hammerstein.errors import InputError, naming
from hammerstein.files import (
    drop_cleanup,
    reason_of,
    refuse_no_file,
    refuse_unwritable,
    register_cleanup,
    remove_empty,
)
from hammerstein.runtime.manifest import (
    EMPTY,
    MANIFEST,
    NEW,
    RESERVED,
    Exchange,
    FileEntry,
    Manifest,
    Owner,
    clear,
    digest_of,
    exchange,
    is_inside,
    is_own_file,
    is_plain_file,
    recover,
    refuse_file_name,
    refuse_link,
)
from hammerstein.runtime.signals import uninterrupted

PATIENCE_S = 30.0
"""Longest wait for the lock [s]; a report takes less."""
PAUSE_S = 0.05
"""Interval of attempts [s], below what a person notices."""
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP)


@contextmanager
def locked(
    path: Path, patience_s: float | None = None, busy: tuple[str, str] | None = None
) -> Iterator[None]:
    """Hold a lock file inside the block.

    On a file system without locks nothing is held.

    Parameters
    ----------
    path : the lock file, in a folder that exists
    patience_s : how long to wait for another process; ``PATIENCE_S`` if not given
    busy : source and words of the error where that one is not done by then

    Raises
    ------
    InputError : another run holds the lock for longer than that
    OSError : the file cannot be made
    """
    lock = FileLock(path, timeout=PATIENCE_S if patience_s is None else patience_s)
    try:
        lock.acquire(poll_interval=PAUSE_S)
    except Timeout:
        source, what = busy or (str(path.parent), "another run is writing there")
        raise InputError(source, f"{what}; wait for it, or choose another place") from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    try:
        yield
    finally:
        if sys.platform == "win32":  # which does not remove what is open
            lock.release()
        with contextlib.suppress(OSError):
            os.unlink(path)
        lock.release()  # the second time nothing is held


ROOM = f"{RESERVED}-new"
LOCK = f"{RESERVED}-lock"


class Stage:
    """Temporary place for the new files of a folder.

    folder : where they go
    owner : which command writes them
    overwrite : whether they replace files that the command did not write, or that a person changed
    kept : places of files of an earlier run that a person had changed; known when the block is left
    """

    def __init__(self, folder: Path, room: Path, owner: Owner, overwrite: bool):
        self.folder, self.owner, self.overwrite = folder, owner, overwrite
        self.kept: tuple[Path, ...] = ()
        self._room = room
        self._digests: dict[str, str] = {}
        self._owners: dict[str, Owner] = {}

    def write(self, name: str, content: str | bytes | BinaryIO, owner: Owner | None = None) -> None:
        """Write one file.

        Parameters
        ----------
        name : relative to the folder, with ``/`` between its parts
        content : text, bytes, or an open file that is copied
        owner : which command writes it; that of the folder if not given
        """
        if not is_inside(name):
            raise InputError(str(self.folder), f"{name!r} names no file in the folder")
        data = content.encode("utf-8") if isinstance(content, str) else content
        path = self._room / NEW / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:  # follows no link
            shutil.copyfileobj(io.BytesIO(data) if isinstance(data, bytes) else data, file)
        self._digests[name] = digest_of(path)
        self._owners[name] = owner or self.owner

    def take(self, folder: Path) -> None:
        """Copy every file of a folder; those in its manifest belong to the same command."""
        listed = Manifest.read(folder).files
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            if (name := path.relative_to(folder).as_posix()) != MANIFEST:
                self.write(name, path.read_bytes(), Owner(listed[name].owner) if name in listed else None)

    @property
    def names(self) -> list[str]:
        """Names of the new files."""
        return [name for name in self._digests if name != MANIFEST]

    def publish(self) -> None:
        """Replace the files of the earlier run by these."""
        before, new = Manifest.read(self.folder), dict(self._digests)
        free = {name for name, digest in new.items() if self._loses_nothing(name, digest)}
        for name in new.keys() - free:
            before.refuse_foreign([name], self._owners[name], self.overwrite)
        old = () if self.owner.single else (self.owner.name, *self.owner.replaces)
        leaving = {
            name: entry.sha256 for name, entry in before.files.items() if name in new or entry.owner in old
        }
        leaving |= {
            name: digest_of(self.folder / name)
            for name in new
            if name in free or (self.overwrite and is_plain_file(self.folder, name))
        }
        entries = {
            name: entry
            for name, entry in before.files.items()
            if name not in leaving and is_plain_file(self.folder, name)
        }
        listed = {name: self._owners[name] for name in new if self._owners[name].listed}
        entries |= {n: FileEntry(owner=owner.name, sha256=new[n]) for n, owner in listed.items()}
        if entries or before.files:
            self.write(MANIFEST, Manifest(self.folder, entries).to_json())
        if (self.folder / MANIFEST).is_file():
            leaving[MANIFEST] = digest_of(self.folder / MANIFEST)
        self.kept += exchange(self.folder, self._room, Exchange(leaving=leaving, coming=self._digests))

    def _loses_nothing(self, name: str, digest: str) -> bool:
        """Whether the existing file is empty, or equal to the new one."""
        return any(is_own_file(self.folder, name, one) for one in (digest, EMPTY))


@contextmanager
def staged(folder: Path, owner: Owner, overwrite: bool = False) -> Iterator[Stage]:
    """Write files inside the block; at its end they replace those of an earlier run.

    Only files that the manifest of the earlier run lists, with equal digests, are removed. A file that a
    person changed is kept under another name; everything else stays as it is. If the block ends with an
    exception, nothing changes.

    Parameters
    ----------
    folder : folder for the files; created if it does not exist
    owner : which command writes them
    overwrite : whether they replace files that the command did not write, or that a person changed

    Raises
    ------
    InputError : the folder cannot be written, is a link, or holds other people's files under these names
    """
    refuse_link(folder)
    made = tuple(place for place in (folder, *folder.parents) if not place.exists())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _room_of(folder, made) as (room, kept):
            stage = Stage(folder, room, owner, overwrite)
            stage.kept = kept
            yield stage
            with uninterrupted:
                stage.publish()
    except OSError as error:
        what = f"cannot be written ({reason_of(error)}); choose another place"
        raise InputError(str(folder), what) from None
    finally:
        remove_empty(made)


def prepare(
    folder: Path, owner: Owner, names: Sequence[str], overwrite: bool = False, option: str = ""
) -> None:
    """Before the work, finish or undo an interrupted run in a folder, and refuse files of others.

    Parameters
    ----------
    folder : where files will go
    owner : which command will write them
    names : names that will certainly be written
    overwrite : whether they replace files that the command did not write, or that a person changed
    option : option with the folder, such as ``--out``; default: the folder

    Raises
    ------
    InputError : as ``staged`` would
    """
    refuse_link(folder)
    try:
        if any((folder / name).exists() for name in (ROOM, LOCK)):
            with _room_of(folder, ()):
                pass
        Manifest.read(folder).refuse_foreign(names, owner, overwrite, option)
    except OSError as error:
        raise InputError(str(folder), f"cannot be read ({reason_of(error)})") from None


def prepare_folder(
    option: str, folder: Path, owner: Owner, names: Sequence[str], overwrite: bool = False
) -> None:
    """Raise InputError, before the work, for a folder that cannot be written; else like ``prepare``.

    option : option with the folder, such as ``--out``
    """
    refuse_unwritable(option, folder)
    prepare(folder, owner, names, overwrite)


def prepare_file(option: str, path: Path, owner: Owner, overwrite: bool = False) -> None:
    """Raise InputError, before the work, for a file that ``write_file`` could not write.

    Parameters
    ----------
    option : option with the file, such as ``--out``
    path, owner, overwrite : as for ``write_file``
    """
    refuse_unwritable(option, path.parent)
    refuse_no_file(option, path)
    refuse_file_name(option, path)
    if path.parent.exists():
        prepare(behind_link(path.parent), owner, [path.name], overwrite, option)


def write_file(
    path: Path, content: str | bytes | BinaryIO, owner: Owner, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write one file under the rule of folders; return the place of a file that a person had changed.

    Parameters
    ----------
    path, content : where to, and what
    owner : which command writes it
    overwrite : whether it replaces a file that the command did not write, or that a person changed

    Raises
    ------
    InputError : it cannot be written, or another file is there that must not be replaced
    """
    with staged_beside(path, owner, overwrite) as stage:
        stage.write(path.name, content)
    return stage.kept


@contextmanager
def staged_beside(path: Path, owner: Owner, overwrite: bool = False) -> Iterator[Stage]:
    """Return the stage of the folder of one file; the folder may be a link, and errors name the file."""
    folder = behind_link(path.parent)
    refuse_no_file(str(path), path)
    with naming(str(path), instead_of=str(folder)), staged(folder, owner, overwrite) as stage:
        yield stage


def behind_link(folder: Path) -> Path:
    """Target of a folder that may be a link."""
    return folder.resolve() if folder.is_symlink() else folder


@contextmanager
def _room_of(folder: Path, made: Sequence[Path]) -> Iterator[tuple[Path, tuple[Path, ...]]]:
    """Hidden folder for the making, empty, and what was kept aside when an interrupted run was finished."""
    room, lock = folder / ROOM, folder / LOCK
    refuse_link(room)

    def discard() -> None:
        clear(room)
        lock.unlink(missing_ok=True)
        remove_empty((room, *made))

    try:
        with locked(lock):
            register_cleanup(room, discard)
            try:
                with uninterrupted:
                    kept = recover(folder, room)
                room.mkdir(exist_ok=True)
                yield room, kept
            finally:
                clear(room)
                remove_empty([room])
    finally:
        drop_cleanup(room)

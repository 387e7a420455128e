"""Files of a folder that are replaced together, or not at all, and the list of those that were written.

They are made in a hidden folder inside the one they are for, and when all are there, they are moved into
place. Who is stopped in between leaves a journal, and the next one who writes there finishes the exchange, or
undoes it where that cannot be done.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, BinaryIO, Literal

from filelock import FileLock, Timeout
from pydantic import AfterValidator, ValidationError

from hammerstein.errors import InputError, naming
from hammerstein.files import (
    drop_cleanup,
    read_limited,
    reason_of,
    refuse_no_file,
    refuse_unwritable,
    register_cleanup,
    remove_empty,
)
from hammerstein.runtime.signals import uninterrupted
from hammerstein.validation import Strict

RESERVED = ".hammerstein"
MANIFEST = f"{RESERVED}.json"
EMPTY = hashlib.sha256().hexdigest()
CHUNK_BYTES = 1 << 20  # of a file that is compared, at a time
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?")
_NO_NAME = re.compile(r'[\x00-\x1f\x7f-\x9f/\\<>:"|?*]')


@dataclass(frozen=True)
class Owner:
    """Command that writes a file or a set of files.

    name : its name in the manifest
    replaces : other owners whose files of an earlier run are removed
    single : whether each file is independent: other files of an earlier run stay, and it replaces no file of
        another command
    listed : whether the manifest lists its files; others belong to the user from the start
    """

    name: str
    replaces: tuple[str, ...] = ()
    single: bool = False
    listed: bool = True


SWEEP = Owner("sweep", single=True)


class FileEntry(Strict):
    """One file in a manifest."""

    owner: str
    sha256: str


def _inside(name: str) -> str:
    if not is_inside(name):
        raise ValueError("names no file in the folder")
    return name


def is_inside(name: str) -> bool:
    """Whether a text names a file in a folder or its subfolders."""
    parts = PurePosixPath(name).parts
    return bool(parts) and all(map(_is_part, parts)) and "/".join(parts) == name


def _is_part(name: str) -> bool:
    """Whether a text is the name of one file on this system, and completely visible."""
    return is_name(name) if os.name == "nt" else name != ".." and name.isprintable()


FileName = Annotated[str, AfterValidator(_inside)]
"""Name of a file in a folder or its subfolders."""


class _ManifestFile(Strict):
    format: Literal["hammerstein-manifest/1"] = "hammerstein-manifest/1"
    files: dict[FileName, FileEntry]


@dataclass(frozen=True, eq=False)
class Manifest:
    """Files that this program wrote into a folder, by name, with their digests."""

    folder: Path
    files: Mapping[str, FileEntry]

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """Read the manifest of a folder; a missing or damaged one is empty, so that no file is touched."""
        path = folder / MANIFEST
        with suppress(InputError, ValidationError):
            if not path.is_symlink():
                return cls(folder, _ManifestFile.model_validate_json(read_limited(path, "manifest")).files)
        return cls(folder, {})

    def to_json(self) -> str:
        """Text of the manifest: sorted keys, no clock and no host."""
        return json.dumps(_ManifestFile(files=dict(self.files)).model_dump(), indent=1, sort_keys=True) + "\n"

    def is_foreign(self, name: str, owner: Owner) -> bool:
        """Whether a name belongs to a file of somebody else; empty files do not count."""
        path, entry = self.folder / name, self.files.get(name)
        if through_a_link(self.folder, name):
            return True
        if not path.exists() or is_own_file(self.folder, name, EMPTY):
            return False
        return entry is None or not path.is_file() or (owner.single and entry.owner != owner.name)

    def refuse_foreign(
        self, names: Iterable[str], owner: Owner, overwrite: bool = False, option: str = ""
    ) -> None:
        """Raise InputError, with all names, if other files have the names to be written.

        Parameters
        ----------
        names, owner : files to be written, and their owner
        overwrite : whether ordinary files may be replaced, whoever wrote them
        option : option with the file, such as ``--out``; default: the folder
        """
        found = [name for name in names if self.is_foreign(name, owner)]
        if overwrite:
            found = [name for name in found if not is_plain_file(self.folder, name)]
        if not found:
            return
        listed = ", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else "")
        kind = "" if overwrite else ", or give --overwrite"
        was = f"this command did not write; move it away, choose another place{kind}"
        if option:
            raise InputError(option, f"{self.folder / listed} is a file that {was}")
        raise InputError(str(self.folder), f"holds {listed}, which {was}")


def digest_of(path: Path) -> str:
    """SHA-256 of a file, line ends counted as one character: git may exchange them in a text."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            if chunk.endswith(b"\r"):
                chunk += file.read(1)
            digest.update(chunk.replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def is_own_file(folder: Path, name: str, digest: str) -> bool:
    """Whether a file, reached through no link, is there and has this digest."""
    return is_plain_file(folder, name) and digest_of(folder / name) == digest


def is_plain_file(folder: Path, name: str) -> bool:
    """Whether an ordinary file exists, not through a link."""
    return not through_a_link(folder, name) and (folder / name).is_file()


def is_name(name: str) -> bool:
    r"""Whether a text is a valid name of a file or folder on every system.

    >>> [is_name(name) for name in ("circle", "..", "a/b", "con", "a.")]
    [True, False, False, False, False]
    """
    bad = _NO_NAME.search(name) or _RESERVED.fullmatch(name) or name.endswith((".", " ")) or not name.strip()
    return not bad


def refuse_name(source: Path) -> None:
    """Refuse a file whose name without its suffix could not be the name of a folder, such as ``...toml``."""
    if not is_name(source.stem):
        raise InputError(
            repr(str(source))[1:-1],
            f"{source.stem!r} cannot be the name of a folder for its report; rename the file",
        )


def refuse_file_name(option: str, path: Path) -> None:
    """Raise InputError for a name that is invalid in a manifest or reserved."""
    if not _is_part(path.name) or path.name.startswith(RESERVED):
        raise InputError(option, f"{path.name!r} is not possible as a file name; choose another")


def refuse_link(folder: Path) -> None:
    """Refuse a folder that is a link, because files would be written elsewhere."""
    if is_link(folder):
        raise InputError(
            str(folder), f"is a link to {os.path.realpath(folder)}; name that folder, or remove the link"
        )


def through_a_link(folder: Path, name: str) -> bool:
    """Whether a part of a name in a folder is a link."""
    parts = PurePosixPath(name).parts
    return any(is_link(folder.joinpath(*parts[: k + 1])) for k in range(len(parts)))


def is_link(path: Path) -> bool:
    """Whether a path itself is a link, or a junction of Windows."""
    isjunction = getattr(os.path, "isjunction", None)  # Python 3.12
    return path.is_symlink() or bool(isjunction is not None and isjunction(path))


NEW, OLD, JOURNAL, DRAFT = "new", "old", "journal.json", "journal.part"
EDITED = "edited"


class Exchange(Strict):
    """Files of an exchange, as the journal lists them.

    leaving : files of earlier runs that are replaced or removed, with their digests
    coming : new files, with their digests; the last one is the manifest
    """

    leaving: dict[FileName, str]
    coming: dict[FileName, str]


def exchange(folder: Path, room: Path, plan: Exchange) -> tuple[Path, ...]:
    """Replace files by those in ``room``; return the places of files that were kept aside.

    Raises OSError where it cannot be done; then everything is as it was.
    """
    try:
        for name in plan.leaving:
            (room / OLD / name).parent.mkdir(parents=True, exist_ok=True)
        for name in plan.coming:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with (room / DRAFT).open("xb") as draft:
            draft.write(plan.model_dump_json().encode())
            draft.flush()
            os.fsync(draft.fileno())
        os.replace(room / DRAFT, room / JOURNAL)
        return _carry_out(folder, room, plan)
    except OSError:
        _remove_empty(folder, plan)
        raise


def recover(folder: Path, room: Path) -> tuple[Path, ...]:
    """Finish or undo an interrupted exchange, and remove its temporary folder.

    Raises InputError where a step would follow a link.
    """
    kept: tuple[Path, ...] = ()
    if (room / JOURNAL).exists():
        plan = _journal(room)
        _refuse_links(folder, room, plan)
        there = [any(is_own_file(at, *new) for at in (room / NEW, folder)) for new in plan.coming.items()]
        if there and all(there):  # each new file is ready, or in its place already
            kept = _carry_out(folder, room, plan)
        else:
            _undo(folder, room, plan)
            _remove_empty(folder, plan)
    clear(room)
    return kept


def clear(room: Path) -> None:
    """Remove temporary files, unless a journal still needs them."""
    if not (room / JOURNAL).exists():
        for place in (room / NEW, room / OLD):
            if is_link(place):
                place.unlink()
            shutil.rmtree(place, ignore_errors=True)
        (room / DRAFT).unlink(missing_ok=True)


def _journal(room: Path) -> Exchange:
    try:
        return Exchange.model_validate_json(read_limited(room / JOURNAL, "journal"))
    except (InputError, ValidationError):
        return Exchange(leaving={}, coming={})


def _refuse_links(folder: Path, room: Path, plan: Exchange) -> None:
    """Refuse an exchange that would follow a link into another folder; InputError."""
    left = (path.relative_to(room / OLD).as_posix() for path in (room / OLD).rglob("*"))
    for parent in {PurePosixPath(name).parent for name in {*plan.leaving, *plan.coming, *left}}:
        for place in (Path(), Path(room.name, NEW), Path(room.name, OLD)):
            if through_a_link(folder, (place / parent).as_posix()):
                raise InputError(str(folder / place / parent), f"is reached through a link; remove {room}")


def _carry_out(folder: Path, room: Path, plan: Exchange) -> tuple[Path, ...]:
    """Do each step that is not done yet."""
    kept: dict[Path, Path] = {}
    try:
        for name in plan.leaving.keys() - plan.coming.keys():
            _put_away(folder, room, name, plan)
        for name in plan.coming:
            if (room / NEW / name).exists():
                if not _put_away(folder, room, name, plan) and os.path.lexists(folder / name):
                    kept[folder / name] = put_aside(folder / name)
                os.replace(room / NEW / name, folder / name)
        os.unlink(room / JOURNAL)
    except OSError:
        _undo(folder, room, plan)
        for place, aside in kept.items():
            os.rename(aside, place)
        raise
    _remove_empty(folder, plan)
    return tuple(kept.values())


def _put_away(folder: Path, room: Path, name: str, plan: Exchange) -> bool:
    """Move a file out of the folder if it is still the file that is to be replaced."""
    if name in plan.leaving and is_own_file(folder, name, plan.leaving[name]):
        os.replace(folder / name, room / OLD / name)
        return True
    return False


def put_aside(path: Path) -> Path:
    """Rename somebody's file to a free name; return it."""
    number, place = 1, path.with_name(f"{path.name}.{EDITED}")
    while os.path.lexists(place):
        number += 1
        place = path.with_name(f"{path.name}.{EDITED}-{number}")
    os.rename(path, place)
    return place


def _undo(folder: Path, room: Path, plan: Exchange) -> None:
    """Take new files out again, and bring the old ones back."""
    for name, digest in plan.coming.items():
        if not (room / NEW / name).exists() and is_own_file(folder, name, digest):
            os.replace(folder / name, room / NEW / name)
    old = room / OLD
    for path in sorted(old.rglob("*")):
        place = folder / path.relative_to(old)
        if path.is_file() and not os.path.lexists(place):
            os.replace(path, place)
    (room / JOURNAL).unlink(missing_ok=True)


def _remove_empty(folder: Path, plan: Exchange) -> None:
    """Remove subfolders that nothing is left in."""
    places = {place for name in {**plan.leaving, **plan.coming} for place in Path(name).parents}
    remove_empty(folder / place for place in sorted(places - {Path()}, reverse=True))


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
        with suppress(OSError):
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

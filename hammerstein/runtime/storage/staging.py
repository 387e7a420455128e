"""Files of a folder that are replaced together, or not at all.

They are made in a hidden folder inside the one they are for, and when all are there, they are moved into
place. Who is stopped in between leaves a journal, and the next one who writes there finishes the exchange, or
undoes it where that cannot be done.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hammerstein.errors import InputError
from hammerstein.files import begun, ended, reason_of, remove_empty
from hammerstein.runtime.interrupts import deferred_interrupts
from hammerstein.runtime.storage.exchange import NEW, Exchange, clear, exchange, recover
from hammerstein.runtime.storage.lock import LOCK, locked
from hammerstein.runtime.storage.manifest import (
    MANIFEST,
    FileEntry,
    Holder,
    Manifest,
    Owner,
    digest_of,
    refuse_link,
)

ROOM = ".hammerstein-new"


class Stage:
    """Where the files of a folder are made.

    folder : where they go
    kept : places of files of an earlier run that a person had changed; known when the block is left
    """

    def __init__(self, folder: Path, room: Path):
        self.folder = folder
        self.kept: tuple[Path, ...] = ()
        self._room = room
        self._digests: dict[str, str] = {}

    def write(self, name: str, content: str | bytes) -> None:
        """Make one file; ``name`` is relative to the folder, with ``/`` between its parts."""
        data = content.encode("utf-8") if isinstance(content, str) else content
        path = self._room / NEW / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            file.write(data)
        self._digests[name] = digest_of(path)

    @property
    def written(self) -> list[Path]:
        """Places of the files, once they are there."""
        return [self.folder / name for name in self._digests if name != MANIFEST]

    def publish(self, owner: Owner) -> None:
        """Exchange the files of the earlier run for these."""
        before = Manifest.read(self.folder)
        new = dict(self._digests)
        before.refuse_foreign(new, owner)
        replaced = {
            name: entry.sha256
            for name, entry in before.files.items()
            if name in new or entry.owner in (owner.name, *owner.replaces)
        }
        adopted = {
            name: digest_of(self.folder / name)
            for name in new
            if name not in before.files and before.holder(name, owner) is Holder.OURS
        }
        stay = {name: entry for name, entry in before.files.items() if name not in replaced}
        entries = stay | {name: FileEntry(owner=owner.name, sha256=digest) for name, digest in new.items()}
        self.write(MANIFEST, Manifest(self.folder, entries).to_json())
        leaving = replaced | adopted
        if (self.folder / MANIFEST).is_file():
            leaving[MANIFEST] = digest_of(self.folder / MANIFEST)
        self.kept += exchange(self.folder, self._room, Exchange(leaving=leaving, coming=self._digests))


@contextmanager
def staged(folder: Path, owner: Owner) -> Iterator[Stage]:
    """Make files inside the block; at its end they take the place of those of an earlier run.

    Of the earlier run only what its manifest lists, with the very digest, is removed. What a person has
    changed is kept under another name, everything else stays as it is. Where the block is left by an
    exception, nothing has happened.

    Parameters
    ----------
    folder : where the files go; made if it does not exist
    owner : which command writes them

    Raises
    ------
    InputError : the folder cannot be written, is a link, or holds other people's files under these names
    """
    refuse_link(folder)
    made = tuple(place for place in (folder, *folder.parents) if not place.exists())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _room_of(folder, made) as (room, kept):
            stage = Stage(folder, room)
            stage.kept = kept
            yield stage
            with deferred_interrupts():
                stage.publish(owner)
    except OSError as error:
        what = f"cannot be written ({reason_of(error)}); choose another place"
        raise InputError(str(folder), what) from None
    finally:
        remove_empty(made)


def prepare(folder: Path, owner: Owner, names: Sequence[str]) -> None:
    """Finish what an interrupted run left in a folder, and refuse other people's files, before the work.

    Parameters
    ----------
    folder : where files will go
    owner : which command will write them
    names : names that are certain to be written

    Raises
    ------
    InputError : as ``staged`` would
    """
    refuse_link(folder)
    try:
        if (folder / ROOM).exists():
            with _room_of(folder, ()):
                pass
        Manifest.read(folder).refuse_foreign(names, owner)
    except OSError as error:
        raise InputError(str(folder), f"cannot be read ({reason_of(error)})") from None


@contextmanager
def _room_of(folder: Path, made: Sequence[Path]) -> Iterator[tuple[Path, tuple[Path, ...]]]:
    """Hidden folder for the making, empty, and what was kept aside when an interrupted run was finished."""
    room = folder / ROOM
    refuse_link(room)

    def discard() -> None:
        clear(room)
        (room / LOCK).unlink(missing_ok=True)
        remove_empty((room, *made))

    try:
        with locked(room):
            begun(room, discard)
            try:
                with deferred_interrupts():
                    kept = recover(folder, room)
                yield room, kept
            finally:
                clear(room)
    finally:
        ended(room)

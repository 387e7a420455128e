"""List of the files that this program wrote into a folder, and their safe replacement."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, ValidationError

from hammerstein.errors import InputError
from hammerstein.files import read_limited, remove_empty
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

"""Which files of a folder this program wrote, so that no other is ever removed or overwritten."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, ValidationError

from hammerstein.errors import InputError
from hammerstein.files import read_limited
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


class Holder(Enum):
    """Whose a file is."""

    NOBODY = auto()
    OURS = auto()
    EDITED = auto()
    FOREIGN = auto()


@dataclass(frozen=True, eq=False)
class Manifest:
    """Files that this program wrote into a folder, by name, with the digest of what it wrote."""

    folder: Path
    files: Mapping[str, FileEntry]

    @classmethod
    def read(cls, folder: Path) -> Manifest:
        """Read the manifest of a folder; a missing or spoilt one lists nothing: nothing is touched."""
        path = folder / MANIFEST
        try:
            if path.is_symlink():
                return cls(folder, {})
            return cls(folder, _ManifestFile.model_validate_json(read_limited(path, "manifest")).files)
        except (InputError, ValidationError):
            return cls(folder, {})

    def to_json(self) -> str:
        """Text of the manifest: sorted keys, no clock and no host."""
        return json.dumps(_ManifestFile(files=dict(self.files)).model_dump(), indent=1, sort_keys=True) + "\n"

    def holder(self, name: str, owner: Owner) -> Holder:
        """Tell whose the file is that has a name."""
        path = self.folder / name
        if through_a_link(self.folder, name):
            return Holder.FOREIGN
        if not path.exists():
            return Holder.NOBODY
        entry = self.files.get(name)
        if is_own_file(self.folder, name, EMPTY):
            return Holder.NOBODY
        if entry is None or not path.is_file() or (owner.single and entry.owner != owner.name):
            return Holder.FOREIGN
        return Holder.OURS if digest_of(path) == entry.sha256 else Holder.EDITED

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
        found = [name for name in names if self.holder(name, owner) is Holder.FOREIGN]
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
    """Whether an ordinary file is there, reached through no link."""
    return not through_a_link(folder, name) and (folder / name).is_file()


def is_name(name: str) -> bool:
    r"""Whether a text can be the name of a file or folder, on every system.

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
    """Refuse a name that no manifest can hold, or that the program keeps for itself; InputError."""
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

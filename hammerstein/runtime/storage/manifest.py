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

MANIFEST = ".hammerstein.json"
CHUNK_BYTES = 1 << 20
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?")
_NO_NAME = re.compile(r'[\x00-\x1f\x7f-\x9f/\\<>:"|?*]')


@dataclass(frozen=True)
class Owner:
    """Which command writes a set of files.

    name : as it stands in the manifest
    replaces : whose files of an earlier run are removed, beside its own
    sign : a file and a text in it; a folder without a manifest that holds them is one of its own, written
        before there were manifests
    """

    name: str
    sign: tuple[str, str]
    replaces: tuple[str, ...] = ()


class FileEntry(Strict):
    """One file in a manifest."""

    owner: str
    sha256: str


def _inside(name: str) -> str:
    parts = PurePosixPath(name).parts
    if not parts or not all(is_name(part) for part in parts) or "/".join(parts) != name:
        raise ValueError("names no file in the folder")
    return name


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
        """Tell whose the file is that stands under a name."""
        path = self.folder / name
        if _through_a_link(self.folder, name):
            return Holder.FOREIGN
        if not path.exists():
            return Holder.NOBODY
        if not path.is_file():
            return Holder.FOREIGN
        if name in self.files:
            return Holder.OURS if digest_of(path) == self.files[name].sha256 else Holder.EDITED
        is_new_here = all(entry.owner != owner.name for entry in self.files.values())
        return Holder.OURS if is_new_here and _is_signed(self.folder, owner) else Holder.FOREIGN

    def refuse_foreign(self, names: Iterable[str], owner: Owner) -> None:
        """Refuse to write under names that other people's files have; InputError names them all."""
        found = [name for name in names if self.holder(name, owner) is Holder.FOREIGN]
        if found:
            listed = ", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else "")
            what = "was" if len(found) == 1 else "were"
            raise InputError(
                str(self.folder),
                f"holds {listed}, which {what} not written by hammerstein and would be overwritten; "
                "move it away, or choose another place",
            )


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
    path = folder / name
    return not _through_a_link(folder, name) and path.is_file() and digest_of(path) == digest


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


def refuse_link(folder: Path) -> None:
    """Refuse a folder that is a link: what is written into it would go elsewhere."""
    if _is_link(folder):
        raise InputError(
            str(folder), f"is a link to {os.path.realpath(folder)}; name that folder, or remove the link"
        )


def _through_a_link(folder: Path, name: str) -> bool:
    parts = PurePosixPath(name).parts
    return any(_is_link(folder.joinpath(*parts[: k + 1])) for k in range(len(parts)))


def _is_link(path: Path) -> bool:
    isjunction = getattr(os.path, "isjunction", None)  # Python 3.12
    return path.is_symlink() or bool(isjunction is not None and isjunction(path))


def _is_signed(folder: Path, owner: Owner) -> bool:
    name, text = owner.sign
    try:
        return text in read_limited(folder / name, "report")
    except InputError:
        return False

"""Exchange the files of a folder for new ones: by a journal, so that it can be finished or undone later."""

from __future__ import annotations

import os
import shutil
from pathlib import Path, PurePosixPath

from pydantic import ValidationError

from hammerstein.errors import InputError
from hammerstein.files import read_limited, remove_empty
from hammerstein.runtime.storage.manifest import FileName, is_link, is_own_file, through_a_link
from hammerstein.validation import Strict

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
    """Exchange files that lie ready in ``room``; give the places of those that were kept aside.

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
        if plan.coming and all(_is_there(folder, room, *item) for item in plan.coming.items()):
            kept = _carry_out(folder, room, plan)
        else:
            _undo(folder, room, plan)
            _remove_empty(folder, plan)
    clear(room)
    return kept


def clear(room: Path) -> None:
    """Remove what was made, unless a journal still needs it."""
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
    parents = {PurePosixPath(name).parent for name in {*plan.leaving, *plan.coming, *left}}
    for parent in parents:
        for place in (Path(), Path(room.name, NEW), Path(room.name, OLD)):
            if through_a_link(folder, (place / parent).as_posix()):
                raise InputError(str(folder / place / parent), f"is reached through a link; remove {room}")


def _is_there(folder: Path, room: Path, name: str, digest: str) -> bool:
    """Whether a new file is ready, or in its place already."""
    return any(is_own_file(place, name, digest) for place in (room / NEW, folder))


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
    """Return somebody's file another name, which is free."""
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

"""The folders that ``hammerstein init`` makes: of one's own actuator, or of scenarios that are shipped."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from hammerstein.errors import InputError
from hammerstein.plugins import load_plugins
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import behind_link, staged
from hammerstein.scenario.assessment import ASSESSMENTS

STARTER = Path(__file__).parents[1] / "starter"
INIT = Owner("init", single=True, listed=False)


def own_folder(target: Path) -> None:
    """Copy records, their model, a scenario, its numbers and what to do next, for one's own actuator.

    Parameters
    ----------
    target : folder; created if it does not exist

    Raises
    ------
    InputError : a file has one of these names already, or the folder cannot be written
    """
    with staged(behind_link(target), INIT) as stage:
        stage.take(STARTER)
        refuse_existing(target, stage.names)


def folder_of(assessment: str, target: Path) -> None:
    """Copy the scenarios that a kind of assessment brings, and the numbers that were accepted for them.

    Raises InputError as ``own_folder`` does, and where no such kind brings any.
    """
    load_plugins()
    brought = {name: files for name, kind in ASSESSMENTS.kinds.items() if (files := kind.shipped())}
    if assessment not in brought:
        raise InputError("--of", f"nothing is available for {assessment!r}; give one of {', '.join(brought)}")
    with staged(behind_link(target), INIT) as stage:
        for name, file in brought[assessment].items():
            stage.write(name, file.read_bytes())
        refuse_existing(target, stage.names)


def refuse_existing(target: Path, names: Sequence[str]) -> None:
    """Refuse a folder that holds one of these files: nothing is ever written over; InputError names them.

    A file or a link where a folder is to be stands in the way, too.
    """
    folders = {place for name in names for place in Path(name).parents if place != Path(".")}
    there = [name for name in names if os.path.lexists(target / name)]
    there += sorted(f.as_posix() for f in folders if (target / f).is_symlink() or (target / f).is_file())
    if there:
        listed = ", ".join(there[:5]) + (f" and {len(there) - 5} more" if len(there) > 5 else "")
        raise InputError(str(target), f"already holds {listed}; nothing was written. Choose another folder")

"""Commands for beginners: working folder, content of a file, guide."""

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from hammerstein.commands.options import AsJson, with_help
from hammerstein.commands.terminal import show as show_table, tell, tell_json
from hammerstein.errors import InputError

STARTER, GUIDE = Path(__file__).parents[1] / "starter", Path(__file__).parents[1] / "guide"
FIRST = ("start", "record", "identify", "compensators")


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to create; default: here.")] = Path(
        "."
    ),
    of: str | None = with_help(
        "Copy scenarios with their accepted numbers: paper, or those of a plug-in.", metavar="NAME"
    ),
) -> None:
    """Create a working folder with an example.

    It has records, a model, a scenario, its numbers, and the next steps.
    """
    from hammerstein.runtime.staging import Owner, behind_link, staged

    brought = None if of is None else _brought_by(of)
    with staged(behind_link(folder), Owner("init", single=True, listed=False)) as stage:
        if brought is None:
            stage.take(STARTER)
        else:
            for name, file in brought.items():
                stage.write(name, file.read_bytes())
        _refuse_existing(folder, stage.names)
    there = "" if folder == Path(".") else f"cd {shlex.quote(str(folder))}, then "
    if of is not None:
        tell(f"scenarios in {folder}; {there}hammerstein run . or hammerstein check .")
        return
    tell(f"the next steps are in {folder / 'README.md'}")
    tell(f"look at {folder / 'reports/circle/report.html'}; {there}hammerstein run .")


def _brought_by(assessment: str) -> Mapping[str, Path]:
    """The scenarios that a kind of assessment brings, and the numbers that were accepted for them.

    Raises InputError where no such kind brings any.
    """
    from hammerstein.plugins import load_plugins
    from hammerstein.scenario.assessment import ASSESSMENTS

    load_plugins()
    brought = {name: files for name, kind in ASSESSMENTS.kinds.items() if (files := kind.shipped())}
    if assessment not in brought:
        raise InputError("--of", f"nothing is available for {assessment!r}; give one of {', '.join(brought)}")
    return brought[assessment]


def _refuse_existing(target: Path, names: Sequence[str]) -> None:
    """Refuse a folder that holds one of these files: nothing is ever written over; InputError names them.

    A file or a link where a folder is to be stands in the way, too.
    """
    folders = {place for name in names for place in Path(name).parents if place != Path(".")}
    there = [name for name in names if os.path.lexists(target / name)]
    there += sorted(f.as_posix() for f in folders if (target / f).is_symlink() or (target / f).is_file())
    if there:
        listed = ", ".join(there[:5]) + (f" and {len(there) - 5} more" if len(there) > 5 else "")
        raise InputError(str(target), f"already holds {listed}; nothing was written. Choose another folder")


def show(
    file: Annotated[
        Path,
        typer.Argument(help="Scenario, model or packaged actuator, record, drive file, report or baseline."),
    ],
    as_json: AsJson = False,
) -> None:
    """Print the content of a file.

    Nothing is run.
    """
    from hammerstein.commands.contents import contents_of
    from hammerstein.commands.terminal_tables import facts_table
    from hammerstein.model import packaged_actuators, place_of

    kind, facts = contents_of(place_of(str(file)) if str(file) in packaged_actuators() else file)
    if as_json:
        tell_json({"file": str(file), "kind": kind, **dict(facts)})
        return
    show_table(facts_table(f"{file}: {kind}", facts))


def guide(
    topic: Annotated[str | None, typer.Argument(help="Page to show; default: list of all pages.")] = None,
) -> None:
    """Read the guide."""
    from hammerstein.commands.terminal_tables import facts_table

    pages = guide_pages()
    if topic is None:
        texts = {name: page.read_text(encoding="utf-8") for name, page in pages.items()}
        titles = [(name, text.partition("\n")[0].removeprefix("# ")) for name, text in texts.items()]
        show_table(facts_table("hammerstein guide TOPIC", titles))
        return
    if topic not in pages:
        raise InputError("guide", f"has no page {topic!r}; the pages are {', '.join(pages)}")
    text = pages[topic].read_text(encoding="utf-8")
    if not sys.stdout.isatty():
        tell(text.rstrip())
        return
    from rich.console import Console
    from rich.markdown import Markdown

    Console().print(Markdown(text))


def guide_pages() -> dict[str, Path]:
    """Pages of the guide by name, those for beginners first."""
    found = {path.stem: path for path in sorted(GUIDE.glob("*.md"))}
    return {name: found[name] for name in dict.fromkeys([*FIRST, *found]) if name in found}

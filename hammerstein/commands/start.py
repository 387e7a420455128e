"""Commands for a person who begins: a working folder, what a file holds, the guide, voltages on a model."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from hammerstein.commands.record_options import AsJson, Overwrite
from hammerstein.commands.terminal import show as show_table, tell, tell_json


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to create; default: here.")] = Path(
        "."
    ),
    of: Annotated[
        str | None,
        typer.Option(
            "--of",
            metavar="NAME",
            help="Copy scenarios with their accepted numbers: paper, or those of a plug-in.",
        ),
    ] = None,
) -> None:
    """Create a working folder with an example.

    It has records, a model, a scenario, its numbers, and the next steps.
    """
    from hammerstein.commands.working_folder import folder_of, own_folder

    there = "" if folder == Path(".") else f"cd {shlex.quote(str(folder))}, then "
    if of is not None:
        folder_of(of, folder)
        tell(f"scenarios in {folder}; {there}hammerstein run . or hammerstein check .")
        return
    own_folder(folder)
    tell(f"the next steps are in {folder / 'README.md'}")
    tell(f"look at {folder / 'reports/circle/report.html'}; {there}hammerstein run .")


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

    found = contents_of(place_of(str(file)) if str(file) in packaged_actuators() else file)
    if as_json:
        tell_json({"file": str(file), "kind": found.kind, **dict(found.facts)})
        return
    show_table(facts_table(f"{file}: {found.kind}", found.facts))


def guide(
    topic: Annotated[str | None, typer.Argument(help="Page to show; default: list of all pages.")] = None,
) -> None:
    """Read the guide."""
    from hammerstein.commands.terminal_tables import facts_table
    from hammerstein.errors import InputError

    pages = guide_pages()
    if topic is None:
        titles = [(name, _title(page)) for name, page in pages.items()]
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


GUIDE = Path(__file__).parents[1] / "guide"
FIRST = ("start", "record", "identify", "compensators")


def guide_pages() -> dict[str, Path]:
    """Pages of the guide by name, those that a person begins with first."""
    found = {path.stem: path for path in sorted(GUIDE.glob("*.md"))}
    return {name: found[name] for name in dict.fromkeys([*FIRST, *found]) if name in found}


def _title(page: Path) -> str:
    return page.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")


def play(
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    drive: Annotated[
        Path, typer.Argument(help="CSV: time_s and one column for each input; V if no unit is named.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="File for the positions.")] = Path("played.csv"),
    sensor: Annotated[
        bool, typer.Option("--sensor", help="Simulate the model's converter and sensor, with noise.")
    ] = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a model's response to voltages.

    It is written to a file: the counterpart of compensate.
    """
    from hammerstein.commands.playing import PLAYED, played
    from hammerstein.commands.refusals import refuse_output, write_output
    from hammerstein.commands.terminal_tables import played_table
    from hammerstein.commands.watch import watched

    refuse_output(out, [Path(model), drive], PLAYED, overwrite)
    with watched() as onlooker:
        found = played(model, drive, sensor, onlooker)
        write_output(out, found.to_csv(onlooker.tell), PLAYED, overwrite)
    if as_json:
        tell_json({"played": str(out), **found.summary()})
        return
    show_table(played_table(found))
    tell(f"positions in {out}")

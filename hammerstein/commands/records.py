"""Commands that start from measured records."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands.jobs import PROCESSORS
from hammerstein.commands.option_groups import (
    AcceptOrder,
    AsJson,
    HeldBack,
    Identified,
    InLoop,
    Overwrite,
    RecordFiles,
    StaticBlock,
)
from hammerstein.commands.options import grouped, refuse_output, words_of
from hammerstein.commands.terminal import Spinner, complain, show, tell, tell_json, tell_kept, tell_statements
from hammerstein.errors import InputError, naming
from hammerstein.escaping import one_line

if TYPE_CHECKING:
    from hammerstein.identification.fit import Fit
    from hammerstein.identification.in_loop.identify import LoopSettings
    from hammerstein.identification.settings import Settings
    from hammerstein.model import HammersteinModel
    from hammerstein.records.loops import Loop
    from hammerstein.records.record import Record

MOST_NAMED = 3
"""Records whose names make up that of a folder."""
MOST_LOOPS = 8
"""Of each pair and record, in the table."""


def folder_name(files: Sequence[Path]) -> str:
    """Name of the folder of several records: no other set of records has it."""
    from hammerstein.reporting.figures.loops import file_labels

    labels = file_labels([str(file) for file in files])
    if len(labels) <= MOST_NAMED:
        return "_".join(labels)
    return f"{labels[0]}_and_{len(labels) - 1}_more_{sha256(repr(labels).encode()).hexdigest()[:6]}"


@grouped
def loops(
    recorded: RecordFiles,
    out: Annotated[Path, typer.Option(metavar="DIR", help="File or folder for the figure.")] = Path(
        "reports"
    ),
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figure.")] = True,
    accept_order: AcceptOrder = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Measure hysteresis loops in records.

    Of each loop: height, width, area, closure, drift.
    """
    from hammerstein.commands.terminal_tables import gains_table
    from hammerstein.records.gains import refuse_swapped
    from hammerstein.records.loops import loop_table, move_at_once, turned_backwards, without_loops
    from hammerstein.reporting.figures.loops import LOOPS, LOOPS_FILES, loops_of_records
    from hammerstein.runtime.manifest import refuse_name
    from hammerstein.runtime.staging import prepare_folder

    folder = out / folder_name(recorded.files)
    if figures:
        refuse_name(recorded.files[0])
        prepare_folder("--out", folder, LOOPS, LOOPS_FILES, overwrite)
    records = recorded.read(all_driven=False)
    if not accept_order:
        refuse_swapped(records)
    gains = recorded.gains(records)
    found = {record.source: loop_table(record) for record in records}
    empty = {record.source: without_loops(record) for record in records if not found[record.source]}
    if len(empty) == len(records) and not any(map(move_at_once, records)):
        raise InputError(*next(iter(empty.items())))
    for source, why in empty.items():
        complain(f"{source}: {why}")
    for record in records:
        if turned := turned_backwards(found[record.source]):
            complain(f"{record.source}: {turned}")
        for lost in record.outliers:
            complain(f"{record.source}: excluded outliers of {lost.column}: {lost.describe()}")
    if as_json:
        each = [(file, one) for file, own in found.items() for one in own]
        plain = [{"file": file, **asdict(one), "width_percent": one.width_percent} for file, one in each]
        tell_json({"loops": plain})
    else:
        show(gains_table(gains))
        if len(empty) < len(records):
            _show_loops(found)
    if figures:
        from hammerstein.reporting.figures import save_figures

        figure = loops_of_records(records, [found[record.source] for record in records])
        for path in save_figures({"loops": figure} if figure else {}, folder, LOOPS, overwrite):
            (complain if as_json else tell)(str(path))


def _show_loops(found: Mapping[str, Sequence[Loop]]) -> None:
    """Print the most informative loops of each file."""
    from hammerstein.commands.terminal_tables import loops_table
    from hammerstein.records.loops import telling_loops

    shown = {source: telling_loops(loops, MOST_LOOPS) for source, loops in found.items()}
    show(loops_table(shown))
    if (few := sum(map(len, shown.values()))) < (all_ := sum(map(len, found.values()))):
        tell(f"{few} of {all_} loops: for each pair the settled ones, or the widest; --json lists all")


@grouped
def identify(
    recorded: RecordFiles,
    held: HeldBack,
    identified: Identified,
    static: StaticBlock,
    in_loop: InLoop,
    out: Annotated[Path, typer.Option(metavar="FILE", help="File for the model.")] = Path("model.json"),
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the fit report; default: beside the model."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Identify a model from records and report its errors.

    The report has the limits of the model, too.
    """
    from hammerstein.commands.terminal_tables import fit_table
    from hammerstein.reporting.fit_page import ALWAYS, FIT, MODEL, Asked, answer, fit_json, write_fit
    from hammerstein.runtime.staging import prepare_folder

    refuse_output(out, [*recorded.files, *(held.validate or [])], MODEL, overwrite)
    held.refuse_fitted(recorded.files)
    settings: Settings | LoopSettings = in_loop.settings(identified.order) or identified.settings(
        hysteresis=static.hysteresis, dead_zones=static.dead_zones
    )
    in_loop.refuse_unused([*words_of(identified), *words_of(static)])
    folder = report or out.parent / f"{out.stem}_fit"
    prepare_folder("--report", folder, FIT, ALWAYS, overwrite)
    words = [word for group in (recorded, held, identified, static, in_loop) for word in words_of(group)]
    asked = Asked(out, recorded.files[: 1 if recorded.axes is None else 2], words)
    records, validation = recorded.read(), held.read(recorded)
    recorded.gains(records)
    model, fit = _identified(records, settings, validation, out)
    tell_kept(write_fit(model, fit, out, folder, figures, overwrite, asked))
    if in_loop.hysteresis_in_loop:
        search_file(out).unlink(missing_ok=True)
    if as_json:
        tell_json(json.loads(fit_json(model, fit)), indent=1, sort_keys=True)
        return
    show(fit_table(fit))
    tell_statements(answer(model, fit, folder, asked))


def search_file(model: Path) -> Path:
    """Where the progress of a search for hysteresis in the loop is kept until there is a model."""
    return model.with_name(f"{model.stem}.search.json")


def _identified(
    records: Sequence[Record], settings: Settings | LoopSettings, validation: Sequence[Record], out: Path
) -> tuple[HammersteinModel, Fit]:
    """Model and fit report, with progress on the terminal."""
    from hammerstein.identification.identify import identify as identify_model
    from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
    from hammerstein.quantities import LONGEST_NAME

    same: dict[str, Any] = {"validation": validation, "name": one_line(out.stem)[:LONGEST_NAME]}
    if not isinstance(settings, LoopSettings):
        with Spinner() as spinner:
            return identify_model(records, settings, progress=spinner.tell, **same)
    kept = search_file(out)
    with Spinner(f"searching; {kept} holds the progress, and the same command continues from it") as spinner:
        return identify_in_loop(records, settings, kept=kept, progress=spinner.tell, **same)


@grouped
def compare(
    recorded: RecordFiles,
    held: HeldBack,
    identified: Identified,
    in_loop: InLoop,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the comparison.")] = Path("compare"),
    jobs: Annotated[
        int, typer.Option(min=1, help="Parallel identifications.", show_default="the processors")
    ] = PROCESSORS,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figure.")] = True,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Fit every kind of model to records and recommend one.

    That is every kind of hysteresis, and linear models.
    """
    from hammerstein.commands.terminal_tables import comparison_table, facts_table, rates_table
    from hammerstein.comparison.compare import compare as compared
    from hammerstein.reporting.compare_page import ALWAYS, COMPARISON, next_command, write_comparison
    from hammerstein.runtime.staging import prepare_folder

    settings, loop = identified.settings(), in_loop.settings(identified.order)
    held.refuse_fitted(recorded.files)
    prepare_folder("--out", out, COMPARISON, ALWAYS, overwrite)
    records, validation = recorded.read(), held.read(recorded)
    recorded.gains(records)
    samples = sum(record.samples for record in records)
    begun = f"comparing every kind of model on {samples} samples; it takes several times as long as identify"
    with Spinner(begun) as spinner, naming("--hysteresis-in-loop", instead_of="in_loop"):

        def watch(what: str, done: int, total: int) -> None:
            spinner.tell(f"{what} ({done} of {total} fitted)" if done < total else what)

        found = compared(records, settings, validation=validation, in_loop=loop, jobs=jobs, progress=watch)
    tell_kept(write_comparison(found, out, figures, overwrite))
    if as_json:
        tell_json(json.loads(found.to_json()), indent=1, sort_keys=True)
        return
    show(comparison_table(found))
    if len(found.frequencies_hz) > 1:
        show(rates_table(found))
    if found.failed:
        show(facts_table("Not fitted", ((one.name, one.reason) for one in found.failed)))
    for sentence in found.sentences():
        tell(sentence)
    tell(f"comparison and model files in {out}; open {out / 'compare.html'}")
    if command := next_command(found, out):
        tell(f"Next: {command}")

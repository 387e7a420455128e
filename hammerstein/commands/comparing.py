"""The command that sets every kind of model side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hammerstein.commands.grouped import grouped
from hammerstein.commands.jobs import PROCESSORS
from hammerstein.commands.record_options import AsJson, HeldBack, Identified, InLoop, Overwrite, RecordFiles
from hammerstein.commands.terminal import show, tell, tell_json, tell_kept
from hammerstein.commands.watch import Spinner

if TYPE_CHECKING:
    from hammerstein.comparison.result import Comparison


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
    from hammerstein.comparison.compare import compare as compared
    from hammerstein.errors import naming
    from hammerstein.reporting.compare_page import ALWAYS, COMPARISON, next_command, write_comparison
    from hammerstein.runtime.storage.staging import prepare_folder

    settings, loop = identified.settings(), in_loop.settings(identified.order)
    held.refuse_fitted(recorded.files)
    prepare_folder("--out", out, COMPARISON, ALWAYS, overwrite)
    records, validation = recorded.read(), held.read(recorded)
    recorded.gains(records)
    samples = sum(record.samples for record in records)
    begun = f"comparing every kind of model on {samples} samples; long records take minutes"
    with Spinner(begun) as spinner, naming("--hysteresis-in-loop", instead_of="in_loop"):

        def watch(what: str, done: int, total: int) -> None:
            spinner.tell(f"{what} ({done} of {total} fitted)" if done < total else what)

        found = compared(records, settings, validation=validation, in_loop=loop, jobs=jobs, progress=watch)
    tell_kept(write_comparison(found, out, figures, overwrite))
    if as_json:
        tell_json(json.loads(found.to_json()), indent=1, sort_keys=True)
        return
    _show_comparison(found)
    tell(f"comparison and model files in {out}; open {out / 'compare.html'}")
    if command := next_command(found, out):
        tell(f"Next: {command}")


def _show_comparison(found: Comparison) -> None:
    """Print the tables, and what is recommended."""
    from hammerstein.commands.terminal_tables import comparison_table, failed_table, rates_table

    show(comparison_table(found))
    if len(found.frequencies_hz) > 1:
        show(rates_table(found))
    if found.failed:
        show(failed_table(found))
    for sentence in found.sentences():
        tell(sentence)

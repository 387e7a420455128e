"""The command that writes a drive which erases the past of an actuator."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hammerstein.commands.law_options import volts
from hammerstein.commands.record_options import AsJson, Overwrite
from hammerstein.commands.terminal import tell, tell_json, tell_statements


def degauss(
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="File for the voltages.")] = Path("degauss.csv"),
    frequency: Annotated[
        float, typer.Option(min=1e-3, metavar="HZ", help="Frequency of the alternation.")
    ] = 10.0,
    cycles: Annotated[int, typer.Option(min=1, max=10_000, help="Periods until the amplitude is zero.")] = 40,
    range_v: Annotated[
        str | None,
        typer.Option("--range", metavar="LOW,HIGH", help="Allowed voltages; default: recorded range."),
    ] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Write a drive that erases an actuator's history.

    The drive is a decaying alternation.
    """
    from hammerstein.commands.refusals import refuse_output, write_output
    from hammerstein.compensators.degauss import degauss_drive
    from hammerstein.compensators.drive_file import DRIVE, Terms
    from hammerstein.model import HammersteinModel

    refuse_output(out, [Path(model)], DRIVE, overwrite)
    terms = Terms(volts("--range", range_v))
    found = degauss_drive(HammersteinModel.load(model), frequency, cycles, terms)
    write_output(out, found.to_csv(), DRIVE, overwrite)
    if as_json:
        figures = {"before_um": found.before_um.tolist(), "after_um": found.after_um.tolist()}
        tell_json({"drive": str(out), **figures, "statements": found.statements()})
        return
    tell_statements(found.statements())
    tell(f"voltages in {out}")

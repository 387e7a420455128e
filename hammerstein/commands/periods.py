"""Periods of a periodic path: written as a drive file or a wave table, and learnt from a trial."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hammerstein.commands.law_options import volts
from hammerstein.commands.options import write_output
from hammerstein.commands.terminal import tell, tell_json, tell_statements
from hammerstein.errors import InputError

if TYPE_CHECKING:
    from hammerstein.compensators.cycle import Cycle
    from hammerstein.compensators.drive_file import Terms
    from hammerstein.compensators.path_file import Onlooker
    from hammerstein.runtime.manifest import Owner


class TableRequest(NamedTuple):
    """What a person asks of a wave table; no device: the period as a drive file."""

    device: str | None
    scale: str | None
    points: int | None

    def check(self) -> None:
        """Raise InputError for words that are none, before anything is computed."""
        from hammerstein.compensators.wave_table import DEVICES

        if self.device is None and (self.scale is not None or self.points is not None):
            raise InputError("--table-scale, --table-points", "need --table")
        if self.device is not None and self.device not in DEVICES:
            raise InputError("--table", f"{self.device!r} is not one of {', '.join(DEVICES)}")
        scale = self.factors()
        if scale is not None and (scale[0] == 0.0 or not all(map(math.isfinite, scale))):
            raise InputError(
                "--table-scale", "must be FACTOR or FACTOR,OFFSET, finite, with a factor other than 0"
            )

    def owner(self) -> Owner:
        """Who writes the file."""
        from hammerstein.compensators.drive_file import DRIVE
        from hammerstein.compensators.wave_table import WAVE_TABLE

        return DRIVE if self.device is None else WAVE_TABLE

    def factors(self) -> tuple[float, float] | None:
        """Factor and offset from volts to the numbers of the table."""
        scale = volts("--table-scale", self.scale)
        if scale is None:
            return None
        if len(scale) > 2:
            raise InputError("--table-scale", "must be FACTOR or FACTOR,OFFSET")
        return scale[0], scale[1] if len(scale) == 2 else 0.0

    def form(self, found: Cycle) -> tuple[list[str], list[float], str]:
        """What must be known of a period, its errors [um], and the text of its file."""
        from hammerstein.compensators.wave_table import wave_table
        from hammerstein.metrics import rms

        if self.device is None:
            return found.statements(), [rms(found.error_um)], found.to_csv()
        table = wave_table(found, self.device, self.factors(), self.points)
        return table.statements(), list(table.errors_um), table.text()


class Period(NamedTuple):
    """Options for one period of a path, and its output file."""

    model: str
    path: Path
    law: str
    options: dict[str, Any]
    terms: Terms
    out: Path
    table: TableRequest
    as_json: bool
    onlooker: Onlooker
    overwrite: bool

    def write(self, text: str, found: Cycle) -> None:
        """Write the period and its run-up."""
        from hammerstein.compensators.drive_file import DRIVE

        write_output(self.out, text, self.table.owner(), self.overwrite)
        write_output(run_up_of(self.out), found.run_up_csv(), DRIVE, self.overwrite)


def run_up_of(out: Path) -> Path:
    """File of the run-up of a period."""
    return out.with_name(f"{out.stem}.run_up.csv")


def write_cycle(asked: Period) -> None:
    """Write one settled period, as a drive file or as a wave table."""
    from hammerstein.compensators.cycle import cycle_of

    found = cycle_of(asked.model, asked.path, asked.law, asked.options, asked.terms, asked.onlooker)
    said, errors, text = asked.table.form(found)
    asked.write(text, found)
    _tell(asked, {"rms_um": errors}, said, "one period")


def write_ilc_update(
    asked: Period, trial: tuple[Path, Path], uncertainty: str, before: tuple[Path, Path] | None = None
) -> None:
    """Write the next period of a periodic path, from a trial."""
    from hammerstein.compensators.learning import ModelUncertainty, learn_from_files

    deviations = volts("--uncertainty", uncertainty) or ()
    if len(deviations) != 2 or not all(0.0 <= value < 1.0 for value in deviations):
        raise InputError(
            "--uncertainty", f"{uncertainty!r} must be two relative standard deviations, such as 0.05,0.01"
        )
    work = (asked.model, asked.path, asked.law, asked.options, trial, ModelUncertainty(*deviations))
    found, taught = learn_from_files(*work, asked.terms, asked.onlooker, before)
    about, errors, text = asked.table.form(found)
    asked.write(text, found)
    figures = {"error_rms_um": taught.error_rms_um, "noise_um": taught.noise_um, "rms_um": errors}
    _tell(asked, {"finished": taught.finished, **figures}, [taught.statement(), *about], "next period")


def _tell(asked: Period, figures: dict[str, Any], said: list[str], what: str) -> None:
    run_up = run_up_of(asked.out)
    if asked.as_json:
        tell_json({"drive": str(asked.out), "run_up": str(run_up), **figures, "statements": said})
        return
    tell_statements(said)
    tell(f"run-up in {run_up}, {what} in {asked.out}")

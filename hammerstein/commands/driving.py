"""Commands on a model: drives for a path, degaussing, simulation, and code export.

Before them stand the groups of their options: of a law, and of its drive.
"""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands.options import (
    AsJson,
    Overwrite,
    option_of,
    refuse_output,
    told_by_options,
    with_help,
    write_output,
)
from hammerstein.commands.terminal import show, tell, tell_json, tell_kept, tell_statements, watched
from hammerstein.errors import InputError

if TYPE_CHECKING:
    from hammerstein.compensators.cycle import Cycle
    from hammerstein.compensators.drive_file import Terms
    from hammerstein.compensators.learning import IlcUpdate
    from hammerstein.compensators.path_file import Onlooker
    from hammerstein.runtime.staging import Owner


Asked = tuple[str, Path, str, dict[str, Any]]
"""Model, path, law and options."""
RangeWords = Annotated[
    str | None,
    typer.Option("--range", metavar="LOW,HIGH", help="Allowed voltages; default: recorded range."),
]


@dataclass(frozen=True)
class LawWords:
    """Options of laws."""

    filter_hz: float | None = with_help("Bandwidth of the reference filter.")
    preview_s: float | None = with_help("How far ahead the path is known.", metavar="S")
    softening_v: float | None = with_help("Voltage over which drive jumps are spread.")
    gain: str | None = with_help("For inverse_multiplicative: auto or identity.")
    option: list[str] | None = with_help("Another option of the law, as in a scenario.", metavar="KEY=VALUE")

    def options(self) -> dict[str, Any]:
        """Given options, by their names in a scenario.

        Raises InputError for a gain that no word stands for, and for an option without a key or given twice.
        """
        if self.gain not in (None, "auto", "identity"):
            what = f"must be auto or identity, not {self.gain!r}; put a matrix into a scenario"
            raise InputError("--gain", what)
        known = {name: value for name, value in vars(self).items() if value is not None and name != "option"}
        own = [words.partition("=") for words in self.option or ()]
        for i, (name, sign, _) in enumerate(own):
            if not sign or not name.isidentifier():
                raise InputError("--option", f"{name + sign!r} has no key or no value; write KEY=VALUE")
            if name in known or name in [other for other, _, _ in own[:i]]:
                raise InputError("--option", f"{name} is given twice; remove one of them")
        return known | {name: _value(words) for name, _, words in own}

    @property
    def own(self) -> frozenset[str]:
        """Keys from ``--option``."""
        return frozenset(words.partition("=")[0] for words in self.option or ())


def _value(words: str) -> Any:
    """Value of an option in the words of a scenario file; other words are a text.

    >>> _value("[1, 2]"), _value("0.5"), _value("auto")
    ([1, 2], 0.5, 'auto')
    """
    try:
        return tomllib.loads(f"value = {words}")["value"]
    except tomllib.TOMLDecodeError:
        return words


Conditioned = Annotated[
    bool | None,
    typer.Option(
        "--conditioned/--at-rest",
        help="The actuator was driven to HIGH, then LOW, before the start, or not; default: as before the "
        "records.",
        show_default=False,
    ),
]


@dataclass(frozen=True)
class Sent:
    """Range of the drive, and initial state of the actuator."""

    range_v: RangeWords = None
    start_v: str | None = with_help(
        "Voltage before the first sample; the path is zero there.", metavar="V[,V]"
    )
    conditioned: Conditioned = None
    accept_flagged: bool = with_help("Accept a model that its fit report flags.", default=False)

    def parsed(self) -> dict[str, Any]:
        """The same by name, with numbers in place of words."""
        return vars(self) | {
            name: volts(option_of(name), getattr(self, name)) for name in ("range_v", "start_v")
        }


@dataclass(frozen=True)
class Reached:
    """Options for a path that is out of reach."""

    lead_in: bool = with_help("First move from the initial position to the start of the path.", default=False)
    offset_um: str | None = with_help("Shift of the path in um.", metavar="UM[,UM]")
    approach_um: str | None = with_help(
        "Reach every hold from one side, against backlash: -5 from 5 um below, 5 from above.",
        metavar="UM[,UM]",
    )
    units: str | None = with_help("Unit of the path, if its columns name none.", metavar="nm|um|mm|m")
    clip: bool = with_help("Accept a path that is partly out of reach.", default=False)
    beyond_records: bool = with_help("Accept voltages beyond the records.", default=False)

    def terms(self, sent: Sent, step_v: float | None) -> Terms:
        """Limits of a drive."""
        from hammerstein.compensators.drive_file import Terms

        moved = {name: volts(option_of(name), getattr(self, name)) for name in ("offset_um", "approach_um")}
        return Terms(**sent.parsed(), **vars(self) | moved, step_v=step_v)

    def refuse_with_period(self) -> None:
        """Raise InputError for options that a period does not use, because it has a run-up."""
        given = ["--lead-in"] * self.lead_in + ["--approach-side"] * (self.approach_um is not None)
        if given:
            what = "leave it out with --cycle, --table or --learn, whose drives begin with a run-up"
            raise InputError(", ".join(given), what)


def volts(option: str, words: str | None) -> tuple[float, ...] | None:
    """Comma-separated voltages of an option.

    Raises InputError for words that are none.

    >>> volts("--range", "0,120")
    (0.0, 120.0)
    """
    if words is None:
        return None
    try:
        return tuple(float(word) for word in words.split(","))
    except ValueError:
        raise InputError(option, f"{words!r} is not a list of numbers with commas between them") from None


@dataclass(frozen=True)
class TableRequest:
    """Options of a wave table; without a device, the period becomes a drive file."""

    table: str | None = with_help("Write this period as a wave table.", metavar="pi|nv200|csv")
    table_scale: str | None = with_help("From V to the unit of the table.", metavar="FACTOR[,OFFSET]")
    table_points: int | None = with_help("Largest number of points of the table.", min=2)

    def factors(self) -> tuple[float, float] | None:
        """Factor and offset from volts to the numbers of the table, if they are given.

        Raises InputError for words that are none.
        """
        from hammerstein.compensators.wave_table import DEVICES

        if self.table is None and (self.table_scale is not None or self.table_points is not None):
            raise InputError("--table-scale, --table-points", "need --table")
        if self.table is not None and self.table not in DEVICES:
            raise InputError("--table", f"{self.table!r} is not one of {', '.join(DEVICES)}")
        factors = volts("--table-scale", self.table_scale)
        if factors is None:
            return None
        if len(factors) > 2:
            raise InputError("--table-scale", "must be FACTOR or FACTOR,OFFSET")
        if factors[0] == 0.0 or not all(map(math.isfinite, factors)):
            raise InputError(
                "--table-scale", "must be FACTOR or FACTOR,OFFSET, finite, with a factor other than 0"
            )
        return factors[0], factors[1] if len(factors) == 2 else 0.0

    def owner(self) -> Owner:
        """Owner of the file."""
        from hammerstein.compensators.drive_file import DRIVE
        from hammerstein.compensators.wave_table import WAVE_TABLE

        return DRIVE if self.table is None else WAVE_TABLE

    def form(self, found: Cycle) -> tuple[list[str], list[float], str]:
        """Statements on a period, its errors [um], and the text of its file."""
        from hammerstein.compensators.wave_table import wave_table
        from hammerstein.metrics import rms

        if self.table is None:
            return found.statements(), [rms(found.error_um)], found.to_csv()
        table = wave_table(found, self.table, self.factors(), self.table_points)
        return table.statements(), list(table.errors_um), table.text()


@dataclass(frozen=True)
class Trials:
    """Files of the trial and the previous one, and uncertainty of the model."""

    learn: tuple[Path, Path] | None = with_help(
        "Drive and measurement of a trial; writes the next drive.", metavar="DRIVE MEASURED"
    )
    before: tuple[Path, Path] | None = with_help(
        "The previous trial: its drive is kept if the new trial is worse.", metavar="DRIVE MEASURED"
    )
    uncertainty: str | None = with_help(
        "Relative standard deviations of weights and resonances for --learn; default: 0.05,0.01.",
        metavar="W,R",
    )

    def name_other_model(self, model: str) -> None:
        """Note a drive that was computed for another model than this one."""
        from hammerstein.commands.playing import initial_state
        from hammerstein.model import HammersteinModel

        if self.learn and self.learn[0].is_file():
            initial_state(self.learn[0], HammersteinModel.load(model))

    def refuse_lone(self) -> None:
        """Raise InputError for options of a trial without a trial."""
        if self.uncertainty is not None and self.learn is None:
            raise InputError("--uncertainty", "applies to --learn; give --learn DRIVE MEASURED too")
        if self.before is not None and self.learn is None:
            raise InputError("--before", "is the trial before --learn; give --learn DRIVE MEASURED too")

    def period(self, asked: Asked, terms: Terms, onlooker: Onlooker) -> tuple[Cycle, IlcUpdate | None]:
        """Period of a path, and its update from the trial, if there is one."""
        from hammerstein.compensators.cycle import cycle_of

        if self.learn is None:
            return cycle_of(*asked, terms, onlooker), None
        from hammerstein.compensators.learning import ModelUncertainty, learn_from_files

        words = self.uncertainty or "0.05,0.01"
        deviations = volts("--uncertainty", words) or ()
        if len(deviations) != 2 or not all(0.0 <= value < 1.0 for value in deviations):
            raise InputError(
                "--uncertainty", f"{words!r} must be two relative standard deviations, such as 0.05,0.01"
            )
        known = ModelUncertainty(*deviations)
        return learn_from_files(*asked, self.learn, known, terms, onlooker, self.before)


def compensate(
    *,
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    reference: Annotated[
        Path, typer.Argument(help="CSV: time_s and one column for each axis; um if no unit is named.")
    ],
    law: str = with_help(
        "hammerstein_inverse, exact_inverse, inverse_multiplicative, decoupled_inverse or none.",
        default="hammerstein_inverse",
    ),
    words: LawWords,
    sent: Sent,
    converter_step: float | None = with_help(
        "Step of the converter; default: that of the model file.", metavar="V"
    ),
    out: Path = with_help("File for the voltages.", default=Path("drive.csv"), metavar="FILE"),
    cycle: bool = with_help("The path is one period; write one settled period.", default=False),
    wanted: TableRequest,
    trials: Trials,
    reached: Reached,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Compute the voltages that follow a path.

    The predicted response is written beside them.
    """
    from hammerstein.commands.terminal_tables import compensation_table
    from hammerstein.compensators.drive_file import DRIVE, compensate as compensated

    trials.refuse_lone()
    options = words.options()
    wanted.factors()  # words that are none are refused before anything is computed
    read = [Path(model), reference, *(trials.learn or ()), *(trials.before or ())]
    refuse_output(out, read, wanted.owner(), overwrite)
    periodic = cycle or wanted.table is not None or trials.learn is not None
    run_up = out.with_name(f"{out.stem}.run_up.csv")
    if periodic:
        refuse_output(run_up, read, DRIVE, overwrite)
    asked, terms = (model, reference, law, options), reached.terms(sent, converter_step)
    with told_by_options("compensate", words.own), watched() as onlooker:
        if periodic:
            reached.refuse_with_period()
            trials.name_other_model(model)
            period, taught = trials.period(asked, terms, onlooker)
            _write_period((out, run_up), period, taught, wanted, overwrite, as_json)
            return
        found = compensated(*asked, terms, onlooker)
        write_output(out, found.to_csv(tell=onlooker.tell), wanted.owner(), overwrite)
    if as_json:
        tell_json({"drive": str(out), **found.summary()})
        return
    show(compensation_table(found))
    tell_statements(found.essentials())
    tell(f"voltages in {out}, for the stage of model {found.model.origin}; see the notes at its end")


def degauss(
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    out: Path = with_help("File for the voltages.", default=Path("degauss.csv"), metavar="FILE"),
    frequency: float = with_help("Frequency of the alternation.", default=10.0, min=1e-3, metavar="HZ"),
    cycles: int = with_help("Periods until the amplitude is zero.", default=40, min=1, max=10_000),
    range_v: RangeWords = None,
    beyond_records: bool = with_help("Accept voltages beyond the records.", default=False),
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Write a drive that erases an actuator's history.

    The drive is a decaying alternation.
    """
    from hammerstein.compensators.degauss import degauss_drive
    from hammerstein.compensators.drive_file import DRIVE, Terms
    from hammerstein.model import HammersteinModel

    refuse_output(out, [Path(model)], DRIVE, overwrite)
    terms = Terms(volts("--range", range_v), beyond_records=beyond_records)
    found = degauss_drive(HammersteinModel.load(model), frequency, cycles, terms)
    write_output(out, found.to_csv(), DRIVE, overwrite)
    if as_json:
        figures = {"before_um": found.before_um.tolist(), "after_um": found.after_um.tolist()}
        tell_json({"drive": str(out), **figures, "statements": found.statements()})
        return
    tell_statements(found.statements())
    tell(f"voltages in {out}")


def play(
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    drive: Annotated[
        Path, typer.Argument(help="CSV: time_s and one column for each input; V if no unit is named.")
    ],
    out: Path = with_help("File for the positions.", default=Path("played.csv"), metavar="FILE"),
    sensor: bool = with_help("Simulate the model's converter and sensor, with noise.", default=False),
    conditioned: Conditioned = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a model's response to voltages.

    It is written to a file: the counterpart of compensate.
    """
    from hammerstein.commands.playing import PLAYED, played
    from hammerstein.commands.terminal_tables import played_table

    refuse_output(out, [Path(model), drive], PLAYED, overwrite)
    with watched() as onlooker:
        found = played(model, drive, sensor, onlooker, conditioned)
        write_output(out, found.to_csv(onlooker.tell), PLAYED, overwrite)
    if as_json:
        tell_json({"played": str(out), **found.summary()})
        return
    show(played_table(found))
    tell(f"positions in {out}")


FORMATS = ("c", "fmu")


def export(
    *,
    model: Annotated[str | None, typer.Argument(help="Model file, or packaged actuator.")] = None,
    law: str = with_help(
        "A law of compensate, or model: the actuator itself; the default needs no path in advance.",
        default="exact_inverse",
    ),
    form: str = with_help("c: C99; fmu: the same C code as an FMU.", "--format", default="c"),
    fmi: int | None = with_help("Write an FMU of FMI 2 or 3.", metavar="2|3"),
    out: Path | None = with_help("Folder for the code.", metavar="DIR"),
    check: Path | None = with_help("Repeat an export and compare the files.", metavar="DIR"),
    sample_time: float | None = with_help("Sample time; default: that of the model's drive.", metavar="S"),
    words: LawWords,
    sent: Sent,
    float32: bool = with_help("Compute in single precision.", default=False),
    overwrite: Overwrite = False,
    as_json: bool = with_help("Print one JSON object.", "--json", default=False),
) -> None:
    """Export a law or a model as C code or as an FMU.

    The code runs without Python.
    """
    from hammerstein.export.folder import ALWAYS, EXPORT, check_export, write_export
    from hammerstein.export.request import request_of
    from hammerstein.runtime.staging import prepare_folder

    if check is not None and model is None:
        files = check_export(check)
        if as_json:
            tell_json({"check": str(check), "files": files})
        else:
            tell(f"{check}: all {len(files)} files match the model")
        return
    if check is not None or model is None:
        raise InputError("export", "give a model and --out DIR, or only --check DIR")
    if form not in FORMATS:
        raise InputError("--format", f"{form!r} is not one of {', '.join(FORMATS)}")
    if fmi not in (None, 2, 3):
        raise InputError("--fmi", f"{fmi} is not one of 2, 3")
    if out is None:
        raise InputError("--out", "name a folder for the code")
    with told_by_options("compensate", words.own):
        prepare_folder("--out", out, EXPORT, ALWAYS, overwrite)
        request, loaded = request_of(
            model,
            law,
            sample_time,
            fmi=fmi or 3,
            options=words.options(),
            **sent.parsed(),
            float32=float32,
            form=form if fmi is None else "fmu",
        )
        written = write_export(request, loaded, out, overwrite)
    tell_kept(written.kept)
    if as_json:
        tell_json({"export": str(out), "statements": written.statements, "files": written.files})
        return
    tell_statements(written.statements)
    tell(f"{', '.join(written.files)} in {out}; run make check there to replay golden.csv")


def _write_period(
    files: tuple[Path, Path],
    period: Cycle,
    taught: IlcUpdate | None,
    wanted: TableRequest,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write a period of a path and its run-up, and state the result of the trial, if there was one."""
    from hammerstein.compensators.drive_file import DRIVE

    (out, run_up), (said, errors, text) = files, wanted.form(period)
    write_output(out, text, wanted.owner(), overwrite)
    write_output(run_up, period.run_up_csv(*(wanted.factors() or ())), DRIVE, overwrite)
    learnt = ("finished", "error_rms_um", "noise_um")
    figures = {name: getattr(taught, name) for name in learnt} if taught else {"rms_um": errors}
    said = said if taught is None else [taught.statement(), *said]
    if as_json:
        tell_json({"drive": str(out), "run_up": str(run_up), **figures, "statements": said})
        return
    tell_statements(said)
    word = "one" if taught is None else "previous" if taught.worse else "same" if taught.finished else "next"
    tell(f"run-up in {run_up}, {word} period{' again' * (word in ('previous', 'same'))} in {out}")

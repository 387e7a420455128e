"""Commands on measured records, and their groups of options."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands.options import (
    AsJson,
    Overwrite,
    refuse_output,
    told_by_options,
    with_help,
    words_of,
)
from hammerstein.commands.terminal import Spinner, complain, show, tell, tell_json, tell_kept, tell_statements
from hammerstein.errors import InputError
from hammerstein.escaping import one_line
from hammerstein.runtime.resources import processors

if TYPE_CHECKING:
    from hammerstein.identification.fit import Fit
    from hammerstein.identification.in_loop.identify import LoopSettings
    from hammerstein.identification.options import CascadeOptions, KindOptions
    from hammerstein.identification.settings import Settings
    from hammerstein.model import HammersteinModel
    from hammerstein.records.gains import Gain
    from hammerstein.records.loops import Loop
    from hammerstein.records.record import Record
    from hammerstein.validation import Strict

MOST_NAMED = 3
"""Most records in the name of a folder."""
MOST_LOOPS = 8
"""Most loops of each pair and record in the table."""


@dataclass(frozen=True)
class RecordFiles:
    """Records of one actuator, and how their files are read."""

    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", help="Records: CSV, .dat, .npy, .mat, HDF5, Parquet, .xlsx, TDMS."),
    ]
    inputs: str | None = with_help(
        "Voltage columns, by name or number; default: by their units.", metavar="COL[,COL]"
    )
    outputs: str | None = with_help("Displacement columns; default: by their units.", metavar="COL[,COL]")
    axes: str | None = with_help(
        "Files are pairs of arrays, voltages then displacements, with these axes: sample, "
        "channel, experiment, period. --inputs and --outputs then name variables.",
        metavar="NAME[,NAME]",
    )
    rate: float | None = with_help("Sampling rate.", metavar="HZ")
    time: str | None = with_help("Time column in s, instead of --rate; default: by its unit.", metavar="COL")
    input_scale: float | None = with_help(
        "Factor from the numbers to V; default: from the unit.", metavar="S"
    )
    output_scale: float | None = with_help(
        "Factor from the numbers to um; default: from the unit.", metavar="S"
    )
    units: str | None = with_help(
        "Unit of the displacements, if their names have none.", metavar="nm|um|mm|m"
    )
    accept_gain: bool = with_help("Accept an unlikely gain in um/V.", default=False)

    def read(self, held: Sequence[Path] | None = None, all_driven: bool = True) -> tuple[Record, ...]:
        """Records to fit, or validation records."""
        from hammerstein.records.reading import read_records

        files, scale = self.files if held is None else held, self._scale()
        if self.axes is not None:
            return tuple(record for pair in self._pairs(files) for record in self._of(*pair, all_driven))
        return read_records(
            files,
            inputs=_columns(self.inputs),
            outputs=_columns(self.outputs),
            rate_hz=self.rate,
            time=self.time,
            input_scale=self.input_scale,
            output_scale=scale,
            all_driven=all_driven,
        )

    def _scale(self) -> float | None:
        """Factor from the displacements of the files to um, where an option gives it."""
        from hammerstein.signals.units import displacement_factor

        if self.units is None:
            return self.output_scale
        if self.output_scale is not None:
            raise InputError("--units", "repeats --output-scale; remove one of them")
        return displacement_factor(self.units)

    def _named_unit(self) -> bool:
        """Whether the unit of every displacement is known from an option or a name, not taken to be um."""
        from hammerstein.signals.units import unit_in

        if self.units is not None or self.output_scale is not None:
            return True
        columns = _columns(self.outputs)
        return self.axes is None if columns is None else all(unit_in(name) is not None for name in columns)

    def _pairs(self, files: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
        """Files with voltages and with displacements, in the order in which they were given."""
        if len(files) % 2:
            what = "files come in pairs, first voltages, then displacements; "
            raise InputError("--axes", f"{what}{files[-1]} has no partner")
        return zip(files[::2], files[1::2], strict=True)

    def _of(self, voltages: Path, displacements: Path, all_driven: bool) -> tuple[Record, ...]:
        from hammerstein.records.reading import read_paired_records

        if self.rate is None or self.time is not None:
            raise InputError("--axes", "pairs of arrays have no time column: use --rate instead of --time")
        scale = self._scale()
        with told_by_options("axes"):
            return read_paired_records(
                voltages,
                displacements,
                axes=_columns(self.axes) or (),
                rate_hz=self.rate,
                input_scale=1.0 if self.input_scale is None else self.input_scale,
                output_scale=1.0 if scale is None else scale,
                variables=(self.inputs, self.outputs),
                all_driven=all_driven,
            )

    def gains(self, records: Sequence[Record]) -> list[Gain]:
        """Gains of the records; implausible ones need confirmation, or raise InputError in a script."""
        from hammerstein.records import gains as found

        if self.rate is None:
            for clock in found.doubtful_clocks(records):
                complain(clock)
        gains = found.pair_gains(records)
        for order in found.doubtful_order(gains):
            complain(f"{order}: if columns were exchanged, correct --inputs, --outputs or the files")
        if self.accept_gain:
            return gains
        doubts = [*found.doubtful_responses(records)]
        unsure = [] if doubts or self._named_unit() else found.doubtful_units(gains)
        if unsure:
            raise InputError(records[0].source, f"{unsure[0]}; name the unit: --units nm, um or mm")
        doubts += [*found.doubtful_gains(gains), *found.doubtful_jumps(records)]
        if doubts:
            doubt = "; ".join(doubts)
            asked = sys.stdin.isatty() and sys.stderr.isatty()
            if not (asked and typer.confirm(f"{doubt}. Is this right?", err=True)):
                source = records[0].source if len(records) == 1 else f"{len(records)} records"
                doubt = doubt.replace(f" of {source}", "")  # the message begins with it
                remedy = "check --inputs, --outputs and their scales, or accept the gain with --accept-gain"
                raise InputError(source, f"{doubt}; {remedy}")
        return gains


def _columns(words: str | None) -> list[str] | None:
    return None if words is None else [word.strip() for word in words.split(",") if word.strip()]


@dataclass(frozen=True)
class Validation:
    """Validation records."""

    validate: list[Path] | None = with_help("Validation record; may be repeated.", metavar="FILE")

    def read(self, recorded: RecordFiles) -> tuple[Record, ...]:
        """Read the validation records with the settings of the fitted ones."""
        return recorded.read(self.validate, all_driven=False) if self.validate else ()

    def refuse_fitted(self, files: Sequence[Path]) -> None:
        """Refuse a validation record that is also fitted."""
        fitted = {file.resolve() for file in files}
        twice = sorted({str(file) for file in self.validate or () if file.resolve() in fitted})
        if twice:
            raise InputError(
                "--validate", f"{twice[0]} is also a fitted record; use another record for validation"
            )


OF_THE_LOOP = ("--order", "--accept-order", "--sensor-bandwidth", "--sensor-delay")
"""Options of a cascade that the search for hysteresis in the loop uses, too."""


@dataclass(frozen=True)
class InLoop:
    """Hysteresis in the loop of the dynamics."""

    hysteresis_in_loop: bool = with_help(
        "Plays in the loop of a state space, for resonances that move with the amplitude.", default=False
    )
    minutes: float = with_help("Time limit of --hysteresis-in-loop.", default=60.0, min=0.1, max=1440.0)

    def refuse_unused(self, words: Sequence[str]) -> None:
        """Refuse options of other models, which its search would ignore."""
        unused = [word for word in words if word.startswith("--") and word not in OF_THE_LOOP]
        if self.hysteresis_in_loop and unused:
            raise InputError("--hysteresis-in-loop", f"does not use {', '.join(unused)}; remove it")

    def settings(self, *asked: Strict) -> tuple[Settings, LoopSettings | None]:
        """Settings of cascades, and those of its search; None if not requested."""
        from hammerstein.identification.settings import Settings

        given = {name: value for options in asked for name, value in options.model_dump().items()}
        order = given["order"]
        if self.hysteresis_in_loop and given["dynamics"] != "state_space":
            given["order"] = None
        with told_by_options("Settings"):
            cascade = Settings(**given)
        if not self.hysteresis_in_loop:
            return cascade, None
        from hammerstein.identification.in_loop.identify import LoopSettings

        with told_by_options("LoopSettings"):
            return cascade, LoopSettings(order=order, minutes=self.minutes).with_sensor(cascade)


def folder_name(files: Sequence[Path]) -> str:
    """Unique name of the folder of several records."""
    from hammerstein.reporting.figures.loops import file_labels

    labels = file_labels([str(file) for file in files])
    if len(labels) <= MOST_NAMED:
        return "_".join(labels)
    return f"{labels[0]}_and_{len(labels) - 1}_more_{sha256(repr(labels).encode()).hexdigest()[:6]}"


def loops(
    recorded: RecordFiles,
    out: Path = with_help("File or folder for the figure.", default=Path("reports"), metavar="DIR"),
    figures: bool = with_help("Draw the figure.", default=True),
    accept_order: bool = with_help("Accept the columns although an output leads.", default=False),
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Measure hysteresis loops in records.

    Of each loop: height, width, area, closure, drift.
    """
    from hammerstein.commands.terminal_tables import gains_table
    from hammerstein.records.gains import refuse_swapped
    from hammerstein.records.loops import loop_table, move_at_once, ringing, turned_backwards, without_loops
    from hammerstein.reporting.figures.loops import LOOPS, LOOPS_FILES, loops_of_records
    from hammerstein.runtime.staging import prepare_folder, refuse_name

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
        for doubt in (turned_backwards(found[record.source]), ringing(record, found[record.source])):
            if doubt:
                complain(f"{record.source}: {doubt}")
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
        tell(f"{few} of {all_} loops shown, settled or else the widest of a pair; all: --json")


def identify(
    recorded: RecordFiles,
    held: Validation,
    cascade: CascadeOptions,
    block: KindOptions,
    in_loop: InLoop,
    out: Path = with_help("File for the model.", default=Path("model.json"), metavar="FILE"),
    report: Path | None = with_help("Folder for the fit report; default: beside the model.", metavar="DIR"),
    figures: bool = with_help("Draw figures.", default=True),
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
    settings, loop = in_loop.settings(cascade, block)
    in_loop.refuse_unused([*words_of(cascade), *words_of(block)])
    folder = report or out.parent / f"{out.stem}_fit"
    prepare_folder("--report", folder, FIT, ALWAYS, overwrite)
    words = [word for group in (recorded, held, cascade, block, in_loop) for word in words_of(group)]
    asked = Asked(out, recorded.files[: 1 if recorded.axes is None else 2], words)
    records, validation = recorded.read(), held.read(recorded)
    recorded.gains(records)
    model, fit = _identified(records, loop or settings, validation, out)
    tell_kept(write_fit(model, fit, out, folder, figures, overwrite, asked))
    if in_loop.hysteresis_in_loop:
        for file in search_files(out):
            file.unlink(missing_ok=True)
    if as_json:
        tell_json(json.loads(fit_json(model, fit)), indent=1, sort_keys=True)
        return
    show(fit_table(fit))
    tell_statements(answer(model, fit, folder, asked))


def search_files(model: Path) -> tuple[Path, Path]:
    """Files for progress and best model of a search for hysteresis in the loop, until it ends."""
    return model.with_name(f"{model.stem}.search.json"), model.with_name(f"{model.stem}.partial.json")


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
    kept, playable = search_files(out)
    begun = (
        f"searching; {kept} will hold every finished part, from which the same command continues, "
        f"and {playable} the best model so far"
    )
    same |= {"kept": kept, "playable": playable}
    with Spinner(begun) as spinner:
        return identify_in_loop(records, settings, progress=spinner.tell, **same)


def compare(
    recorded: RecordFiles,
    held: Validation,
    cascade: CascadeOptions,
    in_loop: InLoop,
    out: Path = with_help("Folder for the comparison.", default=Path("compare"), metavar="DIR"),
    jobs: int = with_help(
        "Parallel identifications.", default=processors(), min=1, show_default="the processors"
    ),
    figures: bool = with_help("Draw the figure.", default=True),
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

    settings, loop = in_loop.settings(cascade)
    held.refuse_fitted(recorded.files)
    prepare_folder("--out", out, COMPARISON, ALWAYS, overwrite)
    records, validation = recorded.read(), held.read(recorded)
    recorded.gains(records)
    samples = sum(record.samples for record in records)
    begun = f"comparing every kind of model on {samples} samples; it takes several times as long as identify"
    with Spinner(begun) as spinner:

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

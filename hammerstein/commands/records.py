"""Commands that start from measured records."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hammerstein.commands.law_options import (
    AcceptFlagged,
    Conditioned,
    FilterHz,
    LawGain,
    Preview,
    PreviewS,
    Range,
    SofteningV,
    Start,
    volts,
)
from hammerstein.commands.record_options import (
    AcceptGain,
    AsJson,
    CreepModes,
    DelaySamples,
    DynamicsOption,
    Files,
    Inputs,
    InputScale,
    Operators,
    Order,
    Outputs,
    OutputScale,
    Placing,
    Rate,
    Ridge,
    SensorBandwidth,
    Thresholds,
    Time,
    Validate,
    Weights,
)
from hammerstein.commands.terminal import complain, hushed, show, tell, tell_json
from hammerstein.escaping import clean

if TYPE_CHECKING:
    from hammerstein.files import Content
    from hammerstein.records.gains import Gain
    from hammerstein.records.record import Record

_ALONE = ("start", "range")
"""Options whose own values make a message of their own."""
_OPTIONS = {
    "sample_time_s": "sample-time",
    "range_v": "range",
    "start_v": "start",
    "sensor_bandwidth_hz": "sensor-bandwidth",
    "thresholds_v": "thresholds",
}
MOST_NAMED = 3
"""Records whose names make up that of a folder."""
MOST_LOOPS = 8
"""Of each pair and record, in the table."""


def refuse_output(out: Path, inputs: list[Path], content: Content) -> None:
    """Refuse an output that cannot be written, holds something else, or is one of the files that are read."""
    from hammerstein.errors import InputError
    from hammerstein.files import refuse_overwriting, refuse_unwritable

    refuse_unwritable("--out", out.parent)
    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError("--out", f"{out} is one of the files that are read; choose another name")
    refuse_overwriting("--out", out, content)


def refuse_fitted(held: Sequence[Path], files: Sequence[Path]) -> None:
    """Refuse records that are held back and fitted at once."""
    from hammerstein.errors import InputError

    twice = sorted({str(f) for f in held if f.resolve() in {g.resolve() for g in files}})
    if twice:
        raise InputError(
            "--validate", f"{twice[0]} is among the records that are fitted; hold back another one"
        )


def _columns(words: str) -> list[str]:
    return [word.strip() for word in words.split(",") if word.strip()]


def _option_of(where: str) -> str:
    """Option that gave a setting; nothing where the mistake is of them together."""
    name = where.partition("[")[0]
    return f"--{_OPTIONS.get(name, name.replace('_', '-'))}" * bool(name)


@contextmanager
def told_by_options(source: str) -> Iterator[None]:
    """Let the mistakes in what a function was told name the options that told it."""
    from hammerstein.errors import InputError

    try:
        yield
    except InputError as error:
        if error.source in _ALONE:
            raise InputError(f"--{error.source}", error.mistakes) from None
        if error.source != source:
            raise
        named = [m._replace(where=_option_of(m.where)) for m in error.mistakes]
        raise InputError("options", named) from None


def reader(
    inputs: str,
    outputs: str,
    rate: float | None,
    time: str | None,
    input_scale: float | None,
    output_scale: float | None,
) -> partial[tuple[Record, ...]]:
    """How the files of a command are read."""
    from hammerstein.records.reading import read_records

    return partial(
        read_records,
        inputs=_columns(inputs),
        outputs=_columns(outputs),
        rate_hz=rate,
        time=time,
        input_scale=input_scale,
        output_scale=output_scale,
    )


def checked_gains(records: Sequence[Record], accepted: bool) -> list[Gain]:
    """Gains of the records; a person is asked about those that no actuator has, a script is refused."""
    from hammerstein.errors import InputError
    from hammerstein.records.gains import doubtful_gains, pair_gains

    gains = pair_gains(records)
    doubts = [] if accepted else doubtful_gains(gains)
    if doubts:
        doubt = "; ".join(doubts)
        asked = sys.stdin.isatty() and sys.stderr.isatty()
        if not (asked and typer.confirm(f"{doubt}. Is that right?", err=True)):
            source = records[0].source if len(records) == 1 else f"{len(records)} records"
            remedy = "see --input-scale and --output-scale, or give --accept-gain if it is right"
            raise InputError(source, f"{doubt}; {remedy}")
    return gains


def folder_name(files: Sequence[Path]) -> str:
    """Name of the folder of several records: no other set of records has it."""
    from hashlib import sha256

    from hammerstein.reporting.figures.measured import file_labels

    labels = file_labels([str(file) for file in files])
    if len(labels) <= MOST_NAMED:
        return "_".join(labels)
    return f"{labels[0]}_and_{len(labels) - 1}_more_{sha256(repr(labels).encode()).hexdigest()[:6]}"


def loops(
    files: Files,
    inputs: Inputs,
    outputs: Outputs,
    rate: Rate = None,
    time: Time = None,
    input_scale: InputScale = None,
    output_scale: OutputScale = None,
    accept_gain: AcceptGain = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the figure goes.")] = Path("reports"),
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figure.")] = True,
    as_json: AsJson = False,
) -> None:
    """Find the loops in measured records: height, width, area, closure, drift."""
    from hammerstein.commands.tables import gains_table, loops_table
    from hammerstein.errors import InputError
    from hammerstein.files import refuse_unwritable
    from hammerstein.records.loops import loop_table, move_at_once, telling_loops, without_loops
    from hammerstein.reporting.figures.measured import LOOPS, LOOPS_FILES, loops_of_records
    from hammerstein.storage.manifest import refuse_name
    from hammerstein.storage.staging import prepare

    if figures:
        refuse_unwritable("--out", out)
        refuse_name(files[0])
        prepare(out / folder_name(files), LOOPS, LOOPS_FILES)
    read = reader(inputs, outputs, rate, time, input_scale, output_scale)
    records = read(files, all_driven=False)
    gains = checked_gains(records, accept_gain)
    found = {record.source: loop_table(record) for record in records}
    empty = {record.source: without_loops(record) for record in records if not found[record.source]}
    if len(empty) == len(records) and not any(map(move_at_once, records)):
        raise InputError(*next(iter(empty.items())))
    for source, why in empty.items():
        complain(f"{source}: {why}")
    for record in records:
        for lost in record.outliers:
            complain(f"{record.source}: outliers of {lost.column} are left out: {lost.describe()}")
    if as_json:
        plain = [
            {"file": source, **asdict(loop), "width_percent": loop.width_percent}
            for source, loops_found in found.items()
            for loop in loops_found
        ]
        tell_json({"loops": plain})
    else:
        show(gains_table(gains))
        if len(empty) < len(records):
            shown = {source: telling_loops(loops, MOST_LOOPS) for source, loops in found.items()}
            show(loops_table(shown))
            if (few := sum(map(len, shown.values()))) < (all_ := sum(map(len, found.values()))):
                tell(
                    f"{few} of {all_} loops: of each pair the settled and the widest; --json has all of them"
                )
    if figures:
        from hammerstein.reporting.figures import save_figures

        figure = loops_of_records(records, [found[record.source] for record in records])
        for path in save_figures({"loops": figure} if figure else {}, out / folder_name(files), LOOPS):
            (complain if as_json else tell)(str(path))


def identify(
    files: Files,
    inputs: Inputs,
    outputs: Outputs,
    rate: Rate = None,
    time: Time = None,
    input_scale: InputScale = None,
    output_scale: OutputScale = None,
    accept_gain: AcceptGain = False,
    validate: Validate = None,
    operators: Operators = "auto",
    partition: Placing = "auto",
    thresholds: Thresholds = None,
    method: Weights = "invertible",
    hysteresis: Annotated[
        str, typer.Option(help="Static block: prandtl_ishlinskii, asymmetric, rate_dependent or bouc_wen.")
    ] = "prandtl_ishlinskii",
    dead_zones: Annotated[
        int | None, typer.Option(help="Of each input, with asymmetric; found if not given.")
    ] = None,
    ridge: Ridge = 0.0,
    dynamics: DynamicsOption = "auto",
    order: Order = None,
    creep_modes: CreepModes = "auto",
    delay_samples: DelaySamples = None,
    sensor_bandwidth: SensorBandwidth = None,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the model goes.")] = Path("model.json"),
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where the fit report goes; beside the model if not given."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    as_json: AsJson = False,
) -> None:
    """Identify a model from measured records, and say how far it can be trusted."""
    from hammerstein.commands.tables import fit_table, gains_table, kept_aside
    from hammerstein.commands.warm_up import compile_once
    from hammerstein.files import refuse_unwritable
    from hammerstein.identification.identify import identify as identified
    from hammerstein.identification.settings import settings_of
    from hammerstein.model import CONTENT
    from hammerstein.reporting.fit_folder import ALWAYS, FIT, write_fit
    from hammerstein.reporting.fit_page import fit_json
    from hammerstein.storage.staging import prepare

    with told_by_options("identification"):
        settings = settings_of(
            operators=operators,
            thresholds=thresholds,
            partition=partition,
            method=method,
            ridge=ridge,
            hysteresis=hysteresis,
            dead_zones=dead_zones,
            dynamics=dynamics,
            order=order,
            creep_modes=creep_modes,
            delay_samples=delay_samples,
            sensor_bandwidth_hz=sensor_bandwidth,
        )
    held = validate or []
    refuse_output(out, [*files, *held], CONTENT)
    refuse_fitted(held, files)
    folder = report or out.parent / f"{out.stem}_fit"
    refuse_unwritable("--report", folder)
    prepare(folder, FIT, ALWAYS)
    compile_once(complain)
    read = reader(inputs, outputs, rate, time, input_scale, output_scale)
    records, validation = read(files), read(held, all_driven=False) if held else ()
    gains = checked_gains(records, accept_gain)
    with Spinner() as spinner:
        model, fit = identified(
            records, settings, validation=validation, name=out.stem, progress=spinner.tell
        )
    for place in write_fit(model, fit, out, folder, figures):
        complain(kept_aside(place))
    if as_json:
        tell_json(json.loads(fit_json(model, fit)), indent=1, sort_keys=True)
        return
    show(gains_table(gains))
    show(fit_table(fit))
    tell(fit.verdict)
    for text in (fit.invertibility, *fit.flags, *fit.not_identifiable, *fit.notes):
        tell(f"* {text}")
    tell(f"model in {out}, fit report in {folder}")


class Spinner:
    """What is being done, on stderr, when a person watches."""

    def __enter__(self) -> Spinner:
        self.status = None
        if sys.stderr.isatty() and not hushed():
            from rich.console import Console

            self.status = Console(stderr=True).status("reading")
            self.status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.status is not None:
            self.status.stop()

    def tell(self, what: str) -> None:
        """Show what is being done."""
        if self.status is not None:
            from rich.text import Text

            self.status.update(Text(clean(what)))


def compensate(
    model: Annotated[str, typer.Argument(help="Model file, or packaged actuator.")],
    reference: Annotated[Path, typer.Argument(help="CSV: time_s, then one column an axis, in um.")],
    law: Annotated[
        str,
        typer.Option(
            help="hammerstein_inverse, exact_inverse, inverse_multiplicative, decoupled_inverse or none."
        ),
    ] = "hammerstein_inverse",
    out: Annotated[Path, typer.Option(metavar="FILE", help="Where the voltages go.")] = Path("drive.csv"),
    filter_hz: FilterHz = None,
    preview_s: PreviewS = None,
    preview: Preview = None,
    softening_v: SofteningV = None,
    gain: LawGain = None,
    range_v: Range = None,
    start: Start = None,
    conditioned: Conditioned = False,
    cycle: Annotated[
        bool,
        typer.Option("--cycle", help="The path is a period of a periodic one; write one that settled."),
    ] = False,
    table: Annotated[
        str | None, typer.Option(metavar="pi|nv200|csv", help="Write that period as a wave table.")
    ] = None,
    table_scale: Annotated[
        str | None, typer.Option(metavar="FACTOR[,OFFSET]", help="From V to the numbers of the table.")
    ] = None,
    table_points: Annotated[int | None, typer.Option(min=2, help="Most points of the table.")] = None,
    learn: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="DRIVE MEASURED", help="A trial: write the next drive of the periodic path."),
    ] = None,
    unsure: Annotated[
        str | None,
        typer.Option(
            metavar="W,R",
            help="Deviations of weights and resonances that --learn counts on; 0.05,0.01 if not given.",
        ),
    ] = None,
    clip: Annotated[bool, typer.Option("--clip", help="Accept a path partly out of reach.")] = False,
    beyond_records: Annotated[
        bool, typer.Option("--beyond-records", help="Accept voltages that were never recorded.")
    ] = False,
    accept_flagged: AcceptFlagged = False,
    as_json: AsJson = False,
) -> None:
    """Turn a reference into the voltages to send, with the predicted response."""
    from hammerstein.commands.periods import Period, Table, write_cycle, write_lesson
    from hammerstein.commands.tables import compensation_table
    from hammerstein.commands.warm_up import compile_once
    from hammerstein.compensators.drive_file import Terms, compensate as compensated
    from hammerstein.errors import InputError
    from hammerstein.files import write_atomic

    if gain not in (None, "auto", "identity"):
        raise InputError("--gain", f"must be auto or identity, not {gain!r}; a matrix goes into a scenario")
    if unsure is not None and learn is None:
        raise InputError("--unsure", "says what --learn counts on; give --learn DRIVE MEASURED too")
    ahead = preview if preview_s is None else preview_s
    options = {"filter_hz": filter_hz, "preview_s": ahead, "softening_v": softening_v, "gain": gain}
    wanted = Table(table, table_scale, table_points)
    wanted.check()
    refuse_output(out, [Path(model), reference, *(learn or ())], wanted.content())
    compile_once(complain)
    ends, begins = volts("--range", range_v), volts("--start", start)
    terms = Terms(ends, begins, conditioned, clip, beyond_records, accept_flagged)
    with told_by_options("compensate"):
        period = Period(model, reference, law, options, terms, out, wanted, as_json)
        if learn is not None:
            write_lesson(period, learn, unsure or "0.05,0.01")
            return
        if cycle or table is not None:
            write_cycle(period)
            return
        found = compensated(model, reference, law, options, terms)
    write_atomic(out, found.to_csv())
    if as_json:
        tell_json({"drive": str(out), **found.summary()})
        return
    show(compensation_table(found))
    for text in found.statements():
        tell(text)
    tell(f"voltages in {out}")

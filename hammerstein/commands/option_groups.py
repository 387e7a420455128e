"""Groups of options that several commands have: records and their identification, a law and its drive."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands.options import told_by_options
from hammerstein.commands.terminal import complain
from hammerstein.errors import InputError

if TYPE_CHECKING:
    from hammerstein.compensators.drive_file import Terms
    from hammerstein.identification.in_loop.identify import LoopSettings
    from hammerstein.identification.settings import Settings
    from hammerstein.records.gains import Gain
    from hammerstein.records.record import Record

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files, also edited ones.")]
AcceptOrder = Annotated[
    bool, typer.Option("--accept-order", help="Accept the columns although an output leads.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]


@dataclass(frozen=True)
class RecordFiles:
    """Records of one actuator, and how their files are read."""

    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Records: CSV, .dat, .npy, .mat, Parquet.")
    ]
    inputs: Annotated[
        str | None,
        typer.Option(
            metavar="COL[,COL]", help="Voltage columns, by name or number; default: by their units."
        ),
    ] = None
    outputs: Annotated[
        str | None, typer.Option(metavar="COL[,COL]", help="Displacement columns; default: by their units.")
    ] = None
    axes: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[,NAME]",
            help="Files are pairs of arrays, voltages then displacements, with these axes: sample, "
            "channel, experiment, period. --inputs and --outputs then name variables.",
        ),
    ] = None
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Sampling rate.")] = None
    time: Annotated[
        str | None,
        typer.Option(metavar="COL", help="Time column in s, instead of --rate; default: by its unit."),
    ] = None
    input_scale: Annotated[
        float | None, typer.Option(metavar="S", help="Factor from the numbers to V; default: from the unit.")
    ] = None
    output_scale: Annotated[
        float | None, typer.Option(metavar="S", help="Factor from the numbers to um; default: from the unit.")
    ] = None
    units: Annotated[
        str | None,
        typer.Option(metavar="nm|um|mm", help="Unit of the displacements, if their names have none."),
    ] = None
    accept_gain: Annotated[
        bool, typer.Option("--accept-gain", help="Accept a gain outside 0.001 to 1000 um/V.")
    ] = False

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
        """Gains of the records; a person is asked about those that no actuator has, a script is refused."""
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
                remedy = "check --inputs, --outputs and their scales, or accept the gain with --accept-gain"
                raise InputError(source, f"{doubt}; {remedy}")
        return gains


def _columns(words: str | None) -> list[str] | None:
    return None if words is None else [word.strip() for word in words.split(",") if word.strip()]


@dataclass(frozen=True)
class HeldBack:
    """Records that are judged and not fitted."""

    validate: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="Validation record; may be repeated.")
    ] = None

    def read(self, recorded: RecordFiles) -> tuple[Record, ...]:
        """Records of its files, read as the others are."""
        return recorded.read(self.validate, all_driven=False) if self.validate else ()

    def refuse_fitted(self, files: Sequence[Path]) -> None:
        """Refuse a validation record that is also fitted."""
        fitted = {file.resolve() for file in files}
        twice = sorted({str(file) for file in self.validate or () if file.resolve() in fitted})
        if twice:
            raise InputError(
                "--validate", f"{twice[0]} is also a fitted record; use another record for validation"
            )


@dataclass(frozen=True)
class StaticBlock:
    """Kind of the static block."""

    hysteresis: Annotated[
        str, typer.Option(help="Hysteresis: prandtl_ishlinskii, asymmetric, generalised and others.")
    ] = "prandtl_ishlinskii"
    dead_zones: Annotated[
        int | None, typer.Option(help="Dead-zones of each input, with asymmetric; default: searched.")
    ] = None


OF_THE_LOOP = ("--order", "--accept-order")
"""Options of a cascade that the search for hysteresis in the loop uses, too."""


@dataclass(frozen=True)
class InLoop:
    """Hysteresis in the loop of the dynamics."""

    hysteresis_in_loop: Annotated[
        bool,
        typer.Option(
            "--hysteresis-in-loop",
            help="Plays in the loop of a state space, for resonances that move with the amplitude.",
        ),
    ] = False
    minutes: Annotated[
        float, typer.Option(min=0.1, max=1440.0, help="Time limit of --hysteresis-in-loop.")
    ] = 60.0

    def refuse_unused(self, words: Sequence[str]) -> None:
        """Refuse options of other models, which its search would ignore."""
        unused = [word for word in words if word.startswith("--") and word not in OF_THE_LOOP]
        if self.hysteresis_in_loop and unused:
            raise InputError("--hysteresis-in-loop", f"does not use {', '.join(unused)}; remove it")

    def settings(self, order: int | None) -> LoopSettings | None:
        """The settings of its search; None where it is not asked for."""
        from hammerstein.identification.in_loop.identify import LoopSettings

        return LoopSettings(order, self.minutes) if self.hysteresis_in_loop else None


@dataclass(frozen=True)
class Identified:
    """How a model is identified; every name is that of a field of the settings."""

    operators: Annotated[str, typer.Option(help="Thresholds of each pair; auto: by cross-validation.")] = (
        "auto"
    )
    partition: Annotated[
        str,
        typer.Option(
            help="Thresholds: uniform in time or voltage, fitted, or auto: fitted if this lowers the error."
        ),
    ] = "auto"
    thresholds: Annotated[
        str | None, typer.Option(metavar="V[,V]", help="Your own thresholds in V, for all pairs.")
    ] = None
    solver: Annotated[
        str, typer.Option(help="Weights: invertible, least_squares, nonnegative or closed_form.")
    ] = "invertible"
    ridge: Annotated[float, typer.Option(help="Ridge penalty of the weights; 0: none.")] = 0.0
    dynamics: Annotated[
        str, typer.Option(help="none, lag, second_order, state_space, or auto: lowest error.")
    ] = "auto"
    order: Annotated[int | None, typer.Option(help="Order of a state-space model; default: searched.")] = None
    creep_modes: Annotated[
        str, typer.Option(help="Slow modes of each axis; auto: up to 3, each if it lowers the error.")
    ] = "auto"
    delay_samples: Annotated[int | None, typer.Option(help="Delay of the outputs; default: estimated.")] = (
        None
    )
    sensor_bandwidth: Annotated[
        float | None, typer.Option(metavar="HZ", help="Bandwidth of the sensor, from its data sheet.")
    ] = None
    sensor_delay: Annotated[
        float, typer.Option(metavar="SECONDS", help="Known delay of the sensor; excluded from the model.")
    ] = 0.0

    accept_order: AcceptOrder = False

    def settings(self, **more: Any) -> Settings:
        """The settings, with what one command alone asks for."""
        from hammerstein.identification.settings import settings_of

        asked = asdict(self)
        asked["sensor_bandwidth_hz"] = asked.pop("sensor_bandwidth")
        asked["sensor_delay_s"] = asked.pop("sensor_delay")
        with told_by_options("identification"):
            return settings_of(**asked, **more)


RangeWords = Annotated[
    str | None,
    typer.Option("--range", metavar="LOW,HIGH", help="Allowed voltages; default: recorded range."),
]


@dataclass(frozen=True)
class LawWords:
    """Options of a law; each is taken by those laws that have it."""

    filter_hz: Annotated[float | None, typer.Option(help="Bandwidth of the reference filter.")] = None
    preview_s: Annotated[float | None, typer.Option(metavar="S", help="How far ahead the path is known.")] = (
        None
    )
    softening_v: Annotated[float | None, typer.Option(help="Voltage over which drive jumps are spread.")] = (
        None
    )
    gain: Annotated[str | None, typer.Option(help="For inverse_multiplicative: auto or identity.")] = None
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Another option of the law, as in a scenario."),
    ] = None

    def options(self) -> dict[str, Any]:
        """Those that were given, by their names in a scenario.

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
        """Keys that ``--option`` gave."""
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


@dataclass(frozen=True)
class Sent:
    """Range of the drive, and initial state of the actuator."""

    range_v: RangeWords = None
    start: Annotated[
        str | None,
        typer.Option(metavar="V[,V]", help="Voltage before the first sample; the path is zero there."),
    ] = None
    conditioned: Annotated[
        bool,
        typer.Option("--conditioned", help="The actuator was driven to HIGH, then LOW, before the start."),
    ] = False
    accept_flagged: Annotated[
        bool, typer.Option("--accept-flagged", help="Accept a model that its fit report flags.")
    ] = False

    @property
    def ends(self) -> tuple[float, ...] | None:
        """Voltages of the range."""
        return volts("--range", self.range_v)

    @property
    def begins(self) -> tuple[float, ...] | None:
        """Voltages of the start."""
        return volts("--start", self.start)


@dataclass(frozen=True)
class Reached:
    """What is done with a path that the drive does not reach as it is."""

    lead_in: Annotated[
        bool,
        typer.Option("--lead-in", help="First move from the initial position to the start of the path."),
    ] = False
    offset: Annotated[str | None, typer.Option(metavar="UM[,UM]", help="Shift of the path in um.")] = None
    approach_side: Annotated[
        str | None,
        typer.Option(
            metavar="UM[,UM]",
            help="Reach every hold from one side, against backlash: -5 from 5 um below, 5 from above.",
        ),
    ] = None
    units: Annotated[
        str | None, typer.Option(metavar="nm|um|mm", help="Unit of the path, if its columns name none.")
    ] = None
    clip: Annotated[bool, typer.Option("--clip", help="Accept a path that is partly out of reach.")] = False
    beyond_records: Annotated[
        bool, typer.Option("--beyond-records", help="Accept voltages beyond the records.")
    ] = False

    def terms(self, sent: Sent) -> Terms:
        """All that is allowed of a drive."""
        from hammerstein.compensators.drive_file import Terms

        return Terms(
            sent.ends,
            sent.begins,
            sent.conditioned,
            self.clip,
            self.beyond_records,
            sent.accept_flagged,
            self.lead_in,
            volts("--offset", self.offset),
            volts("--approach-side", self.approach_side),
            self.units,
        )

    def refuse_with_period(self) -> None:
        """Raise InputError for options that a period does not use, because it writes a run-up of its own."""
        if self.lead_in or self.offset is not None or self.approach_side is not None:
            options = "--lead-in, --offset, --approach-side"
            raise InputError(options, "are for a path, not for a period (--cycle, --table, --learn)")


def volts(option: str, words: str | None) -> tuple[float, ...] | None:
    """Voltages from an option, with commas between them.

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

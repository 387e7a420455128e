"""Options that several commands have, and groups of them: a law and its drive."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.errors import InputError

if TYPE_CHECKING:
    from hammerstein.compensators.drive_file import Terms

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files, also edited ones.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]


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

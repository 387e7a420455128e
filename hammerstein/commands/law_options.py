"""What a person says of a law and its voltages: options that several commands have, and their words."""

from __future__ import annotations

from typing import Annotated

import typer

FilterHz = Annotated[float | None, typer.Option(help="Bandwidth of the reference filter.")]
SofteningV = Annotated[float | None, typer.Option(help="Voltage that spreads the jump.")]
PreviewS = Annotated[
    float | None, typer.Option("--preview-s", metavar="S", help="How far ahead the reference is known.")
]
Preview = Annotated[float | None, typer.Option("--preview", hidden=True)]  # as it was called before
LawGain = Annotated[str | None, typer.Option(help="Of inverse_multiplicative: auto or identity.")]
Range = Annotated[
    str | None,
    typer.Option("--range", metavar="LOW,HIGH", help="Voltages it may use; those of the records."),
]
Start = Annotated[
    str | None,
    typer.Option(metavar="V[,V]", help="Voltage before the first sample; the path counts from there."),
]
Conditioned = Annotated[
    bool, typer.Option("--conditioned", help="It was driven to HIGH, then LOW, before the start.")
]
AcceptFlagged = Annotated[
    bool, typer.Option("--accept-flagged", help="Accept a model that its fit report flags.")
]


def volts(option: str, words: str | None) -> tuple[float, ...] | None:
    """Voltages from an option, with commas between them.

    Raises InputError for words that are none.

    >>> volts("--range", "0,120")
    (0.0, 120.0)
    """
    from hammerstein.errors import InputError

    if words is None:
        return None
    try:
        return tuple(float(word) for word in words.split(","))
    except ValueError:
        raise InputError(option, f"{words!r} are no voltages with commas between them") from None

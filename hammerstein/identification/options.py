"""Names of identification options, the same in scenarios, on the command line and in Python."""

from collections.abc import Iterable
from typing import Literal

from hammerstein.hysteresis import HYSTERESIS
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.plugins import load_plugins
from hammerstein.validation import suggestion

Partition = Literal["auto", "time", "voltage", "fitted"]
Solver = Literal["closed_form", "least_squares", "nonnegative", "invertible"]
DynamicsKind = Literal["auto", "none", "lag", "second_order", "state_space"]
InitialStateMode = Literal["auto", "rest", "repeated"]
MOST_DEAD_ZONES = 50
"""Largest number of operators of an input."""
FEWEST_EXPERIMENTS = 3
"""Allowed numbers of experiments of a search for hysteresis in the loop."""
PLAYS = "prandtl_ishlinskii"
"""Default kind."""


def identifiable_kinds() -> dict[str, type[Identifiable]]:
    """Identifiable kinds of hysteresis by name, plug-ins included."""
    load_plugins()
    described = {name: file.describes for name, file in HYSTERESIS.kinds.items()}
    return {
        name: block
        for name, block in described.items()
        if block is not None and issubclass(block, Identifiable)
    }


def known_kind(name: str) -> str:
    """Return the name of an identifiable kind of hysteresis; ValueError, for pydantic, for any other name."""
    known = identifiable_kinds()
    if name not in known:
        raise ValueError(unknown_word(name, known))
    return name


def unknown_word(word: str, known: Iterable[str]) -> str:
    """State that a word is unknown, and list the known ones."""
    return f"{word!r} is not known; choose one of {', '.join(known)}{suggestion(word, known)}"

"""Words that choose how a model is identified: the same in scenarios, on the command line and in Python."""

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
"""Most that are taken of an input."""
FEWEST_EXPERIMENTS = 3
"""Experiments that a search for hysteresis in the loop takes."""
PLAYS = "prandtl_ishlinskii"
"""Kind that is fitted where no other one is asked for."""


def identifiable_kinds() -> dict[str, type[Identifiable]]:
    """Kinds of hysteresis that can be identified, by their name: those of plug-ins, too."""
    load_plugins()
    described = {name: file.describes for name, file in HYSTERESIS.kinds.items()}
    return {
        name: block
        for name, block in described.items()
        if block is not None and issubclass(block, Identifiable)
    }


def known_kind(name: str) -> str:
    """Give the name of a kind of hysteresis back; ValueError, for pydantic, where it cannot be identified."""
    known = identifiable_kinds()
    if name not in known:
        raise ValueError(unknown_word(name, known))
    return name


def unknown_word(word: str, known: Iterable[str]) -> str:
    """Say that a word is none of those that are known, and which they are."""
    return f"{word!r} is not known; choose one of {', '.join(known)}{suggestion(word, known)}"

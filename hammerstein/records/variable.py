"""An array of a file: how it is loaded, and what the file states as its unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

UNIT_NAMES = ("unit_string", "units", "unit")
"""Attributes that hold a unit, without regard to case: of National Instruments, and of most HDF5 files."""


class Variable(NamedTuple):
    """One array of a file.

    load : gives its numbers; unit : as the file states it, empty where it states none
    """

    load: Callable[[], Any]
    unit: str = ""


Variables = Mapping[str, Variable]
"""Name of each array in a file; the only one of an ``.npy`` file has no name."""


def stated_unit(attributes: Mapping[str, Any]) -> str:
    """Unit among the attributes of an array; empty where there is none, or no text.

    Examples
    --------
    >>> stated_unit({"Units": b"mV"}), stated_unit({"unit_string": "um"}), stated_unit({"units": 3})
    ('mV', 'um', '')
    """
    named = {name.lower(): value for name, value in attributes.items()}
    for name in UNIT_NAMES:
        value = named.get(name)
        text = value.decode("utf-8", errors="replace") if isinstance(value, bytes) else value
        if isinstance(text, str) and text.strip():
            return text.strip()
    return ""

"""Numbers and tables of Python as text of C."""

import math
import re
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np

from hammerstein.escaping import C

WIDTH = 100
"""Characters of a line of C."""
LARGEST = {"double": float(np.finfo(np.float64).max), "float": float(np.finfo(np.float32).max)}
_TOKEN = re.compile(
    r"/\*.*?\*/|\"[^\"\n]*\"|[A-Za-z_]\w*|(?P<number>(?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+)|\d+",
    re.S,
)


def literal(value: Any) -> str:
    """Text of a number: the shortest decimal that a C compiler reads back to the last bit.

    >>> literal(0.1), literal(3), literal(float("inf")) == repr(LARGEST["double"])
    ('0.1', '3', True)
    """
    if isinstance(value, int | np.integer):
        return str(int(value))
    number = float(value)
    if np.isinf(number):  # a wall that no number reaches; C has no literal for infinity
        number = math.copysign(LARGEST["double"], number)
    return repr(number)


def initializer(value: Any, indent: int = 0) -> C:
    """Text that initialises a number, an array, or a structure given as a mapping of its members.

    >>> str(initializer({"end": 1, "x": np.array([0.0, 2.5])}))
    '{ .end = 1, .x = { 0.0, 2.5 } }'
    """
    if isinstance(value, Mapping):
        parts = [f".{key} = {initializer(part, indent + 2)}" for key, part in value.items()]
    elif isinstance(value, list | tuple | np.ndarray):
        parts = [initializer(part, indent + 2) for part in value]
    else:
        return C.escape(literal(value))
    line = f"{{ {', '.join(parts)} }}"
    if len(line) <= WIDTH - indent and "\n" not in line:
        return C(line)
    inside = " " * (indent + 2)
    if any("{" in part for part in parts):
        body = ",\n".join(f"{inside}{part}" for part in parts)
    else:
        body = textwrap.fill(
            ", ".join(parts),
            WIDTH,
            initial_indent=inside,
            subsequent_indent=inside,
            break_long_words=False,
            break_on_hyphens=False,
        )
    return C(f"{{\n{body}\n{' ' * indent}}}")


def in_single_precision(code: str) -> str:
    """C code with every floating constant outside comments as one of ``float``.

    >>> in_single_precision("a = 0.1 * b[1]; /* 0.5 V */ c = 1e-05;")
    'a = 0.1f * b[1]; /* 0.5 V */ c = 1e-05f;'
    """

    def single(found: re.Match[str]) -> str:
        if found["number"] is None:
            return found[0]
        number = min(float(found["number"]), LARGEST["float"])
        return f"{np.float32(number)!s}f"

    return _TOKEN.sub(single, code)


def identifier(words: str) -> str:
    """Name in C from any words.

    >>> identifier("stage 2 (x/y)"), identifier("2nd")
    ('stage_2_x_y', 'model_2nd')
    """
    name = re.sub(r"\W+", "_", words, flags=re.ASCII).strip("_").lower() or "model"
    return f"model_{name}" if name[0].isdigit() else name

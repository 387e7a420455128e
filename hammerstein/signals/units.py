"""Units in the names of columns and in rows of units, and their factors to V, um and s."""

import re
from typing import Literal, NamedTuple

from hammerstein.errors import InputError

Kind = Literal["voltage", "displacement", "time"]

BASE: dict[Kind, str] = {"voltage": "V", "displacement": "um", "time": "s"}
FACTORS: dict[Kind, dict[str, float]] = {
    "voltage": {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3},
    "displacement": {"um": 1.0, "nm": 1e-3, "pm": 1e-6, "mm": 1e3, "cm": 1e4, "m": 1e6, "inch": 2.54e4},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
}
WORDS = {
    "volt": "v",
    "millivolt": "mv",
    "kilovolt": "kv",
    "micron": "um",
    "inche": "inch",
    "sec": "s",
    "second": "s",
}
WORDS |= {"millisecond": "ms", "microsecond": "us", "nanosecond": "ns", "minute": "min"}
for _prefix, _short in (("", "m"), ("milli", "mm"), ("micro", "um"), ("nano", "nm")):
    WORDS |= {f"{_prefix}meter": _short, f"{_prefix}metre": _short}
NO_UNIT = ("", "-", "1", "hz", "khz")
"""What else may stand in a row of units."""
SINGLE = ("m", "s", "v")
"""Letters that may be part of a name after a mere underscore or blank, such as ``x_m`` for a measured x."""

IN_BRACKETS = re.compile(r"^(?P<name>.*?)(?P<open>\s*[\[(]\s*)(?P<unit>[^\[\]()]*?)(?P<close>\s*[\])]\s*)$")
BEHIND_SLASH = re.compile(r"^(?P<name>.+?)(?P<open>\s*/\s*|\s+in\s+)(?P<unit>[^\W\d_]+)(?P<close>\s*)$")
AT_END = re.compile(r"^(?P<name>.+?)(?P<open>[_ ])(?P<unit>[^\W\d_]+)(?P<close>\s*)$")
PLAIN = re.compile(r"^(?P<name>)(?P<open>)(?P<unit>[^\W\d_]+)(?P<close>)$")


class Unit(NamedTuple):
    """What a column is measured in.

    Parameters
    ----------
    symbol : as it is usually written, such as ``mV``
    kind : voltage, displacement or time
    factor : to V, um or s
    """

    symbol: str
    kind: Kind
    factor: float


def unit_of(word: str) -> Unit | None:
    """Unit for a word in upper or lower case; None if it is not a unit.

    Examples
    --------
    >>> unit_of("mV").factor, unit_of("µm").kind, unit_of("Volts").symbol, unit_of("deg")
    (0.001, 'displacement', 'V', None)
    """
    short = word.strip().lower().replace("µ", "u").replace("μ", "u")
    short = WORDS.get(short.removesuffix("s"), short) if len(short) > 2 else short
    for kind, factors in FACTORS.items():
        for symbol, factor in factors.items():
            if symbol.lower() == short:
                return Unit(symbol, kind, factor)
    return None


def displacement_factor(units: str) -> float:
    """Factor from a unit of length to um; InputError for the option that names another one.

    Examples
    --------
    >>> displacement_factor("nm")
    0.001
    """
    known = FACTORS["displacement"]
    if units not in known:
        raise InputError("--units", f"{units!r} is not one of {', '.join(known)}")
    return known[units]


def is_unit(word: str) -> bool:
    """Whether a word may stand in a row of units."""
    word = word.strip()
    found = IN_BRACKETS.match(word)
    inner = found["unit"] if found and not found["name"] else word
    return (found is not None and not found["name"]) or inner.lower() in NO_UNIT or bool(unit_of(inner))


def _match(name: str) -> tuple[re.Match[str], Unit] | None:
    """Where the unit stands in the name of a column, and the unit; None if it has none."""
    for pattern in (IN_BRACKETS, BEHIND_SLASH, AT_END, PLAIN):
        match = pattern.match(name)
        if match and (unit := unit_of(match["unit"])):
            vague = pattern in (AT_END, PLAIN) and match["unit"].lower() in SINGLE
            if not vague or (pattern is AT_END and unit.symbol != "m"):
                return match, unit
    return None


def unit_in(name: str) -> Unit | None:
    """Unit in the name of a column: ``u [mV]``, ``x (nm)``, ``x / um``, ``time_ms``; None if it has none.

    A lone ``m`` behind an underscore or a blank may mean "measured" and is not a unit.

    Examples
    --------
    >>> [unit.symbol if (unit := unit_in(n)) else None for n in ("u_mV", "X (um)", "Weg / nm", "x_m")]
    ['mV', 'um', 'nm', None]
    """
    found = _match(name)
    return found[1] if found else None


def bracketed(unit: str) -> str:
    """Unit that a file states beside a name, in brackets: a lone ``V`` there is no part of a name.

    Examples
    --------
    >>> bracketed("V"), bracketed("(nm)"), bracketed("")
    ('[V]', '(nm)', '')
    """
    unit = unit.strip()
    return f"[{unit}]" if unit and not IN_BRACKETS.match(unit) else unit


def axis_name(column: str) -> str:
    """Name of the axis that a column holds, once its numbers were turned into V, um or s: without a unit.

    A column that is called by a unit alone keeps the one that its numbers have now.

    Examples
    --------
    >>> axis_name("Vx [V]"), axis_name("X (nm)"), axis_name("x"), axis_name("[mV]")
    ('Vx', 'X', 'x', 'V')
    """
    found = _match(column)
    if found is None:
        return column
    match, unit = found
    is_word = match.re is PLAIN and unit.factor == 1.0  # such as Volt
    return match["name"].strip(" _") or (column if is_word else BASE[unit.kind])


def spoken(name: str) -> str:
    """Name of a column in a sentence: a bare number says little.

    Examples
    --------
    >>> spoken("3"), spoken("X (um)"), spoken("[V]")
    ('column 3', 'X', '[V]')
    """
    return f"column {name}" if name.isdigit() else without_unit(name) or name


def without_unit(name: str) -> str:
    """Name of a column without the unit in brackets or behind a slash, for a label that has its own.

    Examples
    --------
    >>> without_unit("X (um)"), without_unit("u / V"), without_unit("u_x"), without_unit("[V]")
    ('X', 'u', 'u_x', '')
    """
    found = _match(name)
    return found[0]["name"].strip(" _") if found else name

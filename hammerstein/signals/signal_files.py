"""Text tables of times and one column for each axis: voltages to play, paths to follow."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError, Mistake, Notice, refuse
from hammerstein.files import refuse_size
from hammerstein.quantities import POSITION_UM, column, size
from hammerstein.runtime.resources import free_bytes
from hammerstein.signals.text_tables import find_layout, read_text, where
from hammerstein.signals.units import BASE, Kind, Unit, axis_name, bracketed, unit_in

OF_TIME = ("time", "t", "zeit")
"""Names of a column of time, without its unit."""
SHOWN = 80
"""Characters of a line that a message shows."""
LARGEST_BYTES = 2_000_000_000  # of a table of samples
MEMORY_SHARE = 2.0
"""Memory that reading a table takes, in parts of its size as text."""


def read_signal(path: Path) -> tuple[Array, Array, list[str]]:
    """Read a text table with a column of time, such as ``time_s`` or ``t [ms]``, and one column an axis.

    Returns times (row,) [s], values (axis, row) in V and um by the units in the names of their columns, and
    these names. InputError names the row and column that are wrong.
    """
    _refuse_large(path)
    layout = find_layout(path, "CSV or other text: export it as CSV")
    units = layout.units or [""] * layout.width
    names = [
        f"{name} {bracketed(unit)}" if unit else name for name, unit in zip(layout.names, units, strict=False)
    ]
    time = _time_in(names)
    if time is None or len(names) < 2:
        with path.open(encoding=layout.encoding) as file:
            first = next((line.strip() for line in file if line.strip() and not line.startswith("#")), "")
        raise InputError(
            str(path),
            "needs a header with a column time_s (or for example t [ms]) and one column for each "
            f"axis, none of them a number; its first line is {first[:SHOWN]!r}",
        )
    values, rows, mistakes = read_text(path, layout, range(layout.width), names)
    refuse(str(path), mistakes)
    if not names[-1] and np.isnan(values[-1]).all():  # a comma at the end of each row
        names, values = names[:-1], values[:-1]
    if not all(names):
        raise InputError(str(path), "its rows have more cells than its header; give every column a name")
    bad = np.argwhere(~(np.abs(values.T) <= POSITION_UM.high))
    if len(bad):
        row, column = (int(i) for i in bad[0])
        place = where(names[column], rows, row, row)
        value = float(values[column, row])
        what = f"is {value:.3g}, beyond {POSITION_UM.high:.3g}" if np.isfinite(value) else "has no number"
        raise InputError(str(path), [Mistake(place, f"{what}; correct it, or remove the row")])
    at = names.index(time)
    times, values = _factor(time) * values[at], np.delete(values, at, axis=0)
    if len(times) < 2:
        raise InputError(str(path), "has a single row; a signal needs at least two")
    late = np.nonzero(np.diff(times) <= 0)[0]
    if len(late):
        raise InputError(str(path), f"row {rows[int(late[0]) + 1]}: {time} does not increase")
    names.remove(time)
    factors = [unit.factor if (unit := _unit(name)) else 1.0 for name in names]
    return times, np.array(factors)[:, None] * values, names


def _refuse_large(path: Path) -> None:
    """Refuse a table that the memory does not hold: a drive of minutes has hundreds of megabytes."""
    refuse_size(path, "CSV file", LARGEST_BYTES)
    needed, free = MEMORY_SHARE * path.stat().st_size, free_bytes()
    if needed > free:
        what = f"takes about {size(needed)} of memory to read, but {size(free)} are free; cut it into parts"
        raise InputError(str(path), what)


def _time_in(names: Sequence[str]) -> str | None:
    """Column of time, if there is one."""
    found = ["time_s"] if "time_s" in names else [name for name in names if _plain(name) in OF_TIME]
    return found[0] if len(found) == 1 else None


def _factor(time: str) -> float:
    """Factor to seconds; a column of time without a unit is in seconds."""
    unit = unit_in(time)
    return unit.factor if unit is not None and unit.kind == "time" else 1.0


def chosen(path: str | Path, names: Sequence[str], axes: Sequence[str], kind: Kind, word: str) -> list[int]:
    """Columns (axis,) of a table for these axes: by their names, or in their order if no column has a name.

    Parameters
    ----------
    path : of the file, for messages
    names : of its columns beside ``time_s``
    axes : names of the axes
    kind : kind of quantity that is needed
    word : their quantity in our own files, such as ``reference`` in ``reference_x_um``

    Raises
    ------
    InputError : some columns are named like axes and others are not, there are too many or too few, or one is
        in a unit of another kind
    """
    found = _named(names, axes, [column(word, axis, BASE[kind].lower()) for axis in axes])
    if found is None:
        if len(names) != len(axes) or {_plain(name) for name in names} & {_plain(axis) for axis in axes}:
            what = f"has the columns {', '.join(names)}; give one for each axis: {', '.join(axes)}"
            raise InputError(str(path), what)
        found = list(range(len(names)))
        pairs = ", ".join(f"{name} for {axis}" for name, axis in zip(names, axes, strict=True))
        warnings.warn(f"{path}: columns are assigned in their order: {pairs}", Notice, stacklevel=2)
    for name in (names[i] for i in found):
        unit = _unit(name)
        if unit is not None and unit.kind != kind:
            raise InputError(str(path), f"column {name} is in {unit.symbol}, which is not a {kind}")
    return found


def holds(names: Sequence[str], axes: Sequence[str]) -> bool:
    """Whether a table has a column for each of these axes, by their names."""
    return _named(names, axes, axes) is not None


def _named(names: Sequence[str], axes: Sequence[str], ours: Sequence[str]) -> list[int] | None:
    """Columns of the names that a file of ours has, else of the axes' names; None where one is missing."""
    forms = (
        (ours, names),
        (axes, names),
        (axes, [axis_name(name) for name in names]),
        ([_plain(axis) for axis in axes], [_plain(name) for name in names]),
    )
    for wanted, there in forms:
        if all(there.count(name) == 1 for name in wanted):
            return [there.index(name) for name in wanted]
    return None


def _unit(name: str) -> Unit | None:
    """Unit in the name of a column of voltages or positions; one of time is a word, such as "second"."""
    unit = unit_in(name)
    return None if unit is not None and unit.kind == "time" else unit


def _plain(name: str) -> str:
    """Name of a column without its unit, in small letters."""
    return axis_name(name).casefold()

"""CSV tables of times and one column an axis: voltages to play, paths to follow."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.axis_names import column
from hammerstein.errors import InputError, Notice
from hammerstein.files import read_limited
from hammerstein.quantities import POSITION_UM
from hammerstein.signals.units import BASE, Kind, Unit, axis_name, unit_in

if TYPE_CHECKING:
    import pandas as pd

OF_TIME = ("time", "t", "zeit")
"""Names of a column of time, without its unit."""
SHOWN = 80
"""Characters of a line that a message shows."""


def read_signal(path: Path) -> tuple[Array, Array, list[str]]:
    """Read a CSV file with a column of time, such as ``time_s`` or ``t [ms]``, and one column an axis.

    Returns times (row,) [s], values (axis, row) in V and um by the units in the names of their columns, and
    these names. InputError names the row and column that are wrong.
    """
    import pandas as pd

    text = read_limited(path, what="CSV file")
    frame = _table(text, path)
    names = [str(name) for name in frame.columns]
    time = _time_in(names)
    if time is None or len(names) < 2:
        raise InputError(
            str(path),
            "needs a header with a column time_s (or t [ms], say) and one column for each axis, separated "
            f"by commas; its first line is {','.join(names)[:SHOWN]!r}",
        )
    lines = enumerate(text.splitlines(), start=1)
    rows = [number for number, line in lines if line.strip() and not line.lstrip().startswith("#")][1:]
    try:
        numbers = frame.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    except OverflowError:  # a whole number of hundreds of digits
        numbers = frame.map(_float).to_numpy(dtype=float)
    bad = np.argwhere(~(np.abs(numbers) <= POSITION_UM.high))
    if len(bad):
        row, column = (int(i) for i in bad[0])
        value = frame.iloc[row, column]
        what = "is no number" if str(value) == "nan" else f"{value!s} is not a finite number within 1e9"
        raise InputError(str(path), f"row {rows[row]}, column {frame.columns[column]}: {what}")
    times = _factor(time) * frame[time].to_numpy(dtype=float)
    if len(times) < 2:
        raise InputError(str(path), "has a single row; a signal needs at least two")
    late = np.nonzero(np.diff(times) <= 0)[0]
    if len(late):
        raise InputError(str(path), f"row {rows[int(late[0]) + 1]}: {time} does not increase")
    names.remove(time)
    factors = [unit.factor if (unit := _unit(name)) else 1.0 for name in names]
    return times, np.array(factors)[:, None] * frame[names].to_numpy(dtype=float).T, names


def _float(cell: object) -> float:
    """Number of a cell; NaN where it holds none."""
    try:
        return float(str(cell))
    except ValueError:
        return math.nan


def _time_in(names: Sequence[str]) -> str | None:
    """Column of time, if there is one."""
    found = ["time_s"] if "time_s" in names else [name for name in names if _plain(name) in OF_TIME]
    return found[0] if len(found) == 1 else None


def _factor(time: str) -> float:
    """Factor to seconds; a column of time without a unit is in seconds."""
    unit = unit_in(time)
    return unit.factor if unit is not None and unit.kind == "time" else 1.0


def chosen(path: str | Path, names: Sequence[str], axes: Sequence[str], kind: Kind, word: str) -> list[int]:
    """Columns (axis,) of a table that hold these axes: by their names, or in their order where none has one.

    Parameters
    ----------
    path : of the file, for messages
    names : of its columns beside ``time_s``
    axes : names of the axes
    kind : what is wanted of them
    word : what they hold in a file of ours, such as ``reference`` in ``reference_x_um``

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
        warnings.warn(f"{path}: its columns are taken in their order: {pairs}", Notice, stacklevel=2)
    for name in (names[i] for i in found):
        unit = _unit(name)
        if unit is not None and unit.kind != kind:
            raise InputError(str(path), f"column {name} is in {unit.symbol}, which is no {kind}")
    return found


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


def _table(text: str, path: Path) -> pd.DataFrame:
    """Table of a CSV file; InputError where a row has more cells than the header."""
    import pandas as pd

    # Not as pandas would have it: a cell too many in every row makes the first column an index there.
    form = {"skipinitialspace": True, "comment": "#", "index_col": False, "low_memory": False}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            return pd.read_csv(io.StringIO(text), **form)  # type: ignore[call-overload,no-any-return]
    except pd.errors.ParserWarning:
        what = "its rows have more cells than its header; give every column a name"
    except pd.errors.EmptyDataError:
        what = "holds no table"
    except pd.errors.ParserError as error:
        cells = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
        told = "row {1} has {2} cells, and the header {0}".format(*cells.groups()) if cells else str(error)
        what = f"is not a CSV table: {told.strip()}"
    raise InputError(str(path), what)

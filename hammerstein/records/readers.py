"""Columns of numbers from files: text, NumPy, MATLAB and Parquet.

How a column is named
    by its name in the header or by its number from 1: text, Parquet and two-dimensional arrays;
    ``NAME`` or ``NAME:3``: the only, or the third, column of the variable NAME in an ``.npz`` or ``.mat``
    file; a field of a MATLAB structure has a dotted name, ``data.u:2``;
    ``2:1:5`` or ``NAME:2:1:5``: an array of more than two axes, with one number from 1 for every axis but
    that of time. The axis of time of an array is its longest one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.errors import InputError, Mistake, naming, refuse
from hammerstein.quantities import unique
from hammerstein.records.checks import gap_mistakes, refuse_large
from hammerstein.records.file_formats import SUFFIXES, Variable, Variables, reason_of, variables_of
from hammerstein.signals.signal_files import OF_TIME
from hammerstein.signals.text_tables import FORMATS, find_layout, read_text, where
from hammerstein.signals.units import Kind, Unit, bracketed, unit_in, without_unit
from hammerstein.validation import nearest, suggestion

TIME_NAMES = (*OF_TIME, "x-axis")
"""Names of a time column, without their unit and in any case."""
ARRAY_TIME_NAMES = ("time", "t", "Time", "time_s", "t_s")

NO_RECORDS = (".json", ".toml")
PARQUET = (".parquet", ".pq")


class Columns(NamedTuple):
    """Columns taken from one file.

    Parameters
    ----------
    source : the file
    names : unique name of each column
    values : (column, sample), not finite where a number is missing
    rows : (sample,) row of each sample in the file, from 1
    mistakes : fields without a number
    units : unit of each column as the file states it, in its name or in a row of units
    """

    source: str
    names: tuple[str, ...]
    values: Array
    rows: Indices
    mistakes: tuple[Mistake, ...]
    units: tuple[str, ...]


def read_columns(path: str | Path, wanted: Sequence[str]) -> Columns:
    """Columns of one file; its suffix selects the format.

    Parameters
    ----------
    path : ``.npy``, ``.npz``, ``.mat``, ``.parquet``; anything else is read as text
    wanted : columns by name or number, see the top of this module

    Raises
    ------
    InputError : a missing, empty or unreadable file, unknown columns (with the names that exist)
    """
    path = refuse_missing(Path(path))
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        values, stated = array_columns(path, wanted)
        units = [bracketed(unit) or column.split(":")[0] for unit, column in zip(stated, wanted, strict=True)]
        return _columns(path, tuple(wanted), values, np.arange(1, values.shape[1] + 1), units)
    if suffix in PARQUET:
        return _parquet_columns(path, wanted)
    layout = find_layout(path)
    indices = _choose(path, wanted, layout.names, layout.width)
    own = unique(layout.names)
    names = tuple((own[index] if own else "") or str(index + 1) for index in indices)
    units = [_unit_text(index, layout.names, layout.units) for index in indices]
    values, rows, text = read_text(path, layout, indices, names)
    return _columns(path, names, values, rows, units, text)


def _unit_text(index: int, names: Sequence[str], units: Sequence[str]) -> str:
    """Where the unit of a column is to be looked for: in the row of units, or in its name."""
    beneath = bracketed(units[index]) if units else ""
    return beneath or (names[index] if names else "")


@dataclass(frozen=True)
class Header:
    """Header of a file: column names as written, and their units, if any.

    names : (column,), empty without a header; units : (column,)
    """

    names: tuple[str, ...]
    units: tuple[Unit | None, ...]

    @classmethod
    def of(cls, path: str | Path) -> Header:
        """Header of a file; arrays have a name and the unit that the file states.

        Raises
        ------
        InputError : a missing, empty or unreadable file
        """
        path = refuse_missing(Path(path))
        suffix = path.suffix.lower()
        if suffix in SUFFIXES:
            arrays = {name: found.unit for name, found in variables_of(path).items() if name}
            return cls(
                tuple(arrays), tuple(unit_in(bracketed(unit) or name) for name, unit in arrays.items())
            )
        if suffix in PARQUET:
            with _parquet(path) as file:
                names = tuple(file.schema_arrow.names)
            return cls(names, tuple(map(unit_in, names)))
        layout = find_layout(path)
        texts = [_unit_text(k, layout.names, layout.units) for k in range(layout.width)]
        return cls(tuple(layout.names), tuple(map(unit_in, texts)))

    def measuring(self, kind: Kind) -> list[str]:
        """Columns with a unit of a kind, by name, or by number if names are equal."""
        found = [k for k, unit in enumerate(self.units) if unit is not None and unit.kind == kind]
        return [
            self.names[k] if self.names and self.names.count(self.names[k]) == 1 else str(k + 1)
            for k in found
        ]

    def called_time(self) -> list[str]:
        """Columns with the name of a time."""
        return [name for name in self.names if (without_unit(name) or name).lower() in TIME_NAMES]

    def listed(self) -> str:
        """Its columns with their numbers, for a message."""
        if not self.units:
            return "`hammerstein show` lists the content of the file"
        return _known("", unique(self.names), len(self.units))


def named_time(path: str | Path) -> Columns | None:
    """Readable time column of a file, if there is one.

    Raises
    ------
    InputError : a missing, empty or unreadable file
    """
    path = Path(path)
    arrays = path.suffix.lower() in SUFFIXES
    for name in ARRAY_TIME_NAMES if arrays else Header.of(path).called_time():
        try:
            columns = read_columns(path, [name])
        except InputError:
            continue
        return columns if np.isfinite(columns.values).all() and columns.rows.size > 1 else None
    return None


def read_array(path: str | Path, variable: str | None = None) -> Array:
    """One numeric array of an ``.npy``, ``.npz`` or ``.mat`` file, with all its axes.

    Parameters
    ----------
    path : file
    variable : its name, where the file holds more than one

    Raises
    ------
    InputError : a missing or unreadable file, an unknown variable (with the names that exist)
    """
    path = refuse_missing(Path(path))
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(str(path), f"is not a file of arrays; give one of {', '.join(SUFFIXES)}")
    variables = variables_of(path)
    with naming(str(path)):
        return _loaded(variables, variable or "")


def refuse_missing(path: Path) -> Path:
    """Return a path; refuse any that is no readable, non-empty file, such as a pipe.

    Models, reports and scenarios are refused, too.
    """
    try:
        if not path.is_file():
            what = "does not exist; check its name and folder"
            if path.exists():
                what = "is a folder; give a file" if path.is_dir() else "is not a regular file; give one"
            raise InputError(str(path), what)
        if path.stat().st_size == 0:
            raise InputError(str(path), "is empty (0 bytes); record it again")
        path.open("rb").close()
        if path.suffix.lower() in NO_RECORDS:
            what = f"is a {path.suffix.lower()} file, such as a model or a scenario; give {FORMATS}"
            raise InputError(str(path), what)
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({(error.strerror or str(error)).lower()})") from None
    return path


def _columns(
    path: Path,
    names: tuple[str, ...],
    values: Array,
    rows: Indices,
    units: Sequence[str],
    text: Sequence[Mistake] = (),
) -> Columns:
    """Columns with a mistake for every gap, save the gaps that text has left."""
    spoiled = {mistake.where for mistake in text}
    gaps = [mistake for mistake in gap_mistakes(names, values, rows) if mistake.where not in spoiled]
    return Columns(str(path), names, values, rows, (*text, *gaps), tuple(units))


def _choose(path: Path, wanted: Sequence[str], names: Sequence[str], width: int) -> list[int]:
    """Index of each wanted column: by name as written, by number, by name in any case, without its unit."""
    indices: list[int] = []
    mistakes: list[Mistake] = []
    own, bare = unique(names), [without_unit(name) for name in names]
    for column in wanted:
        found = [k for k, name in enumerate(names) if name == column]
        if not found and column.isdecimal() and 1 <= int(column) <= width:
            found = [int(column) - 1]
        for candidates in (own, names, bare):
            found = found or [k for k, name in enumerate(candidates) if name.lower() == column.lower()]
        if len(found) == 1:
            indices.append(found[0])
        elif found:
            numbers = " and ".join(str(k + 1) for k in found)
            what = f"is {len(found)} times in the header; give its number, {numbers}"
            mistakes.append(Mistake(f"column {column}", what))
        else:
            mistakes.append(Mistake(f"column {column}", "is not in the file; " + _known(column, own, width)))
    if len(set(indices)) < len(indices):
        mistakes.append(Mistake("columns", "one column is named twice, by name and by number"))
    refuse(str(path), mistakes)
    return indices


def _known(column: str, names: Sequence[str], width: int) -> str:
    if not any(names):
        return f"it has no header: name columns by number, 1 to {width}"
    meant = "".join(f"did you mean {near}? " for near in nearest(column, names))
    listed = ", ".join(f"{k + 1} {name}" for k, name in enumerate(names[:20]) if name)
    return f"{meant}it has {listed}{', ...' if len(names) > 20 else ''}"


@contextmanager
def _parquet(path: Path) -> Iterator[Any]:
    """A Parquet file; InputError where it cannot be read."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        what = "reading Parquet needs pyarrow: pip install pyarrow, or convert the file to CSV"
        raise InputError(str(path), what) from None
    try:
        with parquet.ParquetFile(path) as file:
            yield file
    except (OSError, arrow.ArrowException) as error:
        raise InputError(str(path), f"cannot be read as a Parquet file ({error})") from None


def _parquet_columns(path: Path, wanted: Sequence[str]) -> Columns:
    with _parquet(path) as file:
        names = file.schema_arrow.names
        indices = _choose(path, wanted, names, len(names))
        chosen = tuple(names[k] for k in indices)
        refuse_large((len(indices), file.metadata.num_rows))
        table = file.read(columns=chosen)
    import pyarrow as arrow

    values = np.full((len(chosen), table.num_rows), np.nan)
    rows = np.arange(1, table.num_rows + 1)
    text = []
    for k, name in enumerate(chosen):
        try:
            values[k] = table[name].cast(arrow.float64()).to_numpy()
        except (arrow.ArrowException, TypeError):
            what = f"has {table[name].type}, not numbers; choose another column"
            text.append(Mistake(where(name, rows, 0, table.num_rows - 1), what))
    return _columns(path, chosen, values, rows, chosen, text)


def array_columns(path: Path, wanted: Sequence[str]) -> tuple[Array, list[str]]:
    """Columns (column, sample) of a file of arrays with a suffix of ``SUFFIXES``, and their stated units.

    Parameters
    ----------
    path : file
    wanted : ``NAME``, ``NAME:3``, ``3`` or, in an array of more axes, ``NAME:2:1:5``: one number from 1 for
        every axis but that of time, which is the longest

    Raises
    ------
    InputError : unreadable file, unknown variables and columns (all at once), columns of different length
    """
    variables = variables_of(path)
    columns: list[Array] = []
    units: list[str] = []
    mistakes: list[Mistake] = []
    for column in wanted:
        name, numbers = _parsed(column)
        try:
            columns.append(_column(_loaded(variables, name), column, numbers))
            units.append(variables[_resolved(variables, name)].unit)
        except InputError as error:
            mistakes += [Mistake(f"column {column}", mistake.what) for mistake in error.mistakes]
    if not mistakes and len({len(column) for column in columns}) > 1:
        listed = ", ".join(f"{name} {len(column)}" for name, column in zip(wanted, columns, strict=True))
        mistakes.append(Mistake("columns", f"have different numbers of samples: {listed}"))
    refuse(str(path), mistakes)
    return np.vstack(columns), units


def arrays_in(path: Path) -> Iterator[tuple[str, str]]:
    """Names of the arrays of a file, their lengths, and the names of their columns.

    Raises InputError where the file cannot be read.
    """
    for name, variable in variables_of(path).items():
        yield name or "array", _described(name, variable)


def _described(name: str, variable: Variable) -> str:
    """How long an array is and how its columns are named, or why nobody knows."""
    try:
        shape = np.shape(variable.load())
    except InputError as error:
        return error.mistakes[0].what
    except Exception as error:  # on a damaged file NumPy, SciPy and h5py raise whatever they stumble over
        return f"cannot be read ({reason_of(error)})"
    if not shape:
        return "a single number"
    longest = int(np.argmax(shape))
    column = _columns_of(name, [n for axis, n in enumerate(shape) if axis != longest])
    unit = f" in {variable.unit}" if variable.unit else ""
    columns = f"; its columns are {column}" if column else ""
    return f"{shape[longest]} samples{unit}{columns}"


def _columns_of(name: str, sizes: Sequence[int]) -> str:
    """First and last column of an array with these axes beside the longest, as a person writes them."""
    ends = [
        ":".join([*([name] if name else []), *map(str, numbers)]) for numbers in ([1] * len(sizes), sizes)
    ]
    return " to ".join(dict.fromkeys(ends))


def _parsed(column: str) -> tuple[str, list[int]]:
    """``data.u:2:1`` is the variable ``data.u`` and the numbers 2 and 1."""
    parts = column.split(":")
    numbers: list[int] = []
    while parts and parts[-1].isdecimal():
        numbers.insert(0, int(parts.pop()))
    return ":".join(parts), numbers


def _loaded(variables: Variables, name: str) -> Array:
    name = _resolved(variables, name)
    if name not in variables:
        start = f"there is no variable {name}" if name else "there are several variables, name one"
        known = f"it has {', '.join(variables)}" if any(variables) else "its one array has no name"
        raise InputError("file", f"{start}{suggestion(name, variables) or ';'} {known}")
    try:
        array = np.asarray(variables[name].load())
        refuse_large(array.shape)
    except InputError as error:
        raise InputError("file", f"{name or 'the array'} {error.mistakes[0].what}") from None
    except Exception as error:  # as above
        raise InputError("file", f"{name or 'the array'} cannot be read ({reason_of(error)})") from None
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise InputError("file", f"{name or 'the array'} holds {kind}; save an array of real numbers")
    return array.astype(np.float64)


def _resolved(variables: Variables, name: str) -> str:
    """Path of a variable: as in MATLAB (``Y(3).Data``), or the end of one path alone."""
    if not name and len(variables) == 1:
        return next(iter(variables))
    dotted = re.sub(r"[({](\d+)[)}]", r".\1", name.strip("/").replace("/", "."))
    for path in (dotted, dotted.replace(".1", "")):
        ends = [known for known in variables if known == path or known.endswith(f".{path}")]
        if path in variables or len(ends) == 1:
            return path if path in variables else ends[0]
    return name


def _column(array: Array, column: str, numbers: Sequence[int]) -> Array:
    """One line of an array along its longest axis."""
    if array.ndim == 0:
        raise InputError("file", "is a single number, not a signal")
    array = np.moveaxis(array, int(np.argmax(array.shape)), -1)
    sizes = array.shape[:-1]
    if not numbers and all(size == 1 for size in sizes):
        return array.reshape(-1)
    if not sizes and list(numbers) == [1]:
        return array
    if len(numbers) != len(sizes) or not all(1 <= n <= s for n, s in zip(numbers, sizes, strict=True)):
        wanted = _columns_of(_parsed(column)[0], sizes) or "the name alone"
        raise InputError("file", f"does not fit an array of {array.shape[-1]} samples; write {wanted}")
    return np.asarray(array[tuple(n - 1 for n in numbers)])

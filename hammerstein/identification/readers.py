"""Columns of numbers out of files: text, NumPy, MATLAB and Parquet.

How a column is named
    by its name in the header, or by its number from 1, in text, Parquet and two-dimensional arrays
    ``NAME`` or ``NAME:3``, the only or the third column of the variable NAME in an ``.npz`` or ``.mat`` file;
    fields of a MATLAB structure are named with dots, ``data.u:2``
    ``2:1:5`` in an array of more than two axes: one number from 1 for every axis but that of time

The axis of time of an array is its longest one.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError, Mistake
from hammerstein.identification.record_checks import gap_mistakes
from hammerstein.identification.text_tables import find_layout, read_text

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns taken from one file.

    Parameters
    ----------
    source : the file
    names : name of each column
    values : (column, sample), not finite where a number is missing
    rows : (sample,) row of each sample in the file, from 1
    mistakes : fields without a number
    """

    source: str
    names: tuple[str, ...]
    values: Array
    rows: Rows
    mistakes: tuple[Mistake, ...]


def read_columns(path: str | Path, wanted: Sequence[str]) -> Columns:
    """Columns of one file by name or number from 1; the format is told by the end of the file's name.

    Parameters
    ----------
    path : ``.npy``, ``.npz``, ``.mat``, ``.parquet``; anything else is read as text
    wanted : columns, see the top of this module

    Raises
    ------
    InputError : a missing, empty or unreadable file, unknown columns (with the names that exist)
    """
    path = Path(path)
    _refuse_missing(path)
    suffix = path.suffix.lower()
    if suffix in _VARIABLES:
        return _array_columns(path, wanted)
    if suffix in (".parquet", ".pq"):
        return _parquet_columns(path, wanted)
    layout = find_layout(path)
    indices = _choose(path, wanted, layout.names, layout.width)
    names = tuple(_label(index, layout.names) for index in indices)
    values, rows, mistakes = read_text(path, layout, indices, names)
    return _columns(path, names, values, rows, mistakes)


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
    path = Path(path)
    _refuse_missing(path)
    if path.suffix.lower() not in _VARIABLES:
        raise InputError(str(path), "is no file of arrays; give .npy, .npz or .mat")
    variables = _variables(path)
    return _numbers(path, *_variable(path, variables, variable or ""))


def _refuse_missing(path: Path) -> None:
    try:
        if not path.is_file():
            what = "is a folder; give a file" if path.is_dir() else "does not exist; check its name and folder"
            raise InputError(str(path), what)
        if path.stat().st_size == 0:
            raise InputError(str(path), "is empty (0 bytes); record it again")
        path.open("rb").close()
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({(error.strerror or str(error)).lower()})") from None


def _columns(
    path: Path, names: tuple[str, ...], values: Array, rows: Rows, text: Sequence[Mistake] = ()
) -> Columns:
    spoiled = {mistake.where for mistake in text}
    gaps = [m for m in gap_mistakes(names, values, rows) if m.where not in spoiled]
    return Columns(str(path), names, values, rows, (*text, *gaps))


def _choose(path: Path, wanted: Sequence[str], names: Sequence[str], width: int) -> list[int]:
    """Index of each wanted column: by name as written, then by number, then by name in any case."""
    indices, mistakes = [], []
    lower = [name.lower() for name in names]
    for column in wanted:
        found = [k for k, name in enumerate(names) if name == column]
        if not found and column.isdecimal() and 1 <= int(column) <= width:
            found = [int(column) - 1]
        found = found or [k for k, name in enumerate(lower) if name == column.lower()]
        if len(found) == 1:
            indices.append(found[0])
        elif found:
            numbers = " and ".join(str(k + 1) for k in found)
            mistakes.append(Mistake(f"column {column}", f"stands {len(found)} times; give its number, {numbers}"))
        else:
            mistakes.append(Mistake(f"column {column}", "is not in the file" + _known(column, names, width)))
    if mistakes:
        raise InputError(str(path), mistakes)
    return indices


def _known(column: str, names: Sequence[str], width: int) -> str:
    if not any(names):
        return f"; it has no header, name columns by number, 1 to {width}"
    near = difflib.get_close_matches(column, names, n=1)
    suggestion = f"; did you mean {near[0]}?" if near else ""
    listed = ", ".join(f"{k + 1} {name}" for k, name in enumerate(names[:20]) if name)
    return f"{suggestion or ';'} it has {listed}" + (", ..." if len(names) > 20 else "")


def _label(index: int, names: Sequence[str]) -> str:
    return names[index] if names and names[index] else str(index + 1)


def _parquet_columns(path: Path, wanted: Sequence[str]) -> Columns:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise InputError(
            str(path),
            "reading Parquet needs pyarrow; pip install 'hammerstein-control[parquet]', or convert it to CSV",
        ) from None
    import pandas as pd

    try:
        file = parquet.ParquetFile(path)
        names = file.schema_arrow.names
        indices = _choose(path, wanted, names, len(names))
        frame = file.read(columns=[names[k] for k in sorted(set(indices))]).to_pandas()
    except (OSError, ValueError) as error:
        raise InputError(str(path), f"is no Parquet file that can be read ({error})") from None
    rows = np.arange(1, len(frame) + 1)
    chosen = tuple(names[k] for k in indices)
    text, values = [], []
    for name in chosen:
        numbers = pd.to_numeric(frame[name], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
        if not frame[name].dtype.kind in "iufb" and np.isnan(numbers).all():
            text.append(Mistake(f"column {name}", f"holds {frame[name].dtype}, not numbers; choose another"))
        values.append(numbers)
    return _columns(path, chosen, np.vstack(values), rows, text)


def _array_columns(path: Path, wanted: Sequence[str]) -> Columns:
    variables = _variables(path)
    values, mistakes = [], []
    for column in wanted:
        try:
            values.append(_one_column(path, variables, column))
        except InputError as error:
            mistakes += [Mistake(m.where or f"column {column}", m.what) for m in error.mistakes]
    lengths = {len(value) for value in values}
    if len(lengths) > 1:
        listed = ", ".join(f"{name} {len(value)}" for name, value in zip(wanted, values, strict=False))
        mistakes.append(Mistake("columns", f"have different numbers of samples: {listed}"))
    if mistakes:
        raise InputError(str(path), mistakes)
    stacked = np.vstack(values)
    return _columns(path, tuple(wanted), stacked, np.arange(1, stacked.shape[1] + 1))


def _one_column(path: Path, variables: Mapping[str, Callable[[], Any]], column: str) -> Array:
    """One column, from ``NAME``, ``NAME:2``, ``2`` or ``NAME:2:1:5``."""
    match = re.fullmatch(r"(?:(?P<name>.*?[^\d:].*?)(?::|$))?(?P<numbers>\d+(?::\d+)*)?", column)
    name = (match["name"] if match else column) or ""
    numbers = [int(n) for n in match["numbers"].split(":")] if match and match["numbers"] else []
    array = _numbers(path, *_variable(path, variables, name))
    array = np.moveaxis(array, int(np.argmax(array.shape)), -1)
    sizes = array.shape[:-1]
    if not numbers and int(np.prod(sizes)) == 1:
        return array.reshape(-1)
    numbers = [1, *numbers] if len(numbers) == len(sizes) - 1 and 1 in sizes[:1] else numbers
    inside = len(numbers) == len(sizes) and all(1 <= n <= size for n, size in zip(numbers, sizes, strict=True))
    if not inside and not (sizes == () and numbers == [1]):
        limits = ":".join(f"1..{size}" for size in sizes)
        name = name or next(iter(variables)) if len(variables) > 1 else name
        raise InputError(
            str(path),
            [Mistake(f"column {column}", f"is not in an array of {array.shape[-1]} samples; write "
                     f"{name + ':' if name else ''}{limits}")],
        )
    return np.asarray(array[tuple(n - 1 for n in numbers)] if sizes else array)


def _variable(
    path: Path, variables: Mapping[str, Callable[[], Any]], name: str
) -> tuple[str, Callable[[], Any]]:
    if name in variables:
        return name, variables[name]
    if not name and len(variables) == 1:
        return next(iter(variables.items()))
    if not variables:
        raise InputError(str(path), "holds no array of numbers; save the signals as plain numeric arrays")
    near = difflib.get_close_matches(name, variables, n=1)
    suggestion = f"; did you mean {near[0]}?" if near else ";"
    start = f"holds no variable {name}" if name else "holds several variables; name one"
    raise InputError(str(path), f"{start}{suggestion} it has {', '.join(list(variables)[:30])}")


def _numbers(path: Path, name: str, load: Callable[[], Any]) -> Array:
    try:
        array = np.asarray(load())
    except (ValueError, OSError) as error:
        raise InputError(str(path), f"{name} cannot be read ({error})".strip()) from None
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise InputError(str(path), f"{name} holds {kind}; save it as an array of real numbers".strip())
    return array.astype(np.float64)


def _variables(path: Path) -> dict[str, Callable[[], Any]]:
    """Every array in the file by name, loaded when called."""
    try:
        return _VARIABLES[path.suffix.lower()](path)
    except (ValueError, OSError, EOFError, TypeError, KeyError) as error:
        raise InputError(str(path), f"is no {path.suffix} file that can be read ({error})") from None

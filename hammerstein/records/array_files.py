"""Arrays in NumPy and MATLAB files, and how one column of them is named."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError, Mistake

Array = NDArray[np.float64]
Variables = Mapping[str, Callable[[], Any]]
"""Name of each variable in a file, and how to load it; the only one of an ``.npy`` file has no name."""

SUFFIXES = (".npy", ".npz", ".mat")


def array_columns(path: Path, wanted: Sequence[str]) -> Array:
    """Columns (column, sample) of an ``.npy``, ``.npz`` or ``.mat`` file.

    Parameters
    ----------
    path : file
    wanted : ``NAME``, ``NAME:3``, ``3`` or, in an array of more axes, ``NAME:2:1:5``: one number from 1 for
        every axis but that of time, which is the longest

    Raises
    ------
    InputError : unreadable file, unknown variables and columns (all at once), columns of different length
    """
    variables = _variables(path)
    columns: list[Array] = []
    mistakes: list[Mistake] = []
    for column in wanted:
        name, numbers = _parsed(column)
        try:
            columns.append(_column(_loaded(variables, name), column, numbers))
        except InputError as error:
            mistakes += [Mistake(f"column {column}", mistake.what) for mistake in error.mistakes]
    lengths = {len(column) for column in columns}
    if not mistakes and len(lengths) > 1:
        listed = ", ".join(f"{name} {len(column)}" for name, column in zip(wanted, columns, strict=True))
        mistakes.append(Mistake("columns", f"have different numbers of samples: {listed}"))
    if mistakes:
        raise InputError(str(path), mistakes)
    return np.vstack(columns)


def whole_array(path: Path, variable: str) -> Array:
    """One array with all its axes; the variable may be empty where the file holds a single one.

    Raises
    ------
    InputError : unreadable file or unknown variable
    """
    variables = _variables(path)
    try:
        return _loaded(variables, variable)
    except InputError as error:
        raise InputError(str(path), error.mistakes) from None


def _parsed(column: str) -> tuple[str, list[int]]:
    """``data.u:2:1`` is the variable ``data.u`` and the numbers 2 and 1."""
    parts = column.split(":")
    numbers: list[int] = []
    while parts and parts[-1].isdecimal():
        numbers.insert(0, int(parts.pop()))
    return ":".join(parts), numbers


def _loaded(variables: Variables, name: str) -> Array:
    if not variables:
        raise InputError("file", "it holds no array of numbers; save the signals as plain numeric arrays")
    if not name and len(variables) == 1:
        name = next(iter(variables))
    if name not in variables:
        near = difflib.get_close_matches(name, variables, n=1)
        start = f"there is no variable {name}" if name else "there are several variables, name one"
        known = f"it has {', '.join(list(variables)[:30])}" if any(variables) else "its one array has no name"
        raise InputError("file", f"{start}{f'; did you mean {near[0]}?' if near else ';'} {known}")
    try:
        array = np.asarray(variables[name]())
    except Exception as error:  # on a damaged file NumPy, SciPy and h5py raise whatever they stumble over
        raise InputError("file", f"{name or 'the array'} cannot be read ({error})") from None
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise InputError("file", f"{name or 'the array'} holds {kind}; save an array of real numbers")
    return array.astype(np.float64)


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
        name = _parsed(column)[0]
        limits = ":".join(f"(1 to {size})" for size in sizes) or "the name alone"
        wanted = f"{name}:{limits}" if name and sizes else limits
        raise InputError("file", f"does not fit an array of {array.shape[-1]} samples; write {wanted}")
    return np.asarray(array[tuple(n - 1 for n in numbers)])


def _variables(path: Path) -> Variables:
    suffix = path.suffix.lower()
    try:
        if suffix == ".npy":
            return _numpy_array(path)
        return _numpy_archive(path) if suffix == ".npz" else _matlab(path)
    except Exception as error:  # as above
        what = f"is no {suffix} file that can be read ({error}); was it cut short, or is it of another kind?"
        raise InputError(str(path), what) from None


def _numpy_array(path: Path) -> Variables:
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.dtype.names:
        return {name: partial(array.__getitem__, name) for name in array.dtype.names}
    return {"": lambda: array}


def _numpy_archive(path: Path) -> Variables:
    with np.load(path, allow_pickle=False) as archive:
        names = list(archive.files)

    def load(name: str) -> Any:
        with np.load(path, allow_pickle=False) as archive:
            return archive[name]

    return {name: partial(load, name) for name in names}


def _matlab(path: Path) -> Variables:
    import h5py

    return _matlab_hdf5(path) if h5py.is_hdf5(path) else _matlab_old(path)


def _matlab_old(path: Path) -> Variables:
    """Versions 4 to 7.2."""
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns of objects that it cannot read; they are left out here
        content = scipy.io.loadmat(path)
    found = (pair for name, value in content.items() if name[:2] != "__" for pair in _flat(name, value))
    return {name: partial(np.asarray, value) for name, value in found}


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numeric arrays inside a variable; fields of structures get dotted names."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if not isinstance(value, np.ndarray) or isinstance(value, MatlabOpaque | MatlabFunction):
        return
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            yield from _flat(f"{name}.{field}", value.flat[0][field])
    elif value.dtype.kind in "biufc" and value.size:
        yield name, value


def _matlab_hdf5(path: Path) -> Variables:
    """Version 7.3: HDF5, with the axes of every array in reverse order."""
    import h5py

    names: list[str] = []

    def note(name: str, item: Any) -> None:
        kind = item.attrs.get("MATLAB_class", b"double")
        numeric = (
            isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and kind not in (b"char", b"cell")
        )
        if numeric and "MATLAB_empty" not in item.attrs and not name.startswith("#"):
            names.append(name)

    def load(name: str) -> Any:
        with h5py.File(path, "r") as file:
            return file[name][()].T

    with h5py.File(path, "r") as file:
        file.visititems(note)
    return {name.replace("/", "."): partial(load, name) for name in names}

"""Arrays in NumPy, MATLAB, HDF5, Excel and TDMS files, and the names of their columns."""

import math
import re
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError, Mistake, naming, refuse
from hammerstein.records import checks
from hammerstein.records.checks import refuse_large as refuse_large
from hammerstein.records.file_formats import (
    Variable,
    Variables,
    excel_columns,
    is_matlab_v4,
    is_matlab_v5,
    read_matlab_v5,
    stated_unit,
    tdms_channels,
)
from hammerstein.validation import suggestion

HDF5, HEADER_BYTES = b"\x89HDF\r\n\x1a\n", 512
"""Sign of an HDF5 file, and size of MATLAB's header before it."""
GENERIC_HDF5 = (".h5", ".hdf5")
EXCEL, TDMS = ".xlsx", ".tdms"
SUFFIXES = (".npy", ".npz", ".mat", *GENERIC_HDF5, EXCEL, TDMS)
MOST_OBJECTS = 100_000
"""Most variables of an HDF5 file; a file with more is no record."""


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
    except Exception as error:  # as above
        return f"cannot be read ({_reason(error)})"
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


def whole_array(path: Path, variable: str) -> Array:
    """One array with all its axes; the variable may be empty if the file has a single one.

    Raises
    ------
    InputError : unreadable file or unknown variable
    """
    variables = variables_of(path)
    with naming(str(path)):
        return _loaded(variables, variable)


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
    except Exception as error:  # on a damaged file NumPy, SciPy and h5py raise whatever they stumble over
        raise InputError("file", f"{name or 'the array'} cannot be read ({_reason(error)})") from None
    if array.dtype.kind not in "biuf":
        kind = "complex numbers" if array.dtype.kind == "c" else "no numbers"
        raise InputError("file", f"{name or 'the array'} holds {kind}; save an array of real numbers")
    return array.astype(np.float64)


def _reason(error: Exception) -> str:
    """Error message of a library for a damaged file, without parts that a person cannot read."""
    text = str(error).partition("\n")[0]
    if re.search(r"pickle|Python objects|Object arrays", text):
        return "it contains other things than numbers"
    return "its header is damaged" if " object at 0x" in text or not text else text[:200]


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


def variables_of(path: Path) -> Variables:
    """Arrays of a file by their names, each with the unit that the file states; InputError if unreadable."""
    suffix = path.suffix.lower()
    try:
        found = _READERS[suffix](path)
    except ImportError:
        kind, extra = _EXTRAS[suffix]
        what = f"is {kind}: pip install 'hammerstein-control[{extra}]', or save it as CSV"
        raise InputError(str(path), what) from None
    except Exception as error:  # as above
        why = _reason(error)
        what = f"cannot be read as a {suffix} file ({why}); was it cut short, or is it of another kind?"
        raise InputError(str(path), what) from None
    if not found:
        what = f"has no array of numbers; is it a {suffix} file, with signals as plain numeric arrays?"
        raise InputError(str(path), what)
    return found


def _numpy_array(path: Path) -> Variables:
    array = np.load(path, mmap_mode="r", allow_pickle=False)
    if array.dtype.names:
        return {name: Variable(partial(array.__getitem__, name)) for name in array.dtype.names}
    return {"": Variable(lambda: array)}


def _numpy_archive(path: Path) -> Variables:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        names = list(archive.files)

    def load(name: str) -> Any:
        refuse_large(*_declared(path, name))
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return archive[name]

    return {name: Variable(partial(load, name)) for name in names}


def _declared(path: Path, name: str) -> tuple[tuple[int, ...], int]:
    """Shape and bytes of a number that the header of an array in an ``.npz`` file declares."""
    with zipfile.ZipFile(path) as archive, archive.open(f"{name}.npy") as file:
        old = np.lib.format.read_magic(file) == (1, 0)
        read = np.lib.format.read_array_header_1_0 if old else np.lib.format.read_array_header_2_0
        shape, _, kind = read(file)
        return tuple(shape), kind.itemsize


def _matlab(path: Path) -> Variables:
    with path.open("rb") as file:
        begin = file.read(HEADER_BYTES + len(HDF5))
    if HDF5 in (begin[: len(HDF5)], begin[HEADER_BYTES:]):
        return _hdf5(path, matlab=True)
    if is_matlab_v5(begin):
        content = read_matlab_v5(path, most_bytes=8 * checks.MOST_NUMBERS)
    elif is_matlab_v4(begin):
        content = _matlab_v4(path)
    else:
        raise ValueError("it has neither the byte-order mark of version 5 nor the first number of version 4")
    found = (pair for name, value in content.items() if name[:2] != "__" for pair in _flat(name, value))
    return {name: Variable(partial(np.asarray, value)) for name, value in found}


def _matlab_v4(path: Path) -> dict[str, Any]:
    """Version 4, by SciPy, whose reader of this version is Python; of others it is compiled and may die."""
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns of what it cannot read; that is left out here
        listed = scipy.io.whosmat(path)
        numbers = sum(math.prod(shape) for _, shape, _ in listed)
        if numbers > path.stat().st_size or any(min(shape) < 0 for _, shape, _ in listed):
            raise ValueError("it declares more numbers than it contains")
        content: dict[str, Any] = scipy.io.loadmat(path)
    return content


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numeric arrays inside a variable; fields of structures get dotted names."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if not isinstance(value, np.ndarray) or isinstance(value, MatlabOpaque | MatlabFunction):
        return
    if value.dtype.names:
        for k, item in enumerate(value.flatten(order="F"), start=1):
            number = f".{k}" if value.size > 1 else ""  # a lone structure has none
            for field in value.dtype.names:
                yield from _flat(f"{name}{number}.{field}", item[field])
    elif value.dtype == object:
        for k, item in enumerate(value.flatten(order="F"), start=1):
            yield from _flat(f"{name}.{k}", item)
    elif value.dtype.kind in "biufc" and value.size:
        yield name, value


def _hdf5(path: Path, matlab: bool = False) -> Variables:
    """Numeric arrays of an HDF5 file by their path in it, with dots.

    matlab : whether it is one of MATLAB 7.3, with the axes of every array in reverse order; then text, empty
        arrays and what its objects refer to are left out, and cells and arrays of structures are looked into
    """
    import h5py

    places: dict[str, tuple[str, str]] = {}
    seen: set[int] = set()

    def note(name: str, item: Any) -> None:
        if _refused(item, seen):
            return
        kind = item.attrs.get("MATLAB_class", b"double") if matlab else None
        if isinstance(item, h5py.Group):
            for member, inside in _members(item) if matlab else _inside(item):
                note(f"{name}.{member}", inside)
        elif item.dtype == h5py.ref_dtype and kind == b"cell":
            for number, inside in _referred(item):
                note(f"{name}.{number}", inside)
        elif item.dtype.kind in "biuf" and kind != b"char" and not (matlab and "MATLAB_empty" in item.attrs):
            places[name] = item.name, stated_unit(item.attrs)

    def load(place: str) -> Any:
        with h5py.File(path, "r") as file:
            refuse_large(file[place].shape)
            array = file[place][()]
            return array.T if matlab else array

    with h5py.File(path, "r") as file:
        _refused(file, seen)
        for name, item in _inside(file):
            if not (matlab and name.startswith("#")):
                note(name, item)
    return {name: Variable(partial(load, place), unit) for name, (place, unit) in places.items()}


def _refused(item: Any, seen: set[int]) -> bool:
    """Whether a group or cell was looked into before, under another name; ValueError for what no record is.

    It lies at one address of the file, however many links lead to it.
    """
    import h5py

    if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
        raise ValueError(f"{item.name} is in another file; save it in this one")
    address = h5py.h5o.get_info(item.id).addr
    known = address in seen
    seen.add(address)
    if len(seen) > MOST_OBJECTS:
        raise ValueError(f"it has more than {MOST_OBJECTS} objects")
    return known and (isinstance(item, h5py.Group) or item.dtype == h5py.ref_dtype)


def _inside(group: Any) -> Iterator[tuple[str, Any]]:
    """Objects of a group; ValueError for a link to another file."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            raise ValueError(f"{name} is in another file; save it in this one")
        yield name, group[name]


def _referred(item: Any) -> Iterator[tuple[int, Any]]:
    """Objects that an array of references names, by number."""
    refuse_large(item.shape)
    for number, reference in enumerate(item[()].flat, start=1):
        yield number, item.file[reference]


def _members(group: Any) -> Iterator[tuple[str, Any]]:
    """Fields of a structure; those of an array of structures stand under the number of each."""
    import h5py

    for field, item in _inside(group):
        several = isinstance(item, h5py.Dataset) and item.dtype == h5py.ref_dtype
        if several and item.attrs.get("MATLAB_class") is None:
            yield from ((f"{number}.{field}", inside) for number, inside in _referred(item))
        else:
            yield field, item


_READERS: Mapping[str, Callable[[Path], Variables]] = {
    ".npy": _numpy_array,
    ".npz": _numpy_archive,
    ".mat": _matlab,
    **dict.fromkeys(GENERIC_HDF5, _hdf5),
    EXCEL: excel_columns,
    TDMS: tdms_channels,
}
_EXTRAS = {
    ".mat": ("a MATLAB file of version 7.3", "matlab"),
    **dict.fromkeys(GENERIC_HDF5, ("an HDF5 file", "matlab")),
    EXCEL: ("an Excel workbook", "excel"),
    TDMS: ("a TDMS file", "tdms"),
}

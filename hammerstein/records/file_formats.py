"""Arrays in files of NumPy, MATLAB, HDF5, Excel and LabVIEW (TDMS), by their names."""

import math
import re
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError
from hammerstein.quantities import unique
from hammerstein.records import checks
from hammerstein.records.checks import refuse_large
from hammerstein.signals.signal_files import OF_TIME
from hammerstein.signals.units import is_unit, unit_in, unit_of

HDF5, BEFORE_HDF5 = b"\x89HDF\r\n\x1a\n", 512
"""Sign of an HDF5 file, and size of MATLAB's header before it."""
GENERIC_HDF5 = (".h5", ".hdf5")
EXCEL, TDMS = ".xlsx", ".tdms"
SUFFIXES = (".npy", ".npz", ".mat", *GENERIC_HDF5, EXCEL, TDMS)
MOST_OBJECTS = 100_000
"""Most variables of an HDF5 file; a file with more is no record."""
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


def variables_of(path: Path) -> Variables:
    """Arrays of a file by their names, each with the unit that the file states; InputError if unreadable."""
    suffix = path.suffix.lower()
    try:
        found = _READERS[suffix](path)
    except ImportError:
        kind, extra = _EXTRAS[suffix]
        what = f"is {kind}: pip install 'hammerstein-control[{extra}]', or save it as CSV"
        raise InputError(str(path), what) from None
    except Exception as error:  # a damaged file: they raise whatever they stumble over
        why = reason_of(error)
        what = f"cannot be read as a {suffix} file ({why}); was it cut short, or is it of another kind?"
        raise InputError(str(path), what) from None
    if not found:
        what = f"has no array of numbers; is it a {suffix} file, with signals as plain numeric arrays?"
        raise InputError(str(path), what)
    return found


def reason_of(error: Exception) -> str:
    """Error message of a library for a damaged file, without parts that a person cannot read."""
    text = str(error).partition("\n")[0]
    if re.search(r"pickle|Python objects|Object arrays", text):
        return "it contains other things than numbers"
    return "its header is damaged" if " object at 0x" in text or not text else text[:200]


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
        begin = file.read(BEFORE_HDF5 + len(HDF5))
    if HDF5 in (begin[: len(HDF5)], begin[BEFORE_HDF5:]):
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
    if not isinstance(value, np.ndarray):
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


HEADER_BYTES = 128  # MAT-File Format, header
LOOKED_AT = 1000  # bytes of a compressed variable in which its size stands
DEEPEST = 20  # structures within structures
MEMBER_BYTES = 100  # of an empty member of a cell or structure, about
MATRIX, COMPRESSED = 14, 15
"""Types of an element (MAT-File Format, data types)."""
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Storage types of numbers, by the type in their tag."""
CELL, STRUCTURE = 1, 2
"""Classes of an array (MAT-File Format, MATLAB array types)."""
ARRAYS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""NumPy types of MATLAB arrays, by their class."""
IS_COMPLEX = 0x08
"""Flag of an array (MAT-File Format, array flags)."""
UNREAD = object()
"""Placeholder for a variable of an unsupported class."""


class Element(NamedTuple):
    """One element of a file: its tag and its content."""

    kind: int
    data: memoryview


class Reader:
    """Elements of a file of one byte order; none may exceed the remaining file."""

    def __init__(self, order: str, most_bytes: int):
        self.order, self.most_bytes = order, most_bytes
        self.left = most_bytes

    def spend(self, size: int) -> None:
        """Count the bytes read; ValueError beyond the limit."""
        self.left -= size
        if self.left < 0:
            raise ValueError(
                f"it decompresses to more than {self.most_bytes / 1e6:.0f} MB; save only the "
                "signals in a file"
            )

    def elements(self, data: memoryview) -> Iterator[Element]:
        """All consecutive elements in a buffer."""
        place = 0
        while place + 8 <= len(data):
            element, place = self.element(data, place)
            yield element

    def element(self, data: memoryview, place: int) -> tuple[Element, int]:
        """One element, and the position of the next one."""
        if place + 8 > len(data):
            raise ValueError("it is cut short")
        kind, size = (int(n) for n in np.frombuffer(data[place : place + 8], f"{self.order}u4"))
        if kind >> 16:  # a small element: size and type share the first word, the content is the second
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise ValueError("a small element is longer than 4 bytes")
            return Element(kind, data[place + 4 : place + 4 + size]), place + 8
        begin = place + 8
        if begin + size > len(data):
            raise ValueError(f"an element of {size} bytes reaches beyond its end")
        content = data[begin : begin + size]
        return Element(kind, content), begin + (size if kind == COMPRESSED else 8 * math.ceil(size / 8))

    def inflated(self, data: memoryview) -> memoryview:
        """Content of a compressed element, if it is no larger than allowed."""
        head = zlib.decompressobj().decompress(data[:LOOKED_AT], 8)
        if len(head) < 8:
            raise ValueError("a compressed variable is cut short")
        size = int(np.frombuffer(head, f"{self.order}u4")[1])
        self.spend(size)
        whole = zlib.decompressobj().decompress(data, size + 8)
        if len(whole) < size + 8:
            raise ValueError("a compressed variable is shorter than declared")
        return memoryview(whole)

    def numbers(self, element: Element, count: int) -> NDArray[Any]:
        """A given count of numbers of an element, in their stored type."""
        stored = NUMBERS.get(element.kind)
        if stored is None:
            raise ValueError(f"an array is stored as type {element.kind}, which holds no numbers")
        values = np.frombuffer(element.data, f"{self.order}{stored}")
        if len(values) != count:
            raise ValueError(f"an array of {count} numbers is stored with {len(values)}")
        return values

    def variable(self, element: Element, depth: int = 0) -> tuple[str, Any]:
        """Name and content of a matrix element; ValueError for another one."""
        if element.kind != MATRIX:
            raise ValueError(f"an element of type {element.kind} is in place of a variable")
        data = element.data
        if depth > DEEPEST:
            raise ValueError(f"structures are nested more than {DEEPEST} deep")
        if not len(data):
            return "", np.zeros((0, 0))
        parts = self.elements(data)
        flags = self.numbers(_next(parts), 2)
        class_, flag = int(flags[0]) & 0xFF, int(flags[0]) >> 8
        if class_ not in ARRAYS and class_ not in (CELL, STRUCTURE):
            return "", UNREAD
        dimensions = _next(parts)
        shape = tuple(int(n) for n in self.numbers(dimensions, len(dimensions.data) // 4))
        if len(shape) < 2 or min(shape) < 0:
            raise ValueError(f"an array has the shape {shape}")
        count = math.prod(shape)
        if count > len(data):
            raise ValueError(f"an array of {count:.3g} values is stored in {len(data)} bytes")
        name = bytes(_next(parts).data).decode("latin-1")
        if class_ in (CELL, STRUCTURE):
            self.spend(count * MEMBER_BYTES)
        if class_ == CELL:
            cells = np.empty(count, dtype=object)
            for i in range(count):
                cells[i] = self.variable(_next(parts), depth + 1)[1]
            return name, cells.reshape(shape, order="F")
        if class_ == STRUCTURE:
            return name, self._structure(parts, shape, depth)
        self.spend(count * np.dtype(ARRAYS[class_]).itemsize * (2 if flag & IS_COMPLEX else 1))
        real = self.numbers(_next(parts), count).astype(ARRAYS[class_], copy=False)
        if flag & IS_COMPLEX:
            real = real + 1j * self.numbers(_next(parts), count)
        return name, real.reshape(shape, order="F")

    def _structure(self, parts: Iterator[Element], shape: tuple[int, ...], depth: int) -> NDArray[Any]:
        """Array of structures: one field an entry of its type."""
        length = int(self.numbers(_next(parts), 1)[0])
        listed = bytes(_next(parts).data)
        if not 0 < length <= 64 or len(listed) % length:
            raise ValueError("the names of a structure's fields are damaged")
        pieces = [listed[i : i + length] for i in range(0, len(listed), length)]
        names = [piece.partition(b"\0")[0].decode("latin-1") for piece in pieces]
        if len(set(names)) < len(names) or "" in names:
            raise ValueError("the names of a structure's fields are damaged")
        found = np.empty(math.prod(shape), dtype=[(name, object) for name in names])
        for i in range(len(found)):
            for name in names:
                found[name][i] = self.variable(_next(parts), depth + 1)[1]
        return found.reshape(shape, order="F")


def is_matlab_v5(begin: bytes) -> bool:
    """Whether a file begins like versions 5 to 7.2, with a byte order mark."""
    return begin[126:HEADER_BYTES] in (b"IM", b"MI") and 0 not in begin[:4]


def is_matlab_v4(begin: bytes) -> bool:
    """Whether a file begins like version 4, with a small number; only these are read with SciPy."""
    return len(begin) >= 4 and 0 in begin[:4]


def read_matlab_v5(path: Path, most_bytes: int) -> dict[str, Any]:
    """Variables of a MATLAB file of version 5 to 7.2 by name, every length checked against the file.

    SciPy's compiled reader crashed the process on some damaged files. Arrays of numbers, cells and structures
    are returned as SciPy returns them; texts, sparse matrices, objects and functions are skipped.

    Source: The MathWorks, MAT-File Format (2015), chapter 1.

    Parameters
    ----------
    path : file whose beginning ``is_matlab_v5`` knows
    most_bytes : limit of the unpacked size

    Raises
    ------
    ValueError, zlib.error : the file is damaged, or holds more than it may
    """
    data = memoryview(path.read_bytes())
    reader = Reader("<" if bytes(data[126:128]) == b"IM" else ">", most_bytes)
    found = {}
    for element in reader.elements(data[HEADER_BYTES:]):
        if element.kind == COMPRESSED:
            element, _ = reader.element(reader.inflated(element.data), 0)
        name, value = reader.variable(element)
        if value is not UNREAD and name:
            found[name] = value
    return found


def _next(parts: Iterator[Element]) -> Element:
    element = next(parts, None)
    if element is None:
        raise ValueError("a variable is cut short")
    return element


def excel_columns(path: Path) -> Variables:
    """Sheets of a workbook: the columns below the first row of texts, or all of a sheet without one.

    A column is called as its header says, behind the name of its sheet where there are several. A row of
    units may come between the names and the numbers.
    """
    import openpyxl

    with zipfile.ZipFile(path) as archive:  # its parts may declare more text than the numbers could take
        refuse_large((sum(part.file_size for part in archive.infolist()),), 1)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        sheets = {sheet.title: _sheet(sheet) for sheet in book.worksheets}
    finally:
        book.close()
    filled = {title: columns for title, columns in sheets.items() if columns}
    return {
        (name if len(filled) == 1 else f"{title}.{name}"): variable
        for title, columns in filled.items()
        for name, variable in columns.items()
    }


def _sheet(sheet: Any) -> dict[str, Variable]:
    """Columns of a sheet by name; by number where it has no header. An empty one below it is left out."""
    rows = [row for row in sheet.iter_rows(values_only=True) if any(cell is not None for cell in row)]
    first = next((k for k, row in enumerate(rows) if _numbers(row)), len(rows))
    width = max((len(row) for row in rows[first:]), default=0)
    names, units = _header(rows[:first], width)
    columns: dict[str, Variable] = {}
    for k in range(width):
        cells = [row[k] if k < len(row) else None for row in rows[first:]]
        if any(isinstance(cell, int | float) for cell in cells):
            values = np.array([cell if isinstance(cell, int | float) else math.nan for cell in cells], float)
            columns[names[k]] = Variable(partial(np.asarray, values), units[k])
    return columns


def _header(above: Sequence[Sequence[Any]], width: int) -> tuple[Sequence[str], Sequence[str]]:
    """Names and units (width,) of the columns, out of the rows above the numbers."""
    texts = [["" if cell is None else str(cell).strip() for cell in row] for row in above[-2:]]
    *titles, last = [(row + [""] * width)[:width] for row in texts] or [[""] * width]
    only_units = bool(titles) and any(last) and all(is_unit(word) for word in last)
    names, units = (titles[0], last) if only_units else (last, [""] * width)
    return unique([name or str(k) for k, name in enumerate(names, start=1)]), units


def _numbers(row: Sequence[Any]) -> bool:
    """Whether a row holds numbers and no text."""
    return any(isinstance(cell, int | float) for cell in row) and not any(isinstance(c, str) for c in row)


def tdms_channels(path: Path) -> Variables:
    """Channels of a TDMS file: by name, behind that of their group where there are several groups.

    The sample time of waveforms is their clock, ``time_s``, where they share one and no channel is a clock.
    """
    from nptdms import TdmsFile

    with TdmsFile.read_metadata(path) as file:
        groups = [group for group in file.groups() if group.channels()]
        channels = {
            (channel.name if len(groups) == 1 else f"{group.name}.{channel.name}"): channel
            for group in groups
            for channel in group.channels()
            if channel.dtype is not None and np.dtype(channel.dtype).kind in "biuf"
        }

    def load(group: str, name: str) -> Any:
        with TdmsFile.open(path) as file:
            channel = file[group][name]
            refuse_large((len(channel),))
            return channel[:]

    found = {
        name: Variable(partial(load, channel.group_name, channel.name), stated_unit(channel.properties))
        for name, channel in channels.items()
    }
    waves = {(channel.properties.get("wf_increment"), len(channel)) for channel in channels.values()}
    step, samples = waves.pop() if len(waves) == 1 else (None, 0)
    kinds = {unit.kind for name, one in found.items() if (unit := unit_of(one.unit) or unit_in(name))}
    names = {channel.name.lower() for channel in channels.values()}
    if step and "time" not in kinds and names.isdisjoint(OF_TIME):
        found["time_s"] = Variable(lambda: np.arange(samples) * step, "s")
    return found


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

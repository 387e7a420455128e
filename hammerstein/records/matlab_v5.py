"""MATLAB files of version 5 to 7.2, read with every length checked against the file.

A damaged file raises an error. SciPy's compiled reader crashed the process on some damaged files. Arrays of
numbers, texts, cells and structures are returned as SciPy returns them; sparse matrices, objects and
functions are skipped.

Source: The MathWorks, MAT-File Format (2015), chapter 1.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

HEADER_BYTES = 128  # MAT-File Format, header
LOOKED_AT = 1000  # bytes of a compressed variable in which its size stands
DEEPEST = 20  # structures within structures
MEMBER_BYTES = 100  # of an empty member of a cell or structure, about
MATRIX, COMPRESSED = 14, 15
"""Types of an element (MAT-File Format, data types)."""
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How numbers are stored, by the type in their tag."""
TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
CELL, STRUCTURE, TEXT = 1, 2, 4
"""Classes of an array (MAT-File Format, MATLAB array types)."""
ARRAYS = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""What arrays of numbers are in MATLAB, by their class."""
IS_COMPLEX = 0x08
"""Flag of an array (MAT-File Format, array flags)."""
UNREAD = object()
"""Stands for a variable of a class that is left out."""


class Element(NamedTuple):
    """One element of a file: its tag and its content."""

    kind: int
    data: memoryview


class Reader:
    """Elements of one file of a byte order, none of which is larger than the rest of the file allows."""

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
        """All elements that follow each other in some bytes."""
        place = 0
        while place + 8 <= len(data):
            element, place = self.element(data, place)
            yield element

    def element(self, data: memoryview, place: int) -> tuple[Element, int]:
        """One element, and where the next one begins."""
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
        machine = zlib.decompressobj()
        head = machine.decompress(data[:LOOKED_AT], 8)
        if len(head) < 8:
            raise ValueError("a compressed variable is cut short")
        size = int(np.frombuffer(head, f"{self.order}u4")[1])
        self.spend(size)
        whole = zlib.decompressobj().decompress(data, size + 8)
        if len(whole) < size + 8:
            raise ValueError("a compressed variable is shorter than declared")
        return memoryview(whole)

    def numbers(self, element: Element, count: int) -> NDArray[Any]:
        """So many numbers of an element, in the type in which they are stored."""
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
        if class_ not in ARRAYS and class_ not in (CELL, STRUCTURE, TEXT):
            return "", UNREAD
        dimensions = _next(parts)
        shape = tuple(int(n) for n in self.numbers(dimensions, len(dimensions.data) // 4))
        if len(shape) < 2 or min(shape) < 0:
            raise ValueError(f"an array has the shape {shape}")
        count = math.prod(shape)
        if count > len(data):
            raise ValueError(f"an array of {count:.3g} values is stored in {len(data)} bytes")
        name = bytes(_next(parts).data).decode("latin-1")
        if class_ == TEXT:
            return name, _text(_next(parts))
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


def is_matlab_v5(path: Path) -> bool:
    """Whether a file begins as those of version 5 to 7.2 do; others have no byte order at its place."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
    return len(header) == HEADER_BYTES and header[126:128] in (b"IM", b"MI") and 0 not in header[:4]


def is_matlab_v4(path: Path) -> bool:
    """Whether a file begins as those of version 4 do, with a small number: the only ones that SciPy reads."""
    with path.open("rb") as file:
        header = file.read(4)
    return len(header) == 4 and 0 in header


def read_matlab_v5(path: Path, most_bytes: int) -> dict[str, Any]:
    """Variables of a file by name.

    Parameters
    ----------
    path : file for which ``is_matlab_v5`` is true
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


def _text(element: Element) -> NDArray[Any]:
    encoding = TEXTS.get(element.kind)
    if encoding is None:
        raise ValueError(f"a text is stored as type {element.kind}")
    return np.array([bytes(element.data).decode(encoding, errors="replace")])

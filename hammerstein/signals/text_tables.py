"""Numbers in text: any separator, with or without header, comments, byte order mark or decimal comma.

The first part of the file tells its layout; pandas then reads the columns that are wanted.
"""

import contextlib
import csv
import gzip
import re
import zlib
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.errors import InputError, Mistake
from hammerstein.signals.units import is_unit

FORMATS = "CSV or other text, .npy, .npz, .mat, .h5, .xlsx, .tdms or .parquet"
"""Files that records are read from, for a message."""
SHOWN = 5
"""Places of one kind of mistake that are listed; the rest is counted."""
HEAD_BYTES = 1 << 18  # of a file that are looked at to learn its dialect
HEAD_LINES = 3000
"""Lines by which a dialect is chosen."""
GZIP = b"\x1f\x8b"
UNPACKED_PARTS = 1000
"""Of the size of a head, that a packed file is looked through for its end."""


class Dialect(NamedTuple):
    """Signs between columns (a blank for any white space), inside numbers and between groups of digits."""

    separator: str
    decimal: str
    grouping: str = ""


DIALECTS = (
    *(Dialect(*signs) for signs in (",.", "\t.", "\t,", ";.", ";,", " .", " ,")),
    Dialect(",", ","),  # quoted fields
    *(Dialect(*signs) for signs in (";,.", "\t,.", " ,.", ",,.", ";.,", "\t.,", " .,", ",.,")),
)
"""In the order of preference: digits are grouped only where nothing else explains as many lines."""
PLAIN_DIALECTS = 7
"""Those without groups of digits; the others are tried only where a number looks grouped."""
COMMENTS = ("#", "%")
BYTE_ORDER_MARKS = (
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
GROUPED = {
    sign: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:{re.escape(sign)}\d{{3}})+(?:{re.escape(point)}\d*)?$")
    for sign, point in ((",", "."), (".", ","))
}
WORD_WITH_UNIT = re.compile(r"\S+(?:\s+[\[(][^\])]*[\])])?")


class Layout(NamedTuple):
    """Layout of the numbers in a text file.

    Parameters
    ----------
    dialect : signs between columns and inside numbers
    encoding : of the text
    comment : sign that opens a comment line
    first : line of the first numbers, from 0
    width : number of columns
    names : header, empty if there is none
    units : row of units, empty if there is none
    """

    dialect: Dialect
    encoding: str
    comment: str
    first: int
    width: int
    names: tuple[str, ...]
    units: tuple[str, ...] = ()


def find_layout(path: Path, formats: str = FORMATS) -> Layout:
    """Separator, decimal sign, encoding and header of a text file, from its first lines.

    formats : that a message proposes in place of a binary file

    Raises
    ------
    InputError : a binary file, or text without a line of numbers
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if head.startswith(GZIP):
        raise InputError(str(path), _packed(path))
    encoding = _encoding(head)
    if encoding != "utf-16" and b"\0" in head:
        raise InputError(str(path), f"is a binary file; give {formats}")
    whole = -1 if len(head) == HEAD_BYTES else None
    lines = re.split("\r\n|\r|\n", head.decode(encoding, errors="replace"))[:whole][:HEAD_LINES]
    comment = "%" if any(line.lstrip().startswith("%") for line in lines) else "#"
    body = [line for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    dialect, width, grade = _dialect(body)
    if width == 0:
        what = f"has no line of numbers among its first {len(lines)} lines"
        if len(body) == 1:  # usually a header alone
            first_words = body[0].strip()[:80]
            what = f"has one line and no numbers below it: {first_words}; export the samples, too"
        raise InputError(str(path), what)
    table = [[] if line.lstrip().startswith(COMMENTS) else _fields(line, dialect.separator) for line in lines]
    first = _first_row(table, width, dialect, grade)
    names, units = _header(lines[:first], dialect, width)
    return Layout(dialect, encoding, comment, first, width, names, units)


def _packed(path: Path) -> str:
    """Message about a file packed with gzip: whether it is incomplete, as far as it was read."""
    try:
        with gzip.open(path) as file:
            for _ in range(UNPACKED_PARTS):
                if not file.read(HEAD_BYTES):
                    break
    except (OSError, EOFError, zlib.error):
        return (
            "is compressed with gzip and was cut short or damaged; copy it again, then decompress it (gunzip)"
        )
    return "is compressed with gzip; decompress it first (gunzip)"


def _encoding(head: bytes) -> str:
    for mark, encoding in BYTE_ORDER_MARKS:
        if head.startswith(mark):
            return encoding
    try:
        head[: len(head) - 4 if len(head) == HEAD_BYTES else None].decode("utf-8")
    except UnicodeDecodeError as error:
        return "latin-1" if error.reason != "unexpected end of data" else "utf-8"
    return "utf-8"


def _fields(line: str, separator: str) -> list[str]:
    """Fields of a line without blanks around them; no field for an empty line."""
    if not line.strip():
        return []
    if separator == " ":
        return line.split()
    if '"' not in line:  # what the reader would give, in less time
        return [field.strip() for field in line.split(separator)]
    return [field.strip() for field in next(csv.reader([line], delimiter=separator), [])]


def _number(field: str, dialect: Dialect) -> float | None:
    """Value of a field; None if it is no number."""
    if dialect.grouping and GROUPED[dialect.grouping].match(field):
        field = field.replace(dialect.grouping, "")
    if dialect.decimal == ",":
        if "." in field or field.endswith(",") or field.startswith(","):
            return None
        field = field.replace(",", ".", 1)
    if "_" in field:  # Python reads 1_000, a file does not mean it
        return None
    try:
        return float(field)
    except ValueError:
        return None


def _grade(fields: Sequence[str], dialect: Dialect) -> int:
    """Likeness of a line to a row of numbers: 0 all numbers, 1 some are missing, 2 half are, 3 is none.

    A separator at the end of the line opens no column.
    """
    body = fields[:-1] if len(fields) > 1 and fields[-1] == "" else fields
    numbers = sum(_number(field, dialect) is not None for field in body)
    if numbers == 0:
        return 3
    if numbers == len(body):
        return 0
    if numbers + sum(field == "" for field in body) == len(body):
        return 1
    return 2 if 2 * numbers >= len(body) else 3


def _dialect(lines: Sequence[str]) -> tuple[Dialect, int, int]:
    """Signs, width and worst grade of the rows that explain most of the lines.

    Full rows are preferred; rows with gaps or with a column of text count where full rows are the exception.
    """
    widths: dict[tuple[int, int], Counter[int]] = {}
    separators = {dialect.separator for dialect in DIALECTS}
    split = {separator: [_fields(line, separator) for line in lines] for separator in separators}
    for k, dialect in enumerate(DIALECTS):
        if k >= PLAIN_DIALECTS and not _possible(dialect, lines):
            continue
        for fields in split[dialect.separator]:
            for grade in range(_grade(fields, dialect), 3):
                widths.setdefault((grade, k), Counter())[len(fields)] += 1
    for share in (0.5, 0.0):
        for grade in range(3):
            found = [
                (count, width, -k)
                for k in range(len(DIALECTS))
                for width, count in widths.get((grade, k), Counter()).items()
                if count > share * len(lines)
            ]
            if found:
                _, width, k = max(found)
                return DIALECTS[-k], width, grade
    return DIALECTS[0], 0, 0


def _possible(dialect: Dialect, lines: Sequence[str]) -> bool:
    """Whether some line holds the signs of a dialect; a comma as sign and separator needs quotes."""
    signs = {dialect.decimal, dialect.grouping} - {""}
    quoted = dialect.separator == ","
    return any(all(sign in line for sign in signs) and ('"' in line or not quoted) for line in lines)


def _first_row(table: Sequence[Sequence[str]], width: int, dialect: Dialect, grade: int) -> int:
    """First line of the numbers: the first row, or spoiled rows right above it."""
    first = next(k for k, row in enumerate(table) if len(row) == width and _grade(row, dialect) <= grade)
    while first > 0 and len(table[first - 1]) == width:
        above = [_number(field, dialect) is not None for field in table[first - 1]]
        if not above[0] and 2 * sum(above) <= width:
            break
        first -= 1
    return first


def _header(lines: Sequence[str], dialect: Dialect, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units in the nearest lines above the numbers with one word a column; titles are passed over.

    Where there are only units, they are the names as well. Lines of comments come last: one with as many
    words as columns may stand below the header.
    """
    units: tuple[str, ...] = ()
    told = reversed([line for line in lines if line.strip()])
    for line in sorted(told, key=lambda line: line.lstrip("\ufeff \t")[:1] in COMMENTS):
        names = _words(line.lstrip("\ufeff \t#%"), dialect.separator, width)
        if len(names) != width or not any(names):
            continue
        if any(_number(name, dialect) is not None for name in names):
            break
        if not all(is_unit(name) for name in names):
            return tuple(names), units
        units = units or tuple(names)
    return units, units


def _words(line: str, separator: str, width: int) -> list[str]:
    """Fields of a line of names; a blank between a name and its unit in brackets parts no columns."""
    words = WORD_WITH_UNIT.findall(line) if separator == " " else _fields(line, separator)
    if separator == " " and len(words) != width:
        words = line.split()
    names = [word.strip("\"' ") for word in words]
    names = names[:-1] if len(names) > width and names[-1] == "" else names
    return names + [""] * (width - len(names) if len(names) == width - 1 and separator != " " else 0)


def where(name: str, rows: Indices | None = None, start: int = 0, stop: int = 0) -> str:
    """``column x, row 5`` or ``column x, rows 5 to 9`` for the samples start..stop (both included)."""
    if rows is None:
        return f"column {name}"
    if start == stop:
        return f"column {name}, row {rows[start]}"
    return f"column {name}, rows {rows[start]} to {rows[stop]}"


def not_listed(place: str, count: int, what: str) -> list[Mistake]:
    """How many mistakes of one kind there are behind those that are shown."""
    return [Mistake(place, f"{count - SHOWN} more {what}")] if count > SHOWN else []


def read_text(
    path: Path, layout: Layout, indices: Sequence[int], names: Sequence[str]
) -> tuple[Array, Indices, list[Mistake]]:
    """Columns of a text file: values (column, sample), the row of every sample, and what is no number.

    Parameters
    ----------
    path : file
    layout : how it holds its numbers
    indices : columns wanted, from 0
    names : of these columns, for the messages
    """
    lines, skipped, mistakes = _scan(path, layout)
    frame = _frame(path, layout, sorted(set(indices)), skipped)
    if len(frame) != len(lines):
        raise InputError(
            str(path),
            f"{len(lines)} lines of numbers hold {len(frame)} rows: is there an unclosed quotation mark?",
        )
    columns, spoiled = zip(*(_numbers(frame[index], layout.dialect) for index in indices), strict=True)
    values = np.vstack(columns)
    written = np.isfinite(values).any(axis=0)
    for texts in spoiled:
        written[list(texts)] = True
    filled = np.flatnonzero(written)
    samples = int(filled[-1]) + 1 if filled.size else 0
    for name, texts in zip(names, spoiled, strict=True):
        mistakes += _text_mistakes(name, texts, lines)
    return values[:, :samples], lines[:samples], mistakes


def _frame(path: Path, layout: Layout, indices: list[int], skipped: list[int]) -> Any:
    import pandas as pd

    try:
        return pd.read_csv(
            path,
            sep=r"\s+" if layout.dialect.separator == " " else layout.dialect.separator,
            **_numbers_of(layout.dialect),
            encoding=layout.encoding,
            encoding_errors="replace",
            comment=layout.comment,
            header=None,
            names=list(range(layout.width)),
            usecols=indices,
            skiprows=[*range(layout.first), *skipped],
            skip_blank_lines=False,
            low_memory=False,
            compression=None,  # what is packed was refused as binary; a name says nothing
        )
    except (pd.errors.ParserError, ValueError) as error:
        raise InputError(str(path), f"cannot be read as a table ({error})") from None


def _numbers_of(dialect: Dialect) -> dict[str, Any]:
    """How pandas reads the numbers: as text where it cannot tell the signs apart."""
    if dialect.grouping or dialect.decimal == dialect.separator:
        return {"dtype": str, "keep_default_na": False, "na_values": ["", "nan", "NaN", "NA", "N/A"]}
    return {"decimal": dialect.decimal}


def _numbers(series: Any, dialect: Dialect) -> tuple[Array, dict[int, str]]:
    """A column as numbers, and its fields with text instead."""
    import pandas as pd

    if series.dtype.kind in "iuf":
        return series.to_numpy(dtype=np.float64), {}
    numbers = None
    if "decimal" in _numbers_of(dialect):
        with contextlib.suppress(OverflowError):  # a whole number of hundreds of digits
            numbers = pd.to_numeric(series.astype(object), errors="coerce").to_numpy(dtype=np.float64)
    if numbers is None:
        found = [_number(str(text).strip(), dialect) for text in series]
        numbers = np.array([np.nan if value is None else value for value in found])
    spoiled = np.flatnonzero(np.isnan(numbers) & series.notna().to_numpy())
    return numbers, {int(k): str(series.iloc[k]).strip() for k in spoiled}


def _text_mistakes(name: str, texts: dict[int, str], rows: Indices) -> list[Mistake]:
    if len(texts) == len(rows):
        example = next(iter(texts.values()))[:40]
        told = (
            f"{example!r} and others: this column has text in every row; name another column, or "
            "use --rate instead of dates"
        )
        return [Mistake(where(name), told)]
    what = "is text in a column of numbers; correct or delete the row"
    shown = list(texts.items())[:SHOWN]
    mistakes = [Mistake(where(name, rows, k, k), f"{text[:40]!r} {what}") for k, text in shown]
    return mistakes + not_listed(where(name), len(texts), "fields with text further down")


def _scan(path: Path, layout: Layout) -> tuple[Indices, list[int], list[Mistake]]:
    """Rows of the samples, as an editor counts them from 1; lines to skip, from 0; rows that are too long."""
    skipped, long = [], []
    row = layout.first
    with path.open(encoding=layout.encoding, errors="replace") as file:
        for row, line in enumerate(islice(file, layout.first, None), start=layout.first + 1):
            if line.isspace() or line.lstrip().startswith(layout.comment):
                skipped.append(row - 1)
            elif _count(line, layout) > layout.width:
                long.append(row)
    rows = np.delete(np.arange(layout.first + 1, row + 1), np.array(skipped, dtype=np.int64) - layout.first)
    what = f"has more columns than the others, which have {layout.width}; correct its separators"
    mistakes = [Mistake(f"row {row}", what) for row in long[:SHOWN]]
    return rows, skipped, mistakes + not_listed("rows", len(long), "rows with too many columns")


def _count(line: str, layout: Layout) -> int:
    """Columns of a line; separators alone at its end open none."""
    if layout.dialect.separator == " ":
        return len(line.split(layout.comment)[0].split())
    if line.count(layout.dialect.separator) < layout.width:
        return layout.width
    fields = _fields(line.split(layout.comment)[0], layout.dialect.separator)
    return max((k + 1 for k, field in enumerate(fields) if field), default=0)

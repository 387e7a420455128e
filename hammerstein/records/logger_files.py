"""Columns of Excel workbooks and channels of TDMS files, by name, each loaded when it is asked for."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.records.declared_size import refuse_large


def excel_columns(path: Path) -> Mapping[str, Callable[[], Any]]:
    """Sheets of a workbook: the columns below the first row of texts, or all of a sheet without one.

    A column is called as its header says, behind the name of its sheet where there are several.
    """
    import openpyxl

    _refuse_unpacked(path)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    try:
        sheets = {sheet.title: _sheet(sheet) for sheet in book.worksheets}
    finally:
        book.close()
    filled = {title: columns for title, columns in sheets.items() if columns}
    return {
        (name if len(filled) == 1 else f"{title}.{name}"): partial(np.asarray, values)
        for title, columns in filled.items()
        for name, values in columns.items()
    }


def _refuse_unpacked(path: Path) -> None:
    """Refuse a workbook whose parts declare more text than the numbers that are read could take."""
    with zipfile.ZipFile(path) as archive:
        refuse_large((sum(part.file_size for part in archive.infolist()),), 1)


def _sheet(sheet: Any) -> dict[str, Array]:
    """Columns of a sheet by name; by number where it has no header. An empty one below it is left out."""
    rows = [row for row in sheet.iter_rows(values_only=True) if any(cell is not None for cell in row)]
    first = next((k for k, row in enumerate(rows) if _numbers(row)), len(rows))
    width = max((len(row) for row in rows[first:]), default=0)
    head = rows[first - 1] if first else ()
    columns: dict[str, Array] = {}
    for k in range(width):
        cells = [row[k] if k < len(row) else None for row in rows[first:]]
        if any(isinstance(cell, int | float) for cell in cells):
            name = str(head[k]) if k < len(head) and head[k] is not None else str(k + 1)
            columns[name] = np.array([_cell(cell) for cell in cells])
    return columns


def _numbers(row: Sequence[Any]) -> bool:
    """Whether a row holds numbers and no text."""
    return any(isinstance(cell, int | float) for cell in row) and not any(isinstance(c, str) for c in row)


def _cell(cell: Any) -> float:
    return float(cell) if isinstance(cell, int | float) else math.nan


def tdms_channels(path: Path) -> Mapping[str, Callable[[], Any]]:
    """Channels of a TDMS file: by name, behind that of their group where there are several groups."""
    from nptdms import TdmsFile

    with TdmsFile.read_metadata(path) as file:
        groups = [group for group in file.groups() if group.channels()]
        names = {
            (channel.name if len(groups) == 1 else f"{group.name}.{channel.name}"): (group.name, channel.name)
            for group in groups
            for channel in group.channels()
            if channel.dtype is not None and np.dtype(channel.dtype).kind in "biuf"
        }

    def load(place: tuple[str, str]) -> Any:
        with TdmsFile.open(path) as file:
            channel = file[place[0]][place[1]]
            refuse_large((len(channel),))
            return channel[:]

    return {name: partial(load, place) for name, place in names.items()}

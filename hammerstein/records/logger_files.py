"""Columns of Excel workbooks and channels of TDMS files, by name, each loaded when it is asked for."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hammerstein.blocks.axis_names import unique
from hammerstein.records.checks import refuse_large
from hammerstein.signals.signal_files import OF_TIME
from hammerstein.signals.units import is_unit, unit_in, unit_of

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


def excel_columns(path: Path) -> Variables:
    """Sheets of a workbook: the columns below the first row of texts, or all of a sheet without one.

    A column is called as its header says, behind the name of its sheet where there are several. A row of
    units may come between the names and the numbers.
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
        (name if len(filled) == 1 else f"{title}.{name}"): variable
        for title, columns in filled.items()
        for name, variable in columns.items()
    }


def _refuse_unpacked(path: Path) -> None:
    """Refuse a workbook whose parts declare more text than the numbers that are read could take."""
    with zipfile.ZipFile(path) as archive:
        refuse_large((sum(part.file_size for part in archive.infolist()),), 1)


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
            values = np.array([_cell(cell) for cell in cells])
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


def _cell(cell: Any) -> float:
    return float(cell) if isinstance(cell, int | float) else math.nan


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
        places = {
            name: (channel.group_name, channel.name, stated_unit(channel.properties))
            for name, channel in channels.items()
        }

    def load(group: str, name: str) -> Any:
        with TdmsFile.open(path) as file:
            channel = file[group][name]
            refuse_large((len(channel),))
            return channel[:]

    found = {
        name: Variable(partial(load, group, channel), unit) for name, (group, channel, unit) in places.items()
    }
    waves = {(channel.properties.get("wf_increment"), len(channel)) for channel in channels.values()}
    step, samples = waves.pop() if len(waves) == 1 else (None, 0)
    kinds = {unit.kind for name, place in places.items() if (unit := unit_of(place[2]) or unit_in(name))}
    if step and "time" not in kinds and {place[1].lower() for place in places.values()}.isdisjoint(OF_TIME):
        found["time_s"] = Variable(lambda: np.arange(samples) * step, "s")
    return found

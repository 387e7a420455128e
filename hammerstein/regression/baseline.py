"""The numbers of a scenario as they were accepted, and their file."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, FiniteFloat

from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.report import Report
from hammerstein.files import read_limited, refuse_no_file, write_atomic
from hammerstein.runtime.storage.exchange import put_aside
from hammerstein.validation import Strict, mistakes_in

FORMAT = "hammerstein-baseline/1"
NOTHING = " \t\r\n{}[]"
"""A file of these alone holds nothing that could be lost."""

Key = tuple[tuple[str, str | float], ...]
"""What tells one row from the others: names and values, in order of the names."""
Numbers = Mapping[Key, Mapping[str, float]]


class RowFile(Strict):
    """One row in a baseline file."""

    key: dict[str, str | FiniteFloat]
    numbers: dict[str, FiniteFloat]


class BaselineFile(Strict):
    """What a baseline file holds."""

    format: Literal["hammerstein-baseline/1"]
    digest: str = ""
    scenario_digest: str
    model_digest: str
    rows: Annotated[tuple[RowFile, ...], Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class Baseline:
    """Accepted numbers of one scenario, and the hashes of the scenario and the model that gave them."""

    scenario_digest: str
    model_digest: str
    rows: Numbers

    @classmethod
    def of(cls, report: Report) -> Baseline:
        """Return the numbers of a report.

        Raises
        ------
        SimulationError : a number is infinite or NaN
        InputError : two rows have the same key
        """
        rows = numbers_of(report)
        for key, numbers in rows.items():
            for metric, value in numbers.items():
                if not math.isfinite(value):
                    raise SimulationError(
                        f"{report.name}: {metric} is {value} in the row {words_of(key)}; a baseline "
                        "needs finite numbers"
                    )
        return cls(report.digest, report.model_digest, rows)

    @classmethod
    def load(cls, path: Path) -> Baseline:
        """Read a baseline file; InputError with every mistake in it."""
        text = read_limited(path, what="baseline")
        with mistakes_in(str(path), BaselineFile):
            file = BaselineFile.model_validate_json(text)
        rows = _by_key(((row.key, row.numbers) for row in file.rows), str(path))
        return cls(file.scenario_digest, file.model_digest, rows)

    def to_json(self) -> str:
        """Text of the baseline file: one row a line, full precision, sorted keys, no clock and no host.

        Its first entry is the digest of the others: a file that a person changed has another.
        """
        rows = [{"key": dict(key), "numbers": dict(numbers)} for key, numbers in self.rows.items()]
        lines = ",\n".join("  " + json.dumps(row, sort_keys=True, allow_nan=False) for row in rows)
        text = (
            f' "format": {json.dumps(FORMAT)},\n "model_digest": {json.dumps(self.model_digest)},\n'
            f' "rows": [\n{lines}\n ],\n "scenario_digest": {json.dumps(self.scenario_digest)}\n}}\n'
        )
        return f"{{\n{_digest_line(text)}\n{text}"

    def save(self, path: Path, overwrite: bool = False) -> SavedBaseline:
        """Write the file in one piece, unless it holds the same already.

        A baseline that a person has changed is kept under another name, unless it may be overwritten.

        Raises InputError if it cannot be written, or if the file that is there is no baseline.
        """
        data = self.to_json().encode()
        if path.is_file() and path.read_bytes() == data:
            return SavedBaseline(written=False)
        refuse_no_file("--update-baseline", path)
        kept = None
        if path.exists() and not overwrite and not _is_own(path):
            kept = put_aside(path)
        write_atomic(path, data)
        return SavedBaseline(written=True, kept=kept)


class SavedBaseline(NamedTuple):
    """Whether a baseline had to be written, and the new name of one that a person had changed."""

    written: bool
    kept: Path | None = None


def _is_own(path: Path) -> bool:
    """Whether a file is a baseline as it was written; InputError where it is none."""
    text = read_limited(path, what="baseline") if path.stat().st_size else ""
    if not text.strip(NOTHING):
        return True
    if FORMAT.partition("/")[0] not in text:
        what = f"{path} is no baseline and would be overwritten; move it away, or give --overwrite"
        raise InputError("--update-baseline", what)
    _, digest, rest = [*text.split("\n", 2), "", ""][:3]
    return digest == _digest_line(rest)


def _digest_line(rest: str) -> str:
    return f' "digest": "{hashlib.sha256(rest.encode()).hexdigest()}",'


def numbers_of(report: Report) -> Numbers:
    """All numbers of a report: its rows with their bands, and the numbers of its judgements.

    Raises InputError where two rows cannot be told apart.
    """
    bands: dict[Key, dict[str, float]] = {}
    for band in report.bands:
        numbers = bands.setdefault(key_of(band.key()), {})
        numbers |= {f"{band.metric}.{part}": getattr(band, f"{part}_um") for part in ("p5", "median", "p95")}
    rows = [(row.key(), dict(row.figures) | bands.get(key_of(row.key()), {})) for row in report.rows]
    judged = (found for judgement in report.judgements for found in judgement.numbers())
    return _by_key([*rows, *judged], report.name)


def key_of(names: Mapping[str, str | float | None]) -> Key:
    """Key of a row, without its empty fields.

    >>> key_of({"measured_axis": "y", "frequency_hz": 50.0, "amplitude_v": None})
    (('frequency_hz', 50.0), ('measured_axis', 'y'))
    """
    return tuple(sorted((name, value) for name, value in names.items() if value is not None and value != ""))


def words_of(key: Key) -> str:
    """Key of a row as words, for messages.

    >>> words_of((("compensator", "exact"), ("frequency_hz", 50.0)))
    'compensator exact, frequency_hz 50'
    """
    return ", ".join(f"{n} {v:g}" if isinstance(v, float) else f"{n} {v}" for n, v in key)


def _by_key(
    rows: Iterable[tuple[Mapping[str, str | float | None], Mapping[str, float]]], source: str
) -> Numbers:
    found: dict[Key, Mapping[str, float]] = {}
    for names, numbers in rows:
        key = key_of(names)
        if key in found:
            raise InputError(
                source,
                f"two rows are both {words_of(key)}; use every label and every swept value only once",
            )
        found[key] = numbers
    return found

"""Accepted numbers of a scenario, their file, and a report compared with them: every number, both ways."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, FiniteFloat

from hammerstein.errors import InputError, Mistake, SimulationError, refuse
from hammerstein.experiment.report import Report
from hammerstein.files import read_limited, refuse_no_file, write_atomic
from hammerstein.metrics import METRICS
from hammerstein.runtime.staging import put_aside
from hammerstein.scenario.assessment import DEFAULT as OTHERS, numbers_of_judgements
from hammerstein.scenario.scenario import Tolerance
from hammerstein.validation import Strict, mistakes_in, suggestion

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
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    if not text.strip(NOTHING):
        return True
    if FORMAT.partition("/")[0] not in text:
        what = f"{path} is not a baseline and would be overwritten; move it away, or give --overwrite"
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


# Another processor or NumPy differs in the last bits of sines, sums and decompositions. Tried on the shipped
# scenarios: noise of 1e-12 of every voltage, reference and reading, a thousand times as much, moves no number
# by more than 1e-9 of itself, for a converter's step flips only where a value lies as close to its edge. So
# 0.1 % is wide, also for worst values of rounded readings; a floor of one 40 nm step there would only hide
# real changes. The floor of 1e-6 (one picometre) is for zeros of theory, such as the residue of an exact
# inverse: they hold nothing but last bits.
DEFAULT = Tolerance(relative=1e-3, absolute=1e-6)
# A millionth of a degree is no length: it is a turn by 2e-8 of the radius. A phase that is nearly zero is
# what is left of sums of samples, which the oldest and the newest NumPy order differently (1e-4 degrees in
# the triangles). 0.001 degrees is a turn by 2e-5 of the radius, a fiftieth of what a length may move.
ANGLE = Tolerance(relative=1e-3, absolute=1e-3)
COUNT = Tolerance(relative=0.0, absolute=0.0)


class Kind(StrEnum):
    """What can be wrong with a scenario's numbers."""

    MOVED = "left its tolerance"
    MISSING_ROW = "a row of the baseline is missing"
    EXTRA_ROW = "row is not in the baseline"
    MISSING_NUMBER = "number of the baseline is missing"
    EXTRA_NUMBER = "number is not in the baseline"
    MISSING_COLUMN = "number of every row of the baseline is missing"
    SCENARIO_CHANGED = "the scenario, or a file beside its actuator, changed after the baseline was made"
    MODEL_CHANGED = "the actuator's model changed after the baseline was made"
    NO_BASELINE = "has no baseline"
    ORPHAN = "belongs to no scenario"


@dataclass(frozen=True)
class Finding:
    """One difference from the baseline.

    kind : kind of difference
    key : row; empty for the whole scenario
    metric : name of the number; empty for a row or the whole scenario
    baseline, now : values of the number, None if missing; digests of changed content
    tolerance : allowed change
    """

    kind: Kind
    key: Key = ()
    metric: str = ""
    baseline: float | str | None = None
    now: float | str | None = None
    tolerance: Tolerance = DEFAULT

    @property
    def excess(self) -> float:
        """Deviation relative to the tolerance; infinite for a difference without size."""
        if not isinstance(self.baseline, (int, float)) or not isinstance(self.now, (int, float)):
            return math.inf
        allowed = limit(self.baseline, self.tolerance)
        moved = abs(deviation(self.metric, self.now, self.baseline))
        return moved / allowed if allowed > 0.0 and math.isfinite(moved) else math.inf


def compare(
    report: Report, baseline: Baseline, tolerances: Mapping[str, Tolerance] | None = None
) -> tuple[Finding, ...]:
    """Find all differences of a report from its baseline.

    A number may change by the larger of the relative and the absolute tolerance, up or down: a better number
    is a finding, too. Missing and additional rows and numbers are findings, except a number that no row of
    the baseline has (``new_columns``). NaN equals nothing.

    Parameters
    ----------
    report : report of a run
    baseline : accepted numbers
    tolerances : by name of the number; others may move by 0.1 %, but 1e-6 (angles: 0.001 degrees) in any
        case, and ``saturated_samples`` not at all

    Raises
    ------
    InputError : a tolerance is for a number that no report has

    Examples
    --------
    >>> from hammerstein.experiment.run import run
    >>> from hammerstein.scenario.scenario import Scenario
    >>> report = run(Scenario.model_validate({
    ...     "question": "How large is a loop?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}}))
    >>> compare(report, Baseline.of(report))
    ()
    """
    allowed, names = all_tolerances(tolerances), [OTHERS, *METRICS, *numbers_of_judgements()]
    refuse(
        report.name,
        [
            Mistake(f"tolerances.{name}", f"is not a number of a report{suggestion(name, names)}")
            for name in allowed
            if name not in names
        ],
    )
    now, stored = numbers_of(report), baseline.rows
    lost, added = _columns(stored, now) - _columns(now), set(new_columns(report, baseline))
    return (
        *_changes(report, baseline),
        *(Finding(Kind.MISSING_COLUMN, metric=name) for name in sorted(lost)),
        *_rows(_without(now, added), _without(stored, lost), allowed),
    )


def new_columns(report: Report, baseline: Baseline) -> tuple[str, ...]:
    """Names of the numbers that no row of the baseline has, such as those of a new figure of merit.

    They are not compared until the baseline is written anew.
    """
    return tuple(sorted(_columns(numbers_of(report), baseline.rows) - _columns(baseline.rows)))


def _columns(rows: Numbers, others: Numbers | None = None) -> set[str]:
    """Names of all numbers; of the rows alone that others have, too, if they are given."""
    return {name for key, row in rows.items() if others is None or key in others for name in row}


def _without(rows: Numbers, columns: set[str]) -> Numbers:
    return {
        key: {name: value for name, value in numbers.items() if name not in columns}
        for key, numbers in rows.items()
    }


def all_tolerances(given: Mapping[str, Tolerance] | None = None) -> dict[str, Tolerance]:
    """Tolerances by name: those of the scenario, and of counts, which may not move at all."""
    return {name: COUNT for name, metric in METRICS.items() if metric.exact} | dict(given or {})


def tolerance_of(metric: str, tolerances: Mapping[str, Tolerance]) -> Tolerance:
    """Tolerance of a number; that of a metric is that of its band.

    >>> tolerance_of("rms_um.p5", {"default": Tolerance(relative=0.01)}).relative
    0.01
    """
    name = metric.partition(".")[0]
    return tolerances.get(name, tolerances.get(OTHERS, ANGLE if _is_angle(name) else DEFAULT))


def _is_angle(name: str) -> bool:
    return name.endswith("_deg")


def deviation(metric: str, now: float, baseline: float) -> float:
    """How far a number has moved; the short way round for an angle.

    >>> deviation("phase_deg", 179.0, -179.5)
    -1.5
    """
    moved = now - baseline
    return (moved + 180.0) % 360.0 - 180.0 if _is_angle(metric.partition(".")[0]) else moved


def limit(baseline: float, tolerance: Tolerance) -> float:
    """How far a number may move from its baseline.

    >>> limit(-0.5, Tolerance(relative=0.01, absolute=1e-6))
    0.005
    """
    return max(tolerance.relative * abs(baseline), tolerance.absolute)


def _changes(report: Report, baseline: Baseline) -> Iterator[Finding]:
    if report.digest != baseline.scenario_digest:
        yield Finding(Kind.SCENARIO_CHANGED, baseline=baseline.scenario_digest, now=report.digest)
    if report.model_digest != baseline.model_digest:
        yield Finding(Kind.MODEL_CHANGED, baseline=baseline.model_digest, now=report.model_digest)


def _rows(now: Numbers, stored: Numbers, tolerances: Mapping[str, Tolerance]) -> Iterator[Finding]:
    for key in stored:
        if key not in now:
            yield Finding(Kind.MISSING_ROW, key)
        else:
            yield from _numbers(key, now[key], stored[key], tolerances)
    yield from (Finding(Kind.EXTRA_ROW, key) for key in now if key not in stored)


def _numbers(
    key: Key, now: Mapping[str, float], stored: Mapping[str, float], tolerances: Mapping[str, Tolerance]
) -> Iterator[Finding]:
    for metric, before in stored.items():
        tolerance = tolerance_of(metric, tolerances)
        if metric not in now:
            yield Finding(Kind.MISSING_NUMBER, key, metric, baseline=before)
        elif not _is_void(metric, (now, stored), tolerances) and not (
            abs(deviation(metric, now[metric], before)) <= limit(before, tolerance)  # never true for NaN
        ):
            yield Finding(Kind.MOVED, key, metric, before, now[metric], tolerance)
    added = (metric for metric in now if metric not in stored)
    yield from (Finding(Kind.EXTRA_NUMBER, key, metric, now=now[metric]) for metric in added)


def _is_void(
    metric: str, sides: tuple[Mapping[str, float], ...], tolerances: Mapping[str, Tolerance]
) -> bool:
    """Whether a number is a ratio to something that is zero, now and in the baseline."""
    base = METRICS[metric].ratio_of if metric in METRICS else None
    if base is None:
        return False  # else without height a loop has no relative width, and what is zero has no phase
    floor = tolerance_of(base, tolerances).absolute
    return all(abs(side.get(base, math.inf)) <= floor for side in sides)

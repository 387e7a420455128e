"""Description of any file of this program, recognised by its content."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from hammerstein.errors import InputError
from hammerstein.files import read_limited
from hammerstein.records.file_formats import SUFFIXES
from hammerstein.records.readers import PARQUET, arrays_in, read_columns, refuse_missing
from hammerstein.validation import mistakes_in

Facts = tuple[tuple[str, str], ...]
Named = dict[str, Any]
T = TypeVar("T", bound=BaseModel)
MOST_COLUMNS = 40  # of a table, whose ranges are shown: a screen of them
PAGES = (".html", ".htm", ".md")
MOST_STATEMENTS = 5  # of a report; its page has all of them
OWN_TABLES = {"drive_": "drive file", "played_": "file of played voltages"}  # how a column of each begins


Contents = tuple[str, Facts]
"""Description of a file: its kind, and names and texts."""


class _Report(BaseModel):
    name: str
    actuator: str
    scenario: Named
    rows: tuple[Named, ...]
    verdicts: tuple[Named, ...] = ()
    statements: tuple[str, ...] = ()


class _Baseline(BaseModel):
    rows: tuple[Named, ...]


class _Records(BaseModel):
    records: tuple[str, ...]
    held_records: tuple[str, ...] = ()

    def told(self) -> Iterator[tuple[str, str]]:
        yield "records", ", ".join(self.records)
        yield "validation records", ", ".join(self.held_records) or "none"


class _Fit(_Records):
    model: str
    verdict: str


class _Comparison(_Records):
    models: tuple[Named, ...]
    sentences: tuple[str, ...] = ()


def contents_of(path: Path) -> Contents:
    """Describe the content of a file.

    Raises InputError if it cannot be read, or if it is not a file of this program.
    """
    if path.suffix.lower() == ".toml":
        return "scenario", tuple(_scenario(path))
    if path.suffix.lower() == ".json":
        return _json(path)
    if path.suffix.lower() in SUFFIXES:
        refuse_missing(path)
        return "arrays", tuple(arrays_in(path))
    if path.suffix.lower() in PAGES:
        raise InputError(str(path), "is a page for reading; its data are in the .json beside it")
    facts = tuple(_table(path))
    return _kind_of_table([name for name, _ in facts]), facts


def _kind_of_table(names: Sequence[str]) -> str:
    """What a table is by its columns: of ours, or of a stranger."""
    for begins, kind in OWN_TABLES.items():
        if "time_s" in names and any(name.startswith(begins) for name in names):
            return kind
    return "table of numbers"


def _json(path: Path) -> Contents:
    text = read_limited(path, what="JSON file")
    try:
        found = json.loads(text)
    except ValueError as error:
        reason = str(error).partition(";")[0]  # without what Python tells a programmer
        raise InputError(str(path), f"is not JSON: {reason}") from None
    form = str(found.get("format", "")) if isinstance(found, dict) else ""
    if form.startswith("hammerstein-model/"):
        return "model", tuple(_model(path))
    if form.startswith("hammerstein-report/"):
        return "report", tuple(_report(_read(_Report, found, path)))
    if form.startswith("hammerstein-baseline/"):
        return "baseline", (("rows", str(len(_read(_Baseline, found, path).rows))),)
    if form.startswith("hammerstein-comparison/"):
        return "comparison", tuple(_comparison(_read(_Comparison, found, path)))
    if isinstance(found, dict) and "held_records" in found:
        return "fit report", tuple(_fit(_read(_Fit, found, path)))
    raise InputError(str(path), "is not a model, report, fit report, comparison or baseline of hammerstein")


def _read(form: type[T], found: Any, path: Path) -> T:
    """What is shown of a file of ours; InputError where it is spoilt."""
    with mistakes_in(str(path), form):
        return form.model_validate(found)


def _scenario(path: Path) -> Iterator[tuple[str, str]]:
    from hammerstein.experiment.plan import plan_of
    from hammerstein.quantities import duration, size
    from hammerstein.scenario import load_scenario

    scenario = load_scenario(path)
    plan = plan_of(scenario)
    yield "question", scenario.question
    yield "actuator", str(scenario.actuator)
    yield "drive" if scenario.drive is not None else "reference", _listed(scenario.signal)
    for name, values in scenario.sweep.values():
        yield f"sweep {name}", ", ".join(f"{value:g}" for value in values)
    for source in (*scenario.compensators, *scenario.models):
        law = getattr(source, "law", "model")
        found = source.identification
        where = f"file {source.model}" if found is None else f"identified: {_listed(found)}"
        yield source.label, f"{law}; {where}"
    if scenario.assessment is not None and scenario.assessment.names():
        yield scenario.assessment.title.lower(), ", ".join(scenario.assessment.names())
    takes = duration(plan.seconds) if plan.seconds > 60.0 else "a minute at most"
    yield "takes", f"{takes} on one processor, {size(plan.bytes)} of memory"


def _model(path: Path) -> Iterator[tuple[str, str]]:
    from hammerstein.dynamics import WithLoop
    from hammerstein.model import HammersteinModel

    model = HammersteinModel.load(path)
    where = "in the loop of the dynamics; before it, " * isinstance(model.dynamics, WithLoop)
    yield "name", model.name
    yield "origin", model.origin
    yield "inputs", ", ".join(model.inputs)
    yield "outputs", ", ".join(model.outputs)
    yield "hysteresis", f"{where}{model.hysteresis.describe()}"
    yield "dynamics", model.dynamics.describe()
    gains = model.gain(model.amplitude_v)
    for o, output in enumerate(model.outputs):
        told = [f"{gains[o, k]:.4g} from {name}" for k, name in enumerate(model.inputs)]
        yield f"gain of {output} [um/V]", ", ".join(told)
    yield "recorded", model.recorded.statement(model.inputs)
    limits = model.instruments.drive.limits(len(model.inputs))
    each = zip(model.inputs, *limits, strict=True)
    if np.isfinite(limits).all():
        yield "range of the drive", ", ".join(f"{name} {low:.6g} to {high:.6g} V" for name, low, high in each)
    if model.verdict is not None:
        yield (
            "fit report",
            "; ".join(model.verdict.statements) or ("flagged" if model.verdict.flagged else "no flag"),
        )


def _report(found: _Report) -> Iterator[tuple[str, str]]:
    yield "name", found.name
    yield "question", str(found.scenario.get("question", ""))
    yield "actuator", found.actuator
    yield "rows", str(len(found.rows))
    if found.verdicts:
        met = sum(verdict.get("verdict") == "met" for verdict in found.verdicts)
        yield "verdicts", f"{met} of {len(found.verdicts)} claims met"
    for number, text in enumerate(found.statements[:MOST_STATEMENTS], start=1):
        yield f"statement {number}", text


def _fit(found: _Fit) -> Iterator[tuple[str, str]]:
    yield "model", found.model
    yield "verdict", found.verdict
    yield from found.told()


def _comparison(found: _Comparison) -> Iterator[tuple[str, str]]:
    yield "models", ", ".join(str(one.get("name")) for one in found.models)
    yield from found.told()
    yield "recommended", " ".join(found.sentences)


def _table(path: Path) -> Iterator[tuple[str, str]]:
    from hammerstein.signals.text_tables import find_layout

    if path.suffix.lower() in PARQUET:
        raise InputError(str(path), "is a Parquet file; use pandas.read_parquet to see its columns")
    refuse_missing(path)
    layout = find_layout(path)
    held = read_columns(path, [str(number + 1) for number in range(min(layout.width, MOST_COLUMNS))])
    yield "rows", str(held.values.shape[1])
    for number, (name, unit, values) in enumerate(zip(held.names, held.units, held.values, strict=True), 1):
        known = values[np.isfinite(values)]
        span = f"{known.min():.6g} to {known.max():.6g}" if known.size else "no number"
        missing = f", {values.size - known.size} missing" if known.size < values.size else ""
        yield "column " * (name == str(number)) + name + f" {unit}" * (unit not in name), span + missing
    for number, line in enumerate(_notes(path, layout.encoding), start=1):
        yield f"note {number}", line


def _notes(path: Path, encoding: str) -> Iterator[str]:
    """Comment lines of a table, such as those below the columns of a drive file."""
    with path.open(encoding=encoding, errors="replace") as file:
        yield from (line.removeprefix("#").strip() for line in file if line.startswith("#"))


def _listed(value: BaseModel) -> str:
    own = value.model_dump(mode="json", exclude_none=True)
    return ", ".join(f"{key} = {value}" for key, value in own.items())

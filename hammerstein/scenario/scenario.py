"""Scenarios: one validated value for each scenario file."""

import itertools
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from hammerstein.actuators import DEFAULT
from hammerstein.blocks.instruments import Instruments
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.files import digest_of, digest_of_file, read_limited
from hammerstein.metrics import Metric, metrics_of
from hammerstein.model import place_of
from hammerstein.plugins import load_plugins
from hammerstein.quantities import (
    Cycles,
    Figure,
    FileName,
    Frequency,
    NoCycles,
    Seed,
    Size,
    Tolerated,
    Trial,
    Wait,
)
from hammerstein.scenario.assessment import ASSESSMENTS, Assessment, MetricName, NumberName
from hammerstein.scenario.source import IdentificationSpec, ModelSource, Tested
from hammerstein.scenario.variation import Study, Uncertainty
from hammerstein.signals import SIGNALS, Excitation, FromFile, Reference, Shape, written
from hammerstein.validation import Strict, WithInfinity, mistakes_of, with_nearest_kinds

MOST_VALUES = 10_000  # of one key of a sweep
Frequencies = Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=MOST_VALUES)]
Sizes = Annotated[tuple[Size, ...], Field(min_length=1, max_length=MOST_VALUES)]
Trials = Annotated[tuple[Trial, ...], Field(min_length=1, max_length=MOST_VALUES)]


class Sweep(Strict):
    """Values that replace one in the signal, or in every compensator.

    Several keys give every combination, or with ``combine = "zip"`` the first values together, the second
    ones, and so on.
    """

    combine: Literal["product", "zip"] | None = Field(
        default=None, description="every combination of the values of several keys, or the values in step"
    )

    frequency_hz: Frequencies | None = Field(
        default=None, description="frequencies that replace the signal's"
    )
    amplitude_um: Sizes | None = Field(default=None, description="amplitudes that replace the reference's")
    amplitude_v: Sizes | None = Field(default=None, description="amplitudes that replace the drive's")
    radius_um: Sizes | None = Field(default=None, description="radii that replace the signal's")
    trial: Trials | None = Field(default=None, description="trials of compensators that learn, from 1")

    def values(self) -> list[tuple[str, tuple[float, ...]]]:
        """Keys that are swept, with their values."""
        found = ((name, getattr(self, name)) for name in SWEPT)
        return [(name, values) for name, values in found if values is not None]

    def combinations(self, only: str | None = None) -> Iterator[dict[str, float]]:
        """Every combination of the values, by key; of one key alone if ``only`` names it."""
        together = self.combine == "zip"
        swept = {name: values for name, values in self.values() if together or only in (None, name)}
        names, values = list(swept), list(swept.values())
        for found in zip(*values, strict=True) if together else itertools.product(*values):
            yield {name: value for name, value in zip(names, found, strict=True) if only in (None, name)}

    def others(self, name: str) -> int:
        """Number of combinations with each value of one key."""
        if self.combine == "zip":
            return 1
        return math.prod(len(values) for key, values in self.values() if key != name)


SWEPT = tuple(name for name in Sweep.model_fields if name != "combine")
"""Keys that a sweep may vary."""
OF_COMPENSATORS = ("trial",)
"""Those of them that are options of compensators, not keys of a signal."""
DEEPEST = 32
"""Largest nesting of lists and tables; a scenario needs at most 6."""
OWN_JSON = re.compile(r'"format":\s*"hammerstein-([a-z-]+)/')
LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){32}""")
"""Dotted key with more parts than that, quoted or not."""
WORDS = frozenset({"question", "yes_if", "tolerances", "assessment", "study"})
"""Keys of a scenario without effect on its numbers."""


class Measure(Strict):
    """Durations of waiting and measurement."""

    settle_cycles: NoCycles = Field(default=2, description="cycles before the measurement")
    settle_s: Wait = Field(default=0.05, description="shortest time before the measurement")
    measured_cycles: Cycles = Field(default=2, description="measured cycles")
    record_every: Cycles | None = Field(
        default=None, description="record one of so many samples, so that a long run fits into memory"
    )


class Tolerance(Strict):
    """Allowed change of a number from its baseline: the larger of both limits."""

    relative: Tolerated = Field(
        default=1e-3, description="allowed relative difference from the accepted number"
    )
    absolute: Tolerated = Field(default=1e-6, description="difference that is always allowed")


class Scenario(WithInfinity):
    """One experiment: an actuator, a signal, and compensators or models to compare."""

    question: Annotated[str, Field(min_length=1)] = Field(
        description="question of the scenario: the title of the report"
    )
    actuator: FileName = Field(default=DEFAULT, description="packaged actuator or model file")
    seed: Seed = Field(default=1, description="seed of the sensor's noise")
    instruments: Instruments = Field(
        default=Instruments(), description="differences from the actuator's own converter and sensor"
    )
    reference: Reference | None = Field(default=None, description="path to follow, in um")
    drive: Excitation | None = Field(default=None, description="voltage to apply, in V")
    sweep: Sweep = Field(default=Sweep(), description="values that replace one of the signal; each is a run")
    measure: Measure = Field(default=Measure(), description="settling and measured cycles")
    compensators: tuple[Tested, ...] = Field(
        default=(), description="laws that follow the reference; each is a run"
    )
    models: tuple[ModelSource, ...] = Field(
        default=(), description="models whose predictions of the drive are compared"
    )
    uncertainty: Uncertainty | None = Field(default=None, description="repeat the run for random actuators")
    study: Study | None = Field(
        default=None, description="other values of any numeric key, for hammerstein sweep"
    )
    answered_by: MetricName | None = Field(
        default=None, description="figure of merit that answers the question; the report starts with it"
    )
    yes_if: dict[MetricName, Figure] = Field(
        default_factory=dict,
        description="largest value of figures of merit for which the answer to the question is yes; the "
        "first compensator or model is asked",
    )
    tolerances: dict[NumberName, Tolerance] = Field(
        default_factory=dict, description="tolerance of each number in a check, by name"
    )
    assessment: Annotated[Assessment, ASSESSMENTS.field()] | None = Field(
        default=None, description="expected results; each kind is a plug-in"
    )

    @model_validator(mode="after")
    def _is_one_experiment(self) -> Self:
        problems = list(self._problems())
        if problems:
            raise ValueError("\n".join(problems))
        return self

    def _problems(self) -> Iterator[str]:
        if (self.reference is None) == (self.drive is None):
            yield "give either a table [reference] in um or a table [drive] in V"
        if self.reference is not None and not self.compensators:
            yield "a reference needs at least one [[compensators]]"
        if self.reference is not None and self.models:
            yield "[[models]] need a [drive] in V, not a [reference]"
        if self.drive is not None and self.compensators:
            yield "[[compensators]] need a [reference] in um, not a [drive] in V"
        labels = [source.label for source in (*self.compensators, *self.models)]
        for label in sorted({label for label in labels if labels.count(label) > 1}):
            yield f"the label {label!r} is used twice; every label must be different"
        yield from self._never_tested()
        signal = self.reference or self.drive
        lengths = {key: len(values) for key, values in self.sweep.values()}
        if self.sweep.combine == "zip" and len(set(lengths.values())) != 1:
            told = ", ".join(f"{key} {length}" for key, length in lengths.items()) or "no key has any"
            yield f'sweep.combine = "zip" needs equally many values of each key: {told}'
        for key in lengths:
            if key in OF_COMPENSATORS:
                without = [repr(c.label) for c in self.compensators if key not in type(c).model_fields]
                if without or not self.compensators:
                    remedy = "; give them a scenario of their own" if without else ""
                    names = ", ".join(without) or "any compensator"
                    yield f"sweep.{key} is not an option of {names}{remedy}"
            elif signal is not None and key not in signal.model_dump():
                yield f"sweep.{key} is not a key of the {signal.kind} in this scenario"
        yield from self._swept_twice()

    def _swept_twice(self) -> Iterator[str]:
        """A key of the study that the sweep sets in every run would keep none of its values."""
        for key in self.study.values if self.study else ():
            table, _, own = key.rpartition(".")
            of_this = (
                table.startswith("compensators")
                if own in OF_COMPENSATORS
                else table in ("reference", "drive")
            )
            if of_this and own in dict(self.sweep.values()):
                yield f"study.values: {key} is also swept by sweep.{own}; remove it from one of them"

    def _never_tested(self) -> Iterator[str]:
        """A compensator or model for frequencies that the scenario does not have is a mistake."""
        signal = self.reference or self.drive
        if signal is None:
            return
        known = set(self.sweep.frequency_hz or ())
        if not known and not isinstance(signal, FromFile):
            known = {signal.highest_frequency_hz}
        for table, sources in (("compensators", self.compensators), ("models", self.models)):
            for i, source in enumerate(sources, start=1):
                missed = [f"{f:g}" for f in source.only_at_hz or () if f not in known]
                if missed:
                    have = ", ".join(f"{f:g}" for f in sorted(known)) or "none, as its signal is a file"
                    yield (
                        f"{table}[{i}].only_at_hz: there is no run at {', '.join(missed)} Hz for "
                        f"{source.label!r}; the frequencies of this scenario are {have}"
                    )

    @property
    def signal(self) -> Reference | Excitation:
        """The reference or the drive."""
        signal = self.reference or self.drive
        assert signal is not None  # held by the validation above
        return signal

    def signals(self, only: str | None = None) -> Iterator[Reference | Excitation]:
        """Every signal of the sweep; of one swept key alone if ``only`` names it."""
        for signal, _ in self.runs(only):
            yield signal

    def positions(self) -> dict[Reference | Excitation, int]:
        """Position of every signal in the sweep, counted from 1; trials of one signal share it."""
        return {signal: i for i, signal in enumerate(dict.fromkeys(self.signals()), start=1)}

    def experiments(self) -> dict[IdentificationSpec, int]:
        """Position of every identification experiment, counted from 1; equal ones are done once."""
        sources: tuple[ModelSource, ...] = (*self.compensators, *self.models)
        specs = dict.fromkeys(s.identification for s in sources if s.identification is not None)
        return {spec: i for i, spec in enumerate(specs, start=1)}

    def runs(self, only: str | None = None) -> Iterator[tuple[Reference | Excitation, int | None]]:
        """Every signal of the sweep with its trial, where trials are swept; ``only`` as for ``signals``."""
        fields = {name: name.removesuffix("_um").removesuffix("_v") for name in SWEPT}
        for values in self.sweep.combinations(only):
            own = {fields[key]: value for key, value in values.items() if key not in OF_COMPENSATORS}
            trial = values.get("trial")
            yield self.signal.model_copy(update=own), None if trial is None else int(trial)

    def portable(self) -> dict[str, Any]:
        """Content as plain JSON, independent of the location of its files."""
        content = json.loads(self.model_dump_json(exclude_none=True))
        return dict(_with_paths(content, lambda _, name: Path(name).name))

    def metrics(self) -> list[Metric]:
        """Figures of merit of a run: those of every run, and those of its assessment."""
        return metrics_of("" if self.assessment is None else self.assessment.kind)

    def _files(self) -> list[Path]:
        """Model files and signals that the run needs, as far as they exist."""
        named = [self.actuator, *(s.model for s in (*self.compensators, *self.models) if s.model)]
        signals = [self.signal.path] if isinstance(self.signal, FromFile) else []
        return [Path(name) for name in (*named, *signals) if Path(name).is_file()]

    def files(self) -> list[Path]:
        """Existing files that the scenario names."""
        others = self.assessment.actuators() if self.assessment is not None else ()
        return self._files() + [Path(name) for name in others if Path(name).is_file()]

    def content(self) -> list[Any]:
        """Everything that determines its numbers, as plain JSON: itself, and hashes of its files.

        Raises OSError where a file cannot be read.
        """
        return [self.portable(), [digest_of_file(path) for path in self.files()]]

    def digest(self) -> str:
        """Short hash of everything that affects the scenario's numbers, except the actuator's file."""
        content = {key: value for key, value in self.portable().items() if key not in WORDS}
        others = [path for path in self._files() if path != Path(self.actuator)]
        content |= {path.name: digest_of_file(path) for path in others}
        return digest_of(content)[:16]


for _family in (SIGNALS, COMPENSATORS, ASSESSMENTS):
    _family.used_by(Scenario)


ScenarioSource = Scenario | str | Path | Mapping[str, Any]
"""A scenario, its file, or the content of a file."""


def _with_paths(value: Any, path_of: Callable[[str, str], str], key: str = "") -> Any:
    """The same content with other paths of its files, wherever they stand; ``path_of`` takes key and name."""
    if isinstance(value, dict):
        return {k: _with_paths(v, path_of, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_paths(v, path_of) for v in value]
    return path_of(key, value) if key in {"actuator", "model", "path"} and isinstance(value, str) else value


def scenario_of(source: ScenarioSource) -> tuple[str, Scenario]:
    """Name and value of a scenario, given as value, file, or content of a file.

    In a mapping a signal may be a value, such as ``Circle(...)``, and a law too, such as ``ExactInverse()``;
    paths are relative to the working folder. Raises InputError with every mistake.
    """
    if isinstance(source, Scenario):
        return "scenario", source
    load_plugins()
    if isinstance(source, Mapping):
        return "scenario", _validated(_plain(source), "scenario")
    return Path(source).stem, load_scenario(source)


def _plain(source: Mapping[str, Any]) -> dict[str, Any]:
    """What a file would hold: signals and laws that are values in its words."""
    found = dict(source)
    for key, unit in (("reference", "um"), ("drive", "v")):
        if isinstance(found.get(key), Shape):
            found[key] = written(found[key], unit)
    if isinstance(found.get("compensators"), (list, tuple)):
        found["compensators"] = [_with_law_named(one) for one in found["compensators"]]
    return found


def _with_law_named(compensator: Any) -> Any:
    """A compensator whose law is a value, with the name and the options of that law."""
    if not isinstance(compensator, Mapping) or not isinstance(compensator.get("law"), Compensator):
        return compensator
    law = compensator["law"]
    return law.model_dump(exclude_defaults=True) | {**compensator, "law": law.law}


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Paths of model and CSV files in it are relative to its folder.

    Raises InputError with every mistake in the file, each with its key and the nearest known name.
    """
    load_plugins()
    path = Path(path)
    text = read_limited(path, what="scenario file", limit=1_000_000)
    data = _parsed(text, path)
    return _validated(data, str(path), path.parent)


def _validated(data: Mapping[str, Any], source: str, folder: Path | None = None) -> Scenario:
    unknown = list(_unknown_models(data, folder or Path()))
    if folder is not None:
        data = _with_paths(data, partial(_resolved, folder))
    try:
        scenario = _strictly(data)
    except ValidationError as error:
        found = {m.where: m for m in (*unknown, *_beside_kinds(data, error), *mistakes_of(error, Scenario))}
        told = [Mistake(m.where, line) for m in found.values() for line in m.what.split("\n")]
        raise InputError(source, told) from None
    refuse(source, unknown)
    return scenario


def _strictly(data: Mapping[str, Any]) -> Scenario:
    # As JSON, so that a number in quotes is refused while a list still makes a tuple.
    return Scenario.model_validate_json(json.dumps(data, default=str), strict=True)


def _beside_kinds(data: Mapping[str, Any], error: ValidationError) -> list[Mistake]:
    """Mistakes in tables whose kind is misspelt, which hides them."""
    try:
        _strictly(with_nearest_kinds(data, error))
    except ValidationError as other:
        return mistakes_of(other, Scenario)
    return []


def _parsed(text: str, path: Path) -> dict[str, Any]:
    """Content of a TOML file."""
    try:
        # before it is read: that takes memory with the square of the parts of a key
        if LONG_KEY.search(text):
            raise RecursionError
        return _shallow(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        what = f"is not TOML: {error}; a line is a [table], or key = value with text in quotes"
        if text.lstrip().startswith("{"):
            kind = OWN_JSON.search(text)
            own = f"the file of a {kind[1]}; hammerstein show describes it" if kind else "JSON"
            what = f"is {own}; a scenario (.toml) was expected"
    except RecursionError:
        what = "has too deeply nested lists or tables; is it the right file?"
    except ValueError as error:  # a whole number of thousands of digits
        what = f"contains a number that cannot be read ({str(error).partition(';')[0].lower()})"
    raise InputError(str(path), what)


def _shallow(data: dict[str, Any]) -> dict[str, Any]:
    """The content itself; RecursionError where lists and tables lie deeper within each other than any key."""
    level: list[Any] = [data]
    for _ in range(DEEPEST):
        level = [
            x for y in level if isinstance(y, dict | list) for x in (y.values() if isinstance(y, dict) else y)
        ]
        if not level:
            return data
    raise RecursionError


def _unknown_models(data: Mapping[str, Any], folder: Path) -> Iterator[Mistake]:
    """Actuators and model files that a scenario names and that are not there."""
    for where, name in _named_models(data):
        if not isinstance(name, str) or not name.isprintable():
            continue  # told by the validation
        try:
            place_of(_resolved(folder, "model", name)).stat()
        except InputError as error:
            yield Mistake(where, f"{name!r} {error.mistakes[0].what}")
        except OSError as error:
            yield Mistake(where, f"{name!r} cannot be read ({(error.strerror or str(error)).lower()})")


def _named_models(data: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Places in a scenario that name an actuator or a model, whatever else is wrong with it."""
    for key, value in data.items():
        if key in ("actuator", "model"):
            yield key, value
        elif isinstance(value, Mapping):
            yield from ((f"{key}.{where}", name) for where, name in _named_models(value))
        elif isinstance(value, list):
            for i, entry in enumerate(value, start=1):
                if isinstance(entry, Mapping):
                    yield from ((f"{key}[{i}].{where}", name) for where, name in _named_models(entry))


def _resolved(folder: Path, key: str, name: str) -> str:
    """Path of a file that a scenario in a folder names; a packaged actuator has no suffix."""
    return str(folder / name) if key == "path" or name.endswith(".json") else name

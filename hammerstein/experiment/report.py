"""Result of a run: rows of numbers, statements, and traces for figures."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.escaping import csv_text
from hammerstein.metrics import Keyed, Row
from hammerstein.model.simulation import Response
from hammerstein.notebook_repr import NotebookRepr
from hammerstein.scenario import Scenario
from hammerstein.scenario.assessment import Judgement
from hammerstein.signals import Excitation, Reference

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "hammerstein-report/1"


@dataclass(frozen=True, eq=False)
class Target:
    """Target of a run (axis, sample) [um]: a reference, or the prediction of a model."""

    label: str
    reading_um: Array
    position_um: Array

    def part(self, samples: slice) -> Target:
        """Return a part of the samples."""
        return Target(self.label, self.reading_um[:, samples], self.position_um[:, samples])


@dataclass(frozen=True, kw_only=True)
class Band(Keyed):
    """Median and 5-95 % band of one metric of one row over the draws of an uncertain actuator."""

    metric: str
    p5_um: float
    median_um: float
    p95_um: float

    def words(self) -> str:
        """Median, and ends in brackets."""
        return f"{number(self.median_um)} ({number(self.p5_um)} to {number(self.p95_um)})"


TOO_FEW = "too few draws"
"""Fewest draws for sensitivity indices."""


@dataclass(frozen=True, kw_only=True)
class Sensitivity(Keyed):
    """Part of the variance of one metric of one row that is due to one uncertain parameter.

    first, total : index of the parameter alone, and with all that it does together with others
    *_low, *_high : their 95 % limits
    """

    metric: str
    parameter: str
    first: float
    first_low: float
    first_high: float
    total: float
    total_low: float
    total_high: float

    @property
    def is_estimated(self) -> bool:
        """Whether there were enough draws: no first-order index exceeds the total index."""
        return self.first <= self.total


@dataclass(frozen=True, eq=False)
class Trace:
    """The measured window of one case, for figures and for ``--traces``."""

    label: str
    signal: Reference | Excitation
    excited_axis: str
    response: Response
    first_sample: int
    predictions: tuple[Target, ...] = ()
    trial: int | None = None

    @property
    def time_s(self) -> Array:
        """Time of each sample since the start of the run [s]."""
        return self.response.time_s + self.first_sample * self.response.sample_time_s


@dataclass(frozen=True, eq=False)
class Report(NotebookRepr):
    """Result of one scenario.

    rows : figures of merit, one row for each case and measured axis
    statements : warnings about convergence, saturation and settling
    judgements : comparison with the expected results of the scenario
    bands : spread over the draws of an uncertain actuator; empty without uncertainty
    sensitivities : share of each uncertain parameter in the spread; empty if not requested
    traces : measured windows; they are not written into the report file
    """

    name: str
    scenario: Scenario
    actuator: str
    digest: str
    model_digest: str
    instruments: Instruments
    inputs: tuple[str, ...]
    axes: tuple[str, ...]
    rows: tuple[Row, ...]
    statements: tuple[str, ...]
    judgements: tuple[Judgement, ...] = ()
    bands: tuple[Band, ...] = ()
    sensitivities: tuple[Sensitivity, ...] = ()
    traces: tuple[Trace, ...] = ()

    def __repr__(self) -> str:
        judgements = f", {len(self.judgements)} judgements" if self.judgements else ""
        counts = f"{len(self.rows)} rows, {len(self.traces)} traces{judgements}"
        return f"Report({self.name!r} on {self.actuator}: {counts})"

    @property
    def reading_first(self) -> bool:
        """Whether its assessment is about the sensor's readings."""
        asked = self.scenario.assessment
        return asked is not None and asked.reading_first

    @property
    def signal(self) -> str:
        """Kind of the signal, for a sentence."""
        return self.scenario.signal.kind.replace("lissajous", "Lissajous")

    @property
    def reads_truth(self) -> bool:
        """Whether the sensor is ideal, so that its readings equal the true position."""
        return self.instruments.sensor == Instruments.ideal().sensor

    @property
    def is_path(self) -> bool:
        """Whether all axes were driven together."""
        return all(row.excited_axis == "all" for row in self.rows)

    @property
    def banded_metric(self) -> tuple[str, str]:
        """Figure with a reported spread over random actuators, and its name."""
        path = self.is_path and len(self.axes) > 1
        return ("euclidean_max_true_um", "worst distance") if path else ("rms_true_um", "rms error")

    def is_direct(self, row: Row) -> bool:
        """Whether the axis of a row was driven itself."""
        if row.excited_axis == "all":
            return True
        driven = self.inputs if self.scenario.drive is not None else self.axes
        return driven.index(row.excited_axis) == self.axes.index(row.measured_axis)

    @property
    def identified_at(self) -> dict[str, float]:
        """Frequency of the report at which each compensator's or model's hysteresis was identified."""
        sources = (*self.scenario.compensators, *self.scenario.models)
        found = {source.label: getattr(source.identification, "frequency_hz", None) for source in sources}
        here = {row.frequency_hz for row in self.rows}
        return {label: frequency for label, frequency in found.items() if frequency in here}

    @property
    def operators(self) -> dict[str, int]:
        """Number of play operators of each model, where the models differ in nothing else; else empty."""
        sources = {model.label: model.identification for model in self.scenario.models}
        numbers = {label: getattr(source, "operators", None) for label, source in sources.items()}
        found = {label: number for label, number in numbers.items() if isinstance(number, int)}
        others = {source.model_dump_json(exclude={"operators"}) for source in sources.values() if source}
        return found if len(set(found.values())) == len(sources) > len(others) == 1 else {}

    def without_traces(self) -> Report:
        """Return the report without its traces."""
        return replace(self, traces=())

    def to_frame(self) -> pd.DataFrame:
        """Rows as a pandas table; an undefined figure is NaN."""
        import pandas as pd

        return pd.DataFrame([row.columns() for row in self.rows])

    def to_json(self) -> str:
        """Text of ``report.json``: full precision, sorted keys, no clock and no host."""
        content = {
            "format": FORMAT,
            "name": self.name,
            "actuator": self.actuator,
            "scenario": self.scenario.portable(),
            "scenario_digest": self.digest,
            "model_digest": self.model_digest,
            "statements": list(self.statements),
            "verdicts": [judgement.as_dict() | {"verdict": judgement.word} for judgement in self.judgements],
            "bands": [_known(band) for band in self.bands],
            "sensitivities": [_known(found) for found in self.sensitivities],
            "rows": [row.key() | dict(row.figures) for row in self.rows],
        }
        return json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n"

    def bands_to_csv(self) -> str:
        """Text of ``bands.csv``: one line for each row and metric."""
        return csv_text([asdict(band) for band in self.bands])

    def sensitivities_to_csv(self) -> str:
        """Text of ``sensitivities.csv``: one line for each row, metric and uncertain parameter."""
        return csv_text([asdict(found) for found in self.sensitivities])

    def to_csv(self) -> str:
        """Text of ``rms.csv``: one line for each row; undefined figures are empty."""
        return csv_text(self.to_frame())


def _known(found: Band | Sensitivity) -> dict[str, Any]:
    """Plain JSON without what has no value."""
    return {name: value for name, value in asdict(found).items() if value is not None}


TINY = 1e-6  # um; smaller values are rounding errors


@dataclass(frozen=True, order=True)
class Condition:
    """Frequency and amplitude of one run, None if the signal has none; and its trial, if any."""

    frequency_hz: float
    amplitude: float | None
    unit: str
    trial: int | None = None

    @classmethod
    def of(cls, row: Row) -> Condition:
        """Condition of a row."""
        size = (row.amplitude_v, "V") if row.amplitude_um is None else (row.amplitude_um, "um")
        return cls(row.frequency_hz, *size, row.trial)

    def only(self, parts: Collection[str]) -> Condition:
        """Return the condition with only some parts."""
        f, a, n = (getattr(self, part) if part in parts else None for part in PARTS)
        return Condition(f or 0.0, a, self.unit, n)

    def words(self) -> str:
        """Text such as ``50 Hz, 10 V``."""
        frequency = [f"{self.frequency_hz:g} Hz"] if self.frequency_hz else []
        amplitude = [] if self.amplitude is None else [f"{self.amplitude:g} {self.unit}"]
        return ", ".join(frequency + amplitude + ([] if self.trial is None else [f"trial {self.trial}"]))


PARTS = ("frequency_hz", "amplitude", "trial")
"""Parts of a condition."""


def differing(conditions: Collection[Condition]) -> list[str]:
    """Parts that differ between conditions."""
    return [part for part in PARTS if len({getattr(condition, part) for condition in conditions}) > 1]


def told_apart(conditions: Sequence[Condition]) -> dict[Condition, str]:
    """Text for each condition, without the parts that are equal in all of them.

    >>> list(told_apart([Condition(50.0, 10.0, "V"), Condition(50.0, 5.0, "V")]).values())
    ['10 V', '5 V']
    """
    parts = differing(conditions) or PARTS
    return {condition: condition.only(parts).words() for condition in conditions}


def labels_of(rows: Iterable[Row]) -> list[str]:
    """Every compensator or model once, in the order of the report."""
    return list(dict.fromkeys(row.compensator for row in rows))


def largest(rows: Iterable[Row], name: str) -> float | None:
    """Largest value of a figure; None if no row has it."""
    values = [value for row in rows if (value := getattr(row, name)) is not None]
    return max(values) if values else None


def significant(value: float) -> str:
    """Text of a number with three significant digits, trailing zeros included.

    >>> significant(8.0), significant(0.04567), significant(1234.4), significant(1.11e-16)
    ('8.00', '0.0457', '1234', '< 1e-6')
    """
    if value == 0.0:
        return "0"
    if abs(value) < TINY:
        return f"< {TINY:.0e}".replace("e-0", "e-")
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def number(value: float | None) -> str:
    """Text with three significant digits; empty without a value."""
    return "" if value is None or math.isnan(value) else significant(value)

"""Result of a run: rows of numbers, statements, and traces for figures."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
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
    """What a run (axis, sample) [um] is compared with: a reference, or the prediction of a model."""

    label: str
    reading_um: Array
    position_um: Array

    def part(self, samples: slice) -> Target:
        """Return some of the samples."""
        return Target(self.label, self.reading_um[:, samples], self.position_um[:, samples])


@dataclass(frozen=True, kw_only=True)
class Band(Keyed):
    """Median and 5-95 % band of one metric of one row over the draws of an uncertain actuator."""

    metric: str
    p5_um: float
    median_um: float
    p95_um: float


TOO_FEW = "too few draws"
"""For sensitivity indices to mean something."""


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
        """Whether there were enough draws: no parameter does more alone than together with others."""
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
        """Whether its assessment is about what the sensor reads."""
        asked = self.scenario.assessment
        return asked is not None and asked.reading_first

    @property
    def reads_truth(self) -> bool:
        """Whether the sensor is ideal, so that its readings equal the true position."""
        return self.instruments.sensor.is_ideal

    def without_traces(self) -> Report:
        """Return the report without its traces, as small as its file."""
        return replace(self, traces=())

    def to_frame(self) -> pd.DataFrame:
        """Rows as a pandas table; an undefined figure is NaN."""
        import pandas as pd

        return pd.DataFrame([row.columns() for row in self.rows])

    def to_json(self) -> str:
        """Text of ``report.json``: full precision, sorted keys, no clock and no host."""
        return self._json

    @cached_property
    def _json(self) -> str:
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
        return self._table

    @cached_property
    def _table(self) -> str:
        return csv_text(self.to_frame())


def _known(found: Band | Sensitivity) -> dict[str, Any]:
    """Plain JSON without what has no value."""
    return {name: value for name, value in asdict(found).items() if value is not None}

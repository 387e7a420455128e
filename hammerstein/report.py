"""What a run found: rows of numbers, statements, and the traces that figures draw."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.plant import Response
from hammerstein.scenario import Scenario
from hammerstein.signals import Excitation, Reference

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
FORMAT = "hammerstein-report/1"


@dataclass(frozen=True)
class Row:
    """Figures of one case on one measured axis; None where a figure has no meaning.

    Errors are those of the sensor's reading, as in the paper; names with ``true`` are of the true position.
    """

    compensator: str
    excited_axis: str
    measured_axis: str
    frequency_hz: float
    amplitude_v: float | None = None
    amplitude_um: float | None = None
    rms_um: float | None = None
    max_um: float | None = None
    rms_true_um: float | None = None
    max_true_um: float | None = None
    euclidean_rms_um: float | None = None
    euclidean_max_um: float | None = None
    euclidean_rms_true_um: float | None = None
    euclidean_max_true_um: float | None = None
    radial_max_um: float | None = None
    radial_max_true_um: float | None = None
    epsilon_max_um: float | None = None
    height_um: float | None = None
    width_um: float | None = None
    width_percent: float | None = None
    gain: float | None = None
    phase_deg: float | None = None
    saturated_samples: int = 0

    def key(self) -> dict[str, Any]:
        """Give what tells this row from the others."""
        return {name: getattr(self, name) for name in KEY}

    def numbers(self) -> dict[str, float]:
        """Figures that have a meaning in this row, by name."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in KEY}
        return {name: value for name, value in named.items() if value is not None}


KEY = ("compensator", "excited_axis", "measured_axis", "frequency_hz", "amplitude_v", "amplitude_um")


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a model says of a run in volts, over the measured window (axis, sample) [um]."""

    label: str
    reading_um: Array
    position_um: Array


@dataclass(frozen=True, eq=False)
class Trace:
    """The measured window of one case, for figures and for ``--traces``."""

    label: str
    signal: Reference | Excitation
    excited_axis: str
    response: Response
    first_sample: int
    predictions: tuple[Prediction, ...] = ()

    @property
    def time_s(self) -> Array:
        """Time of each sample since the start of the run [s]."""
        return self.response.time_s + self.first_sample * self.response.sample_time_s


@dataclass(frozen=True, eq=False)
class Report:
    """Result of one scenario.

    rows : figures, one row for each case and measured axis
    statements : what a reader must know of convergence, saturation and settling
    traces : measured windows; they are not written into the report file
    """

    name: str
    scenario: Scenario
    actuator: str
    digest: str
    model_digest: str
    inputs: tuple[str, ...]
    axes: tuple[str, ...]
    rows: tuple[Row, ...]
    statements: tuple[str, ...]
    traces: tuple[Trace, ...] = ()

    def without_traces(self) -> Report:
        """Give the report without its traces, as small as its file."""
        return replace(self, traces=())

    def to_frame(self) -> pd.DataFrame:
        """Rows as a pandas table; a figure without meaning is NaN."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.rows])

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
            "rows": [row.key() | row.numbers() for row in self.rows],
        }
        return json.dumps(content, indent=1, sort_keys=True, allow_nan=False) + "\n"

    def to_csv(self) -> str:
        """Text of ``rms.csv``: one line a row, figures without meaning left empty."""
        return str(self.to_frame().to_csv(index=False, lineterminator="\n"))

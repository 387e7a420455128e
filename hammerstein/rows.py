"""One row of a report."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any


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
    euclidean_max_unsaturated_um: float | None = None
    radial_max_um: float | None = None
    radial_max_true_um: float | None = None
    epsilon_max_um: float | None = None
    drift_true_um: float | None = None
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

    def not_finite(self) -> str:
        """Name of a figure that is infinite or NaN, empty if all are finite."""
        return next((name for name, value in self.numbers().items() if not math.isfinite(value)), "")


KEY = ("compensator", "excited_axis", "measured_axis", "frequency_hz", "amplitude_v", "amplitude_um")

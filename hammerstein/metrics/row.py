"""One row of a report, and its key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from hammerstein.metrics.metric import METRICS, metrics_of


@dataclass(frozen=True)
class Keyed:
    """Key of a row, which identifies it among the others."""

    compensator: str
    excited_axis: str
    measured_axis: str
    frequency_hz: float
    amplitude_v: float | None = None
    amplitude_um: float | None = None
    trial: int | None = None

    def key(self) -> dict[str, Any]:
        """Return that by name."""
        return {name: getattr(self, name) for name in KEY}

    @property
    def place(self) -> tuple[Any, ...]:
        """The same without the names."""
        return tuple(self.key().values())

    @property
    def at(self) -> str:
        """Frequency in words, such as `` at 50 Hz``; nothing of a signal that has none."""
        return f" at {self.frequency_hz:g} Hz" if self.frequency_hz else ""


KEY = tuple(field.name for field in fields(Keyed))
"""Names of what tells one row from the others."""


@dataclass(frozen=True)
class Row(Keyed):
    """Figures of merit of one case on one measured axis; None if a figure is undefined.

    Errors are those of the sensor's reading, as in the paper; names with ``true`` are of the true position.
    A figure is read by its name: ``row.rms_um``.
    """

    figures: Mapping[str, float] = field(default_factory=dict)

    def __getattr__(self, name: str) -> float | None:
        if name not in METRICS:
            raise AttributeError(f"a row has no figure {name!r}")
        return self.figures.get(name)

    def not_finite(self) -> str:
        """Name of a figure that is infinite or NaN, empty if all are finite."""
        return next((name for name, value in self.figures.items() if not math.isfinite(value)), "")

    def columns(self) -> dict[str, Any]:
        """Everything in the row by name, None where a figure has no meaning."""
        names = (*(metric.name for metric in metrics_of()), *self.figures)
        return self.key() | {name: self.figures.get(name) for name in names}

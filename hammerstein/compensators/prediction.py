"""Expected error of a drive: contributions of path, model, converter and sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.path_file import half_span_v, travel_um
from hammerstein.model import HammersteinModel

NOTHING_UM = 1e-6
"""A picometre: less is the rounding of numbers."""


def model_error_um(model: HammersteinModel) -> Array | None:
    """Rms error of the model itself (p,) [um], by its fit report; None where no record has judged it."""
    verdict, travel = model.verdict, travel_um(model)
    if verdict is None or len(verdict.nrmse_percent) != len(model.outputs) or travel is None:
        return None
    return np.asarray(0.01 * np.array(verdict.nrmse_percent) * travel)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Parts of the error of a drive, each (p,) in um; all but that of the path are the model file's word.

    path : largest error if the actuator were exactly the model; model : rms, None where untested
    validated : whether a validation record has told that of the model
    converter : half a step; noise : rms, of the sensor
    """

    path: Array
    model: Array | None
    validated: bool
    converter: Array
    noise: float

    @classmethod
    def of(cls, model: HammersteinModel, path_error_um: Array) -> Prediction:
        """Parts of a drive whose path is missed by so much (p,)."""
        half = half_span_v(model)
        volts = float(half.max()) if np.isfinite(half).all() else 1.0
        step_um = 0.5 * model.instruments.drive.resolution_v * np.abs(model.gain(volts)).sum(axis=1)
        validated = model.verdict is not None and model.verdict.held_out
        noise = float(model.instruments.sensor.noise_um)
        return cls(path_error_um, model_error_um(model), validated, np.asarray(step_um), noise)

    @property
    def sum_um(self) -> Array:
        """Sum of all contributions (p,), without that of an untested model."""
        own = 0.0 if self.model is None else self.model
        return np.asarray(self.path + own + self.converter + self.noise)

    def summary(self, o: int) -> dict[str, Any]:
        """Parts of one output, as plain JSON."""
        return {
            "path_um": float(self.path[o]),
            "model_um": None if self.model is None else float(self.model[o]),
            "model_validated": self.validated,
            "converter_um": float(self.converter[o]),
            "noise_um": self.noise,
            "sum_um": float(self.sum_um[o]),
        }

    def statement(self, outputs: Sequence[str]) -> str:
        """Say the parts and their sum for each output."""
        return "Expected error: " + "; ".join(self._of(o, name) for o, name in enumerate(outputs)) + "."

    def _of(self, o: int, name: str) -> str:
        if self.model is None:
            own, more = "model untested", ", and that of the model"
        else:
            word = "validation record" if self.validated else "fitted records only"
            own, more = f"model {self.model[o]:.2g} ({word})", ""
        parts = [f"path {self.path[o]:.2g}" if self.path[o] > NOTHING_UM else "path 0", own]
        parts += [f"converter step {self.converter[o]:.2g}"] if self.converter[o] else []
        parts += [f"sensor noise {self.noise:.2g}"] if self.noise else []
        return f"{name} {' + '.join(parts)} = {self.sum_um[o]:.2g} um{more}"

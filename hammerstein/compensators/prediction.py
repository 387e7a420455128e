"""Expected error of a drive: contributions of path, model, rest position, converter and sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.attempt import Attempt
from hammerstein.compensators.path_file import half_span_v, travel_um
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length


def model_error_um(model: HammersteinModel) -> Array | None:
    """Rms error of the model itself (p,) [um], by its fit report; None where no record has judged it."""
    verdict, travel = model.verdict, travel_um(model)
    if verdict is None or len(verdict.nrmse_percent) != len(model.outputs) or travel is None:
        return None
    return np.asarray(0.01 * np.array(verdict.nrmse_percent) * travel)


@dataclass(frozen=True, eq=False)
class Prediction:
    """Contributions to the rms error of a drive, each (p,) in um; all but the path's are from the model file.

    path : of the drive if the actuator were exactly the model; most : the largest error of that kind
    model : of the model about its mean, None where untested; validated : whether on a validation record
    rest : of the position at rest, from which a path counts; None where no record began at rest
    converter : of rounding to steps, uniformly distributed; noise : of the sensor
    """

    path: Array
    most: Array
    model: Array | None
    validated: bool
    rest: Array | None
    converter: Array
    noise: float

    @classmethod
    def of(cls, model: HammersteinModel, attempt: Attempt) -> Prediction:
        """Contributions to the error of a drive."""
        half, verdict = half_span_v(model), model.verdict
        volts = float(half.max()) if np.isfinite(half).all() else 1.0
        step_v = model.instruments.drive.resolution_v / np.sqrt(12.0)
        known = verdict is not None and len(verdict.rest_um) == len(model.outputs)
        return cls(
            path=attempt.path_rms_um,
            most=attempt.path_error_um,
            model=model_error_um(model),
            validated=verdict is not None and verdict.held_out,
            rest=np.array(verdict.rest_um) if verdict is not None and known else None,
            converter=np.asarray(step_v * np.abs(model.gain(volts)).sum(axis=1)),
            noise=float(model.instruments.sensor.noise_um),
        )

    @property
    def rms_um(self) -> Array:
        """Rms of all contributions together (p,): independent errors add in squares."""
        known = [part for part in (self.model, self.rest) if part is not None]
        squares = [part**2 for part in (self.path, *known, self.converter)]
        return np.asarray(np.sqrt(sum(squares) + self.noise**2))

    def summary(self, o: int) -> dict[str, Any]:
        """Contributions to the error of one output, as plain JSON."""
        return {
            "path_rms_um": float(self.path[o]),
            "path_max_um": float(self.most[o]),
            "model_um": None if self.model is None else float(self.model[o]),
            "model_validated": self.validated,
            "rest_um": None if self.rest is None else float(self.rest[o]),
            "converter_um": float(self.converter[o]),
            "noise_um": self.noise,
            "rms_um": float(self.rms_um[o]),
        }

    def statement(self, outputs: Sequence[str]) -> str:
        """Name the contributions and their rms for each output."""
        return "Expected rms error: " + "; ".join(self._of(o, name) for o, name in enumerate(outputs)) + "."

    def _of(self, o: int, name: str) -> str:
        path, parts, more = float(self.path[o]), [], ""
        parts.append(f"path {length(path, 2)}")
        if self.model is None:
            parts, more = [*parts, "model untested"], " without the error of the model"
        else:
            where = "validation" if self.validated else "fitted"
            parts.append(f"model {self.model[o]:.2g} on {where} records")
        parts += ["rest position untested"] if self.rest is None else [f"rest position {self.rest[o]:.2g}"]
        parts += [f"converter step {self.converter[o]:.2g}"] if self.converter[o] else []
        parts += [f"sensor noise {self.noise:.2g}"] if self.noise else []
        return f"{name} {self.rms_um[o]:.2g} um{more} ({', '.join(parts)})"

"""One law on one path: requested drive, actual drive, predicted motion, and its expected error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Drive
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.path_file import half_span_v, travel_um
from hammerstein.compensators.reach import Shortfall, shortfall
from hammerstein.errors import HammersteinError, InputError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length
from hammerstein.validation import mistakes_of

WIDER = 100.0
"""Spans beyond each end that a drive may use which shows what a path needs."""
LawLike = str | Compensator
"""A law by its name in a scenario, or a compensator."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """The drive that a law computes for a path, and what it leads to. The first ``lead`` samples lead in.

    drive_v : (m, N) as sent; predicted : of all samples
    """

    law: Law[Any]
    reference_um: Array
    lead: int
    drive_v: Array
    predicted: Shortfall

    @classmethod
    def of(
        cls,
        model: HammersteinModel,
        limits: DriveRange,
        compensator: Compensator,
        reference_um: Array,
        lead: int = 0,
    ) -> Attempt:
        """Design the law, and drive the model with it."""
        drive = drive_within(model, limits)
        law = sensorless_law(compensator, {}, model, limits, drive.sample_time_s)
        asked = law.drive_for(reference_um)
        sent, _ = drive.apply(asked)
        predicted = shortfall(model, law, reference_um, asked, drive.sample_time_s, sent)
        return cls(law, reference_um, lead, sent, predicted)

    def limited_um(self, model: HammersteinModel, limits: DriveRange, compensator: Compensator) -> Array:
        """Largest change (p,) of the motion on the path by the ends of the range [um].

        A law that leaves an error of its own leaves it within the range, too. Where no drive is found without
        ends, the whole error counts.
        """
        wide = widened(limits)
        if wide is None:
            return self.path_error_um
        try:
            free = Attempt.of(model, wide, compensator, self.reference_um, self.lead)
        except HammersteinError:
            return self.path_error_um
        change = self.predicted.error_um - free.predicted.error_um
        return np.asarray(np.abs(change[:, self.lead :]).max(axis=1))

    @property
    def path_error_um(self) -> Array:
        """Largest error of each output (p,) on the path, without its lead-in [um]."""
        return np.asarray(np.abs(self.predicted.error_um[:, self.lead :]).max(axis=1))

    @property
    def path_rms_um(self) -> Array:
        """Rms error of each output (p,) there [um]."""
        return np.sqrt(np.mean(self.predicted.error_um[:, self.lead :] ** 2, axis=1))


def drive_within(model: HammersteinModel, limits: DriveRange) -> Drive:
    """Converter and amplifier of a model with another range."""
    ends = tuple(zip(limits.low_v.tolist(), limits.high_v.tolist(), strict=True))
    return model.instruments.drive.model_copy(update={"range_v": ends})


def widened(limits: DriveRange) -> DriveRange | None:
    """The range with ends far away; None where it has none, or conditions beside them."""
    span = WIDER * limits.span_v
    if limits.conditioned or not np.isfinite(span).all():
        return None
    return replace(limits, low_v=limits.low_v - span, high_v=limits.high_v + span)


def sensorless_law(
    law: LawLike,
    options: Mapping[str, Any],
    model: HammersteinModel,
    limits: DriveRange,
    sample_time_s: float,
) -> Law[Any]:
    """Design the law that is named; InputError where it needs the sensor, or its options are wrong."""
    compensator = compensator_of(law, options)
    built = compensator.design(model, limits, sample_time_s)
    if not isinstance(built, Law):
        what = f"{compensator.law} needs the sensor's readings, so it has no drive to send in advance"
        raise InputError("--law", what)
    return built


def compensator_of(law: LawLike, options: Mapping[str, Any]) -> Compensator:
    """Return the compensator that is named, with its options, or that is there already.

    Raises InputError for an unknown law or option.
    """
    if isinstance(law, Compensator):
        if options:
            names = ", ".join(sorted(options))
            raise InputError("compensate", f"pass {names} to {type(law).__name__} itself")
        return law
    given = {name: value for name, value in options.items() if value is not None}
    try:
        return COMPENSATORS.value({"law": law, **given})
    except ValidationError as error:
        raise InputError("compensate", mistakes_of(error, COMPENSATORS.adapter())) from None


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
        parts, more = [f"path {length(float(self.path[o]), 2)}"], ""
        if self.model is None:
            parts, more = [*parts, "model untested"], " without the error of the model"
        else:
            where = "validation" if self.validated else "fitted"
            parts.append(f"model {self.model[o]:.2g} on {where} records")
            more = " plus an untested constant offset" if self.rest is None else ""
        parts += ["rest position untested"] if self.rest is None else [f"rest position {self.rest[o]:.2g}"]
        parts += [f"converter step {self.converter[o]:.2g}"] if self.converter[o] else []
        parts += [f"sensor noise {self.noise:.2g}"] if self.noise else []
        return f"{name} {self.rms_um[o]:.2g} um{more} ({', '.join(parts)})"

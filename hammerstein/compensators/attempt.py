"""One law on one path: requested drive, actual drive, and predicted motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import ValidationError

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Drive
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.reach import Shortfall, shortfall
from hammerstein.errors import HammersteinError, InputError
from hammerstein.model import HammersteinModel
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

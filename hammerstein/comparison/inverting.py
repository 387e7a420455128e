"""Compensators of compared models: invertibility, and error on another model."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.comparison.fitting import Fitted
from hammerstein.comparison.result import Left
from hammerstein.compensators import (
    Compensator,
    ExactInverse,
    HammersteinInverse,
    InverseMultiplicative,
)
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import HammersteinError
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

HEADROOM = 0.1
"""Part of the recorded range by which the voltages may leave it at either end."""
SETTLING = 0.125
"""Part of a record that is not counted: the way from rest to the path."""
MOST_SAMPLES = 100_000
"""Of a record that is played."""


class Inverse(NamedTuple):
    """The best law for a model: an exact inverse, else one without inversion, else none.

    options : the law; None if none works; exact : whether it inverts the model
    words : description, or the reason why there is none
    """

    options: Compensator | None
    exact: bool
    words: str


def inverse_of(model: HammersteinModel, sample_time_s: float) -> Inverse:
    """The law for a model, exact if the model has an inverse."""
    static = isinstance(model.dynamics, StaticDynamics) and not model.dynamics.input_delay_s
    exact: Compensator = ExactInverse() if static else HammersteinInverse()
    try:
        exact.design(model, _range(model), sample_time_s)
        return Inverse(exact, True, exact.law)
    except HammersteinError as error:
        why = str(error)
    try:
        other = InverseMultiplicative()
        other.design(model, _range(model), sample_time_s)
        return Inverse(other, False, f"{other.law}; no exact inverse: {why}")
    except HammersteinError:
        return Inverse(None, False, f"none: {why}")


def _range(model: HammersteinModel) -> DriveRange:
    """Range of the records and a little more."""
    low, high = np.array(model.recorded.lowest_v), np.array(model.recorded.highest_v)
    more = HEADROOM * (high - low)
    return DriveRange.of(np.stack([low - more, high + more], axis=1), model)


def left_by(one: Fitted, law: Inverse, other: Fitted, records: Sequence[Record]) -> Left:
    """Error of the compensator of one model on another model.

    The path is the response of the other model to the voltages of the records, from rest. The law of the
    first model computes the voltages for this path, and the other model responds to them.

    other : the model that predicts best, the same for all; it has no error itself
    """
    if law.options is None:
        return Left(reason=law.words)
    if other is one:
        return Left(law.options.law, reason="this model replaces the actuator")
    errors, spans, held = [], [], []
    try:
        for record in records:
            error, span, at_range = _played(one.model, law.options, other.model, record)
            errors.append(error)
            spans.append(span)
            held.append(at_range)
    except HammersteinError as error:
        return Left(law.options.law, other.name, reason=str(error))
    percent = 100.0 * np.sqrt(np.mean(np.hstack(errors) ** 2, axis=1)) / np.max(spans, axis=0)
    at_range = float(np.mean(np.concatenate(held)))
    return Left(law.options.law, other.name, float(percent.mean()), 100.0 * at_range)


def _played(
    model: HammersteinModel, options: Compensator, other: HammersteinModel, record: Record
) -> tuple[Array, Array, Any]:
    """Error about its mean (output, sample), range of the path (output,) and where the range was reached."""
    part = record.part(0, min(record.samples, MOST_SAMPLES))
    sample_time_s = part.sample_time_s
    first = int(SETTLING * part.samples)
    path = other.simulate(part.u_v + part.rest_v[:, None], sample_time_s).position_um
    law: Law[Any] = options.design(model, _range(model), sample_time_s)  # type: ignore[assignment]  # none of them is a controller
    drive = law.drive_for(path)
    error = (other.simulate(drive, sample_time_s).position_um - path)[:, first:]
    at_range = law.range.reached(drive)[:, first:].any(axis=0)
    return error - error.mean(axis=1, keepdims=True), np.ptp(path[:, first:], axis=1), at_range

"""How a scenario names a compensator: one validated value a law, and how it is built from a model.

To add a law, add one class here and name it in ``Compensator``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, TypeAdapter, model_validator

from hammerstein.blocks import Law
from hammerstein.compensators.feedback.pid import Feedback
from hammerstein.compensators.feedback.tuning import Gains
from hammerstein.driving import RangeLike
from hammerstein.identification.source import ModelSource
from hammerstein.model import HammersteinModel


class NoCompensation(ModelSource):
    """The inverse of the low-frequency gain matrix."""

    law: Literal["none"]

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.linear_gain import LinearGain

        return LinearGain(model, range_v)


class InverseMultiplicativeSpec(ModelSource):
    """The paper's compensator without inversion (Theorem 4.1)."""

    law: Literal["inverse_multiplicative"]
    gain: Literal["identity", "auto"] | tuple[tuple[float, ...], ...] = Field(
        default="auto", description='"identity" (as printed), "auto" (from the slopes), or a matrix in V/um'
    )
    filter_s: PositiveFloat | None = Field(
        default=None, description="time constant of a first-order filter in place of the one-sample delay"
    )
    iterations: PositiveInt = Field(default=1, description="passes of the law in each sample")
    run_anyway: bool = Field(default=False, description="accept an iteration that cannot converge")

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative

        return InverseMultiplicative(
            model, range_v, sample_time_s, self.gain, self.filter_s, self.iterations, self.run_anyway
        )


class DecoupledInverseSpec(ModelSource):
    """The analytic inverse of each direct transfer (paper, reference 20)."""

    law: Literal["decoupled_inverse"]

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.decoupled_inverse import DecoupledInverse

        return DecoupledInverse(model, range_v)


class ExactInverseSpec(ModelSource):
    """The exact inverse of the static block, cross-couplings included."""

    law: Literal["exact_inverse"]
    softening_v: NonNegativeFloat = Field(
        default=0.0, description="voltage over which the jump at a reversal is spread"
    )
    run_anyway: bool = Field(default=False, description="accept a model without an inverse")

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.exact.inverse import ExactInverse

        return ExactInverse(model, range_v, self.softening_v, self.run_anyway)


class HammersteinInverseSpec(ModelSource):
    """The inverse of the dynamics, known ahead, then the exact inverse of the static block."""

    law: Literal["hammerstein_inverse"]
    preview_s: NonNegativeFloat | None = Field(
        default=None, description="how far ahead the reference is known; as far as needed if not given"
    )
    filter_hz: PositiveFloat | None = Field(
        default=None, description="bandwidth of a reference filter, for references that are not smooth"
    )
    softening_v: NonNegativeFloat = Field(
        default=0.0, description="voltage over which the jump at a reversal is spread"
    )
    run_anyway: bool = Field(default=False, description="accept a model without an inverse")

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverse

        options = (self.preview_s, self.filter_hz, self.softening_v, self.run_anyway)
        return HammersteinInverse(model, range_v, sample_time_s, *options)


FeedforwardSpec = Annotated[
    NoCompensation | ExactInverseSpec | HammersteinInverseSpec, Field(discriminator="law")
]


class FeedbackSpec(ModelSource):
    """A PI or PID law with the sensor, alone or on top of a feedforward law."""

    law: Literal["feedback"]
    feedforward: Literal["none", "exact_inverse", "hammerstein_inverse"] | None = Field(
        default=None, description="law whose drive is added, built from the same model"
    )
    derivative: bool = Field(default=False, description="compute a derivative gain too")
    proportional: tuple[float, ...] | None = Field(default=None, description="gain of each output")
    integral_per_s: tuple[float, ...] | None = None
    derivative_s: tuple[float, ...] | None = None

    @model_validator(mode="after")
    def _gains_come_together(self) -> Self:
        given = [self.proportional, self.integral_per_s, self.derivative_s]
        if any(gain is not None for gain in given) and (given[0] is None or given[1] is None):
            raise ValueError("give proportional and integral_per_s together, or none of the gains")
        return self

    def build(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Feedback:
        """Give the law for a model, a drive range and a sample time."""
        added = None
        if self.feedforward is not None:
            options = {"label": self.label, "law": self.feedforward, "model": self.model or "identified"}
            spec: FeedforwardSpec = TypeAdapter(FeedforwardSpec).validate_python(options)
            added = spec.build(model, range_v, sample_time_s)
        bandwidth = model.instruments.sensor.bandwidth_hz
        return Feedback(
            model, range_v, sample_time_s, bandwidth, self._gains(), self.derivative, feedforward=added
        )

    def _gains(self) -> Gains | None:
        if self.proportional is None or self.integral_per_s is None:
            return None
        derivative = self.derivative_s or (0.0,) * len(self.proportional)
        return Gains(np.array(self.proportional), np.array(self.integral_per_s), np.array(derivative))


Compensator = Annotated[
    NoCompensation
    | InverseMultiplicativeSpec
    | DecoupledInverseSpec
    | ExactInverseSpec
    | HammersteinInverseSpec
    | FeedbackSpec,
    Field(discriminator="law"),
]

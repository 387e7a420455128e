"""How a scenario names a compensator: one validated value a law, and how it is built from a model.

To add a law, add one class here and name it in ``Compensator``.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from hammerstein.compensators.law import Law
from hammerstein.model import HammersteinModel
from hammerstein.sources import ModelSource


class NoCompensation(ModelSource):
    """The inverse of the low-frequency gain matrix."""

    law: Literal["none"]

    def build(self, model: HammersteinModel, range_v: float, sample_time_s: float) -> Law[Any]:
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

    def build(self, model: HammersteinModel, range_v: float, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative

        return InverseMultiplicative(
            model, range_v, sample_time_s, self.gain, self.filter_s, self.iterations, self.run_anyway
        )


class DecoupledInverseSpec(ModelSource):
    """The analytic inverse of each direct transfer (paper, reference 20)."""

    law: Literal["decoupled_inverse"]

    def build(self, model: HammersteinModel, range_v: float, sample_time_s: float) -> Law[Any]:
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

    def build(self, model: HammersteinModel, range_v: float, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.exact_inverse import ExactInverse

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

    def build(self, model: HammersteinModel, range_v: float, sample_time_s: float) -> Law[Any]:
        """Give the law for a model, a drive range and a sample time."""
        from hammerstein.compensators.hammerstein_inverse import HammersteinInverse

        options = (self.preview_s, self.filter_hz, self.softening_v, self.run_anyway)
        return HammersteinInverse(model, range_v, sample_time_s, *options)


Compensator = Annotated[
    NoCompensation
    | InverseMultiplicativeSpec
    | DecoupledInverseSpec
    | ExactInverseSpec
    | HammersteinInverseSpec,
    Field(discriminator="law"),
]

"""A compensator that learns a path that repeats, trial by trial, as a scenario names it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.blocks import Law, Learner
from hammerstein.blocks.driving import RangeLike
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.cycle import centred
from hammerstein.compensators.learning.ilc_update import RESONANCE, WEIGHTS, ModelUncertainty, ilc_update
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Deviation, Frequency, Trial


class LearnedLaw(Learner):
    """Iterative learning on the model's own inverse, see ``ilc_update``.

    The first trial plays the settled period of the inverse. Each further trial corrects the drive before it
    by the sensor's readings.

    Parameters
    ----------
    model, inverse : what is known of the actuator, and its inverse, designed for the drive
    uncertainty : relative uncertainty of the model
    trial : the trial that is measured
    """

    def __init__(
        self, model: HammersteinModel, inverse: Law[Any], uncertainty: ModelUncertainty, trial: int = 1
    ):
        self.model, self.inverse, self.uncertainty, self.trial = model, inverse, uncertainty, trial
        self.n_inputs, self.n_outputs, self.range = inverse.n_inputs, inverse.n_outputs, inverse.range

    def first(self, reference_um: Array) -> Array:
        """Voltages of the inverse, see ``Learner.first``."""
        return centred(self.inverse, self.model, reference_um)

    def following(
        self,
        reference_um: Array,
        drive_v: Array,
        reading_um: Array,
        before: tuple[Array, Array] | None = None,
    ) -> Array:
        """Voltages after an update; those of the trial before where this one was worse beyond the noise."""
        bandwidth = self.model.instruments.sensor.bandwidth_hz
        known = (self.model, self.inverse, reference_um)
        taught = ilc_update(*known, drive_v, reading_um, self.uncertainty, bandwidth)
        if before is not None:
            taught = taught.after(ilc_update(*known, *before, self.uncertainty, bandwidth), before[0])
        return taught.drive_v

    def statement(self) -> str:
        """Say what its inverse says, and that a sensor must be there."""
        own = "Each trial after the first needs the sensor readings of the previous one."
        return f"{own} {self.inverse.statement()}".strip()


class Learned(Compensator):
    """Iterative learning from a sensor, on the inverse of the model."""

    law: Literal["learned"] = "learned"
    inverse: Literal["exact_inverse", "hammerstein_inverse"] = Field(
        default="hammerstein_inverse", description="law that computes the drive of a path"
    )
    filter_hz: Frequency | None = Field(
        default=None, description="bandwidth of the reference filter of hammerstein_inverse"
    )
    weights: Deviation = Field(
        default=WEIGHTS, description="relative standard deviation of the model's weights"
    )
    resonance: Deviation = Field(
        default=RESONANCE, description="relative standard deviation of the model's resonances"
    )
    trial: Trial = Field(default=5, description="number of the measured trial; the first is without learning")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> LearnedLaw:
        """Build the learner, see ``Compensator.design``."""
        filtered = {} if self.filter_hz is None else {"filter_hz": self.filter_hz}
        asked: dict[str, Any] = {"law": self.inverse, **filtered}
        inverse = COMPENSATORS.value(asked).design(model, range_v, sample_time_s)
        assert isinstance(inverse, Law)  # each that may be named is one
        return LearnedLaw(model, inverse, ModelUncertainty(self.weights, self.resonance), self.trial)


COMPENSATORS.register(Learned)

"""No compensation: the inverse of the low-frequency gain matrix."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law, Memory
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.base import Compensator
from hammerstein.model import HammersteinModel


class NoCompensationLaw(Law[Memory]):
    """U = U_start + G^+ Y_r, with the gain matrix G of the settled loops.

    This is the least drive if inputs outnumber outputs.

    This is what one sends without a compensator: the right size, and all of the hysteresis.
    """

    def __init__(self, model: HammersteinModel, range_v: RangeLike):
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs
        self.gain_v_per_um: Array = np.ascontiguousarray(
            np.linalg.pinv(model.gain(model.amplitude_v)), dtype=np.float64
        )
        self.range = DriveRange.of(range_v, model)
        self.origin_um = np.zeros(self.n_outputs)
        self.base_v = self.range.start_v - self.range.working_point_v
        self._frame = self._frame_of_steps()
        self._limits = np.stack([self.base_v, *self.range.counted])

    @cached_property
    def _compiled_step(self) -> Any:
        from hammerstein.compensators.kernels import step_gain  # looked up once: a step is short

        return step_gain

    def _step(self, sample_um: Array, state: Memory) -> tuple[Array, Memory] | None:
        drive, sound = self._compiled_step(sample_um, self._frame, self.gain_v_per_um, self._limits)
        return (drive, state) if sound else None

    def rest(self) -> Memory:
        """Return the empty state."""
        return Memory()

    def _respond(self, reference_um: Array, start: Memory) -> tuple[Array, Memory]:
        from hammerstein.compensators.kernels import respond_gain
        from hammerstein.compiled import spans

        drive = np.empty((self.n_inputs, reference_um.shape[1]))
        law = (self.gain_v_per_um, self.base_v, *self.range.counted)
        for first, stop in spans(reference_um.shape[1]):
            respond_gain(reference_um, *law, first, stop, drive)
        return drive, start


class NoCompensation(Compensator):
    """The inverse of the low-frequency gain matrix."""

    law: Literal["none"] = "none"

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        return NoCompensationLaw(model, range_v)

"""No compensation: the inverse of the low-frequency gain matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.blocks import Array, Law
from hammerstein.driving import DriveRange, RangeLike
from hammerstein.model import HammersteinModel


@dataclass(frozen=True)
class NoMemory:
    """State of a law that has none."""

    def as_dict(self) -> dict[str, Any]:
        """Give an empty dictionary."""
        return {}


class LinearGain(Law[NoMemory]):
    """U = U_start + G^+ Y_r, with the gain matrix G of the settled loops.

    This is the least drive if inputs outnumber outputs.

    This is what one sends without a compensator: the right size, and all of the hysteresis.
    """

    def __init__(self, model: HammersteinModel, range_v: RangeLike):
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs
        self.gain_v_per_um: Array = np.asarray(
            np.linalg.pinv(model.hysteresis.gain(model.amplitude_v)), dtype=np.float64
        )
        self.range = DriveRange.of(range_v, model)
        self.origin_um = np.zeros(self.n_outputs)
        self._base_v = self.range.start_v - self.range.working_point_v

    def rest(self) -> NoMemory:
        """Give the empty state."""
        return NoMemory()

    def restore(self, data: dict[str, Any]) -> NoMemory:
        """Give the empty state."""
        return NoMemory()

    def _respond(self, reference_um: Array, start: NoMemory) -> tuple[Array, NoMemory]:
        # einsum, not a BLAS product: its sums do not depend on how many samples there are.
        drive = np.einsum("ko,ot->kt", self.gain_v_per_um, reference_um)
        low, high = self.range.counted
        return np.clip(drive + self._base_v[:, None], low[:, None], high[:, None]), start

"""The actuator itself as a block on one sample grid: hysteresis, then dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange
from hammerstein.dynamics import on_grid
from hammerstein.model import HammersteinModel


@dataclass(frozen=True, eq=False)
class ForwardState:
    """Memory of the hysteresis, and state (n,) of the block behind it."""

    hysteresis: Any
    linear: Array


class ForwardModel:
    """Positions of the model for absolute voltages, from rest at the working point.

    Parameters
    ----------
    model : hysteresis and dynamics
    range_v : what the drive gives; the model itself does not cut
    sample_time_s : for which each voltage is held [s]
    """

    def __init__(self, model: HammersteinModel, range_v: DriveRange, sample_time_s: float):
        self.model, self.range, self.sample_time_s = model.on_grid(sample_time_s), range_v, sample_time_s
        self.block = on_grid(model.dynamics, sample_time_s)
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs

    preview_samples = 0

    def statement(self) -> str:
        """State the conditions before the first sample."""
        return "Before the first sample the actuator rests at its working point."

    def rest(self) -> ForwardState:
        """State of an actuator that was never driven."""
        return ForwardState(self.model.hysteresis.rest(), self.block.rest())

    def respond(self, drive_v: ArrayLike, start: ForwardState | None = None) -> tuple[Array, ForwardState]:
        """Positions (p, N) [um] for voltages (m, N), and the state after them."""
        start = start or self.rest()
        drive = np.atleast_2d(np.asarray(drive_v, dtype=np.float64))
        v, plays = self.model.static_response(drive, start.hysteresis)
        position, linear = self.block.respond(v, start.linear)
        return position, ForwardState(plays, linear)

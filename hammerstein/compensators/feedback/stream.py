"""A controller with its feedforward as one block on a stream: reference and reading in, voltages out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.blocks import Memory, checked_reference
from hammerstein.blocks.sample_grid import require_grid
from hammerstein.compensators.feedback.pid import ControllerState, FeedbackController

if TYPE_CHECKING:
    from hammerstein.blocks.interop.block_system import BlockSystem


@dataclass(frozen=True, eq=False)
class StreamState(Memory):
    """Memory of the controller, references (p, delay) that wait for their reading, memory of the feedforward.

    controller : after the reading of the last sample; forward : empty without feedforward
    """

    controller: ControllerState
    waiting: Array
    forward: Memory


@dataclass(frozen=True, eq=False)
class FeedbackStream:
    """A controller and its feedforward, sample by sample.

    The voltages of a sample are those of the readings before it and of the feedforward; its own reading acts
    on the next one. Where the feedforward needs the reference ahead, the controller compares each reading
    with the reference that came as many samples before.
    """

    law: FeedbackController

    @property
    def delay_samples(self) -> int:
        """Samples that a reference waits for the reading it is compared with."""
        forward = self.law.feedforward
        return self.law.late_samples + (0 if forward is None else forward.preview_samples)

    def rest(self) -> StreamState:
        """Actuator at rest, reference and readings at zero."""
        forward = Memory() if self.law.feedforward is None else self.law.feedforward.rest()
        return StreamState(self.law.rest(), np.zeros((self.law.n_outputs, self.delay_samples)), forward)

    def restore(self, data: dict[str, Any]) -> StreamState:
        """State from what ``as_dict`` gave."""
        return self.rest().restored(data)

    def step(self, signals: Array, state: StreamState) -> tuple[Array, StreamState]:
        """Voltages (m,) of one sample of references, then readings, (2 p,), and the state after it."""
        reference, reading = np.split(signals, 2)
        forward_v, forward = None, state.forward
        if self.law.feedforward is not None:
            forward_v, forward = self.law.feedforward.step(reference, forward)
        asked, controller = self.law.request(state.controller, forward_v)
        line = np.hstack([state.waiting, reference[:, None]])
        controller = self.law.correct(line[:, 0], reading, controller)
        return asked, StreamState(controller, line[:, 1:], forward)

    def primed(self, reference_um: ArrayLike) -> tuple[StreamState, Array]:
        """State of the block when the drive for the first sample of a reference known ahead is due.

        Returns
        -------
        state : the feedforward has seen as much of the reference as it needs ahead
        coming : (p, N) the reference from there on
        """
        reference = checked_reference(reference_um, self.law.n_outputs)
        if self.law.feedforward is None:
            return self.rest(), reference
        forward, coming = self.law.feedforward.primed(reference)
        late, ahead = self.law.late_samples, self.law.feedforward.preview_samples
        waiting = np.hstack([np.zeros((self.law.n_outputs, late)), reference[:, :ahead]])
        return StreamState(self.law.rest(), waiting, forward), coming

    def to_iosys(self, sample_time_s: float, name: str) -> BlockSystem:
        """Give the block as a discrete ``control.NonlinearIOSystem``; see ``FeedbackController.to_iosys``."""
        from hammerstein.blocks.interop.block_system import BlockSystem, Stepwise, signals

        require_grid(self.law.sample_time_s, sample_time_s, "controller")
        block = Stepwise(self.rest(), self.step, StreamState.as_dict, self.restore)
        p = self.law.n_outputs
        wires = signals("reference_um", p) + signals("reading_um", p)
        return BlockSystem(block, wires, signals("requested_v", self.law.n_inputs), sample_time_s, name)

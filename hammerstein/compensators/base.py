"""Base class of compensators, and the laws without cross-coupling: none, and the inverse of each pair."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from hammerstein.arrays import Array, filled
from hammerstein.blocks import Law, Memory, require_square
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.kernels import respond_gain, respond_inverse_play, step_decoupled, step_gain
from hammerstein.dynamics import linear
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PlayState, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.plugins import Family
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.blocks import Controller, Learner


class Compensator(Strict, ABC):
    """Options of a compensator, as in a scenario: frozen, without unknown keys.

    To add one, derive from this class, give it a field ``law: Literal["its name"]`` with that default, and
    register it.
    """

    if TYPE_CHECKING:  # a field of every kind, behind its others
        law: str

    static: ClassVar[bool] = False
    """Whether its law ignores the dynamics of a model."""
    takes_loop: ClassVar[bool] = True
    """Whether its law supports hysteresis in the loop of the dynamics; a static law does not."""

    @abstractmethod
    def design(
        self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float
    ) -> Law[Any] | Controller[Any] | Learner:
        """Build the law.

        Parameters
        ----------
        model : model of the actuator
        range_v : range of the drive [V], see ``DriveRange.of``
        sample_time_s : time between samples [s]

        Raises
        ------
        InputError : options that do not fit the model
        SimulationError : a law that cannot work
        """


COMPENSATORS: Family[Compensator] = Family(Compensator, "law")  # type: ignore[type-abstract]


class NoCompensationLaw(Law[Memory]):
    """U = U_start + G^+ Y_r, with the gain matrix G of the settled loops.

    This is the least drive if inputs outnumber outputs.

    This is the drive without a compensator: the right amplitude, with all of the hysteresis.
    """

    def __init__(self, model: HammersteinModel, range_v: RangeLike):
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs
        self.gain_v_per_um: Array = np.ascontiguousarray(
            np.linalg.pinv(model.gain(model.amplitude_v)), dtype=np.float64
        )
        self.range = DriveRange.of(range_v, model)
        self.origin_um = np.zeros(self.n_outputs)
        self.base_v = self.range.start_v - self.range.working_point_v
        self._limits = np.stack([self.base_v, *self.range.counted])

    def _step(self, sample_um: Array, state: Memory) -> tuple[Array, Memory] | None:
        drive, sound = step_gain(sample_um, self._frame, self.gain_v_per_um, self._limits)
        return (drive, state) if sound else None

    def rest(self) -> Memory:
        """Return the empty state."""
        return Memory()

    def _respond(self, reference_um: Array, start: Memory) -> tuple[Array, Memory]:
        law, shape = (self.gain_v_per_um, self.base_v), (self.n_inputs, reference_um.shape[1])
        return filled(respond_gain, reference_um, *law, *self.range.counted, shape=shape), start


class NoCompensation(Compensator):
    """The inverse of the low-frequency gain matrix."""

    law: Literal["none"] = "none"

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        return NoCompensationLaw(model, range_v)


@dataclass(frozen=True, eq=False)
class InverseState(Memory):
    """Memory of the inverse: its plays, the last value before the jump (m,) [V] and its direction (m,)."""

    plays: PlayState
    last_v: Array
    direction: Array


def inverse_pair(pair: Pair, axis: str = "pair") -> Pair:
    """Analytic inverse of one bank whose smallest threshold is zero.

    With s_j = w_1 + ... + w_j:

        r'_j = sum over i <= j of w_i (r_j - r_i),  w'_1 = 1 / w_1,  w'_j = -w_j / (s_j s_{j-1})

    Source: Kuhnen, European Journal of Control 9 (2003) 407-418 (paper, reference 20).

    Raises
    ------
    SimulationError : a partial sum of the weights is not positive, or there is no operator

    Examples
    --------
    >>> inverse_pair(Pair([0.0, 1.0], [2.0, 2.0])).weights_um_per_v
    array([ 0.5 , -0.25])
    """
    r, w, s = pair.thresholds_v, pair.weights_um_per_v, pair.slopes
    if len(r) == 0:
        raise SimulationError(f"{axis} has no operator, so it has no inverse.")
    if (s <= 0).any():
        j = int(np.argmax(s <= 0))
        raise SimulationError(
            f"{axis} has no inverse: its slope is {s[j]:.3g} um/V when {j + 1} operators move "
            f"(threshold {r[j]:.3g} V). This happens if phase lag is identified as hysteresis; "
            "identify at a lower frequency, or with bounded partial sums."
        )
    thresholds = np.array([w[: j + 1] @ (r[j] - r[: j + 1]) for j in range(len(r))])
    return Pair(thresholds, np.concatenate([[1.0 / w[0]], -w[1:] / (s[1:] * s[:-1])]))


class DecoupledInverseLaw(Law[InverseState]):
    """Each axis inverted on its own; cross-coupling is ignored.

    A smallest threshold r_1 above zero is split off, for play(a) after play(b) is play(a+b): the bank is
    (thresholds r - r_1) after play(r_1), and the inverse of play(r_1) jumps by 2 r_1 at a reversal.
    """

    def __init__(self, model: HammersteinModel, range_v: RangeLike):
        hysteresis = model.hysteresis
        if not isinstance(hysteresis, PrandtlIshlinskii):
            raise InputError(
                "decoupled_inverse",
                f"inverts plays only; the model's hysteresis is of kind {hysteresis.kind!r}",
            )
        require_square(hysteresis.n_inputs, hysteresis.n_outputs, "decoupled_inverse")
        m = self.n_inputs = self.n_outputs = hysteresis.n_inputs
        self.range = DriveRange.of(range_v, model)
        own = [hysteresis.pairs[k][k] for k in range(m)]
        self.jump_v = np.array([direct.thresholds_v[:1].sum() for direct in own])
        shifted = [
            Pair(d.thresholds_v - r, d.weights_um_per_v) for d, r in zip(own, self.jump_v, strict=True)
        ]
        names = [f"Direct transfer {name}" for name in model.outputs]
        self.inverse = _alone(list(map(inverse_pair, shifted, names)))
        self._start, self.origin_um = self._at_start(hysteresis)
        limits, b = np.stack([self.jump_v, *self.range.counted]), self.inverse.bank
        plays = (b.r, b.guide, b.scale, b.n, b.lines, b.w)
        self._of_steps = (self._frame, limits, *plays, (0,) * self.n_outputs)

    def _step(self, sample_um: Array, state: InverseState) -> tuple[Array, InverseState] | None:
        plays = state.plays
        stack = (plays.count, plays.end, plays.x, plays.d, plays.below, plays.window)
        memory = (*stack, state.last_v, state.direction)
        drive, stack, last, direction, sound = step_decoupled(sample_um, *self._of_steps, *memory)
        return (drive, InverseState(PlayState(*stack), last, direction)) if sound else None

    def _at_start(self, hysteresis: PrandtlIshlinskii) -> tuple[InverseState, Array]:
        """State of the inverse where the actuator stands, and the direct positions (p,) there [um].

        The inverse has gone through the positions that the voltages before the start led to.
        """
        history = self.range.history()
        direct = _alone([hysteresis.pairs[k][k] for k in range(self.n_inputs)])
        passed = direct.respond(history)[0]
        if history.shape[1] == 1:
            return InverseState(self.inverse.rest(), *np.zeros((2, self.n_inputs))), passed[:, -1]
        v, plays = self.inverse.respond(passed)
        jump = np.where(self.jump_v > 0.0, self.jump_v, np.inf)
        direction = np.clip((history[:, -1] - v[:, -1]) / jump, -1.0, 1.0)
        return InverseState(plays, v[:, -1], direction), passed[:, -1]

    def rest(self) -> InverseState:
        """Inverse of an actuator at its start."""
        return self._start

    def _respond(self, reference_um: Array, start: InverseState) -> tuple[Array, InverseState]:
        v, plays = self.inverse.respond(self._from_rest(reference_um), start.plays)
        last, direction = start.last_v.copy(), start.direction.copy()
        law = (self.jump_v, *self.range.counted, last, direction)
        drive = filled(respond_inverse_play, v, *law, shape=(len(v), v.shape[1]))
        return drive, InverseState(plays, last, direction)


def _alone(direct: Sequence[Pair]) -> PrandtlIshlinskii:
    """Direct transfers without any coupling."""
    absent = Pair.absent()
    return PrandtlIshlinskii(
        tuple(tuple(pair if i == k else absent for i in range(len(direct))) for k, pair in enumerate(direct))
    )


class DecoupledInverse(Compensator):
    """Analytic inverse of each direct transfer, without cross-coupling (paper, reference 20)."""

    static: ClassVar[bool] = True
    law: Literal["decoupled_inverse"] = "decoupled_inverse"

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        linear(model.dynamics)
        return DecoupledInverseLaw(model, range_v)

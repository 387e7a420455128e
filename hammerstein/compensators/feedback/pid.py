"""Sensor feedback, alone or with a feedforward: the benchmark for sensorless compensation."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from hammerstein.arrays import Array, spans
from hammerstein.blocks import Controller, Law, Memory, checked_reference
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.blocks.instruments import standard_noise
from hammerstein.blocks.law import require_grid
from hammerstein.compensators.base import COMPENSATORS, Compensator
from hammerstein.compensators.feedback.loop import FeedbackLoop, Gains, tuned
from hammerstein.dynamics import LinearBlock, StaticDynamics, WithLoop, discretise
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import PrandtlIshlinskii, slopes_of
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant, Response
from hammerstein.quantities import Gain

if TYPE_CHECKING:
    from hammerstein.blocks.block_system import BlockSystem


@dataclass(frozen=True, eq=False)
class ControllerState(Memory):
    """Memory of the controller, a row for each output: see the columns of ``pid_kernel``."""

    memory: Array


class FeedbackController(Controller[ControllerState]):
    """A discrete PI(D) controller of each output, decoupled by the gain matrix, with or without feedforward.

        e[k] = (reading of the sensor for the position Y_r)[k] - reading[k]
        c[k] = kp e[k] + ki T (e[0] + ... + e[k]) + kd (e[k] - e[k-1]) / T
        U[k+1] = U_ff[k+1] + G^+ c[k]

    The reading of a sample acts on the drive of the next one: the computer needs that time. G is the gain
    matrix of the settled loops; the part of the drive that the range clips is subtracted from the sum at
    once (back-calculation), so that the controller leaves saturation as soon as the reference does.

    Without gains they are computed from the model (``feedback.loop.tuned``): the largest integral gain that
    keeps the sensitivity below 1.6 for every slope of the hysteresis.

    Parameters
    ----------
    model : m inputs, p outputs; its dynamics count for the gains
    range_v : range of the drive [V], see ``DriveRange.of``
    sample_time_s : time between samples [s]
    sensor_bandwidth_hz : -3 dB of the sensor [Hz]; inf: none
    gains : the gains; None: computed
    derivative : compute a derivative gain too (PID), which damps a resonance and passes more noise
    feedforward : law whose drive is added; None: feedback alone

    Raises
    ------
    InputError : gains that do not fit the model, or none to compute from a model without dynamics
    SimulationError : no stable gain

    Examples
    --------
    >>> from hammerstein.dynamics.models import (AxesDynamics, Axis)
    >>> from hammerstein.hysteresis import Pair
    >>> plant = PrandtlIshlinskii([[Pair([0.0, 1.0], [4.0, 2.0])]])
    >>> axis = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),))
    >>> model = HammersteinModel("one axis", plant, axis, 10.0, ("u",), ("y",))
    >>> law = FeedbackController(model, 10.0, 50e-6, sensor_bandwidth_hz=2000.0)
    >>> run = closed_loop(law, Plant(model, model.instruments), np.full((1, 4000), 20.0), [0])
    >>> bool(abs(run.position_um[0, -1] - 20.0) < 0.05)
    True
    """

    def __init__(
        self,
        model: HammersteinModel,
        range_v: RangeLike,
        sample_time_s: float,
        sensor_bandwidth_hz: float = math.inf,
        gains: Gains | None = None,
        derivative: bool = False,
        feedforward: Law[Any] | None = None,
    ):
        hysteresis = model.hysteresis
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self.range, self.sample_time_s = DriveRange.of(range_v, model), sample_time_s
        self.feedforward = feedforward
        self.gain_um_per_v = model.about_middle.gain(model.amplitude_v)
        self.inverse_gain_v_per_um = np.ascontiguousarray(np.linalg.pinv(self.gain_um_per_v))
        known = (model, sample_time_s, sensor_bandwidth_hz)
        self.gains = _judged(gains, *known) if gains else _computed(*known, derivative)
        self._settings = self._new_settings(sensor_bandwidth_hz)
        self._limits = np.stack([self.range.low_v, self.range.high_v])

    def _new_settings(self, sensor_bandwidth_hz: float) -> Array:
        """Lag of the sensor for a reference that is straight between samples, and gains for one sample."""
        p, step = self.n_outputs, self.sample_time_s
        gains = (self.gains.proportional, self.gains.integral_per_s, self.gains.derivative_s)
        if not self.gains.fit(p):
            raise InputError("gains", f"give {p} finite values for each gain, one for each output")
        a = 2.0 * math.pi * sensor_bandwidth_hz * step
        pole = math.exp(-a)
        ramp = (1.0 - pole) / a if math.isfinite(a) else 0.0
        lag = [pole, ramp - pole, 1.0 - ramp]
        rows = [[*lag, kp, ki * step, kd / step] for kp, ki, kd in zip(*gains, strict=True)]
        return np.array(rows, dtype=np.float64)

    def statement(self) -> str:
        """State the gains."""
        return self.gains.statement()

    def rest(self) -> ControllerState:
        """Actuator at rest, reference and readings at zero."""
        return ControllerState(np.zeros((self.n_outputs, 5)))

    def correct(
        self, reference_um: ArrayLike, reading_um: ArrayLike, state: ControllerState
    ) -> ControllerState:
        """Take reference and reading (p,) of a sample: they make the next correction."""
        from hammerstein.compensators.feedback.pid_kernel import correct

        memory = state.memory.copy()
        reference, reading = (np.ascontiguousarray(x, dtype=np.float64) for x in (reference_um, reading_um))
        correct(reference, reading, self._settings, memory)
        return ControllerState(memory)

    def request(
        self, state: ControllerState, feedforward_v: ArrayLike | None = None
    ) -> tuple[Array, ControllerState]:
        """Voltages (m,) of the correction plus a feedforward (m,); the start voltage if none is given.

        Equal to ``closed_loop`` to the last bit. They may exceed the range; the drive limits them.
        """
        from hammerstein.compensators.feedback.pid_kernel import request

        memory, asked = state.memory.copy(), np.empty(self.n_inputs)
        ahead = self.range.start_v if feedforward_v is None else feedforward_v
        forward = np.ascontiguousarray(ahead, dtype=np.float64)
        request(forward, self.inverse_gain_v_per_um, self.gain_um_per_v, self._limits, memory, asked)
        return asked, ControllerState(memory)

    def path_and_feedforward(self, reference_um: ArrayLike) -> tuple[Array, Array]:
        """Path to compare readings with, delayed by the feedforward, and the feedforward itself."""
        reference = checked_reference(reference_um, self.n_outputs)
        samples = reference.shape[1]
        forward = np.repeat(self.range.start_v[:, None], samples, axis=1)
        if self.feedforward is not None:
            forward = self.feedforward.drive_for(reference)
        late = np.pad(reference, ((0, 0), (self.late_samples, 0)))[:, :samples]
        return np.ascontiguousarray(late), forward

    @property
    def late_samples(self) -> int:
        """Delay of the position in samples, caused by the limited preview of the feedforward."""
        return self.feedforward.delay_samples if self.feedforward is not None else 0

    def to_iosys(self, sample_time_s: float, name: str = "compensator") -> BlockSystem:
        """Return the controller, with its feedforward, as a discrete ``control.NonlinearIOSystem``.

        Inputs are ``reference_um[o]`` and ``reading_um[o]``, outputs ``requested_v[k]``. A feedforward with
        preview takes the reference that much earlier than the reading it is compared with;
        ``FeedbackStream.primed`` gives the state to start with where the reference is known ahead.

        Raises InputError for another sample time than the controller was designed for.
        """
        from hammerstein.blocks.block_system import BlockSystem

        require_grid(self.sample_time_s, sample_time_s, "controller")
        stream = FeedbackStream(self)
        rest = stream.rest()
        read, sent = dict.fromkeys(("reference_um", "reading_um"), self.n_outputs), self.n_inputs
        return BlockSystem(rest, stream.step, rest.restored, read, {"requested_v": sent}, sample_time_s, name)


@dataclass(frozen=True, eq=False)
class StreamState(Memory):
    """Memory of the controller, delayed references (p, delay), and memory of the feedforward.

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
        """Delay of a reference before it is compared with a reading, in samples."""
        forward = self.law.feedforward
        return self.law.late_samples + (0 if forward is None else forward.preview_samples)

    def rest(self) -> StreamState:
        """Actuator at rest, reference and readings at zero."""
        forward = Memory() if self.law.feedforward is None else self.law.feedforward.rest()
        return StreamState(self.law.rest(), np.zeros((self.law.n_outputs, self.delay_samples)), forward)

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
        """State of the block at the drive of the first sample of a reference known in advance.

        Returns
        -------
        state : the feedforward has received its preview of the reference
        coming : (p, N) the reference from there on
        """
        reference = checked_reference(reference_um, self.law.n_outputs)
        if self.law.feedforward is None:
            return self.rest(), reference
        forward, coming = self.law.feedforward.primed(reference)
        late, ahead = self.law.late_samples, self.law.feedforward.preview_samples
        waiting = np.hstack([np.zeros((self.law.n_outputs, late)), reference[:, :ahead]])
        return StreamState(self.law.rest(), waiting, forward), coming


def closed_loop(law: Controller[Any], plant: Plant, reference_um: ArrayLike, seed: list[int]) -> Response:
    """Closed-loop response of an actuator with a sensor, from rest.

    Identical to ``Plant.closed_loop`` to the last bit; the loop over the samples is compiled if controller
    and hysteresis are those of this package.

    Parameters
    ----------
    law : the controller
    plant : the actuator in its set-up
    reference_um : (p, N) path [um]; the feedforward, if there is one, knows it ahead, or the position follows
        it by the delay that the feedforward states
    seed : of the sensor's noise

    Raises
    ------
    InputError : shapes that do not fit
    SimulationError : the loop diverges
    """
    reference, hysteresis = checked_reference(reference_um, law.n_outputs), plant.model.hysteresis
    if (law.n_inputs, law.n_outputs) != (hysteresis.n_inputs, hysteresis.n_outputs):
        raise InputError("closed loop", "controller and actuator must have the same axes")
    if not isinstance(law, FeedbackController) or not isinstance(hysteresis, PrandtlIshlinskii):
        return plant.closed_loop(law, reference, seed)
    wires = _compiled_loop(law, plant, hysteresis, reference, seed)
    if not np.isfinite(wires["position_um"]).all():
        raise SimulationError("The closed loop diverges: its gains are too high for this actuator.")
    low, high = plant.instruments.drive.limits(law.n_inputs)[:, :, None]
    return Response(
        sample_time_s=plant.sample_time_s,
        reference_um=reference,
        saturated=(wires["requested_v"] < low) | (wires["requested_v"] > high),
        inputs=plant.model.inputs,
        outputs=plant.model.outputs,
        **wires,
    )


def _compiled_loop(
    law: FeedbackController, plant: Plant, hysteresis: PrandtlIshlinskii, reference_um: Array, seed: list[int]
) -> dict[str, Any]:
    """Wires (axis, sample) of the compiled loop."""
    from hammerstein.compensators.feedback.pid_kernel import run_closed_loop

    path_um, forward_v = law.path_and_feedforward(reference_um)
    m, p, samples = law.n_inputs, law.n_outputs, reference_um.shape[1]
    drive, sensor = plant.instruments.drive, plant.instruments.sensor
    effects = (drive.resolution_v, sensor.range_um, sensor.resolution_um, sensor.noise_um)
    voltages = {name: np.empty((m, samples)) for name in ("requested_v", "drive_v")}
    positions = {name: np.empty((p, samples)) for name in ("hysteresis_um", "position_um", "reading_um")}
    bank, plays = hysteresis.bank, hysteresis.rest().copy()
    noise = standard_noise(np.random.default_rng(seed), p, samples)
    signals = (path_um, np.ascontiguousarray(forward_v), noise)
    controller = (law._settings, law.inverse_gain_v_per_um, law.gain_um_per_v, law._limits, law.rest().memory)
    instruments = (np.array(effects), drive.steps(m), np.array(plant.model.recorded.working_point_v))
    actuator = (
        (bank.r, bank.guide, bank.scale, bank.n, bank.lines, bank.w),
        (plays.count, plays.end, plays.x, plays.d, plays.window),
        (plant.block.entries, plant.block.rest()),
    )
    out = (*voltages.values(), *positions.values())
    for first, stop in spans(samples, 64 + len(plant.block.entries[2])):
        run_closed_loop(signals, controller, instruments, actuator, first, stop, out, (0,) * p)
    return voltages | positions


def _computed(
    model: HammersteinModel, sample_time_s: float, sensor_bandwidth_hz: float, derivative: bool
) -> Gains:
    """Gains from the model's dynamics, the sensor's lag and one sample of delay, for the extreme slopes."""
    if isinstance(model.dynamics, StaticDynamics):
        raise InputError(
            "feedback",
            "the model has no dynamics, so no stable gain can be computed; identify the dynamics too "
            '(method = "hammerstein"), or give the gains',
        )
    if getattr(model.hysteresis, "passes_for_delay", False):  # its slopes lag behind the voltage
        raise InputError(
            "feedback",
            "the thresholds of the model grow with the rate, which the computed gains would leave out; give "
            "proportional and integral_per_s, or a model of another kind",
        )
    return tuned(_loop(model, sample_time_s, sensor_bandwidth_hz), derivative)


def _judged(gains: Gains, model: HammersteinModel, sample_time_s: float, sensor_bandwidth_hz: float) -> Gains:
    """Given gains with the sensitivity of the loop, if the model determines it; infinite if unstable."""
    told = not isinstance(model.dynamics, (StaticDynamics, WithLoop)) and gains.fit(
        model.hysteresis.n_outputs
    )
    if not told or getattr(model.hysteresis, "passes_for_delay", False):
        return gains
    loop = _loop(model, sample_time_s, sensor_bandwidth_hz)
    return replace(gains, sensitivity=loop.sensitivity(gains))


def _loop(model: HammersteinModel, sample_time_s: float, sensor_bandwidth_hz: float) -> FeedbackLoop:
    """The model with the lag of its sensor, for the extreme slopes of the hysteresis."""
    block, p = discretise(model.dynamics, sample_time_s, sensor_bandwidth_hz), model.hysteresis.n_outputs
    reading = LinearBlock(block.A, block.B, block.C[p:], block.D[p:], sample_time_s)
    return FeedbackLoop(reading, np.array(_extreme_slopes(model)))


def _extreme_slopes(model: HammersteinModel) -> list[Array]:
    """Decoupled slope matrices J G^+ (p, p), each input at its least and greatest slope of each output."""
    hysteresis = model.about_middle
    inverse = np.linalg.pinv(hysteresis.gain(model.amplitude_v))
    scale = np.linalg.pinv(inverse)
    ends = []
    for k in range(hysteresis.n_inputs):
        columns = slopes_of(hysteresis, k, model.amplitude_v)
        size = columns * np.sign(scale[:, k])
        extreme = np.unique([size.argmin(axis=0), size.argmax(axis=0)]) if len(columns) else ()
        ends.append([columns[i] for i in extreme])
    return [np.stack(choice, axis=1) @ inverse for choice in itertools.product(*ends)]


class Feedback(Compensator):
    """A PI or PID law with the sensor, alone or on top of a feedforward law."""

    takes_loop: ClassVar[bool] = False
    law: Literal["feedback"] = "feedback"
    feedforward: Literal["none", "exact_inverse", "hammerstein_inverse"] | None = Field(
        default=None, description="feedforward law whose drive is added, from the same model"
    )
    derivative: bool = Field(default=False, description="also compute a derivative gain")
    proportional: tuple[Gain, ...] | None = Field(
        default=None, description="proportional gain of each output"
    )
    integral_per_s: tuple[Gain, ...] | None = Field(
        default=None,
        description=(
            "integral gain of each axis, 1/s times the unit of the proportional gain; tuned if omitted"
        ),
    )
    derivative_s: tuple[Gain, ...] | None = Field(
        default=None,
        description=(
            "derivative gain of each axis, s times the unit of the proportional gain; tuned if omitted"
        ),
    )

    @model_validator(mode="after")
    def _gains_come_together(self) -> Self:
        given = [self.proportional, self.integral_per_s, self.derivative_s]
        if any(gain is not None for gain in given) and (given[0] is None or given[1] is None):
            raise ValueError("give proportional and integral_per_s together, or omit all gains")
        return self

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> FeedbackController:
        """Build the controller, see ``Compensator.design``."""
        added = None
        if self.feedforward is not None:
            added = COMPENSATORS.value({"law": self.feedforward}).design(model, range_v, sample_time_s)
        assert added is None or isinstance(added, Law)  # none of those that may be named reads the sensor
        bandwidth = model.instruments.sensor.bandwidth_hz
        return FeedbackController(
            model, range_v, sample_time_s, bandwidth, self._gains(), self.derivative, feedforward=added
        )

    def _gains(self) -> Gains | None:
        if self.proportional is None or self.integral_per_s is None:
            return None
        derivative = self.derivative_s or (0.0,) * len(self.proportional)
        return Gains(np.array(self.proportional), np.array(self.integral_per_s), np.array(derivative))

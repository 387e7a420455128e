"""Dynamics of the actuator; the only module that uses python-control.

Resonant axes, creep, state-space blocks, and their exact discretisation under a zero-order hold.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from hammerstein.arrays import Array
from hammerstein.dynamics.feedback_block import FeedbackBlock
from hammerstein.dynamics.feedback_hysteresis import (
    ElectromechanicalDynamics,
    FeedbackHysteresisDynamics,
    MatrixForm,
)
from hammerstein.dynamics.linear_block import CONTINUOUS, LinearBlock, low_pass, unit_gain
from hammerstein.errors import InputError
from hammerstein.quantities import (
    Axes,
    CreepGain,
    Damping,
    Delay,
    Resonance,
    TimeConstant,
    interval,
    sampling,
)
from hammerstein.validation import Strict

if TYPE_CHECKING:
    import control

StateMatrices = tuple[Array, Array, Array, Array]
"""A, B, C and D."""


def natural_frequency_hz(bandwidth_hz: float, damping_ratio: float) -> float:
    """Undamped natural frequency [Hz] of a second-order axis whose gain is -3 dB at ``bandwidth_hz``.

    From |G(jw)|^2 = 1 / ((1-q)^2 + 4 z^2 q) = 10^-0.3 with q = (w/w_n)^2.

    >>> round(natural_frequency_hz(430.0, 0.12), 1)
    279.7
    """
    a = 1.0 - 2.0 * damping_ratio**2
    q = a + math.sqrt(a * a + 10.0**0.3 - 1.0)
    return bandwidth_hz / math.sqrt(q)


class InMatrices(Strict, ABC):
    """Linear dynamics in a model file."""

    @abstractmethod
    def block(self) -> LinearBlock:
        """Return the matrices, in continuous time or on a sample time of their own."""

    def system(self) -> control.StateSpace:
        """Return it as a ``control.StateSpace``."""
        return self.block().system()


class CreepMode(Strict):
    """One slow mode: adds ``gain / (1 + time_constant_s s)`` to the direct path of its axis."""

    gain: CreepGain = Field(description="final creep of this mode, as a fraction of the fast displacement")
    time_constant_s: TimeConstant


class Axis(InMatrices):
    """One axis of unit static gain before creep: a resonance, a low-pass, both or none.

    G(s) = w_n^2 / (s^2 + 2 z w_n s + w_n^2) * 1 / (1 + T_l s) * (1 + sum of g_i / (1 + T_i s))

    w_n = 2 pi resonance_hz is the undamped natural frequency, z the damping ratio, T_l the time constant of a
    low-pass, for example of the amplifier. Omitted parts are absent.
    """

    resonance_hz: Resonance | None = Field(default=None, description="undamped natural frequency")
    damping_ratio: Damping | None = None
    lag_s: TimeConstant | None = Field(default=None, description="time constant of a low-pass")
    creep: tuple[CreepMode, ...] = ()

    @model_validator(mode="after")
    def _whole_resonance(self) -> Self:
        if (self.resonance_hz is None) != (self.damping_ratio is None):
            raise ValueError("give both resonance_hz and damping_ratio, or neither")
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_left_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        plain: dict[str, Any] = handler(self)
        return {name: value for name, value in plain.items() if value is not None}

    def describe(self) -> str:
        """Short description."""
        parts = []
        if self.resonance_hz is not None:
            parts.append(f"{self.resonance_hz:.4g} Hz (damping {self.damping_ratio:.3g})")
        if self.lag_s is not None:
            parts.append(f"lag of {interval(self.lag_s)}")
        return " and ".join(parts) or "none"

    @property
    def free(self) -> Array:
        """Its parameters: ln resonance, ln damping, ln time constant of the low-pass, then gain and ln time
        constant of each slow mode; without absent parts.
        """
        x: list[float] = []
        if self.resonance_hz is not None and self.damping_ratio is not None:
            x += [math.log(self.resonance_hz), math.log(self.damping_ratio)]
        if self.lag_s is not None:
            x.append(math.log(self.lag_s))
        for mode in self.creep:
            x += [mode.gain, math.log(mode.time_constant_s)]
        return np.array(x)

    def at(self, free: Array) -> Self:
        """Return the axis with other ``free`` numbers."""
        x = iter(free.tolist())
        fast = ("resonance_hz", "damping_ratio", "lag_s")
        other: dict[str, Any] = {key: math.exp(next(x)) for key in fast if getattr(self, key) is not None}
        other["creep"] = tuple(
            mode.model_copy(update={"gain": next(x), "time_constant_s": math.exp(next(x))})
            for mode in self.creep
        )
        return self.model_copy(update=other)

    def block(self) -> LinearBlock:
        """Return its matrices, in continuous time."""
        parts = [LinearBlock(*matrices, CONTINUOUS) for matrices in self._parts()]
        return reduce(LinearBlock.behind, parts) if parts else unit_gain(1)

    def _parts(self) -> Iterator[StateMatrices]:
        """Parts in series, the last one first."""
        if self.creep:
            yield _slow_modes(self.creep)
        if self.resonance_hz is not None:
            yield _mode(self.resonance_hz, self.damping_ratio or 0.0)
        if self.lag_s is not None:
            pole = np.array([[1.0 / self.lag_s]])
            yield -pole, pole, np.eye(1), np.zeros((1, 1))


class AxesDynamics(InMatrices):
    """One axis for each output, without coupling between the outputs."""

    kind: Literal["axes"] = "axes"
    axes: tuple[Axis, ...] = Field(min_length=1)
    input_delay_s: Delay = 0.0

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.axes)

    @property
    def settle_s(self) -> float:
        """Time in which the slowest axis, without its creep, rings down to a thousandth [s]."""
        times = [axis.lag_s for axis in self.axes if axis.lag_s is not None]
        for axis in self.axes:
            if axis.resonance_hz is not None and axis.damping_ratio:
                times.append(0.5 / math.pi / axis.resonance_hz / axis.damping_ratio)
        return math.log(1e3) * max(times, default=0.0)

    @property
    def free(self) -> Array:
        """Parameters of all axes, one after the other; see ``Axis.free``."""
        return np.concatenate([axis.free for axis in self.axes])

    def at(self, free: Array) -> Self:
        """Return the axes with other ``free`` numbers."""
        ends = np.cumsum([len(axis.free) for axis in self.axes])[:-1]
        each = zip(self.axes, np.split(free, ends), strict=True)
        return self.model_copy(update={"axes": tuple(axis.at(own) for axis, own in each)})

    def describe(self) -> str:
        """Short description."""
        kind = "resonant axes" if any(a.resonance_hz for a in self.axes) else "axes"
        axes = ", ".join(axis.describe() for axis in self.axes)
        return f"{kind}: {axes}" + (", with creep" if any(a.creep for a in self.axes) else "")

    def block(self) -> LinearBlock:
        """Return its matrices, in continuous time."""
        from scipy.linalg import block_diag

        each = [axis.block() for axis in self.axes]
        a, b, c, d = (block_diag(*(getattr(block, name) for block in each)) for name in "ABCD")
        return LinearBlock(a, b, c, d, CONTINUOUS)


class StaticDynamics(InMatrices):
    """No dynamics: the displacement equals the output of the hysteresis."""

    kind: Literal["static"] = "static"
    n_outputs: Axes
    input_delay_s: Delay = 0.0

    def describe(self) -> str:
        """Short description."""
        return "none"

    def block(self) -> LinearBlock:
        """Return its matrices, in continuous time."""
        return unit_gain(self.n_outputs)


class StateSpaceDynamics(MatrixForm, InMatrices):
    """Linear block x' = A x + B v, y = C x + D v, continuous or with a fixed sample time."""

    kind: Literal["state_space"] = "state_space"

    def instability(self) -> str:
        """Message about a pole on or beyond the stability limit, with its remedy; empty if there is none."""
        if self.allow_unstable or not self.A:
            return ""
        poles = np.linalg.eigvals(np.asarray(self.A, dtype=np.float64))
        if self.sample_time_s is None:
            worst, bound, name = float(poles.real.max()), 0.0, "a pole with a real part of {:.6g} 1/s"
        else:
            worst, bound, name = float(np.abs(poles).max()), 1.0, "a pole at |z| = {:.6g}"
        if worst < bound:
            return ""
        return (
            f"is not stable ({name.format(worst)}): its outputs grow without bound. Identify it "
            "again, or set allow_unstable = true beside A to accept it"
        )

    def describe(self) -> str:
        """Short description."""
        return f"state space of order {len(self.A)}, {sampling(self.sample_time_s)}"

    @classmethod
    def of(
        cls, system: control.LTI, input_delay_s: float = 0.0, allow_unstable: bool = False
    ) -> StateSpaceDynamics:
        """Keep a linear system of python-control, continuous or discrete: state space or transfer function.

        A model refuses one that is not stable, unless ``allow_unstable``.

        Raises
        ------
        InputError : anything else (a frequency response has no state), an improper transfer function, or a
            discrete system without a sample time

        Examples
        --------
        >>> import control
        >>> StateSpaceDynamics.of(control.tf([1.0], [1e-6, 1e-4, 1.0])).describe()
        'state space of order 2, continuous'
        """
        from hammerstein.blocks.limit_cycles import matrices_of

        a, b, c, d, sample_time_s = matrices_of(system)
        rows = {k: tuple(map(tuple, m.tolist())) for k, m in zip("ABCD", (a, b, c, d), strict=True)}
        allowed: Literal[True] | None = True if allow_unstable else None
        return cls(**rows, sample_time_s=sample_time_s, input_delay_s=input_delay_s, allow_unstable=allowed)

    def block(self) -> LinearBlock:
        """Return its matrices, in continuous time or on its own sample time."""
        return LinearBlock(**self.matrices(), sample_time_s=self.sample_time_s or CONTINUOUS)


Linear = AxesDynamics | StaticDynamics | StateSpaceDynamics
WithLoop = FeedbackHysteresisDynamics | ElectromechanicalDynamics
Dynamics = Annotated[Linear | WithLoop, Field(discriminator="kind")]


def cantilever(
    bandwidth_hz: ArrayLike | None = None,
    damping_ratio: ArrayLike = 0.12,
    *,
    resonance_hz: ArrayLike | None = None,
) -> control.StateSpace:
    """Cantilever bending modes: one second-order axis of unit static gain for each output.

        G(s) = w_n^2 / (s^2 + 2 z w_n s + w_n^2)

    Parameters
    ----------
    bandwidth_hz : (axis,) frequency [Hz] at which ``control.bandwidth`` finds -3 dB
    damping_ratio : (axis,) or one value for all, positive
    resonance_hz : (axis,) undamped natural frequency [Hz], instead of the bandwidth

    Raises
    ------
    InputError : both or none of bandwidth and resonance, or a value that is not positive

    Examples
    --------
    >>> import control
    >>> round(float(control.bandwidth(cantilever(430.0, 0.12))) / 6.283185307, 3)
    430.0
    """
    import control

    if (bandwidth_hz is None) == (resonance_hz is None):
        raise InputError("cantilever", "give either bandwidth_hz or resonance_hz")
    given = np.atleast_1d(np.asarray(resonance_hz if bandwidth_hz is None else bandwidth_hz, dtype=float))
    zeta = np.broadcast_to(np.asarray(damping_ratio, dtype=float), given.shape)
    if not (np.isfinite(given) & (given > 0) & np.isfinite(zeta) & (zeta > 0)).all():
        raise InputError("cantilever", "frequencies and damping ratios must be positive and finite")
    axes = []
    for f, z in zip(given.tolist(), zeta.tolist(), strict=True):
        axes.append(control.ss(*_mode(f if bandwidth_hz is None else natural_frequency_hz(f, z), z)))
    return control.append(*axes)


def _mode(resonance_hz: float, damping_ratio: float) -> StateMatrices:
    """Matrices of one bending mode.

    Balanced states (x, x'/w): entries of one magnitude discretise without loss.
    """
    w = 2.0 * math.pi * resonance_hz
    a, b = [[0.0, w], [-w, -2.0 * damping_ratio * w]], [[0.0], [w]]
    return np.array(a), np.array(b), np.array([[1.0, 0.0]]), np.array([[0.0]])


def _slow_modes(creep: Sequence[CreepMode]) -> StateMatrices:
    """Matrices of the creep of one axis as slow linear modes: 1 + sum of g_i / (1 + T_i s).

    Source: Croft, Shed and Devasia (paper, reference 7).
    """
    slow = np.reciprocal(np.array([mode.time_constant_s for mode in creep]))
    return -np.diag(slow), slow[:, None], np.array([[mode.gain for mode in creep]]), np.eye(1)


def linear(dynamics: Dynamics) -> Linear:
    """Return the dynamics as linear ones; InputError where they have hysteresis in their loop.

    The response of such a model follows from the loop, so the block in front of it must not be used alone.
    """
    if isinstance(dynamics, WithLoop):
        raise InputError(
            "dynamics",
            f"{dynamics.kind} is not linear, but linear dynamics are needed here; simulate it, export it "
            "with --law model, or identify a cascade from its records",
        )
    return dynamics


def discretise(
    dynamics: Dynamics, sample_time_s: float, sensor_bandwidth_hz: float | None = None
) -> LinearBlock:
    """Discretise a linear block; see ``on_grid``.

    Raises
    ------
    InputError : the dynamics are not linear, or as ``on_grid`` raises it
    """
    block = on_grid(linear(dynamics), sample_time_s, sensor_bandwidth_hz)
    assert isinstance(block, LinearBlock)
    return block


def linearised(dynamics: Dynamics, sample_time_s: float, ends: Array) -> LinearBlock:
    """Put dynamics on a sample grid; a loop with hysteresis has the gains of its slow settled loops.

    ends : (m,) inputs at one end of those loops; the other end is their negative
    """
    if isinstance(dynamics, WithLoop):
        block = on_grid(dynamics, sample_time_s)
        assert isinstance(block, FeedbackBlock)
        return block.with_gain(block.slow_gain(ends))
    return discretise(dynamics, sample_time_s)


def on_grid(
    dynamics: Dynamics, sample_time_s: float, sensor_bandwidth_hz: float | None = None
) -> LinearBlock | FeedbackBlock:
    """Put the block on a sample grid, exactly for an input held over each sample.

    Parameters
    ----------
    dynamics : the block behind the hysteresis, linear or with hysteresis of its own in its loop
    sample_time_s : the grid [s]
    sensor_bandwidth_hz : if given, the outputs are the true positions followed by those behind a
        first-order sensor, whose input is not held: both are discretised together

    Raises
    ------
    InputError : a discrete block on another sample time, or one whose delay is no whole number of samples
    """
    block: LinearBlock | FeedbackBlock = dynamics.block()
    samples, late_s = split_delay(dynamics.input_delay_s, sample_time_s)
    if block.sample_time_s != CONTINUOUS:
        if not math.isclose(block.sample_time_s, sample_time_s, rel_tol=1e-9):
            raise InputError(
                "dynamics",
                f"the model was identified at a sample time of {interval(block.sample_time_s)} and cannot "
                f"run at {interval(sample_time_s)}; set the drive's sample_time_s to the model's",
            )
        if late_s:
            raise InputError(
                "dynamics",
                f"the input delay of {interval(dynamics.input_delay_s)} is not a whole number of samples of "
                f"{interval(sample_time_s)}, the sample time of this block; round it",
            )
        if sensor_bandwidth_hz is not None:
            block = block.observed_by(low_pass(sensor_bandwidth_hz, block.n_outputs).held(sample_time_s))
    else:
        if sensor_bandwidth_hz is not None:
            block = block.observed_by(low_pass(sensor_bandwidth_hz, block.n_outputs))
        block = block.held(sample_time_s, late_s)
    return block.delayed(samples)


def split_delay(delay_s: float, sample_time_s: float) -> tuple[int, float]:
    """Whole samples of a delay, and the rest of it [s], which is less than a sample.

    Examples
    --------
    >>> split_delay(3e-4, 1e-4)
    (3, 0.0)
    >>> split_delay(0.375, 0.25)
    (1, 0.125)
    """
    nearest = round(delay_s / sample_time_s)
    if abs(nearest * sample_time_s - delay_s) <= 1e-6 * sample_time_s:
        return nearest, 0.0
    whole = math.floor(delay_s / sample_time_s)
    return whole, delay_s - whole * sample_time_s

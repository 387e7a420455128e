"""Linear dynamics of the actuator: the only door to python-control.

Resonant axes, creep, state-space blocks, and their exact discretisation under a zero-order hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from hammerstein.errors import InputError
from hammerstein.quantities import Axes, CreepGain, Damping, Delay, Entry, Resonance, SampleTime, TimeConstant

if TYPE_CHECKING:
    import control

    from hammerstein.interop.block_system import BlockSystem

Array = NDArray[np.float64]
CONTINUOUS = 0.0  # sample time [s] of a block in continuous time, as python-control writes it


MOST_DELAY_STATES = 2000


def natural_frequency_hz(bandwidth_hz: float, damping_ratio: float) -> float:
    """Undamped natural frequency [Hz] of a second-order axis whose gain is -3 dB at ``bandwidth_hz``.

    From |G(jw)|^2 = 1 / ((1-q)^2 + 4 z^2 q) = 10^-0.3 with q = (w/w_n)^2.

    >>> round(natural_frequency_hz(430.0, 0.12), 1)
    279.7
    """
    a = 1.0 - 2.0 * damping_ratio**2
    q = a + math.sqrt(a * a + 10.0**0.3 - 1.0)
    return bandwidth_hz / math.sqrt(q)


class CreepMode(BaseModel):
    """One slow mode: adds ``gain / (1 + time_constant_s s)`` to the direct path of its axis."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    gain: CreepGain = Field(description="final creep of this mode, as a fraction of the fast displacement")
    time_constant_s: TimeConstant


class Axis(BaseModel):
    """One axis of unit static gain before creep: a resonance, a low-pass, both or none.

    G(s) = w_n^2 / (s^2 + 2 z w_n s + w_n^2) * 1 / (1 + T_l s) * (1 + sum of g_i / (1 + T_i s))

    w_n = 2 pi resonance_hz is the undamped natural frequency, z the damping ratio, T_l the time constant of a
    low-pass, such as that of the amplifier. What is not given is left out.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    resonance_hz: Resonance | None = Field(default=None, description="undamped natural frequency")
    damping_ratio: Damping | None = None
    lag_s: TimeConstant | None = Field(default=None, description="time constant of a low-pass")
    creep: tuple[CreepMode, ...] = ()

    @model_validator(mode="after")
    def _whole_resonance(self) -> Self:
        if (self.resonance_hz is None) != (self.damping_ratio is None):
            raise ValueError("give resonance_hz and damping_ratio, or none of them")
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_left_out(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        plain: dict[str, Any] = handler(self)
        return {name: value for name, value in plain.items() if value is not None}

    def describe(self) -> str:
        """Say in a few words what it is."""
        parts = []
        if self.resonance_hz is not None:
            parts.append(f"{self.resonance_hz:.4g} Hz (damping {self.damping_ratio:.3g})")
        if self.lag_s is not None:
            parts.append(f"lag of {self.lag_s:.3g} s")
        return " and ".join(parts) or "none"

    def system(self) -> control.StateSpace:
        """Give the axis as a continuous ``control.StateSpace``."""
        import control

        parts = []
        if self.creep:
            parts.append(creep([c.gain for c in self.creep], [c.time_constant_s for c in self.creep]))
        if self.resonance_hz is not None:
            parts.append(cantilever(resonance_hz=self.resonance_hz, damping_ratio=self.damping_ratio or 0.0))
        if self.lag_s is not None:
            parts.append(control.ss([[-1.0 / self.lag_s]], [[1.0 / self.lag_s]], [[1.0]], [[0.0]]))
        return math.prod(parts[1:], start=parts[0]) if parts else control.ss([], [], [], [[1.0]])

    def block(self) -> LinearBlock:
        """Give its matrices, in continuous time."""
        if not (self.creep or self.resonance_hz or self.lag_s):
            return _gain(1)
        system = self.system()
        return LinearBlock(system.A, system.B, system.C, system.D, CONTINUOUS)


class AxesDynamics(BaseModel):
    """One axis for each output, not coupled with each other."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["axes"] = "axes"
    axes: tuple[Axis, ...] = Field(min_length=1)
    input_delay_s: Delay = 0.0

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.axes)

    def describe(self) -> str:
        """Say in a few words what it is."""
        kind = "resonant axes" if any(a.resonance_hz for a in self.axes) else "axes"
        axes = ", ".join(axis.describe() for axis in self.axes)
        return f"{kind}: {axes}" + (", with creep" if any(a.creep for a in self.axes) else "")

    def system(self) -> control.StateSpace:
        """Give the block as a continuous ``control.StateSpace``."""
        import control

        return control.append(*(axis.system() for axis in self.axes))

    def block(self) -> LinearBlock:
        """Give its matrices, in continuous time."""
        from scipy.linalg import block_diag

        each = [axis.block() for axis in self.axes]
        a, b, c, d = (block_diag(*(getattr(block, name) for block in each)) for name in "ABCD")
        return LinearBlock(a, b, c, d, CONTINUOUS)


class StaticDynamics(BaseModel):
    """No dynamics: the displacement follows the hysteresis block at once."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["static"] = "static"
    n_outputs: Axes
    input_delay_s: Delay = 0.0

    def describe(self) -> str:
        """Say in a few words what it is."""
        return "none"

    def system(self) -> control.StateSpace:
        """Give the block as a ``control.StateSpace`` without states."""
        return self.block().system()

    def block(self) -> LinearBlock:
        """Give its matrices, in continuous time."""
        return _gain(self.n_outputs)


class StateSpaceDynamics(BaseModel):
    """Any linear block x' = A x + B v, y = C x + D v, continuous or on a fixed sample time."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["state_space"] = "state_space"
    A: tuple[tuple[Entry, ...], ...]
    B: tuple[tuple[Entry, ...], ...]
    C: tuple[tuple[Entry, ...], ...]
    D: tuple[tuple[Entry, ...], ...]
    sample_time_s: SampleTime | None = Field(default=None, description="absent: continuous time")
    input_delay_s: Delay = 0.0
    allow_unstable: Literal[True] | None = Field(
        default=None, description="true: accept a block whose outputs grow without bound"
    )

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        n, m, p = len(self.A), len(self.D[0]) if self.D else 0, len(self.D)
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
        for name, (rows, columns) in shapes.items():
            matrix = getattr(self, name)
            if len(matrix) != rows or any(len(row) != columns for row in matrix):
                raise ValueError(f"{name} must be {rows} x {columns}")
        if p == 0 or m == 0:
            raise ValueError("D must have at least one row and one column")
        return self

    def instability(self) -> str:
        """Say that a pole lies on the border of stability or beyond, and what to do; empty if none does."""
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
            f"is not stable ({name.format(worst)}): its outputs grow without bound. Identify it again, or "
            "set allow_unstable = true beside A if this is meant"
        )

    def describe(self) -> str:
        """Say in a few words what it is."""
        kind = "continuous" if self.sample_time_s is None else f"at {self.sample_time_s:g} s a sample"
        return f"state space of order {len(self.A)}, {kind}"

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
        from hammerstein.interop.linear_system import matrices_of

        a, b, c, d, sample_time_s = matrices_of(system)
        rows = {k: tuple(map(tuple, m.tolist())) for k, m in zip("ABCD", (a, b, c, d), strict=True)}
        allowed: Literal[True] | None = True if allow_unstable else None
        return cls(**rows, sample_time_s=sample_time_s, input_delay_s=input_delay_s, allow_unstable=allowed)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.D)

    def system(self) -> control.StateSpace:
        """Give the block as a ``control.StateSpace``."""
        return self.block().system()

    def block(self) -> LinearBlock:
        """Give its matrices, in continuous time or on its own sample time."""
        n, m, p = len(self.A), len(self.D[0]), len(self.D)
        a, b = np.reshape(self.A, (n, n)), np.reshape(self.B, (n, m))
        c, d = np.reshape(self.C, (p, n)), np.reshape(self.D, (p, m))
        return LinearBlock(a, b, c, d, self.sample_time_s or CONTINUOUS)


Dynamics = Annotated[AxesDynamics | StaticDynamics | StateSpaceDynamics, Field(discriminator="kind")]


def cantilever(
    bandwidth_hz: ArrayLike | None = None,
    damping_ratio: ArrayLike = 0.12,
    *,
    resonance_hz: ArrayLike | None = None,
) -> control.StateSpace:
    """Cantilever bending modes, one second-order axis of unit static gain an output.

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
        w = 2.0 * math.pi * (f if bandwidth_hz is None else natural_frequency_hz(f, z))
        # Balanced states (x, x'/w): entries of one magnitude discretise without loss.
        axes.append(control.ss([[0.0, w], [-w, -2.0 * z * w]], [[0.0], [w]], [[1.0, 0.0]], [[0.0]]))
    return control.append(*axes)


def creep(gains: Sequence[float], time_constants_s: Sequence[float]) -> control.StateSpace:
    """Creep of one axis as slow linear modes: 1 + sum of g_i / (1 + T_i s).

    Source: Croft, Shed and Devasia (paper, reference 7).
    """
    import control

    n = len(gains)
    slow = np.reciprocal(np.asarray(time_constants_s, dtype=float).reshape(n))
    return control.ss(
        -np.diag(slow), slow.reshape(n, 1), np.asarray(gains, dtype=float).reshape(1, n), [[1.0]]
    )


def low_pass(bandwidth_hz: float, n: int) -> LinearBlock:
    """First-order low-pass of n channels, -3 dB at ``bandwidth_hz``; infinite bandwidth passes all."""
    if math.isinf(bandwidth_hz):
        return _gain(n)
    w = 2.0 * math.pi * bandwidth_hz
    return LinearBlock(-w * np.eye(n), w * np.eye(n), np.eye(n), np.zeros((n, n)), CONTINUOUS)


def _gain(n: int) -> LinearBlock:
    """N channels that pass unchanged."""
    return LinearBlock(np.empty((0, 0)), np.empty((0, n)), np.empty((n, 0)), np.eye(n), CONTINUOUS)


@dataclass(frozen=True, eq=False)
class LinearBlock:
    """A discrete linear block on one sample grid: x[k+1] = A x[k] + B v[k], y[k] = C x[k] + D v[k].

    A : (n, n), B : (n, m), C : (p, n), D : (p, m)

    With ``sample_time_s`` = 0 the matrices are those of continuous time, to be put on a grid by ``held``.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    sample_time_s: float

    def __post_init__(self) -> None:
        for name in "ABCD":
            matrix = np.array(getattr(self, name), dtype=np.float64)
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)

    def __repr__(self) -> str:
        return (
            f"LinearBlock(order {len(self.A)}, {self.n_inputs} inputs, {self.n_outputs} outputs, "
            f"{self.sample_time_s:g} s a sample)"
        )

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.D.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.D.shape[0])

    def system(self) -> control.StateSpace:
        """Give the block as a ``control.StateSpace``.

        python-control up to 0.10.2 sets the shape of the empty matrices of a system without states, which
        NumPy 2.5 warns of; mended in https://github.com/python-control/python-control/pull/1243. No
        simulation comes here: ``held`` needs no system.
        """
        import control

        timebase = self.sample_time_s if self.A.size else None  # without states it fits any
        return control.ss(self.A, self.B, self.C, self.D, timebase)

    def held(self, sample_time_s: float, late_s: float = 0.0) -> LinearBlock:
        """Put a block in continuous time on a grid, exactly for an input held over each sample.

        The input may come ``late_s`` late, less than a sample. Its last value is then carried as a state and
        works until the new one arrives (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 1997,
        section 2.3).
        """
        from scipy.signal import cont2discrete

        if late_s:
            return self.held(late_s).then(self.held(sample_time_s - late_s), sample_time_s)
        a, b, c, d, _ = cont2discrete((self.A, self.B, self.C, self.D), sample_time_s, "zoh")
        return LinearBlock(a, b, c, d, sample_time_s)

    def then(self, rest: LinearBlock, sample_time_s: float) -> LinearBlock:
        """Give one sample that begins with this block's step by the last input and ends with the other's."""
        n, m = self.B.shape
        a = np.block([[np.zeros((m, m + n))], [rest.A @ self.B, rest.A @ self.A]])
        b = np.vstack([np.eye(m), rest.B])
        c, d = np.hstack([self.D, self.C]), np.zeros_like(self.D)
        return LinearBlock(a, b, c, d, sample_time_s)

    def rest(self) -> Array:
        """State (n,) of a block that was never driven."""
        return np.zeros(self.A.shape[0])

    def settled(self, v_um: ArrayLike) -> Array:
        """State (n,) after an input (m,) that was held for ever; nearest to zero where there is no rest."""
        n = self.A.shape[0]
        held = self.B @ np.asarray(v_um, dtype=np.float64)
        if not held.any():
            return self.rest()
        return np.asarray(np.linalg.lstsq(np.eye(n) - self.A, held, rcond=None)[0])

    def respond(
        self, v_um: ArrayLike, start: Array | None = None, *, sample_time_s: float | None = None
    ) -> tuple[Array, Array]:
        """Outputs (p, sample) for a held input (m, sample), and the state (n,) after it.

        Raises InputError where ``sample_time_s`` of the signal is not the block's own, or shapes differ.
        """
        from hammerstein.compiled import spans
        from hammerstein.dynamics.linear_kernel import respond_linear

        if sample_time_s is not None and not math.isclose(sample_time_s, self.sample_time_s, rel_tol=1e-9):
            raise InputError(
                "signal",
                f"its sample time is {sample_time_s:g} s, the block was discretised for "
                f"{self.sample_time_s:g} s; resample one or the other",
            )
        v = np.ascontiguousarray(np.atleast_2d(np.asarray(v_um, dtype=np.float64)))
        if v.shape[0] != self.n_inputs:
            raise InputError("signal", f"has {v.shape[0]} axes, the block wants {self.n_inputs}")
        x = self.rest() if start is None else np.array(start, dtype=np.float64)
        y = np.empty((self.n_outputs, v.shape[1]))
        for first, end in spans(v.shape[1], len(self.rows[2])):
            respond_linear(*self.rows, x, v, first, end, y)
        return y, x

    def step(self, v_um: ArrayLike, state: Array) -> tuple[Array, Array]:
        """Output (p,) for one sample (m,), and the state after it; equal to ``respond`` to the last bit."""
        y, after = self.respond(np.reshape(np.asarray(v_um, dtype=np.float64), (-1, 1)), state)
        return y[:, 0], after

    def to_iosys(self, sample_time_s: float, name: str = "dynamics") -> BlockSystem:
        """Give the block as a discrete python-control system, ``hysteresis_um[i]`` to ``position_um[o]``.

        It stands on its own sample grid; InputError for another sample time.
        """
        from hammerstein.interop.block_system import BlockSystem, Stepwise, require_grid, signals

        require_grid(self.sample_time_s, sample_time_s, "linear block")
        block = Stepwise(self.rest(), self.step, lambda x: {"x": x}, lambda data: np.asarray(data["x"]))
        wires = signals("hysteresis_um", self.n_inputs), signals("position_um", self.n_outputs)
        return BlockSystem(block, *wires, sample_time_s, name)

    @cached_property
    def rows(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Non-zero entries of [[A, B], [C, D]] row by row: axes that do not couple cost nothing."""
        full = np.block([[self.A, self.B], [self.C, self.D]])
        filled = full != 0.0
        start = np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int64)
        return start, np.nonzero(filled)[1].astype(np.int64), full[filled]

    def response(self, frequency_hz: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response (frequency, p, m) of the block on its grid."""
        z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(frequency_hz)) * self.sample_time_s)
        n = self.A.shape[0]
        resolvent = np.linalg.solve(
            z[:, None, None] * np.eye(n) - self.A, np.broadcast_to(self.B, (len(z), *self.B.shape))
        )
        return np.asarray(self.C @ resolvent + self.D)

    def observed_by(self, sensor: LinearBlock) -> LinearBlock:
        """Series with a sensor; the outputs are first this block's own, then the sensor's."""
        n, s = self.A.shape[0], sensor.A.shape[0]
        a = np.block([[self.A, np.zeros((n, s))], [sensor.B @ self.C, sensor.A]])
        b = np.vstack([self.B, sensor.B @ self.D])
        p = self.n_outputs
        c = np.block([[self.C, np.zeros((p, s))], [sensor.D @ self.C, sensor.C]])
        return LinearBlock(a, b, c, np.vstack([self.D, sensor.D @ self.D]), self.sample_time_s)

    def delayed(self, samples: int) -> LinearBlock:
        """Delay the input by whole samples (a shift register in front)."""
        if samples == 0:
            return self
        m, n = self.n_inputs, self.A.shape[0]
        if m * samples > MOST_DELAY_STATES:
            raise InputError(
                "dynamics",
                f"an input delay of {samples * self.sample_time_s:g} s is {samples} samples of "
                f"{self.sample_time_s:g} s; at most {MOST_DELAY_STATES // m} are carried: use a shorter "
                "input_delay_s or a longer sample time",
            )
        shift = np.eye(m * samples, k=-m)
        last = np.zeros((m, m * samples))
        last[:, -m:] = np.eye(m)
        a = np.block([[shift, np.zeros((m * samples, n))], [self.B @ last, self.A]])
        b = np.vstack([np.eye(m * samples, m), np.zeros((n, m))])
        c = np.hstack([self.D @ last, self.C])
        return LinearBlock(a, b, c, np.zeros((self.n_outputs, m)), self.sample_time_s)


def discretise(
    dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    sample_time_s: float,
    sensor_bandwidth_hz: float | None = None,
) -> LinearBlock:
    """Put the block on a sample grid, exactly for an input held over each sample.

    Parameters
    ----------
    dynamics : the linear block
    sample_time_s : the grid [s]
    sensor_bandwidth_hz : if given, the outputs are the true positions followed by those behind a
        first-order sensor, whose input is not held: both are discretised together

    Raises
    ------
    InputError : a discrete block on another sample time, or one whose delay is no whole number of samples
    """
    block = dynamics.block()
    samples, late_s = split_delay(dynamics.input_delay_s, sample_time_s)
    if block.sample_time_s != CONTINUOUS:
        if not math.isclose(block.sample_time_s, sample_time_s, rel_tol=1e-9):
            raise InputError(
                "dynamics",
                f"the model was identified at {block.sample_time_s:g} s a sample and cannot run at "
                f"{sample_time_s:g} s; set the drive's sample_time_s to the model's",
            )
        if late_s:
            raise InputError(
                "dynamics",
                f"the input delay of {dynamics.input_delay_s:g} s is no whole number of samples of "
                f"{sample_time_s:g} s, on which this block is discrete; round it",
            )
        if sensor_bandwidth_hz is not None:
            sensor = low_pass(sensor_bandwidth_hz, block.n_outputs)
            block = block.observed_by(sensor.held(sample_time_s))
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

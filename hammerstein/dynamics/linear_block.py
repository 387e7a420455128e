"""Linear block on one sample grid, and discretisation of continuous blocks."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, ByValue, Complex, Indices, freeze_fields, rows_of, spans, transfer
from hammerstein.blocks.law import require_grid
from hammerstein.errors import InputError
from hammerstein.quantities import interval, number_of, sampling

if TYPE_CHECKING:
    import control

    from hammerstein.blocks.block_system import BlockSystem

CONTINUOUS = 0.0  # sample time [s] of a block in continuous time, as python-control writes it
MOST_DELAY_STATES = 2000  # a matrix of 4 million entries
ROUNDING = 1e-12  # part of its largest gain below which a block passes nothing


def low_pass(bandwidth_hz: float, n: int) -> LinearBlock:
    """First-order low-pass of n channels, -3 dB at ``bandwidth_hz``; infinite bandwidth passes all."""
    if math.isinf(bandwidth_hz):
        return unit_gain(n)
    w = 2.0 * math.pi * bandwidth_hz
    return LinearBlock(-w * np.eye(n), w * np.eye(n), np.eye(n), np.zeros((n, n)), CONTINUOUS)


def unit_gain(n: int) -> LinearBlock:
    """Unit gain of n channels."""
    return LinearBlock(np.empty((0, 0)), np.empty((0, n)), np.empty((n, 0)), np.eye(n), CONTINUOUS)


class SteppedBlock(ABC):
    """Base class of blocks on a sample grid: one compiled loop for batches and single samples."""

    called: ClassVar[str]
    """Its name in a message."""

    if TYPE_CHECKING:  # a field of every block
        D: Array
        sample_time_s: float

    @abstractmethod
    def rest(self) -> Array:
        """State of a block at rest."""

    @abstractmethod
    def carry_on(self, v_um: Array, state: Array, first: int, stop: int, y_um: Array) -> None:
        """Write outputs into y_um (p, sample) for a range of samples; ``state`` is updated."""

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.D.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.D.shape[0])

    def respond(
        self, v_um: ArrayLike, start: Array | None = None, *, sample_time_s: float | None = None
    ) -> tuple[Array, Array]:
        """Outputs (p, sample) for a held input (m, sample), and the state after it.

        Raises InputError where ``sample_time_s`` of the signal is not the block's own, or shapes differ.
        """
        if sample_time_s is not None and not math.isclose(sample_time_s, self.sample_time_s, rel_tol=1e-9):
            raise InputError(
                "signal",
                f"its sample time is {interval(sample_time_s)}, but the block was discretised for "
                f"{interval(self.sample_time_s)}; resample one of them",
            )
        v = rows_of(v_um)
        if v.shape[0] != self.n_inputs:
            raise InputError("signal", f"has {v.shape[0]} axes; the block needs {self.n_inputs}")
        x = self.rest() if start is None else np.array(start, dtype=np.float64)
        y = np.empty((self.n_outputs, v.shape[1]))
        self.carry_on(v, x, 0, v.shape[1], y)
        return y, x

    def step(self, v_um: ArrayLike, state: Array) -> tuple[Array, Array]:
        """Output (p,) for one sample (m,), and the state after it; equal to ``respond`` to the last bit."""
        y, after = self.respond(np.reshape(np.asarray(v_um, dtype=np.float64), (-1, 1)), state)
        return y[:, 0], after

    def to_iosys(self, sample_time_s: float, name: str = "dynamics") -> BlockSystem:
        """Return the block as a discrete python-control system, ``hysteresis_um[i]`` to ``position_um[o]``.

        It has its own sample time; InputError for another one.
        """
        from hammerstein.blocks.block_system import BlockSystem

        require_grid(self.sample_time_s, sample_time_s, self.called)
        wires = {"hysteresis_um": self.n_inputs}, {"position_um": self.n_outputs}
        return BlockSystem(self.rest(), self.step, lambda data: data["x"], *wires, sample_time_s, name)


def entries_of(matrix: Array) -> tuple[Indices, Indices, Array]:
    """First non-zero entry of each row and of the end, columns of the entries, and the entries."""
    filled = matrix != 0.0
    start = np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int64)
    return start, np.nonzero(filled)[1].astype(np.int64), matrix[filled]


@dataclass(frozen=True, eq=False)
class LinearBlock(SteppedBlock, ByValue):
    """A discrete linear block on one sample grid: x[k+1] = A x[k] + B v[k], y[k] = C x[k] + D v[k].

    A : (n, n), B : (n, m), C : (p, n), D : (p, m)

    With ``sample_time_s`` = 0 the matrices are those of continuous time; ``held`` discretises them.
    """

    called: ClassVar[str] = "linear block"

    A: Array
    B: Array
    C: Array
    D: Array
    sample_time_s: float

    def __post_init__(self) -> None:
        freeze_fields(self, *"ABCD")

    def __repr__(self) -> str:
        axes = f"{number_of(self.n_inputs, 'input')}, {number_of(self.n_outputs, 'output')}"
        return f"LinearBlock(order {len(self.A)}, {axes}, {sampling(self.sample_time_s)})"

    def system(self) -> control.StateSpace:
        """Return the block as a ``control.StateSpace``.

        python-control up to 0.10.2 sets the shape of the empty matrices of a system without states, which
        NumPy 2.5 warns of; mended in https://github.com/python-control/python-control/pull/1243. No
        simulation comes here: ``held`` needs no system.
        """
        import control

        timebase = self.sample_time_s if self.A.size else None  # without states it fits any
        return control.ss(self.A, self.B, self.C, self.D, timebase)

    def held(self, sample_time_s: float, late_s: float = 0.0) -> LinearBlock:
        """Discretise a continuous-time block exactly for an input that is constant over each sample.

        The input may be delayed by ``late_s``, less than a sample. Its last value is then a state that acts
        until the new value arrives (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 1997,
        section 2.3). State and input together are a block without input, whose step is a matrix exponential.
        ``scipy.signal.cont2discrete`` does the same, but loading it takes longer than simulating a short run.
        """
        from scipy.linalg import expm

        if late_s:
            return self.held(late_s).then(self.held(sample_time_s - late_s), sample_time_s)
        n, m = self.B.shape
        step = expm(np.block([[self.A, self.B], [np.zeros((m, n + m))]]) * sample_time_s)
        return LinearBlock(step[:n, :n], step[:n, n:], self.C, self.D, sample_time_s)

    def behind(self, first: LinearBlock) -> LinearBlock:
        """Return the series connection, this block last; states of the other one first."""
        a = np.block([[first.A, np.zeros((len(first.A), len(self.A)))], [self.B @ first.C, self.A]])
        b, c = np.vstack([first.B, self.B @ first.D]), np.hstack([self.D @ first.C, self.C])
        return LinearBlock(a, b, c, self.D @ first.D, self.sample_time_s)

    def then(self, rest: LinearBlock, sample_time_s: float) -> LinearBlock:
        """Combine into one sample: this block's step with the last input, then the step of the other."""
        n, m = self.B.shape
        a = np.block([[np.zeros((m, m + n))], [rest.A @ self.B, rest.A @ self.A]])
        b = np.vstack([np.eye(m), rest.B])
        c, d = np.hstack([self.D, self.C]), np.zeros_like(self.D)
        return LinearBlock(a, b, c, d, sample_time_s)

    def lag(self, frequency_hz: ArrayLike) -> Array:
        """Relative deviation of sines (frequency,) from the response to slow ones.

        The largest entry of |G(z) G(1)^-1 - 1| at z = exp(j 2 pi f T), of a block on a grid.
        """
        gain = self.response(np.concatenate([[0.0], np.atleast_1d(frequency_hz)]))
        if np.linalg.svd(gain[0], compute_uv=False).min() <= ROUNDING * np.abs(gain).max():
            return np.full(len(gain) - 1, np.inf)  # at rest an axis stands still
        return np.asarray(np.abs(gain[1:] @ np.linalg.inv(gain[0]) - np.eye(len(gain[0]))).max(axis=(1, 2)))

    def rest(self) -> Array:
        """State (n,) of a block at rest."""
        return np.zeros(self.A.shape[0])

    def settled(self, v_um: ArrayLike) -> Array:
        """Settled state (n,) for a constant input (m,); the one nearest to zero if not unique."""
        n = self.A.shape[0]
        held = self.B @ np.asarray(v_um, dtype=np.float64)
        if not held.any():
            return self.rest()
        return np.asarray(np.linalg.lstsq(np.eye(n) - self.A, held, rcond=None)[0])

    def carry_on(self, v_um: Array, state: Array, first: int, stop: int, y_um: Array) -> None:
        """Write outputs into y_um (p, sample) for a range of samples; ``state`` (n,) is updated."""
        from hammerstein.dynamics.path_kernel import respond_linear

        for start, end in spans(stop - first, len(self.entries[2])):
            respond_linear(*self.entries, state, v_um, first + start, first + end, y_um)

    @cached_property
    def entries(self) -> tuple[Indices, Indices, Array]:
        """Non-zero entries of [[A, B], [C, D]] row by row, which makes uncoupled axes fast."""
        return entries_of(np.block([[self.A, self.B], [self.C, self.D]]))

    def response(self, frequency_hz: ArrayLike) -> Complex:
        """Frequency response (frequency, p, m) of the block on its grid."""
        z = np.exp(2j * np.pi * np.atleast_1d(np.asarray(frequency_hz)) * self.sample_time_s)
        return transfer(self.A, self.B, self.C, self.D, z)

    def observed_by(self, sensor: LinearBlock) -> LinearBlock:
        """Series with a sensor; the outputs are first this block's own, then the sensor's."""
        both = sensor.behind(self)
        c = np.vstack([np.pad(self.C, ((0, 0), (0, len(sensor.A)))), both.C])
        return LinearBlock(both.A, both.B, c, np.vstack([self.D, both.D]), self.sample_time_s)

    def delayed(self, samples: int) -> LinearBlock:
        """Delay the input by whole samples (a shift register in front)."""
        if samples == 0:
            return self
        m = self.n_inputs
        if m * samples > MOST_DELAY_STATES:
            raise InputError(
                "dynamics",
                f"an input delay of {interval(samples * self.sample_time_s)} is {samples} samples of "
                f"{interval(self.sample_time_s)}, but at most {MOST_DELAY_STATES // m} are possible: use a "
                "shorter input_delay_s or a longer sample time",
            )
        shift, last = np.eye(m * samples, k=-m), np.eye(m, m * samples, k=m * (samples - 1))
        register = LinearBlock(shift, np.eye(m * samples, m), last, np.zeros((m, m)), self.sample_time_s)
        return self.behind(register)

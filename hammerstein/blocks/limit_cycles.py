"""Linear systems of python-control, and limit cycles of one around a hysteresis."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Complex, transfer
from hammerstein.errors import InputError

Matrices = tuple[Array, Array, Array, Array, float | None]


def matrices_of(system: Any) -> Matrices:
    """A (n, n), B (n, m), C (p, n), D (p, m), and the sample time [s]; None for continuous time.

    Raises
    ------
    InputError : not a state space or transfer function, or one that no state space has
    """
    if isinstance(system, control.FrequencyResponseData):
        raise InputError(
            "linear system",
            "is a frequency response, which has no state; first fit a transfer function or a state "
            "space to it",
        )
    if not isinstance(system, control.StateSpace | control.TransferFunction):
        kind = type(system).__name__
        raise InputError(
            "linear system", f"is a {kind}; give a control.StateSpace or control.TransferFunction"
        )
    space = system if isinstance(system, control.StateSpace) else _realised(system)
    n, m, p = space.nstates, space.ninputs, space.noutputs
    shapes = ((n, n), (n, m), (p, n), (p, m))
    a, b, c, d = (
        np.asarray(np.reshape(matrix, shape), dtype=np.float64)
        for matrix, shape in zip((space.A, space.B, space.C, space.D), shapes, strict=True)
    )
    discrete = system.isdtime(strict=True)
    if discrete and system.dt is True:
        raise InputError("linear system", "is discrete without a sample time; set its dt in s")
    return a, b, c, d, float(system.dt) if discrete else None


def _realised(system: control.TransferFunction) -> control.StateSpace:
    """State space of a transfer function, element by element: no library beyond SciPy is needed."""
    from scipy.linalg import block_diag

    columns = []
    for i in range(system.ninputs):
        a, b, c, d = zip(*(_element(system, o, i) for o in range(system.noutputs)), strict=True)
        columns.append((block_diag(*a), np.vstack(b), block_diag(*c), np.vstack(d)))
    a, b, c, d = zip(*columns, strict=True)
    return control.ss(block_diag(*a), block_diag(*b), np.hstack(c), np.hstack(d), system.dt)


def _element(system: control.TransferFunction, output: int, input_: int) -> tuple[Array, ...]:
    from scipy.signal import tf2ss

    above, below = (np.trim_zeros(np.atleast_1d(x[output][input_]), "f") for x in (system.num, system.den))
    n = len(below) - 1
    if len(above) > n + 1:
        raise InputError(
            "linear system",
            "is improper: the order of a numerator exceeds that of its denominator; add poles",
        )
    if n == 0:
        gain = np.array([[above[0] / below[0] if len(above) else 0.0]])
        return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), gain
    matrices = tf2ss(above if len(above) else [0.0], below)
    shapes = ((n, n), (n, 1), (1, n), (1, 1))
    return tuple(np.reshape(x, shape) for x, shape in zip(matrices, shapes, strict=True))


AMPLITUDES, FREQUENCIES = 150, 800  # points of the grid on which cycles are looked for
HELD, SAME, TINY = 1e-8, 1e-6, 1e-12  # balance of a cycle, distance of two, slope that is none
STEP = 1e-5
"""Relative step of the numerical derivatives of the loop with respect to amplitude and frequency."""


class HysteresisNonlinearity(control.DescribingFunctionNonlinearity):  # type: ignore[misc]  # no types
    """Scalar hysteresis with its describing function, for python-control.

    Called with one voltage it moves on by one sample, from rest.

    Parameters
    ----------
    of_amplitude : describing function of an amplitude
    move : output of one sample; it keeps its own memory
    span_v : amplitudes between which the describing function rises from zero, or falls back to it [V]
    """

    def __init__(
        self,
        of_amplitude: Callable[[float], complex],
        move: Callable[[float], float],
        span_v: tuple[float, float],
    ):
        super().__init__()
        self._of_amplitude, self._move = of_amplitude, move
        self.span_v = span_v

    def __repr__(self) -> str:
        low, high = self.span_v
        return f"HysteresisNonlinearity(amplitudes {low:.4g} to {high:.4g} V)"

    def __call__(self, value: float) -> float:
        """Output [um] of the next sample for a voltage [V]."""
        return self._move(float(value))

    def _isstatic(self) -> bool:
        return False

    def describing_function(self, A: float) -> complex:
        """Describing function N(A) [um/V]; zero for an amplitude of zero."""
        if A < 0:
            raise ValueError("cannot evaluate describing function for A < 0")
        return self._of_amplitude(float(A)) if A > 0 else 0j


@dataclass(frozen=True)
class LimitCycle:
    """Limit cycle that the describing function predicts.

    amplitude_v : amplitude of the voltage before the range clips it [V]
    frequency_hz : its frequency [Hz]
    stable : whether nearby motions return to it
    angle_deg : angle between the curves -1/N(A) and H at their crossing in the complex plane; do not
        trust a prediction with a small angle
    """

    amplitude_v: float
    frequency_hz: float
    stable: bool
    angle_deg: float


def limit_cycles(
    nonlinearity: HysteresisNonlinearity,
    system: control.LTI,
    amplitudes_v: ArrayLike | None = None,
    frequency_hz: ArrayLike | None = None,
) -> tuple[LimitCycle, ...]:
    """Limit cycles of a negative feedback loop around a hysteresis, by rising amplitude.

        1 + N(A) H(jw) = 0,    u = -H v,    v = hysteresis(u cut at the range)

    The crossings come from ``control.describing_function_response``, refined until the equation holds to the
    last digits. A discrete system is evaluated on the unit circle and includes its sample-and-hold.

    A limit cycle is stable where a motion that grows loses, and one that shrinks gains: with a small change
    of amplitude dA the root s = jw of 1 + N(A) H(s) moves by ds = -(dN/dA H) / (N dH/ds) dA, and its real
    part must be negative; and no other root of positive frequency may lie in the right half-plane.

    Parameters
    ----------
    nonlinearity : as ``to_describing_function`` gives it
    system : H, everything between the output of the hysteresis [um] and the voltage [V] asked for, sign
        taken off: state space or transfer function, continuous or discrete
    amplitudes_v : rising amplitudes to search [V]; the span of the nonlinearity if not given
    frequency_hz : rising frequencies to search [Hz]; two decades about the corner frequencies of the
        system if not given

    Raises
    ------
    InputError : a system with more than one input or output, a frequency response, amplitudes that do not
        rise or at which nothing moves

    Source: Gelb and Vander Velde (1968), chapter 3; stability of a limit cycle: Loeb, Advances in Nonlinear
    Servomechanism Theory (1956), in the form of the moving root.
    """
    loop = _Loop(nonlinearity.describing_function, *_scalar(system))
    low, high = nonlinearity.span_v
    searched = np.geomspace(1.01 * low, high, AMPLITUDES) if amplitudes_v is None else amplitudes_v
    amplitudes = _rising(searched, "amplitudes_v")
    if nonlinearity.describing_function(amplitudes[0]) == 0.0:
        raise InputError(
            "amplitudes_v",
            f"begin at {amplitudes[0]:g} V, where nothing moves; use amplitudes above {low:g} V",
        )
    omega = 2.0 * np.pi * _rising(loop.corners_hz() if frequency_hz is None else frequency_hz, "frequency_hz")
    # The frequency response on a grid, for python-control reads discrete systems as continuous ones here.
    curve = control.frd(loop.response(np.asarray(1j * omega)).reshape(1, 1, -1), omega, smooth=True)
    found = control.describing_function_response(
        curve, nonlinearity, amplitudes, omega=omega, refine=False, warn_nyquist=False
    )
    cycles: list[LimitCycle] = []
    for amplitude, w in sorted(loop.refined(*crossing) for crossing in found.intersections):
        inside = amplitudes[0] <= amplitude <= amplitudes[-1] and omega[0] <= w <= omega[-1]
        if inside and abs(loop.balance(amplitude, 1j * w)) < HELD and not _known(cycles, amplitude, w):
            cycles.append(loop.cycle(amplitude, w))
    return tuple(cycles)


def _known(cycles: list[LimitCycle], amplitude_v: float, omega: float) -> bool:
    """Whether two neighbouring pieces of the curves have given the same crossing."""
    return any(
        math.isclose(c.amplitude_v, amplitude_v, rel_tol=SAME)
        and math.isclose(2.0 * np.pi * c.frequency_hz, omega, rel_tol=SAME)
        for c in cycles
    )


def _rising(values: ArrayLike, name: str) -> Array:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or len(array) < 2 or not (array[0] > 0.0 and (np.diff(array) > 0.0).all()):
        raise InputError(name, "must be two or more rising values above 0")
    return array


def _scalar(system: Any) -> Matrices:
    matrices = matrices_of(system)
    p, m = matrices[3].shape
    if (p, m) != (1, 1):
        raise InputError(
            "linear system",
            f"has {m} inputs and {p} outputs; a describing function needs one input and one output",
        )
    return matrices


@dataclass(frozen=True, eq=False)
class _Loop:
    """1 + N(A) H(s), with H by its matrices; on a sample grid z = exp(s T)."""

    gain: Callable[[float], complex]
    A: Array
    B: Array
    C: Array
    D: Array
    sample_time_s: float | None

    def response(self, s: Complex) -> Complex:
        """H(s) for an array of s."""
        z = s if self.sample_time_s is None else np.exp(s * self.sample_time_s)
        return transfer(self.A, self.B, self.C, self.D, z)[:, 0, 0]

    def balance(self, amplitude: float, s: complex) -> complex:
        """1 + N(A) H(s)."""
        return complex(1.0 + self.gain(amplitude) * self.response(np.array([s]))[0])

    def corners_hz(self) -> Array:
        """Frequencies from a decade or two below the lowest corner of H to as far above the highest one."""
        poles = np.linalg.eigvals(self.A).astype(complex)
        if self.sample_time_s is not None:
            poles = np.log(poles[np.abs(poles) > TINY]) / self.sample_time_s
        corners = np.abs(poles[np.abs(poles) > TINY]) / (2.0 * np.pi)
        if not len(corners):
            raise InputError(
                "frequency_hz", "give the frequencies to search: the system has no corner frequency"
            )
        high = 30.0 * float(corners.max())
        if self.sample_time_s is not None:
            high = min(high, 0.499 / self.sample_time_s)
        return np.geomspace(min(corners.min(), high) / 30.0, high, FREQUENCIES)

    def refined(self, amplitude: float, omega: float) -> tuple[float, float]:
        """Solve 1 + N H = 0 from a crossing of the polygons on."""
        from scipy.optimize import root

        def both(logarithms: Array) -> list[float]:
            a, w = np.exp(logarithms).tolist()
            value = self.balance(a, 1j * w)
            return [value.real, value.imag]

        solution = root(both, np.log([amplitude, omega]), tol=1e-12)
        a, w = np.exp(solution.x).tolist()
        return a, w

    def cycle(self, amplitude: float, omega: float) -> LimitCycle:
        """Stability, and how clearly the curves cross."""
        s, da, ds = 1j * omega, STEP * amplitude, STEP * omega
        by_amplitude = (self.gain(amplitude + da) - self.gain(amplitude - da)) / (2.0 * da)
        ends = self.response(np.array([s - 1j * ds, s, s + 1j * ds]))
        by_s = (ends[2] - ends[0]) / (2j * ds)
        gain, response = self.gain(amplitude), ends[1]
        moves = -by_amplitude * response / (gain * by_s)
        along_n, along_h = by_amplitude / gain**2, 1j * by_s
        angle = abs(math.degrees(np.angle(along_n / along_h)))
        stable = bool(moves.real < 0.0) and self._others_decay(gain, s)
        return LimitCycle(amplitude, omega / (2.0 * np.pi), stable, min(angle, 180.0 - angle))

    def _others_decay(self, gain: complex, s: complex) -> bool:
        """Whether every root of 1 + N H of positive frequency but the one on the axis decays."""
        closed = self.A - gain / (1.0 + gain * self.D[0, 0]) * (self.B @ self.C)
        roots = np.linalg.eigvals(closed)
        if self.sample_time_s is not None:
            roots = np.log(roots[np.abs(roots) > TINY]) / self.sample_time_s
        others = np.delete(roots, np.argmin(np.abs(roots - s)))
        return bool((others[others.imag > 0.0].real < 0.0).all())

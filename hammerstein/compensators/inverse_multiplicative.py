"""The paper's compensator without inversion of the model (Theorem 4.1)."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from hammerstein.arrays import Array, filled
from hammerstein.blocks import Law, Memory, require_square
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.base import Compensator
from hammerstein.compensators.kernels import (
    asked_for,
    feed_back,
    respond_inverse_multiplicative,
    step_inverse_multiplicative,
)
from hammerstein.dynamics import linear
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Hysteresis, PlayState, PrandtlIshlinskii, slopes_of
from hammerstein.hysteresis.invertibility import slope_matrices
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Gain, Passes, TimeConstant, of_equal_rows


@dataclass(frozen=True, eq=False)
class FeedbackState(Memory):
    """Memory of the law: the plays of its inner model and the delayed or filtered signal (m,) [V]."""

    plays: Memory
    memory_v: Array


@dataclass(frozen=True)
class Convergence:
    """Convergence of the iteration of the law over all slopes of its model.

    slope_min_um_per_v, slope_max_um_per_v : smallest and largest direct slope
    spectral_radius : largest of |1 - (1-a) eig(K J)|, a pass; below 1 the iteration converges
    overshoot : whether the real part of some eigenvalue of K J exceeds 1: what is passed on of a change of
        the reference, before any filter, moves the actuator too far, and it turns back (false reversals)
    pass_s : time of a pass through a filter [s]; None for the delay of one sample
    """

    slope_min_um_per_v: float
    slope_max_um_per_v: float
    spectral_radius: float
    overshoot: bool
    pass_s: float | None = None

    @property
    def converges(self) -> bool:
        """True if every reachable slope lets the iteration contract."""
        return self.spectral_radius < 1.0

    def statement(self) -> str:
        """State in one sentence whether it converges, with the numbers."""
        slopes = f"slopes {self.slope_min_um_per_v:.3g} to {self.slope_max_um_per_v:.3g} um/V"
        outcome = "converges" if self.converges else "does not converge"
        tail = ", with overshoot" if self.converges and self.overshoot else ""
        text = f"The inner iteration {outcome}{tail}: {slopes}, spectral radius {self.spectral_radius:.4g}"
        if self.pass_s is None or not 0.0 < self.spectral_radius < 1.0:
            return f"{text}."
        time_s = -self.pass_s / math.log(self.spectral_radius)
        return (
            f"{text} with the filter; an error decays with a time constant of {1e3 * time_s:.3g} "
            "ms, which must be short compared with the path."
        )


class InverseMultiplicativeLaw(Law[FeedbackState]):
    """U(t) = K Y_r(t) + F (U - K Gamma(U)), F a delay of one sample or a first-order filter.

    With K the identity [V/um] and the delay this is Theorem 4.1 as printed,
    ``U(t) = Y_r(t) + U(t-T) - Gamma(U(t-T))``; with the filter ``F = 1 / (1 + tau s)`` it is the remark
    in section 6. With f the output of the filter, ``U = K Y_r + f`` and

        tau df/dt = U - K Gamma(U) - f = K (Y_r - Gamma(U)),

    so that the filter integrates the error, in parallel to the direct path K Y_r, which it does not
    change. For an input held over the time h of a pass (T / iterations), and a = exp(-h / tau),

        f[k+1] = f[k] + (1-a) K (Y_r[k] - Gamma(K Y_r[k] + f[k])).

    The delay of one sample is a = 0. This is a fixed-point iteration, which converges while the spectral
    radius of ``I - (1-a) K J`` stays below 1 for every slope matrix J of the model. With constant J, the
    error is ``s (1 - K J) / (s + K J / tau)`` of the reference: the filter must be fast against the path.

    Parameters
    ----------
    model : square model whose static block is used
    range_v : range of the drive [V], see ``DriveRange.of``
    sample_time_s : time between samples [s]
    gain : "identity", "auto" (the inverse of the summed weights, made so small that no slope overshoots) or
        a matrix (m, m) [V/um]
    filter_s : time constant tau of the first-order filter [s]; None: the one-sample delay
    iterations : passes of the law in each sample
    run_anyway : accept an iteration that cannot converge

    Raises
    ------
    InputError : the model is not square, or the gain does not fit it
    SimulationError : the iteration cannot converge, with slopes, spectral radius and remedy
    """

    def __init__(
        self,
        model: HammersteinModel,
        range_v: RangeLike,
        sample_time_s: float,
        gain: Literal["identity", "auto"] | ArrayLike = "auto",
        filter_s: float | None = None,
        iterations: int = 1,
        run_anyway: bool = False,
    ):
        hysteresis = model.hysteresis.on_grid(sample_time_s)
        require_square(hysteresis.n_inputs, hysteresis.n_outputs, "inverse_multiplicative")
        self.n_inputs = self.n_outputs = hysteresis.n_inputs
        self.hysteresis, self.range, self.iterations = hysteresis, DriveRange.of(range_v, model), iterations
        self.sample_time_s = None if filter_s is None else sample_time_s
        pass_s = None if filter_s is None else sample_time_s / iterations
        self.pole = 0.0 if filter_s is None or pass_s is None else math.exp(-pass_s / filter_s)
        slopes = slope_matrices(hysteresis, model.amplitude_v)
        self.gain_v_per_um = _gain_matrix(gain, hysteresis, model.amplitude_v, slopes)
        self.convergence = replace(convergence(slopes, self.gain_v_per_um, self.pole), pass_s=pass_s)
        if not (self.convergence.converges or run_anyway):
            raise SimulationError(f"{self.convergence.statement()} {self._remedy()}")

        self._start, self.origin_um = self._at_start()
        self._limits = np.stack(self.range.counted)
        self._axes = (0.0,) * self.n_inputs

    def _step(self, sample_um: Array, state: FeedbackState) -> tuple[Array, FeedbackState] | None:
        plays = state.plays
        if not isinstance(self.hysteresis, PrandtlIshlinskii) or not isinstance(plays, PlayState):
            return None
        bank = self.hysteresis.bank
        drive, stack, memory, sound = step_inverse_multiplicative(
            sample_um,
            self._frame,
            *(self._axes, self.gain_v_per_um, self.pole, self.iterations, self._limits),
            *(bank.r, bank.slope, bank.moment),
            *(plays.count, plays.end, plays.x, plays.d, plays.below, state.memory_v),
        )
        return (drive, FeedbackState(PlayState(*(*stack, plays.window)), memory)) if sound else None

    def _at_start(self) -> tuple[FeedbackState, Array]:
        """State at the actuator's start, whose next pass gives the start voltage, and the position."""
        history = self.range.history()
        v, plays = self.hysteresis.standing(history)
        if history.shape[1] == 1:
            return FeedbackState(self.hysteresis.rest(), np.zeros(self.n_inputs)), v
        return FeedbackState(plays, history[:, -1] - self.gain_v_per_um @ v), v

    def statement(self) -> str:
        """State whether the iteration converges, with the numbers."""
        return self.convergence.statement()

    def _remedy(self) -> str:
        if self.convergence.slope_min_um_per_v <= 0:
            return (
                "The direct slope of the model is zero or negative. This happens if phase lag is "
                "identified as hysteresis. Identify at a lower frequency, or set run_anyway = true."
            )
        filtered = self.convergence.pass_s is not None
        slower = " (a slower filter converges too, but overshoots)" if filtered else ""
        return f'Set gain = "auto" or a smaller gain{slower}, or run_anyway = true.'

    def rest(self) -> FeedbackState:
        """Plays and feedback of an actuator at its start."""
        return self._start

    def _respond(self, reference_um: Array, start: FeedbackState) -> tuple[Array, FeedbackState]:
        wanted_um, hysteresis = self._from_rest(reference_um), self.hysteresis
        plays, memory = start.plays.copy(), start.memory_v.copy()  # which the loop writes to
        if not isinstance(hysteresis, PrandtlIshlinskii) or not isinstance(plays, PlayState):
            return self._stepwise(wanted_um, start)
        law = (self.gain_v_per_um, self.pole, self.iterations, *self.range.counted)
        stack, b = (plays.count, plays.end, plays.x, plays.d, plays.below), hysteresis.bank
        given = (wanted_um, self._axes, law, (b.r, b.slope, b.moment), stack, memory)
        shape = (self.n_inputs, wanted_um.shape[1])
        drive = filled(respond_inverse_multiplicative, *given, shape=shape, products=64 * self.iterations)
        return drive, FeedbackState(plays, memory)

    def _stepwise(self, wanted_um: Array, start: FeedbackState) -> tuple[Array, FeedbackState]:
        """Run the loop over the samples around a block of any kind."""
        plays, memory, drive = start.plays, start.memory_v.copy(), np.empty_like(wanted_um)
        for t in range(wanted_um.shape[1]):
            begun = plays  # only the last pass is sent; where the others leave a trace each begins there
            for _ in range(self.iterations):
                u = np.empty(self.n_inputs)
                asked_for(self.gain_v_per_um, wanted_um, t, memory, *self._limits, u)
                v, plays = self.hysteresis.step(u, plays if self.hysteresis.wipes_out else begun)
                feed_back(self.gain_v_per_um, self.pole, u, v, memory)
            drive[:, t] = u
        return drive, FeedbackState(plays, memory)


def convergence(slopes: Array, gain_v_per_um: Array, pole: float = 0.0) -> Convergence:
    """Examine ``I - (1-a) K J`` over every slope matrix J (number, output, input) of a square model."""
    direct = np.diagonal(slopes, axis1=1, axis2=2)
    eigenvalues = np.linalg.eigvals(gain_v_per_um @ slopes)
    overshoot = bool((eigenvalues.real > 1.0 + 1e-9).any())
    radius = float(np.abs(1.0 - (1.0 - pole) * eigenvalues).max())
    return Convergence(float(direct.min()), float(direct.max()), radius, overshoot)


def _gain_matrix(
    gain: str | ArrayLike, hysteresis: Hysteresis[Any], amplitude_v: float, slopes: Array
) -> Array:
    m = hysteresis.n_inputs
    if isinstance(gain, str):
        return np.eye(m) if gain == "identity" else _auto_gain(hysteresis, amplitude_v, slopes)
    matrix = np.asarray(gain, dtype=np.float64)
    if matrix.shape != (m, m) or not np.isfinite(matrix).all():
        raise InputError("gain", f"has shape {matrix.shape}; give a finite ({m}, {m}) matrix in V/um")
    return matrix


def _auto_gain(hysteresis: Hysteresis[Any], amplitude_v: float, slopes: Array) -> Array:
    """Largest multiple of the inverse of the summed weights that overshoots at no slope."""
    last = [slopes_of(hysteresis, k, amplitude_v)[-1] for k in range(hysteresis.n_inputs)]
    summed = np.stack(last, axis=1)
    if abs(np.linalg.det(summed)) < 1e-12 * np.abs(summed).max() ** len(summed):
        raise SimulationError("The summed weights form a singular matrix, so there is no automatic gain.")
    inverse = np.linalg.inv(summed)
    largest = np.linalg.eigvals(inverse @ slopes).real.max()
    return np.asarray(inverse / largest)


class InverseMultiplicative(Compensator):
    """The paper's law without inversion (Theorem 4.1)."""

    static: ClassVar[bool] = True
    law: Literal["inverse_multiplicative"] = "inverse_multiplicative"
    gain: Annotated[
        Literal["identity", "auto"] | tuple[tuple[Gain, ...], ...], AfterValidator(of_equal_rows)
    ] = Field(
        default="auto", description='"identity" (as printed), "auto" (from the slopes), or a matrix in V/um'
    )
    filter_s: TimeConstant | None = Field(
        default=None, description="time constant of a first-order filter instead of the one-sample delay"
    )
    iterations: Passes = Field(default=1, description="iterations in each sample")
    run_anyway: bool = Field(default=False, description="accept an iteration that cannot converge")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        linear(model.dynamics)
        return InverseMultiplicativeLaw(
            model, range_v, sample_time_s, self.gain, self.filter_s, self.iterations, self.run_anyway
        )

"""Base class of all kinds of hysteresis, what some of them can, and their forms in a model file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Protocol, Self, cast, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from hammerstein.arrays import Array, ByValue, Complex, frozen, rows_of
from hammerstein.blocks.law import S, require_grid
from hammerstein.errors import InputError, Mistake, SimulationError
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.plugins import Family
from hammerstein.quantities import NoCycles, Threshold, Weight, WeightError, number_of
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.blocks.block_system import BlockSystem
    from hammerstein.blocks.limit_cycles import HysteresisNonlinearity

SWEEP_SAMPLES = 200
"""Samples of one branch of a loop that determines the reach."""

SLOPES_KEPT = 8
"""Stride of the slopes along a loop."""

SLOW_S = 1e6
"""Sample time for quasi-static sweeps [s]."""


class Normals(Protocol):
    """Source of standard normal numbers."""

    def standard_normal(self, size: Any = None) -> Any:
        """One number, or an array."""


class Hysteresis(ByValue, ABC, Generic[S]):
    """Hysteresis from m voltages, relative to the working point, to p displacements; a frozen value.

    Each output is linear in the weights of its operators:

        v_l[k] = sum over i of  w_li  (operator i of the voltages until k)

    To add a kind, derive from this class, give it a file form (``HysteresisFile``) and register that.
    Abilities that only some kinds have are separate protocols, such as ``Sloped``.
    """

    kind: ClassVar[str]
    wipes_out: ClassVar[bool] = False
    """Whether a closed minor loop is wiped out, as with plays."""

    @cached_property
    def n_inputs(self) -> int:
        """Number m of inputs."""
        return len(self.operators[0])

    @cached_property
    def n_outputs(self) -> int:
        """Number p of outputs."""
        return len(self.operators)

    @property
    def ports(self) -> str:
        """Numbers of inputs and outputs in words."""
        return f"{number_of(self.n_inputs, 'input')}, {number_of(self.n_outputs, 'output')}"

    @property
    @abstractmethod
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of weights of every pair (output, input)."""

    @abstractmethod
    def describe(self) -> str:
        """Short description."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.describe()})"

    def on_grid(self, sample_time_s: float) -> Hysteresis[S]:
        """Return the block on a sample grid; a rate-independent one is the same on all."""
        return self

    def counted_from(self, working_point_v: ArrayLike) -> Hysteresis[S]:
        """Return the block for voltages relative to a working point (m,) [V].

        One that is the same about every voltage, as plays are, does not change.
        """
        return self

    @abstractmethod
    def rest(self) -> S:
        """Memory at rest."""

    def after(self, path_v: Array) -> S:
        """Memory of an actuator that was slowly driven along a path (m, turns) of voltages [V].

        It was never driven before the first of them. By default it then jumps from 0 V to the path.
        """
        return self.respond(path_v)[1]

    def standing(self, path_v: Array) -> tuple[Array, S]:
        """Outputs (p,) [um] and memory at the end of a path (m, turns) of slow voltages [V].

        At the first of them it is at rest.
        """
        v, state = self.respond(path_v)
        return v[:, -1].copy(), state

    def restore(self, data: dict[str, Any]) -> S:
        """Memory from the result of its ``as_dict``."""
        return self.rest().restored(data)

    @abstractmethod
    def _respond(self, u_v: Array, start: S) -> tuple[Array, S]:
        """Outputs (p, N) for checked voltages (m, N), and the memory after them; ``start`` is kept."""

    def respond(self, u_v: ArrayLike, start: S | None = None) -> tuple[Array, S]:
        """Outputs for a whole signal.

        For a signal too long for the memory, call it block by block, each from the state after the previous
        block; the numbers are the same to the last bit.

        Parameters
        ----------
        u_v : (input, sample) voltages, relative to the working point [V], finite
        start : memory before the first sample; at rest if not given

        Returns
        -------
        v_um : (output, sample) outputs [um]
        state : memory after the last sample

        Raises
        ------
        InputError : wrong number of inputs
        SimulationError : a voltage that is not finite
        """
        u = rows_of(u_v)
        if u.ndim != 2 or u.shape[0] != self.n_inputs:
            raise InputError("voltage", f"has shape {u.shape}; it must be ({self.n_inputs}, samples)")
        return self._respond(u, self.rest() if start is None else start)

    def carry_on(self, u_v: Array, start: S, first: int, stop: int, v_um: Array) -> S:
        """Write outputs into v_um (p, sample) for a range of samples, and return the memory after them.

        They are those of ``respond`` for the voltages (m, sample) between the two.
        """
        v_um[:, first:stop], after = self.respond(u_v[:, first:stop], start)
        return after

    def step(self, u_v: ArrayLike, state: S) -> tuple[Array, S]:
        """Outputs (output,) [um] for one sample (input,) [V], and the memory after it.

        Equal to ``respond`` to the last bit.
        """
        y, after = self.respond(np.reshape(np.asarray(u_v, dtype=np.float64), (-1, 1)), state)
        return y[:, 0], after

    def in_loop(self, memory: S) -> tuple[Any, ...] | None:
        """Parameters for ``loop_kernels``, with the arrays of a memory, which a compiled loop updates.

        None for a kind that has none: it is stepped in Python, where it stands in a loop.
        """
        return None

    def amplitude(self, amplitude_v: ArrayLike) -> Array:
        """Half heights of the settled loops (output, input) [um] for a voltage amplitude [V].

        They are negative where the output falls while the voltage rises.

        amplitude_v : of all inputs, or of each of them (m,)
        """
        sizes = np.broadcast_to(np.asarray(amplitude_v, dtype=np.float64), self.n_inputs)
        swings = [self._swept(k, -size, size)[:, -2 * SWEEP_SAMPLES :] for k, size in enumerate(sizes)]
        heights = np.stack([np.ptp(swing, axis=1) for swing in swings], axis=1)
        rises = np.stack([swing[:, SWEEP_SAMPLES - 1] - swing[:, -1] for swing in swings], axis=1)
        return 0.5 * np.copysign(heights, rises)

    def gain(self, amplitude_v: float) -> Array:
        """Gain matrix (output, input) [um/V] of the settled loops at a voltage amplitude [V]."""
        return self.amplitude(amplitude_v) / amplitude_v

    def extremes(self, low_v: Array, high_v: Array) -> tuple[Array, Array]:
        """Lowest and highest position (p,) [um] from rest between two voltages (m,) of each input [V]."""
        if not (np.isfinite(low_v).all() and np.isfinite(high_v).all()):
            return np.full(self.n_outputs, -np.inf), np.full(self.n_outputs, np.inf)
        paths = [self._swept(k, low, high) for k, (low, high) in enumerate(zip(low_v, high_v, strict=True))]
        return (
            np.sum([path.min(axis=1) for path in paths], axis=0),
            np.sum([path.max(axis=1) for path in paths], axis=0),
        )

    def swept_slopes(self, k: int, amplitude_v: float) -> Array:
        """Slopes (number, output) [um/V] along the settled loop of input k, sample by sample."""
        settled = self._swept(k, -amplitude_v, amplitude_v)[:, -2 * SWEEP_SAMPLES :]
        ways = np.repeat([1.0, -1.0], SWEEP_SAMPLES)[1:] * 2.0 * amplitude_v / SWEEP_SAMPLES
        return np.asarray((np.diff(settled, axis=1) / ways).T[::SLOPES_KEPT])

    def _swept(self, k: int, low_v: float, high_v: float) -> Array:
        """Outputs (p, N) while input k goes from rest to both ends of a range, and to both again."""
        ends = [0.0, high_v, low_v, high_v, low_v]
        u = np.zeros((self.n_inputs, 4 * SWEEP_SAMPLES + 1))
        u[k] = np.interp(np.arange(u.shape[1]) / SWEEP_SAMPLES, np.arange(len(ends)), ends)
        return self.respond(u)[0]

    @property
    @abstractmethod
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, pair after pair in the order of the inputs [um/V]."""

    @abstractmethod
    def with_weights(self, weights: Sequence[ArrayLike]) -> Self:
        """Return the same operators with other weights, without standard errors."""

    def _by_pair(self, numbers: Sequence[ArrayLike]) -> Iterator[list[NDArray[Any]]]:
        """Numbers of the weights of each output, taken apart for its pairs."""
        for own, counts in zip(numbers, self.operators, strict=True):
            yield np.split(np.asarray(own), np.cumsum(counts)[:-1])

    @property
    @abstractmethod
    def weight_covariance(self) -> tuple[WeightCovariance, ...] | None:
        """Covariance of the weights of each output, if known."""

    @property
    def weight_errors(self) -> tuple[Array, ...] | None:
        """Standard errors of the weights of each output [um/V], if they are known."""
        if self.weight_covariance is None:
            return None
        return tuple(np.linalg.norm(known.factor_um_per_v, axis=1) for known in self.weight_covariance)

    @property
    @abstractmethod
    def n_beside_weights(self) -> int:
        """Number of free parameters other than weights: thresholds, breakpoints, growth."""

    def drawn(self, generator: Normals) -> Self:
        """Draw a random block from the covariance of its weights.

        Raises InputError where it is not known.
        """
        if self.weight_covariance is None:
            raise InputError("hysteresis", "does not state the covariance of its weights")
        known = zip(self.weights, self.weight_covariance, strict=True)
        return self.with_weights(
            [own + c.factor_um_per_v @ generator.standard_normal(len(own)) for own, c in known]
        )

    def file(self) -> HysteresisFile:
        """Form in a model file; by default that of its fields by name."""
        return HYSTERESIS.kinds[self.kind].model_validate(self)

    def to_iosys(self, sample_time_s: float, name: str = "hysteresis") -> BlockSystem:
        """Block as a discrete ``control.NonlinearIOSystem``, ``drive_v[k]`` to ``hysteresis_um[o]``.

        Raises InputError for a sample time that is not above zero.
        """
        from hammerstein.blocks.block_system import BlockSystem

        require_grid(None, sample_time_s, "hysteresis")
        here = self.on_grid(sample_time_s)
        wires = {"drive_v": self.n_inputs}, {"hysteresis_um": self.n_outputs}
        return BlockSystem(here.rest(), here.step, here.restore, *wires, sample_time_s, name)


class OfPairs(Hysteresis[S]):
    """Hysteresis of pairs (output, input), each with its own settled loop."""

    if TYPE_CHECKING:  # a field of both kinds
        pairs: tuple[tuple[Any, ...], ...]

    def amplitude(self, amplitude_v: ArrayLike) -> Array:
        """Half heights of the settled loops (output, input) [um], in closed form."""
        sizes = np.broadcast_to(np.asarray(amplitude_v, dtype=np.float64), self.n_inputs).tolist()
        return np.array(
            [[pair.amplitude(size) for pair, size in zip(row, sizes, strict=True)] for row in self.pairs]
        )


@runtime_checkable
class Sloped(Protocol):
    """Ability of a piecewise linear kind: the slopes of an input.

    Every slope is one of these, or a mean of some of them with the same shares for all outputs.
    """

    def slope_columns(self, k: int) -> Array:
        """Slopes (number, output) [um/V] that input k can have while it moves."""
        ...


def slopes_of(hysteresis: Hysteresis[Any], k: int, amplitude_v: float) -> Array:
    """Slopes (number, output) [um/V] of input k: all of them, or those in a loop of an amplitude [V]."""
    if isinstance(hysteresis, Sloped):
        return hysteresis.slope_columns(k)
    return hysteresis.swept_slopes(k, amplitude_v)


HARMONIC_SAMPLES = 8192
"""Samples of a cycle from which a first harmonic is taken; its error falls with their square."""


def describing_function(pair: Pair, amplitude_v: ArrayLike, range_v: float = np.inf) -> Complex:
    """First-harmonic gain for a sine, clipped by the range of the drive and passed through the plays.

    For u = A sin(t), cut at +-L, the plays see the peak M = min(A, L). With

        f(x) = 2/pi (arcsin x + x sqrt(1 - x^2))

    the settled loop has, over the thresholds r_i below M,

        N(A) = sum of w_i { [f(M/A) + f((M - 2 r_i)/A)] / 2  -  4j r_i (M - r_i) / (pi A^2) }

    The plays see the cut sine, so the two describing functions do not multiply. On the rising half, the play
    stays at -(M - r) until u = 2 r - M, follows u - r until u = M, and stays at M - r. This half gives the
    real part; the area 4 r (M - r) of the loop gives the imaginary part.

    Parameters
    ----------
    pair : the operators
    amplitude_v : amplitudes A of the sine asked for [V], above zero
    range_v : range L of the drive, the same on both sides [V]; inf: none

    Returns
    -------
    N(A), in the shape of the amplitudes [um/V]; the phase is that of the output against the sine

    Raises
    ------
    InputError : an amplitude or range that is not above zero

    Source: without the range Gelb and Vander Velde, Multiple-Input Describing Functions and Nonlinear System
    Design (1968), table of describing functions (friction-controlled backlash of width 2 r); with the range
    this work, by the integral above.

    Examples
    --------
    A linear gain of 2 um/V behind a range of 1 V, at twice the range:

    >>> round(float(describing_function(Pair.linear(2.0), 2.0, range_v=1.0).real), 6)
    1.217996
    """
    asked = np.asarray(amplitude_v, dtype=np.float64)
    if not (asked > 0.0).all():
        raise InputError("amplitude_v", "must be above 0")
    if not range_v > 0.0:
        raise InputError("range_v", f"is {range_v:g}; it must be above 0")
    peak, r = np.minimum(asked, range_v)[..., None], pair.thresholds_v
    moving = r < peak
    real = 0.5 * (_share(peak / asked[..., None]) + _share((peak - 2.0 * r) / asked[..., None]))
    lost = 4.0 * r * (peak - r) / (np.pi * asked[..., None] ** 2)
    gains = np.where(moving, real - 1j * lost, 0.0)
    return np.asarray(gains @ pair.weights_um_per_v)


def _share(x: Array) -> Array:
    """f(x) = 2/pi (arcsin x + x sqrt(1 - x^2)), the describing function of a cut at x times the amplitude."""
    within = np.clip(x, -1.0, 1.0)
    return np.asarray(2.0 / np.pi * (np.arcsin(within) + within * np.sqrt(1.0 - within**2)))


class Describable(ABC):
    """Ability of a kind with wiping-out: first harmonic of one pair, for python-control."""

    @property
    @abstractmethod
    def reversals_v(self) -> Array:
        """Reversals after which operators of the first pair move, sorted [V]."""

    def first_harmonic(self, amplitude_v: float, range_v: float) -> complex:
        """Gain of the first harmonic [um/V] of the settled loop of one pair, from its samples.

        The second cycle of a sine about the working point, cut at the range, is settled.

        amplitude_v : amplitude of the sine asked for [V]
        range_v : range of the drive, the same on both sides [V]
        """
        angle = 2.0 * np.pi * np.arange(2 * HARMONIC_SAMPLES) / HARMONIC_SAMPLES
        u = np.clip(amplitude_v * np.sin(angle), -range_v, range_v)
        settled = cast("Hysteresis[Any]", self).respond(u[None])[0][0, HARMONIC_SAMPLES:]
        return complex(2j * np.mean(settled * np.exp(-1j * angle[HARMONIC_SAMPLES:])) / amplitude_v)

    def to_describing_function(self, range_v: float = np.inf) -> HysteresisNonlinearity:
        """Return a block of one pair, behind a drive, as ``control.DescribingFunctionNonlinearity``.

        Sines go about the working point.

        Parameters
        ----------
        range_v : range of the drive, the same on both sides of the working point [V]; inf: none

        Raises
        ------
        InputError : more than one input or output, or a range within which no operator moves
        """
        from hammerstein.blocks.limit_cycles import HysteresisNonlinearity

        hysteresis = cast("Hysteresis[Any]", self)
        if (hysteresis.n_outputs, hysteresis.n_inputs) != (1, 1):
            axes = hysteresis.ports
            raise InputError(
                "describing function", f"needs a single pair; the block has {axes}: give one pair of it"
            )
        state: Any = hysteresis.rest()
        smallest, largest = float(self.reversals_v[0]), float(self.reversals_v[-1])
        if not range_v > smallest:
            raise InputError("range_v", f"is {range_v:g}: nothing moves below {smallest:g} V")

        def move(u_v: float) -> float:
            nonlocal state
            v_um, state = hysteresis.step([min(max(u_v, -range_v), range_v)], state)
            return float(v_um[0])

        scale = max(largest, 1.0) if np.isinf(range_v) else range_v
        of_amplitude = partial(self.first_harmonic, range_v=range_v)
        return HysteresisNonlinearity(of_amplitude, move, (smallest or 1e-3 * scale, 100.0 * scale))


def refuse_not_finite(u_v: Array) -> None:
    """Raise SimulationError with the position of the first voltage (m, N) that is not finite, if any."""
    if not np.isfinite(u_v).all():
        axis, sample = (int(i[0]) for i in np.nonzero(~np.isfinite(u_v)))
        raise SimulationError(f"voltage of input {axis + 1} is not finite at sample {sample}")


def working_point(given: ArrayLike | None, m: int, kind: str) -> Array:
    """Working point (m,) of a block [V]; 0 by default.

    Raises InputError for others than m finite ones.
    """
    point = frozen(np.zeros(m) if given is None else given)
    if point.shape != (m,) or not np.isfinite(point).all():
        raise InputError(f"{kind} model", [Mistake("working_point_v", f"must be {m} finite voltages")])
    return point


class PartFile(Strict):
    """Part of a hysteresis in a model file; also created from the part itself, with equal field names."""

    model_config = ConfigDict(from_attributes=True)

    describes: ClassVar[Callable[..., Any] | None] = None
    """Constructor of the part from its fields by name."""

    def value(self) -> Any:
        """Return the described part; InputError if it is invalid."""
        return cast("Any", self.describes)(**{name: described(own) for name, own in self if name != "kind"})

    @model_validator(mode="after")
    def _is_a_part(self) -> Self:
        refuse_unbuilt(self.value)
        return self


def refuse_unbuilt(build: Callable[[], object]) -> None:
    """Turn a failed construction into a ValueError for pydantic, at its place in the file."""
    try:
        build()
    except InputError as error:
        raise ValueError("; ".join(f"{m.where} {m.what}".strip() for m in error.mistakes)) from None


class HysteresisFile(PartFile, ABC):
    """Form of one kind of hysteresis in a model file, selected by ``kind``."""

    describes: ClassVar[type[Hysteresis[Any]] | None] = None
    """Class of the hysteresis in this file; needed if it is ``Identifiable``."""

    if TYPE_CHECKING:  # a field of every kind
        kind: str

    def hysteresis(self) -> Hysteresis[Any]:
        """Return the described hysteresis, from its fields by name; InputError if it is invalid.

        A kind whose class does not take what its file holds says otherwise.
        """
        return cast("Hysteresis[Any]", super().value())

    def value(self) -> Hysteresis[Any]:
        """Return the hysteresis."""
        return self.hysteresis()


HYSTERESIS: Family[HysteresisFile] = Family(HysteresisFile, "kind")


class PairFile(PartFile):
    """One pair in a model file."""

    describes: ClassVar = Pair
    thresholds_v: tuple[Threshold, ...]
    weights_um_per_v: tuple[Weight, ...]
    weight_errors_um_per_v: tuple[WeightError, ...] | None = None


def lower_rows(factor: Any) -> Any:
    """Rows of a lower triangle, each to its diagonal."""
    return [row[: i + 1] for i, row in enumerate(factor)] if isinstance(factor, np.ndarray) else factor


class CovarianceFile(PartFile):
    """Covariance L L^T of all weights of one output, pair after pair in the order of the inputs."""

    factor_um_per_v: Annotated[tuple[tuple[Weight, ...], ...], BeforeValidator(lower_rows)] = Field(
        description="rows of L, each up to its diagonal"
    )
    slopes_at_bound: NoCycles = Field(
        default=0, description="slopes at a bound of the fit: the covariance is that of the other slopes"
    )

    def value(self) -> WeightCovariance:
        """Return the covariance this describes."""
        return WeightCovariance(
            lower_triangle("weight_covariance", self.factor_um_per_v), self.slopes_at_bound
        )


def described(files: Any) -> Any:
    """Values of part files, in the same rows; other values unchanged."""
    if isinstance(files, tuple):
        return tuple(map(described, files))
    return files.value() if isinstance(files, PartFile) else files


def lower_triangle(where: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Lower triangle with zeros above, from the result of ``lower_rows``."""
    n = len(rows)
    if [len(row) for row in rows] != list(range(1, n + 1)):
        raise InputError(where, "row i of a factor must hold i numbers, up to its diagonal")
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = [value for row in rows for value in row]
    return square

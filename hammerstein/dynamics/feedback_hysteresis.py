"""Dynamics with hysteresis in their loop, as a model file names them: of matrices, or of a data sheet."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from hammerstein.arrays import Array
from hammerstein.dynamics.feedback_block import FeedbackBlock, InputProducts, ProductsFile
from hammerstein.dynamics.linear_block import CONTINUOUS
from hammerstein.errors import InputError
from hammerstein.hysteresis import HYSTERESIS, Hysteresis, HysteresisFile, Pair, PrandtlIshlinskii
from hammerstein.quantities import Delay, Entry, Range, SampleTime, number_of, sampling
from hammerstein.validation import Strict

Matrix = tuple[tuple[Entry, ...], ...]
FAR_V = 1e6
"""Amplitude at which all of the hysteresis moves [V]."""


class MatrixForm(Strict):
    """A block by its matrices, in continuous time or on a sample grid, as a model file has it."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    sample_time_s: SampleTime | None = Field(default=None, description="absent: continuous time")
    input_delay_s: Delay = 0.0
    allow_unstable: Literal[True] | None = Field(
        default=None, description="true: accept a block whose outputs grow without bound"
    )

    def _shapes(self) -> dict[str, tuple[int, int]]:
        """Rows and columns that each matrix must have."""
        n, m, p = len(self.A), self.n_inputs, self.n_outputs
        return {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        if not self.D or not self.D[0]:
            raise ValueError("D must have at least one row and one column")
        for name, (rows, columns) in self._shapes().items():
            matrix = getattr(self, name)
            if len(matrix) != rows or any(len(row) != columns for row in matrix):
                raise ValueError(f"{name} must be {rows} x {columns}")
        return self

    def matrices(self) -> dict[str, Array]:
        """Return each matrix by its name."""
        return {name: np.reshape(getattr(self, name), shape) for name, shape in self._shapes().items()}

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.D)

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.D[0])


class FeedbackHysteresisDynamics(MatrixForm):
    """A linear block with hysteresis of any kind inside its loop, continuous or on a fixed sample time.

        x' = A x + B u + E w,    z = F x + G u,    w = Gamma(z) + products,    y = C x + D u

    x' is x of the next sample where a sample time is given. With H, Gamma moves twice in a sample, and E, F
    and G are those of both moves, see ``FeedbackBlock``. Stiffness and damping follow the amplitude, as in a
    voltage-driven piezo, whose hysteresis is between voltage and charge (Goldfarb and Celanovic, IEEE
    Control Systems 17(3), 1997).
    """

    kind: Literal["feedback_hysteresis"] = "feedback_hysteresis"
    E: Matrix
    F: Matrix
    G: Matrix
    H: Matrix | None = Field(default=None, description="what the second z of a sample takes of the first w")
    hysteresis: Annotated[HysteresisFile, HYSTERESIS.field(), Field(description="inside the loop")]
    products: ProductsFile | None = Field(default=None, description="of the products of hysteresis inputs")

    def _shapes(self) -> dict[str, tuple[int, int]]:
        gamma, n = self.hysteresis.hysteresis(), len(self.A)
        h, q, moves = gamma.n_inputs, gamma.n_outputs, 2 if self.H else 1
        more = {"H": (h, q)} if self.H else {}
        both = {"E": (n, moves * q), "F": (moves * h, n), "G": (moves * h, self.n_inputs)}
        return super()._shapes() | both | more

    @model_validator(mode="after")
    def _products_fit(self) -> Self:
        gamma = self.hysteresis.hysteresis()
        h, q = gamma.n_inputs, gamma.n_outputs
        if self.H and self.sample_time_s is None:
            raise ValueError("H belongs to the two moves in a sample: give the sample_time_s")
        if self.H and gamma.on_grid(1.0) != gamma.on_grid(2.0):
            raise ValueError("H moves the hysteresis twice in a sample, which would double its rate: omit H")
        if self.products and any(len(term.weights) != q for term in self.products.terms):
            raise ValueError(f"every product must have {q} weights, one for each output of the hysteresis")
        if self.products and len(self.products.limits) != h:
            raise ValueError(f"products must have {h} limits, one for each input of the hysteresis")
        return self

    @classmethod
    def of(
        cls,
        hysteresis: Hysteresis[Any],
        *,
        sample_time_s: float | None = None,
        products: InputProducts | None = None,
        **matrices: ArrayLike,
    ) -> FeedbackHysteresisDynamics:
        """Keep matrices A to H and a hysteresis.

        Raises InputError where their shapes do not fit, or the hysteresis counts from a working point.
        """
        inside, home = hysteresis.file(), hysteresis.counted_from(np.zeros(hysteresis.n_inputs))
        if home != hysteresis and inside.hysteresis() == home:
            what = "counts from a working point; inputs of a loop count from rest: use its counted_from(0)"
            raise InputError("hysteresis in the loop", what)
        rows = {name: np.asarray(m).tolist() for name, m in matrices.items() if name != "H" or np.size(m)}
        curved = ProductsFile.of(products) if products else None
        return cls(**rows, hysteresis=inside, sample_time_s=sample_time_s, products=curved)

    def describe(self) -> str:
        """Short description."""
        inside = f"with {self.hysteresis.kind} in its loop"
        return f"state space of order {len(self.A)} {inside}, {sampling(self.sample_time_s)}"

    def block(self) -> FeedbackBlock:
        """Return its matrices, in continuous time or on its own sample time."""
        gamma, time_s = self.hysteresis.hysteresis(), self.sample_time_s or CONTINUOUS
        here = gamma if time_s == CONTINUOUS else gamma.on_grid(time_s)
        none = InputProducts.none(gamma.n_inputs, gamma.n_outputs)
        curved = self.products.products() if self.products else none
        return FeedbackBlock(**self.matrices(), hysteresis=here, sample_time_s=time_s, products=curved)

    def instability(self) -> str:
        """Say that a pole of the loop at large amplitudes is not stable; empty if all are."""
        block = self.block()
        if self.allow_unstable or not self.A:
            return ""
        poles = np.linalg.eigvals(block.with_gain(block.hysteresis.gain(FAR_V)).A)
        worst = float(poles.real.max() if self.sample_time_s is None else np.abs(poles).max() - 1.0)
        if worst < 0.0:
            return ""
        return (
            "is not stable at large amplitudes, where the whole hysteresis moves: a pole is "
            f"{worst:.3g} beyond the stability limit. Identify it again, or set allow_unstable = true "
            "to accept it"
        )


HYSTERESIS.used_by(FeedbackHysteresisDynamics)


Positive = Annotated[float, Range(1e-12, 1e12)]
NotNegative = Annotated[float, Range(0.0, 1e12)]


class ElastoSlip(Strict):
    """One stop operator of the charge: V = k (q - p(q)), p the play with this threshold."""

    stiffness_v_per_uc: Positive = Field(description="k: voltage for each uC before it slips")
    threshold_uc: Positive = Field(description="charge at which it slips")


class StackMode(Strict):
    """One mode of the structure that a stack moves: M x_i'' + D x_i' + K x_i = T V_z + f."""

    mass_kg: Positive
    stiffness_n_per_um: Positive
    damping_ns_per_m: NotNegative = 0.0
    output_ratio: Entry = Field(default=1.0, description="motion of the output over that of the stack")

    @property
    def angular(self) -> float:
        """Angular resonance of the shorted stack without hysteresis [rad/s]."""
        return float(np.sqrt(1e6 * self.stiffness_n_per_um / self.mass_kg))

    def matrices(self) -> tuple[Array, Array, Array]:
        """A of (x_i, x_i' / angular), B of a force [N], C of the output."""
        w = self.angular
        a = np.array([[0.0, w], [-w, -self.damping_ns_per_m / self.mass_kg]])
        return a, np.array([[0.0], [w / self.stiffness_n_per_um]]), np.array([[self.output_ratio, 0.0]])


class StackAxis(StackMode):
    """One stack that moves one axis, in one mode or several.

        u = V_h(q) + V_z,    q = C V_z + T (x_1 + ... + x_n),    M x_i'' + D x_i' + K x_i = T V_z + f

    V_h is the sum of the stops. The first mode has its numbers here, the others are ``further_modes``; each
    is scaled so that the end of the stack moves by x_i. Symbols of a data sheet: M effective mass,
    K stiffness with what it drives, D damping, C small-signal capacitance of the clamped stack, T blocking
    force for each volt.
    """

    capacitance_uf: Positive
    force_n_per_v: Positive = Field(description="T; the same number in uC/um")
    stops: tuple[ElastoSlip, ...] = ()
    further_modes: tuple[StackMode, ...] = ()

    @model_validator(mode="after")
    def _stops_differ(self) -> Self:
        if len({stop.threshold_uc for stop in self.stops}) < len(self.stops):
            raise ValueError("two stops have the same threshold; add their stiffnesses")
        return self

    @property
    def modes(self) -> tuple[StackMode, ...]:
        """Every mode, its own first."""
        return (self, *self.further_modes)

    def describe(self) -> str:
        """Short description."""
        resonances = " and ".join(f"{mode.angular / (2.0 * np.pi):.4g}" for mode in self.modes)
        return f"{resonances} Hz with {number_of(len(self.stops), 'stop')}"

    def charge(self) -> Pair:
        """Plays of s = C u + T x whose sum is the charge q.

        With u and x given, q + C V_h(q) = s. The left side is a Prandtl-Ishlinskii operator with slopes that
        fall to 1. Its inverse is therefore also one, and there is no algebraic loop (Krejci and Kuhnen, IEE
        Proc. Control Theory Appl. 148(3), 2001).
        """
        stops = sorted(self.stops, key=lambda stop: stop.threshold_uc)
        r = np.array([0.0, *(stop.threshold_uc for stop in stops)])
        soft = self.capacitance_uf * np.array([stop.stiffness_v_per_uc for stop in stops])
        slopes = 1.0 + soft.sum() - np.concatenate([[0.0], np.cumsum(soft)])
        reached = np.concatenate([[0.0], np.cumsum(slopes[:-1] * np.diff(r))])
        return Pair(reached, np.diff(1.0 / slopes, prepend=0.0))


class ElectromechanicalDynamics(Strict):
    """Stacks driven by voltage, hysteresis between voltage and charge; one axis each, not coupled.

    Source: M. Goldfarb and N. Celanovic, "Modeling piezoelectric stack actuators for control of
    micromanipulation", IEEE Control Systems 17(3), 1997, equations 1 to 6.
    """

    kind: Literal["electromechanical"] = "electromechanical"
    axes: tuple[StackAxis, ...] = Field(min_length=1)
    input_delay_s: Delay = 0.0

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.axes)

    def describe(self) -> str:
        """Short description."""
        return f"electromechanical stacks: {', '.join(axis.describe() for axis in self.axes)}"

    def block(self, *, forces: bool = False) -> FeedbackBlock:
        """Return its matrices, in continuous time.

        forces : the force f on each axis [N] is a further input, after the voltages
        """
        from scipy.linalg import block_diag

        n, modes = len(self.axes), [mode for axis in self.axes for mode in axis.modes]
        of_axis = np.repeat(np.eye(n), [len(axis.modes) for axis in self.axes], axis=1)
        alone, pushed, seen = (block_diag(*each) for each in zip(*(m.matrices() for m in modes), strict=True))
        t, c = np.array([[axis.force_n_per_v, axis.capacitance_uf] for axis in self.axes]).T
        force, stack = pushed @ of_axis.T, np.kron(of_axis, [[1.0, 0.0]]) * t[:, None]
        charged = force * (t / c)  # T q / C is the part of T V_z that the charge makes
        none, charges = Pair(np.zeros(1), np.zeros(1)), [axis.charge() for axis in self.axes]
        pairs = tuple(tuple(charges[i] if i == k else none for k in range(n)) for i in range(n))
        gamma = PrandtlIshlinskii(pairs)
        b, g = np.zeros((len(alone), n)), np.diag(c)
        if forces:
            b, g = np.hstack([b, force]), np.hstack([g, np.zeros((n, n))])
        y, d = of_axis @ seen, np.zeros((n, len(g.T)))
        return FeedbackBlock(alone - charged @ stack, b, y, d, charged, stack, g, gamma, CONTINUOUS)

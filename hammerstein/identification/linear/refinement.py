"""Nonlinear least-squares refinement of a state-space model on weighted lines.

What a linear model is fitted to: responses at points of the unit circle, scaled, warped and weighted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.ndimage import uniform_filter1d

from hammerstein.arrays import Array, Complex
from hammerstein.errors import IdentificationError
from hammerstein.identification.linear.frequency_response import FrequencyResponse
from hammerstein.identification.search import Damping, steps

Weighting = Literal["power", "variance"]

CHUNK = 4096
"""Lines handled at a time, which bounds the memory for long records."""

SPREAD = 0.9
"""Part of the half circle over which the warping spreads a band that is narrow against the sample rate."""

NEIGHBOURS = 5
"""Lines on either side over which a variance from few experiments is averaged before it becomes a weight."""


class Matrices(NamedTuple):
    """A (n, n), B (n, m), C (p, n), D (p, m) of x+ = A x + B u, y = C x + D u."""

    A: Array
    B: Array
    C: Array
    D: Array


@dataclass(frozen=True, eq=False)
class WeightedLines:
    """Data of the least-squares problem.

        minimise over A, B, C, D:   sum over k of | left_k (C (z_k - A)^-1 B + D - target_k) right_k |^2

    z : (F,) points on the unit circle, after the warping
    target : (F, p, m) measured response, inputs and outputs scaled to unit size
    left : (F, p) weight of each output
    right : (F, m, m) factor of the input power: with it the sum is that of output errors in the experiment
    floor : contribution of noise and distortion to the sum, for any model
    total : the sum for the model G = 0, floor included
    input_scale, output_scale : (m,), (p,) units of ``target``
    warp : factor a of the warping
    """

    z: Complex
    target: Complex
    left: Array
    right: Complex
    floor: float
    total: float
    input_scale: Array
    output_scale: Array
    warp: float

    def chunks(self) -> Iterator[slice]:
        """Slices that cover all lines."""
        return (slice(i, i + CHUNK) for i in range(0, len(self.z), CHUNK))

    def cost(self, model: Matrices) -> float:
        """Sum of squared errors of a model."""
        return _Blocks(model, (slice(None),)).cost(self)

    def percent(self, cost: float) -> float:
        """Error left by a fit of this cost, noise and distortion included, in % of the output [%]."""
        return 100.0 * math.sqrt((cost + self.floor) / self.total)

    def physical(self, model: Matrices) -> Matrices:
        """Undo warping and scaling of a model fitted to these lines.

        With z' = (z - a) / (1 - a z) and M = 1 + a A', C' (z' - A')^-1 B' + D' equals
        C (z - A)^-1 B + D for A = M^-1 (A' + a), B = M^-1 B', C = C' (1 - a A), D = D' - a C' M^-1 B'.
        """
        a, eye = self.warp, np.eye(len(model.A))
        mixed = eye + a * model.A
        A = np.asarray(np.linalg.solve(mixed, model.A + a * eye), dtype=np.float64)
        B = np.linalg.solve(mixed, model.B) / self.input_scale
        C = self.output_scale[:, None] * (model.C @ (eye - a * A))
        D = self.output_scale[:, None] * (model.D / self.input_scale - a * model.C @ B)
        return Matrices(A, B, C, D)


def weigh(response: FrequencyResponse, weighting: Weighting) -> WeightedLines:
    """Scale, warp and weigh a measured response.

    The warping z' = (z - a) / (1 - a z) maps the unit circle and the stable poles onto themselves and spreads
    a band far below the Nyquist frequency over the circle. Powers of z' then differ from each other
    where those of z are nearly equal, which keeps the subspace method well conditioned.

    Raises
    ------
    IdentificationError : an output without any response; weights asked from a variance that is not known
    """
    power = np.ascontiguousarray(response.input_power.transpose(2, 0, 1))
    output = response.output_power.T
    dead = np.flatnonzero(output.max(axis=0) == 0.0)
    if dead.size:
        raise IdentificationError(f"output {dead[0] + 1} does not respond at any line: remove it")
    input_scale = np.sqrt(np.diagonal(power, axis1=1, axis2=2).real.mean(axis=0))
    output_scale = np.sqrt(output.mean(axis=0))
    left = _weights(response, weighting) * output_scale
    scaled = left / output_scale  # weight of an output in its own unit
    right = np.linalg.cholesky(power) / input_scale[:, None]
    z: Complex = np.exp(2j * np.pi * response.frequency_hz * response.sample_time_s)
    warp = _warp(float(np.angle(z).max()))
    return WeightedLines(
        z=(z - warp) / (1.0 - warp * z),
        target=response.response.transpose(2, 0, 1) * input_scale / output_scale[:, None],
        left=left,
        right=right,
        floor=float(np.sum(scaled**2 * response.residual_power.T)),
        total=float(np.sum(scaled**2 * output)),
        input_scale=input_scale,
        output_scale=output_scale,
        warp=warp,
    )


def _weights(response: FrequencyResponse, weighting: Weighting) -> Array:
    """Weight (F, p) of each output at each line [1 / output]."""
    if weighting == "power":
        return np.broadcast_to(1.0 / np.sqrt(response.output_power.mean(axis=1)), response.coherence.T.shape)
    residue = response.residual_power.T
    if response.variance is None or not residue.any(axis=0).all():
        raise IdentificationError(
            "the variance of the response is unknown, so it cannot weight the fit: use more "
            "experiments than inputs or several periods, or choose the weighting 'power'"
        )
    return np.asarray(1.0 / np.sqrt(uniform_filter1d(residue, 2 * NEIGHBOURS + 1, axis=0, mode="nearest")))


def _warp(angle: float) -> float:
    """Factor a of the warping that moves the highest line to ``SPREAD`` of the half circle."""
    warp = math.tan(0.5 * math.pi * SPREAD) / math.tan(0.5 * angle)
    return max(0.0, (warp - 1.0) / (warp + 1.0))


CONDITION = 1e6
"""Condition of the eigenvectors above which A is not taken apart: nearly equal poles share their states."""

ROUNDING = 1e-30
"""Part of the total sum of squares that is only rounding."""

DAMPING = Damping(less=0.2, more=4.0, least=1e-10, most=1e10)


@dataclass(frozen=True)
class _Blocks:
    """A model whose A is block diagonal: ``parts`` are the slices of its blocks."""

    model: Matrices
    parts: tuple[slice, ...]

    def pattern(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of A that are free."""
        free = np.zeros(self.model.A.shape, dtype=bool)
        for part in self.parts:
            free[part, part] = True
        rows, columns = np.nonzero(free)
        return rows, columns

    def resolvents(self, z: Complex) -> Iterator[tuple[slice, Complex]]:
        """(z - A)^-1 (F, s, s), block by block."""
        for part in self.parts:
            block = self.model.A[part, part]
            shifted = z[:, None, None] * np.eye(len(block)) - block
            yield part, np.asarray(np.linalg.inv(shifted), dtype=np.complex128)

    def cost(self, lines: WeightedLines) -> float:
        """Sum of squares that the model leaves of the target."""
        total = 0.0
        for k in lines.chunks():
            error = self.model.D - lines.target[k]
            for part, resolvent in self.resolvents(lines.z[k]):
                error += self.model.C[:, part] @ (resolvent @ self.model.B[part])
            error = lines.left[k, :, None] * (error @ lines.right[k])
            total += float(np.sum(error.real**2 + error.imag**2))
        return total

    def moved(self, step: Array) -> _Blocks:
        """Model after a step of the parameters: A, B, then C and D output by output."""
        (n, m), p = self.model.B.shape, len(self.model.C)
        free = self.pattern()
        count = len(free[0])
        A = self.model.A.copy()
        A[free] += step[:count]
        outputs = step[count + n * m :].reshape(p, n + m)
        B = self.model.B + step[count : count + n * m].reshape(n, m)
        return _Blocks(
            Matrices(A, B, self.model.C + outputs[:, :n], self.model.D + outputs[:, n:]), self.parts
        )


def refine(
    lines: WeightedLines,
    start: Matrices,
    max_iterations: int,
    tolerance: float,
    progress: Callable[[int, float], None],
) -> Matrices:
    """Improve a stable model by Levenberg-Marquardt steps with the analytic Jacobian, and keep it stable.

    A is kept block diagonal (one block for each pair of poles, complex or real), which leaves n (m + p + 2) +
    m p parameters instead of n (n + m + p) + m p. The remaining freedom in the state coordinates costs
    nothing: the damping selects the smallest step.

    Parameters
    ----------
    lines : weighted frequency response to fit
    start : stable model
    max_iterations : steps at most
    tolerance : stop when a step lowers the cost by less than this part of it
    progress : called with the number and the cost of every accepted step

    Returns
    -------
    Matrices, stable, in block diagonal form where that is well conditioned
    """
    here, gains = _Place.of(split(start), lines), 0
    if max_iterations < 1 or here.cost <= ROUNDING * lines.total:
        return here.blocks.model
    for tried in steps(here, _Place.step, lambda place: place.cost, DAMPING):
        if not tried.gained:
            continue
        here, gains = tried.there, gains + 1
        progress(gains, here.cost)
        arrived = tried.before.cost - here.cost <= tolerance * here.cost
        if arrived or gains == max_iterations or here.cost <= ROUNDING * lines.total:
            break
    return here.blocks.model


@dataclass(frozen=True, eq=False)
class _Place:
    """One point of the search: the model, its error, and the problem linearised about it."""

    blocks: _Blocks
    lines: WeightedLines
    cost: float

    @classmethod
    def of(cls, blocks: _Blocks, lines: WeightedLines) -> _Place:
        """The place of a model; nobody may stand where it is not stable."""
        A = blocks.model.A
        is_stable = not len(A) or bool(np.abs(linalg.eigvals(A)).max() < 1.0)
        return cls(blocks, lines, blocks.cost(lines) if is_stable else math.inf)

    @cached_property
    def normal_equations(self) -> tuple[Array, Array]:
        """J^T J and J^T e over all lines.

        With X = (z - A)^-1 B R and Z = C (z - A)^-1 the error of output a changes by

            dA_ij: Z_ai X_j,    dB_ij: Z_ai R_j,    dC_aj: X_j,    dD_aj: R_j

        so C and D of one output meet no other output.
        """
        from hammerstein.identification.linear.kernel import add_normal_equations

        lines, blocks = self.lines, self.blocks
        (n, m), p = blocks.model.B.shape, len(blocks.model.C)
        rows, columns = blocks.pattern()
        rows = np.concatenate([rows, np.repeat(np.arange(n), m)])
        columns = np.concatenate([columns, np.tile(np.arange(n, n + m), n)])
        size = len(rows) + p * (n + m)
        hessian, gradient = np.zeros((size, size)), np.zeros(size)
        for k in lines.chunks():
            observed, inputs = _sides(blocks, lines.z[k], lines.right[k])
            error = np.hstack([blocks.model.C, blocks.model.D]) @ inputs - lines.target[k] @ lines.right[k]
            add_normal_equations(observed, inputs, error, lines.left[k], rows, columns, hessian, gradient)
        return hessian + np.triu(hessian, 1).T, gradient

    def step(self, damping: float) -> _Place:
        """Where a damped step leads to; by Cholesky, for a block may have hundreds of entries."""
        hessian, gradient = self.normal_equations
        scale = np.diagonal(hessian)
        scale = np.maximum(scale, 1e-12 * scale.max())
        try:
            factor = linalg.cho_factor(hessian + damping * np.diag(scale))
        except linalg.LinAlgError:
            return replace(self, cost=math.inf)
        return _Place.of(self.blocks.moved(-linalg.cho_solve(factor, gradient)), self.lines)


def split(model: Matrices) -> _Blocks:
    """Change the state coordinates so that A has one block per pair of poles, if possible."""
    n = len(model.A)
    poles, vectors = linalg.eig(model.A)
    upper = np.flatnonzero(poles.imag > 0.0)
    real = np.flatnonzero(poles.imag == 0.0)
    real = real[np.argsort(poles.real[real])]  # neighbours share a block, so that they may turn complex
    columns = [c for i in upper for c in (vectors[:, i].real, vectors[:, i].imag)]
    columns += [vectors[:, i].real for i in real]
    basis = np.reshape(columns, (n, n)).T
    if n == 0 or np.linalg.cond(basis) > CONDITION:
        return _Blocks(model, (slice(0, n),))
    parts = tuple(slice(i, min(i + 2, n)) for i in range(0, n, 2))
    A = np.zeros((n, n))
    B = np.asarray(np.linalg.solve(basis, model.B), dtype=np.float64)
    C = model.C @ basis
    full = np.linalg.solve(basis, model.A @ basis)
    for part in parts:
        A[part, part] = full[part, part]
        seen, driven = float(np.linalg.norm(C[:, part])), float(np.linalg.norm(B[part]))
        balance = math.sqrt(max(seen, 1e-150) / max(driven, 1e-150))
        B[part] *= balance
        C[:, part] /= balance
    return _Blocks(Matrices(A, B, C, model.D), parts)


def _sides(blocks: _Blocks, z: Complex, right: Complex) -> tuple[Complex, Complex]:
    """Z (F, p, n), and X above R (F, n + m, m)."""
    (n, m), p = blocks.model.B.shape, len(blocks.model.C)
    observed = np.empty((len(z), p, n), dtype=np.complex128)
    inputs = np.empty((len(z), n + m, m), dtype=np.complex128)
    inputs[:, n:] = right
    for part, resolvent in blocks.resolvents(z):
        observed[:, :, part] = blocks.model.C[:, part] @ resolvent
        inputs[:, part] = resolvent @ (blocks.model.B[part] @ right)
    return observed, inputs

"""Nonlinear least-squares refinement of a state-space model on weighted lines."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from hammerstein.arrays import Array, Complex
from hammerstein.identification.linear.weighted_lines import Matrices, WeightedLines
from hammerstein.identification.static.damped_search import Damping, steps

CONDITION = 1e6
"""Condition of the eigenvectors above which A is not taken apart: nearly equal poles share their states."""

ROUNDING = 1e-30
"""Part of the whole sum of squares below which nothing but rounding is left."""

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
        """J^T J and J^T e there."""
        return _normal_equations(self.lines, self.blocks)

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
    """Change the state coordinates so that A falls into one block a pair of poles, where it can be done."""
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


def _normal_equations(lines: WeightedLines, blocks: _Blocks) -> tuple[Array, Array]:
    """J^T J and J^T e over all lines.

    With X = (z - A)^-1 B R and Z = C (z - A)^-1 the error of output a changes by

        dA_ij: Z_ai X_j,    dB_ij: Z_ai R_j,    dC_aj: X_j,    dD_aj: R_j

    so C and D of one output meet no other output.
    """
    from hammerstein.identification.linear.kernel import add_normal_equations

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

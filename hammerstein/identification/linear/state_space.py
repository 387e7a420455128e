"""A linear state-space model of stated order from a measured frequency response.

What it is fitted to are responses at points of the unit circle, scaled, warped and weighted; a subspace model
is refined by nonlinear least squares on these lines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from hammerstein.arrays import Array, Complex
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.linear.frequency_response import FrequencyResponse
from hammerstein.identification.linear.kernel import add_normal_equations
from hammerstein.identification.search import Damping, steps

CHUNK = 4096
"""Lines handled at a time, which bounds the memory for long records."""

SPREAD = 0.9
"""Part of the half circle over which the warping spreads a band that is narrow against the sample rate."""


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


def weigh(response: FrequencyResponse) -> WeightedLines:
    """Scale, warp and weigh a measured response.

    The warping z' = (z - a) / (1 - a z) maps the unit circle and the stable poles onto themselves and spreads
    a band far below the Nyquist frequency over the circle. Powers of z' then differ from each other
    where those of z are nearly equal, which keeps the subspace method well conditioned.

    Raises
    ------
    IdentificationError : an output without any response
    """
    power = np.ascontiguousarray(response.input_power.transpose(2, 0, 1))
    output = response.output_power.T
    dead = np.flatnonzero(output.max(axis=0) == 0.0)
    if dead.size:
        raise IdentificationError(f"output {dead[0] + 1} does not respond at any line: remove it")
    input_scale = np.sqrt(np.diagonal(power, axis1=1, axis2=2).real.mean(axis=0))
    output_scale = np.sqrt(output.mean(axis=0))
    each = 1.0 / np.sqrt(response.output_power.mean(axis=1))
    left = np.broadcast_to(each, output.shape) * output_scale
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


MARGIN = 1e-6
"""Distance from the unit circle of a pole that stood on it, after it is put back inside."""


def subspace(lines: WeightedLines, order: int, block_rows: int) -> Matrices:
    """Estimate a stable model of given order from weighted lines.

    With Z_k = [1, z_k, ..., z_k^(q-1)] every line obeys

        Z_k (x) G_k R_k = O X_k + T (Z_k (x) R_k),    O = [C; C A; ...; C A^(q-1)]

    The part of the left side that is orthogonal to Z_k (x) R_k spans the columns of O. Its leading left
    singular vectors give C and, by their shift structure, A; B and D follow by linear least squares.

    Parameters
    ----------
    lines : weighted frequency response to fit
    order : number of states n
    block_rows : q, larger than n / p

    Returns
    -------
    Matrices, stable: a pole outside the unit circle is mirrored into it

    References
    ----------
    McKelvey, Akcay, Ljung, Subspace-based multivariable system identification from frequency response data,
    IEEE Trans. Automatic Control 41 (1996) 960-979, algorithm 2, each line weighted as in the fit.
    """
    p = lines.target.shape[1]
    vectors = linalg.svd(_orthogonal_part(lines, block_rows), full_matrices=False)[0][:, :order]
    A = linalg.lstsq(vectors[:-p], vectors[p:], lapack_driver="gelsy")[0]
    A, C = stable(A), vectors[:p] / _mean_left(lines)[:, None]
    return Matrices(A, C=C, **dict(zip("BD", _input_matrices(lines, A, C), strict=True)))


def stable(A: Array) -> Array:
    """Mirror the eigenvalues outside the unit circle into it."""
    if not len(A) or np.abs(linalg.eigvals(A)).max() < 1.0:
        return A
    # ordered so that the unstable poles stand in the last block, whose inverse has the mirrored ones
    T, Q, inside = linalg.schur(A, sort="iuc")
    last = slice(inside, None)
    T[last, last] = (1.0 - MARGIN) * linalg.inv(T[last, last])
    return np.asarray(Q @ T @ Q.T)


def _mean_left(lines: WeightedLines) -> Array:
    """One weight an output, since the shift structure of O allows no more."""
    return np.asarray(np.sqrt(np.mean(lines.left**2, axis=0)))


def _orthogonal_part(lines: WeightedLines, q: int) -> Array:
    """Triangular factor of the responses' extended rows after those of the inputs are projected out."""
    p, m = lines.target.shape[1:]
    mean_left = _mean_left(lines)
    line_weight = np.sqrt(np.mean((lines.left / mean_left) ** 2, axis=1))
    rows = np.empty((0, q * (m + p)))
    for k in lines.chunks():
        right = lines.right[k] * line_weight[k, None, None]
        powers = lines.z[k, None] ** np.arange(q)
        extended = [
            (powers[:, :, None, None] * block[:, None]).reshape(len(right), -1, m)
            for block in (right, mean_left[:, None] * (lines.target[k] @ right))
        ]
        fresh = np.concatenate(extended, axis=1).swapaxes(1, 2).reshape(-1, q * (m + p))
        rows = linalg.qr(np.concatenate([rows, fresh.real, fresh.imag]), mode="r", overwrite_a=True)[0]
        rows = rows[: q * (m + p)]
    return np.asarray(rows[q * m :, q * m :].T)


def _input_matrices(lines: WeightedLines, A: Array, C: Array) -> tuple[Array, Array]:
    """B and D that fit best to the response, input by input."""
    n, (p, m) = len(A), lines.target.shape[1:]
    rows = np.empty((0, n + p + m))
    size = np.sqrt(np.mean(np.abs(lines.right) ** 2, axis=(1, 2)))
    for k in lines.chunks():
        states = np.linalg.inv(lines.z[k, None, None] * np.eye(n) - A)
        count = len(states)
        direct = np.broadcast_to(np.eye(p), (count, p, p))
        known = np.concatenate([C @ states, direct, lines.target[k]], axis=2)
        known = (known * (lines.left[k] * size[k, None])[:, :, None]).reshape(count * p, n + p + m)
        rows = linalg.qr(np.concatenate([rows, known.real, known.imag]), mode="r", overwrite_a=True)[0]
        rows = rows[: n + p + m]
    both = linalg.lstsq(rows[:, : n + p], rows[:, n + p :])[0]
    return both[:n], both[n:]


TRIAL = 3
"""Steps that each start is given before only the best one goes on."""


def fit_state_space(
    response: FrequencyResponse,
    order: int,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-4,
    progress: Callable[[str], None] | None = None,
) -> LinearBlock:
    """Fit a stable discrete-time state-space model with n states, m inputs and p outputs.

        x[k+1] = A x[k] + B u[k],   y[k] = C x[k] + D u[k],   G(z) = C (z - A)^-1 B + D

        minimise over A, B, C, D:   sum over lines f of | W(f) (G(e^(2 pi i f T)) - G_measured(f)) R(f) |^2

    R R^H is the power of the inputs and W = 1 / rms of each output, so the sum is that of the squared output
    errors in the experiments: the best simulation of signals like these, where noise is white or the order is
    too small for the actuator. Two subspace starts are refined by Levenberg-Marquardt steps. Like every
    nonlinear fit it ends at a minimum near its start, which need not be the lowest of all.

    Parameters
    ----------
    response : measured response, from ``frequency_response``
    order : number of states n
    max_iterations : largest number of steps from the best start
    tolerance : stop when the relative decrease of the sum of squares is below this
    progress : called with one line of text at every start and step

    Returns
    -------
    LinearBlock on the sample time of the records

    Raises
    ------
    InputError : an order below 1
    IdentificationError : too few lines for the order; an output that never responds

    References
    ----------
    McKelvey, Akcay, Ljung, IEEE Trans. Automatic Control 41 (1996) 960-979 (start); Pintelon and Schoukens,
    System Identification, 2nd ed., chapter 9 (criterion).

    Examples
    --------
    One resonance, excited by noise of period 256 and measured in steady state:

    >>> from scipy.signal import lfilter
    >>> u = np.tile(np.random.default_rng(1).standard_normal((1, 256)), 6)
    >>> y = lfilter([0.0, 0.4], [1.0, -1.2, 0.8], u)
    >>> from hammerstein.identification.linear.frequency_response import frequency_response
    >>> g = frequency_response([u[:, -256:]], [y[:, -256:]], 1e-3, period_samples=256)
    >>> block = fit_state_space(g, 2)
    >>> np.poly(block.A).round(6).tolist()
    [1.0, -1.2, 0.8]
    """
    if order < 1:
        raise InputError("order", f"is {order}; a state-space model needs at least 1 state")
    lines = weigh(response)
    report = progress or (lambda text: None)
    trial = min(TRIAL, max_iterations)

    def refined(start: Matrices, done: int, most: int) -> Matrices:
        def step(count: int, cost: float) -> None:
            report(f"step {done + count}: {_left(lines, cost)}")

        return refine(lines, start, most - done, tolerance, step)

    trials = [refined(start, 0, trial) for start in _starts(lines, order, report)]
    model = refined(min(trials, key=lines.cost), trial, max_iterations)
    return LinearBlock(*lines.physical(model), response.sample_time_s)


def _starts(lines: WeightedLines, order: int, report: Callable[[str], None]) -> list[Matrices]:
    """Subspace models with few block rows (best for large orders) and with many (best for small ones)."""
    F, p, m = lines.target.shape
    fewest = math.ceil(order / p) + 1
    most = 2 * F * m // (m + p)
    if most < fewest:
        needed = math.ceil(fewest * (m + p) / (2 * m))
        raise IdentificationError(
            f"a model of order {order} with {m} inputs and {p} outputs needs at least {needed} lines and the "
            f"response has {F}: choose a smaller order, or excite more lines"
        )
    models = []
    for block_rows in sorted({max(fewest, min(q, most)) for q in (order + 1, order + 8)}):
        models.append(subspace(lines, order, block_rows))
        report(f"start with {block_rows} block rows: {_left(lines, lines.cost(models[-1]))}")
    return models


def _left(lines: WeightedLines, cost: float) -> str:
    return f"{lines.percent(cost):.4g} % of the output not explained"

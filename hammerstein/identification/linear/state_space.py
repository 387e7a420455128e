"""A linear state-space model of stated order from a measured frequency response."""

import math
from collections.abc import Callable

import numpy as np
from scipy import linalg

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.linear.frequency_response import FrequencyResponse
from hammerstein.identification.linear.refinement import Matrices, WeightedLines, Weighting, refine, weigh

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
    weighting: Weighting = "power",
    max_iterations: int = 60,
    tolerance: float = 1e-4,
    progress: Callable[[str], None] | None = None,
) -> LinearBlock:
    """Fit a stable discrete-time state-space model with n states, m inputs and p outputs.

        x[k+1] = A x[k] + B u[k],   y[k] = C x[k] + D u[k],   G(z) = C (z - A)^-1 B + D

        minimise over A, B, C, D:   sum over lines f of | W(f) (G(e^(2 pi i f T)) - G_measured(f)) R(f) |^2

    R R^H is the power of the inputs, so with the weighting ``power`` (W = 1 / rms of each output) the sum is
    that of the squared output errors in the experiments: the best simulation of signals like these, where
    noise is white or the order is too small for the actuator. With ``variance`` W is the inverse standard
    deviation of the output at each line: the most likely model where the order is large enough and some
    lines are noisier than others. Two subspace starts are refined by Levenberg-Marquardt steps. Like
    every nonlinear fit it ends at a minimum near its start, which need not be the lowest of all.

    Parameters
    ----------
    response : measured response, from ``frequency_response``
    order : number of states n
    weighting : ``power`` or ``variance``
    max_iterations : largest number of steps from the best start
    tolerance : stop when the relative decrease of the sum of squares is below this
    progress : called with one line of text at every start and step

    Returns
    -------
    LinearBlock on the sample time of the records

    Raises
    ------
    InputError : an order below 1, or an unknown weighting
    IdentificationError : too few lines for the order; an output that never responds; ``variance`` asked where
        the response has none

    References
    ----------
    McKelvey, Akcay, Ljung, IEEE Trans. Automatic Control 41 (1996) 960-979 (start); Pintelon and Schoukens,
    System Identification, 2nd ed., chapter 9 (criterion).

    Examples
    --------
    One resonance, excited by noise of period 256 and measured in steady state:

    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> u = np.tile(np.random.default_rng(1).standard_normal((1, 256)), 6)
    >>> y = lfilter([0.0, 0.4], [1.0, -1.2, 0.8], u)
    >>> from hammerstein.identification.linear.frequency_response import frequency_response
    >>> g = frequency_response(u, y, 1e-3, period_samples=256, settle_periods=5)
    >>> block = fit_state_space(g, 2)
    >>> np.poly(block.A).round(6).tolist()
    [1.0, -1.2, 0.8]
    """
    if order < 1:
        raise InputError("order", f"is {order}; a state-space model needs at least 1 state")
    if weighting not in ("power", "variance"):
        raise InputError("weighting", f"{weighting!r} is not known; choose 'power' or 'variance'")
    lines = weigh(response, weighting)
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

"""Linear least squares on long records: moments summed block by block, then small dense problems.

The sums are exact enough for a recovery to 1e-8 because the regressors are chosen well: differences of
neighbouring plays have a condition number near 20 where the plays themselves have 10^3 and more.

Cross-validation folds: parts of records that are excluded in turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve, cholesky, orth
from scipy.optimize import nnls

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis.identifiable import Bounds as Bounds

DEPENDENT = 1e-10
"""Eigenvalue of the scaled Gram matrix, relative to the largest, under which columns depend on each other."""
OPEN = 1e-3
"""Share of a column in a combination that the data leave open, from which it is open, too."""
WELL_DETERMINED = 1e-4
"""Pivot of the scaled Gram matrix from which no column depends on those before it."""
NOTHING = 1e-7
"""Size of a column, in parts of the largest, below which it holds rounding errors alone."""
NO_DIRECTION = 1e-9
"""Singular value of columns of length one, in parts of the largest, that is a rounding error."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Second moments of regressors and outputs about their means in each record.

    Parameters
    ----------
    gram : (column, column) regressors with each other
    cross : (column, output) regressors with outputs
    power : (output,) outputs with themselves
    samples : how many samples were summed
    means : (record, column + output) means in each record, regressors first
    """

    gram: Array
    cross: Array
    power: Array
    samples: int
    means: Array

    @property
    def freedom(self) -> int:
        """Samples less one for the offset of each record."""
        return self.samples - len(self.means)

    def of_output(self, o: int) -> Moments:
        """Return the moments of one output alone."""
        columns = len(self.gram)
        means = self.means[:, [*range(columns), columns + o]]
        return Moments(self.gram, self.cross[:, [o]], self.power[[o]], self.samples, means)


def moments_of(
    blocks: Iterable[tuple[Array, Array]], columns: int, outputs: int, moving: NDArray[np.intp] | None = None
) -> Moments:
    """Moments of one record from blocks (column, sample) and (output, sample).

    moving : numbers of the columns that the blocks hold; the others are zero all the time. All if not given
    """
    k = columns + outputs
    own = np.arange(columns) if moving is None else moving
    summed, n = np.r_[own, columns:k], len(own)
    gathered, reference = np.zeros((len(summed) + 1,) * 2), np.empty((0, 1))
    rows = np.empty((len(gathered), 0))
    for x, y in blocks:
        if not len(reference):
            reference = np.concatenate([x[:, :1], y[:, :1]])
        if rows.shape[1] != x.shape[1]:
            rows = np.ones((len(gathered), x.shape[1]))
        # sums of large numbers would lose what their differences tell
        np.subtract(x, reference[:n], out=rows[:n])
        np.subtract(y, reference[n:], out=rows[n:-1])
        gathered += rows @ rows.T
    if not len(reference):
        raise IdentificationError("the record has no usable sample")
    samples, mean = gathered[-1, -1], gathered[:-1, -1] / gathered[-1, -1]
    total, means = np.zeros((k, k)), np.zeros((1, k))
    total[np.ix_(summed, summed)] = gathered[:-1, :-1] - samples * np.outer(mean, mean)
    means[0, summed] = mean + reference[:, 0]
    return Moments(
        gram=total[:columns, :columns],
        cross=total[:columns, columns:],
        power=np.diag(total)[columns:].copy(),
        samples=int(samples),
        means=means,
    )


def pooled(parts: Sequence[Moments]) -> Moments:
    """Moments of several records together, each about its own mean."""
    return Moments(
        gram=np.sum([m.gram for m in parts], axis=0),
        cross=np.sum([m.cross for m in parts], axis=0),
        power=np.sum([m.power for m in parts], axis=0),
        samples=sum(m.samples for m in parts),
        means=np.vstack([m.means for m in parts]),
    )


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients of one least-squares problem.

    Parameters
    ----------
    coefficients : (column,) estimates
    spread : (column, free unknown) S, with S S^T the covariance of the estimates, for independent errors;
        without unknowns at a bound
    residual_rms : rms residual, in the unit of the output
    at_bound : (unknown,) whether the unknown is at its bound
    dependent : (column,) whether the column belongs to a combination that the data do not determine; such
        combinations are set to zero
    ways : (column, free unknown) directions in which the estimates are free; empty for a problem of many
    """

    coefficients: Array
    spread: Array
    residual_rms: float
    at_bound: NDArray[np.bool_]
    dependent: NDArray[np.bool_]
    ways: Array = field(default_factory=lambda: np.empty((0, 0)))

    def of_output(self, own: slice, residual_rms: float) -> Solution:
        """Solution for one output of a problem with several outputs."""
        return Solution(
            self.coefficients[own], self.spread[own], residual_rms, self.at_bound[own], self.dependent[own]
        )


class _Scaled(NamedTuple):
    """The problem with columns of unit length, and the directions that the data determine."""

    scale: Array
    roots: Array
    directions: Array
    lost: Array

    @classmethod
    def of(cls, matrix: Array) -> _Scaled:
        scale = 1.0 / not_nothing(_sizes(matrix))
        values, vectors = np.linalg.eigh(scale[:, None] * matrix * scale)
        kept = values > DEPENDENT * max(values.max(initial=0.0), np.finfo(float).tiny)
        return cls(scale, np.sqrt(values[kept]), vectors[:, kept], vectors[:, ~kept])

    def target(self, cross: Array) -> Array:
        """Right-hand side of the small problem."""
        return np.asarray(((self.directions.T @ (self.scale * cross.T).T).T / self.roots).T)

    def coefficients(self, target: Array) -> Array:
        """Free solution."""
        return np.asarray((self.scale * (self.directions @ (target.T / self.roots).T).T).T)


def coefficients(gram: Array, cross: Array) -> Array:
    """Free least-squares coefficients (column,) or (column, problem) for right-hand sides of that shape."""
    norm = _sizes(gram)
    if norm.size and norm.all():
        try:
            factor = cholesky(gram / np.outer(norm, norm), lower=True)
        except LinAlgError:
            factor = np.zeros((1, 1))
        if np.diag(factor).min() > WELL_DETERMINED:
            scaled = cho_solve((factor, True), (cross.T / norm).T)
            return np.asarray((scaled.T / norm).T)
    problem = _Scaled.of(gram)
    return problem.coefficients(problem.target(cross))


def _sizes(gram: Array) -> Array:
    """Lengths of the columns; a product of rounding errors can come out below zero."""
    return np.asarray(np.sqrt(np.maximum(np.diag(gram), 0.0)))


def solve(
    gram: Array,
    cross: Array,
    power: float,
    freedom: int,
    *,
    bounds: Bounds | None = None,
    penalty: Array | None = None,
) -> Solution:
    """Minimise power - 2 cross.c + c.gram.c + c.penalty.c, between bounds if they are given.

    Parameters
    ----------
    gram, cross, power : moments of one output
    freedom : samples less offsets
    bounds : unknowns and their bounds; the coefficients are free if not given
    penalty : (column, column) quadratic penalty, such as a ridge
    """
    scaled = _Scaled.of(gram if penalty is None else gram + penalty)
    target = scaled.target(cross)
    root = scaled.roots[:, None] * scaled.directions.T
    if bounds is None or not bounds.side.any():  # scipy's nnls destroys memory if it is given no unknown
        free = np.ones(len(gram), dtype=np.bool_)
        found = scaled.coefficients(target)
        spread = scaled.scale[:, None] * scaled.directions / scaled.roots
    else:
        root = (root / scaled.scale) @ bounds.basis
        x, free = _bounded(root, target, bounds)
        found = bounds.basis @ x
        spread = bounds.basis[:, free] @ _inverse_root(root[:, free])
    noise = _difference(gram, cross, power, found) / max(freedom - int(free.sum()), 1)
    return Solution(
        coefficients=found,
        spread=np.sqrt(noise) * spread,
        residual_rms=float(np.sqrt(squares_left(gram, cross, power, found) / max(freedom, 1))),
        at_bound=~free,
        dependent=np.any(np.abs(scaled.lost) > OPEN, axis=1),
        ways=np.eye(len(gram)) if bounds is None else bounds.basis[:, free],
    )


def ridge_penalty(gram: Array, ridge: float, roughness: Array) -> Array:
    """Penalty (column, column) of combinations of the coefficients, relative to the power of the columns.

    roughness : (number, column) combinations that it makes small
    """
    strength = ridge * float(np.diag(gram).max(initial=0.0))
    return np.asarray(strength * (roughness.T @ roughness))


def are_within(bounds: Bounds, coefficients: Array) -> bool:
    """Whether unknowns within their bounds make up given coefficients; at most one is to spare."""
    x = np.linalg.lstsq(bounds.basis, coefficients, rcond=None)[0]
    room = bounds.side * (x - bounds.bound)
    _, size, ways = np.linalg.svd(bounds.basis)
    spare = ways[len(size) :]
    if not len(spare):
        return bool((room >= 0.0).all())
    moved = np.where(np.abs(spare[0]) > NO_DIRECTION, bounds.side * spare[0], 0.0)
    up, down = moved > 0.0, moved < 0.0
    low, high = (-room[up] / moved[up]).max(initial=-np.inf), (-room[down] / moved[down]).min(initial=np.inf)
    return bool(low <= high and (room[moved == 0.0] >= 0.0).all())


def squares_left(gram: Array, cross: Array, power: float, found: Array) -> float:
    """Sum of the squared errors of one output with given coefficients; at least its own rounding error.

    Large coefficients of columns that nearly cancel would otherwise pass for a perfect fit.
    """
    size = np.abs(found)
    terms = power + 2.0 * np.abs(cross) @ size + size @ np.abs(gram) @ size
    return max(_difference(gram, cross, power, found), np.finfo(float).eps * float(terms))


def _difference(gram: Array, cross: Array, power: float, found: Array) -> float:
    """Sum of the squared errors as the moments give it, zero where rounding makes it negative."""
    return max(float(power - 2.0 * cross @ found + found @ gram @ found), 0.0)


def _inverse_root(root: Array) -> Array:
    """Matrix S with S S^T = (root^T root)^-1, on the directions that the data determine."""
    scaled = _Scaled.of(root.T @ root)
    return np.asarray(scaled.scale[:, None] * scaled.directions / scaled.roots)


def _bounded(root: Array, target: Array, bounds: Bounds) -> tuple[Array, NDArray[np.bool_]]:
    """Minimise |root x - target| between bounds, and return which unknowns are not at a bound.

    The free unknowns are eliminated, which leaves a problem with non-negative unknowns.
    """
    held = bounds.side != 0.0
    x = np.where(held, bounds.bound, 0.0)
    others = orth(root[:, ~held] / _lengths(root[:, ~held]), rcond=NO_DIRECTION)
    left = root[:, held] * bounds.side[held]
    left = left - others @ (others.T @ left)
    size = 1.0 / _lengths(left)
    rest = target - root @ x
    above, _ = nnls(left * size, rest - others @ (others.T @ rest), maxiter=50 * max(len(size), 1))
    x[held] += bounds.side[held] * size * above
    free = ~held
    free[held] = above > 0.0
    open_ = root[:, ~held]
    rest = target - root[:, held] @ x[held]
    x[~held] = np.linalg.lstsq(open_ / _lengths(open_), rest, rcond=NO_DIRECTION)[0] / _lengths(open_)
    return x, free


def _lengths(matrix: Array) -> Array:
    """Lengths of the columns."""
    return not_nothing(np.linalg.norm(matrix, axis=0))


def not_nothing(sizes: Array) -> Array:
    """Sizes by which columns can be divided: those of rounding errors become the largest, or one."""
    largest = float(sizes.max(initial=0.0))
    return np.where(sizes > NOTHING * largest, sizes, largest if largest > 0.0 else 1.0)


FOLDS = 4
"""Parts of which one is left out at a time."""
PARTS = 16
"""Parts into which a record falls; every fourth of them is one fold."""
UNTOLD = 1e-3
"""Part of their power in all folds that combinations of weights must show in some, or they stay as in all. A
fold that alone has the largest amplitude would be predicted from what the others hardly show."""


def moments_of_folds(
    blocks: Iterable[tuple[int, Array]], y: Array, first: int, columns: int, parts: int
) -> dict[int, Moments]:
    """Moments of each fold of one record: every fourth of its parts, so that cycles lie on both sides.

    Parameters
    ----------
    blocks : first sample and columns (column, sample) of each block
    y : (output, sample) readings
    first : sample from which the record counts
    columns : their number
    parts : parts of equal length into which the record falls

    Raises IdentificationError where a record is too short to leave anything out.
    """
    ends = first + np.ceil((y.shape[1] - first) * np.arange(1, parts + 1) / parts).astype(int)
    folds: dict[int, list[tuple[Array, Array]]] = {fold: [] for fold in range(FOLDS)}
    for k, x in blocks:
        inner = np.unique(ends[(k < ends) & (ends < k + x.shape[1])])  # of a short record some are empty
        edges = [k, *inner.tolist(), k + x.shape[1]]
        for a, b in itertools.pairwise(edges):
            part = int(np.searchsorted(ends, a, side="right"))
            folds[part % FOLDS].append((x[:, a - k : b - k], y[:, a:b]))
    if sum(map(bool, folds.values())) < 2:
        raise IdentificationError("the records are too short for cross-validation")
    return {fold: moments_of(part, columns, len(y)) for fold, part in folds.items() if part}


def left_out(
    records: Sequence[Mapping[int, Moments]], found: Callable[[Moments], Array]
) -> tuple[float, int]:
    """Squares that are left of the folds of one output, each with coefficients of the others, and samples.

    records : moments of each fold of each record
    found : coefficients (column,) that suit some moments
    """
    total, samples = 0.0, 0
    for fold in range(FOLDS):
        test = [parts[fold] for parts in records if fold in parts]
        rest = [moments for parts in records for f, moments in parts.items() if f != fold]
        if test and rest:
            held = pooled(test)
            total += squares_left(held.gram, held.cross[:, 0], float(held.power[0]), found(pooled(rest)))
            samples += held.samples
    return total, samples


def refitted(train: Moments, whole: Moments, weights: Array) -> Array:
    """Weights that suit some folds; as they are for all where these leave them open.

    Their change d is the least of |X d - e|^2 + UNTOLD |X_all d|^2, with the columns X and the errors e of
    these folds: a combination of which they hold the part p of its power changes by p / (p + UNTOLD) of what
    suits them.

    whole, weights : moments of all folds, and the weights that suit them
    """
    held = UNTOLD * whole.gram + np.diag(np.full(len(weights), np.finfo(float).tiny))
    return np.asarray(weights + coefficients(train.gram + held, train.cross[:, 0] - train.gram @ weights))

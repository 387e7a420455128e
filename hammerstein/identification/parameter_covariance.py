"""Joint covariance of all parameters of a model: thresholds, axes, and the dependent weights.

Linearised about the model, the readings of output o are

    y_o ~ offset + A_o d + G_o (w + M_o d),     M_o = -C_o G_o' A_o / s_o^2,

with the derivatives A_o with respect to the parameters x other than weights and G_o with respect to the
weights, C_o the covariance of the weights for given x, and s_o the rms residual. With the weights eliminated,
the outputs give the information H = sum of (A + G M)'(A + G M) / s^2 on d.

* Fitted parameters have the covariance (H + P)^-1. P limits them to their possible values: a threshold to its
cell, the others to a change of about 1, which is large for each. Errors may be correlated within a sixteenth
of a record (White, Econometrica 48 (1980) 817-838); where that makes an error larger, it is scaled up.

* The residual beyond the noise is model error. It is attributed to the thresholds: they differ from those of
the actuator by independent fractions of their cells, and the fitted parameters follow. Without thresholds it
is attributed to the fitted parameters, mostly along the directions that the records determine least. Either
is scaled, by simulated draws, until it explains the residual: a linearisation holds for small changes only.

* The parameters of the axes may have taken up an error of the hysteresis, which is then not in the residual.
They err by as much as they move beside columns of other laws; see ``misspecification``.

How far the parameters of an axis move when the hysteresis in front of it may follow another law.

The residual of a least-squares fit is orthogonal to its derivatives. An error of the hysteresis that a
resonance or a low-pass has taken up is therefore not in the residual, and no covariance of the residual shows
it, whatever correlation it allows for. A wider model does: the parameters move as soon as something else can
explain the same (Hausman, Econometrica 46 (1978) 1251-1271).

The wider model has columns of two other families beside those of the model: plays of each input with their
squares and cubes, because a Preisach operator is a sum of functions of plays (Brokate and Sprekels,
Hysteresis and Phase Transitions, 1996, section 2.4), and Bouc-Wen loops, which have no return-point memory.
Each column may be as large as the part of the residual that is no noise: if the residual is noise, nothing
moves.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.dynamics import AxesDynamics, StaticDynamics
from hammerstein.hysteresis import BoucWen, BoucWenPair, Hysteresis, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.bouc_wen import FIRST_RATES, FIRST_SHARES
from hammerstein.hysteresis.identifiable import Identifiable, within_gaps
from hammerstein.hysteresis.pair import triangle
from hammerstein.identification.excitation import fastest_rad_per_s
from hammerstein.identification.linear.axis_fit import PARTS
from hammerstein.identification.model_selection import behind_path
from hammerstein.identification.score import Candidate, columns_of
from hammerstein.identification.static.regressors import InitialState, Regressors
from hammerstein.identification.static.static_block import half_swing, swing_ends
from hammerstein.identification.static.threshold_search import price
from hammerstein.model.covariance import ParameterCovariance, beside_weights, with_beside_weights
from hammerstein.records.record import Record

PLAYS, POWERS = 8, (1, 2, 3)
"""Plays of each input, from a threshold of 0 to an eighth below half the swing, and the powers of each.
Together with the loops they leave at most a sixth of the misfit of random actuators of five laws."""


def moved_beside_other_laws(
    fitted: Array, weights: Array, others: Array, left: Array, penalties: Array, misfit: float, noise: float
) -> Array:
    """Change of fitted parameters (number,) when other columns may explain the residual as well.

    With the weights eliminated, d and c minimise

        |e - S d - E c|^2 / s^2 + sum (d / scale)^2 + sum c^2 / t^2

    with the derivatives S of the output by the parameters and the other columns E, each of unit power.

    Parameters
    ----------
    fitted, weights, others : (row, sample) S, the columns of the weights, and E
    left : (sample,) residual e [um]
    penalties : (number,) 1 / scale^2
    misfit : t^2, the part of the variance of the residual that is no noise [um^2]
    noise : s^2, variance of the residual [um^2]
    """
    basis, _ = np.linalg.qr(weights.T)
    rows = np.vstack([fitted, others / np.sqrt(np.mean(others**2, axis=1, keepdims=True))])
    rows = rows - (rows @ basis) @ basis.T
    more = np.full(len(others), 1.0 / misfit)
    information = rows @ rows.T + noise * np.diag(np.concatenate([penalties, more]))
    return np.asarray(np.linalg.solve(information, rows @ left)[: len(fitted)])


def other_columns(
    candidate: Candidate, record: Record, start: InitialState, swing_v: Array
) -> Iterator[list[Array]]:
    """Groups of other columns (output) (column, sample) behind the linear block, each about its mean.

    swing_v : (input,) half swing of each input in all records [V]
    """
    for raw in _other_laws(record, start, np.where(swing_v > 0.0, swing_v, 1.0)):
        group = []
        for o in range(len(record.y_um)):
            passed = np.hstack([x for _, x in behind_path(candidate, record, start, o, raw)])
            group.append(passed - passed.mean(axis=1, keepdims=True))
        yield group


def _other_laws(record: Record, start: InitialState, swing_v: Array) -> Iterator[Regressors]:
    """Powers of plays of all inputs, and Bouc-Wen loops of nine shapes, in parts of the half swings."""
    row = tuple(Pair(v / PLAYS * np.arange(PLAYS), np.ones(PLAYS)) for v in swing_v.tolist())
    plays, size = columns_of(PrandtlIshlinskii((row,)), record, start, 0), np.repeat(swing_v, PLAYS)
    for power in POWERS:
        yield Regressors((plays.values / size[:, None]) ** power, (plays.held / size) ** power)
    for rate, share in itertools.product(FIRST_RATES, FIRST_SHARES):
        loads = (rate / swing_v).tolist()
        loops = tuple(BoucWenPair(1.0, 1.0, share * load, (1.0 - share) * load) for load in loads)
        both = columns_of(BoucWen((loops,)), record, start, 0)
        yield Regressors(both.values[1::2] / swing_v[:, None], both.held[1::2] / swing_v)


STEP = 1e-4
"""Step of a numerical derivative, in parts of the possible change of the parameter."""
COUNTED = 50_000
"""Samples of all records together; neighbours in longer ones are averaged, to fit the memory."""
RELATED, RELATED_RAD = 16, 0.5
"""Largest correlation length of the model error in samples, and in radians of the fastest motion."""
DRAWS = 8
"""Number of draws to scale the model error to that in the records."""
HIDDEN = 2
"""Missing columns of an input, a threshold and a breakpoint, each just below the limit of acceptance."""
TOLD = 1e-9
"""Information on a direction of the places, relative to the largest, from which it is identified."""
SIZED = 4
"""Degrees of freedom of the draws where thresholds and breakpoints were fitted: Student's t.

Given ones leave an error in the records, and its size is known from them. How large an error fitted ones hide
is known from few numbers: of 120 random actuators the true error scattered about the middle of normal draws
by a factor of 1.5 more than the draws did, which is the scatter of sqrt(4 / chi^2)
(``tests/coverage_of_bands/results.md``).
"""
UNTOLD = 0.9
"""Standard error, relative to that of its cell alone, from which a threshold is unidentified."""


def parameter_covariance(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState], thresholds_fitted: bool
) -> ParameterCovariance | None:
    """Joint covariance of the parameters of a model whose axes do not couple the outputs.

    None where they do, or where the covariance of the weights is unknown.

    Parameters
    ----------
    candidate : the model, fitted to these records
    records, starts : fitted records and their initial states
    thresholds_fitted : whether the thresholds of plays were fitted; those of other kinds are fitted if they
        are among their free parameters
    """
    hysteresis = candidate.hysteresis
    uncoupled = isinstance(candidate.dynamics, AxesDynamics | StaticDynamics)
    if hysteresis.weight_covariance is None or not uncoupled:
        return None
    scale, cells = _scale(hysteresis, len(beside_weights(hysteresis, candidate.dynamics)), records)
    every = math.ceil(sum(record.samples for record in records) / COUNTED)
    told = [
        _told_by(candidate, record, start, scale, every)
        for record, start in zip(records, starts, strict=True)
    ]
    mean = _pooled(told, hysteresis, _related(records))
    free = np.flatnonzero(scale > 0.0)
    fitted = free if thresholds_fitted else free[free >= cells]
    own = _of_fitted(mean, told, fitted, scale)
    misfit, squares = _of_places(mean, told, fitted, free[free < cells], scale)
    if not misfit.size:
        misfit, squares = own, _excess(mean)
    if candidate.placed:
        readings = hysteresis.n_outputs * mean.samples
        hidden = HIDDEN * hysteresis.n_inputs * price(1 + hysteresis.n_outputs, readings)
        squares = max(squares, hidden * readings)
    most = _most(misfit[cells:], scale[cells:])
    misfit = misfit * _size(candidate, told, mean, misfit, squares, most)
    alone = np.linalg.norm(own, axis=1)
    untold = [int(i) for i in fitted if i < cells and alone[i] > UNTOLD * scale[i]]
    taken = _taken_by_axes(candidate, told, mean, fitted, scale)
    factor = triangle(np.hstack([own, misfit, taken]))
    placed = thresholds_fitted if cells else _has_places(hysteresis)
    return ParameterCovariance(factor, mean.following, tuple(fitted.tolist()), tuple(untold), SIZED * placed)


def _scale(hysteresis: Hysteresis[Any], size: int, records: Sequence[Record]) -> tuple[Array, int]:
    """Possible change of each parameter (number,), as a standard deviation, and the number of thresholds.

    A threshold lies anywhere within half the distance to its nearest neighbour, where the linearisation
    holds; neighbours are 0 V, too, for a threshold, and for a breakpoint the ends of the recorded swing.
    """
    groups: tuple[Array, ...] = ()
    spread = np.empty(0)
    if isinstance(hysteresis, PrandtlIshlinskii):
        groups = tuple(np.split(hysteresis.free, np.cumsum(hysteresis.bank.n)[:-1]))
    elif isinstance(hysteresis, Identifiable):
        groups, spread = hysteresis.places, hysteresis.free_spread
    cells, m = sum(map(len, groups)), hysteresis.n_inputs
    ends = list(zip(*swing_ends(records), strict=True))
    each = [within_gaps(r, *((0.0, np.inf) if i < m else ends[i % m])) for i, r in enumerate(groups)]
    return np.concatenate([*each, spread, np.ones(size - cells - len(spread))]), cells


def _has_places(hysteresis: Hysteresis[Any]) -> bool:
    """Whether some free numbers are places, which stay within the gaps to their neighbours."""
    return isinstance(hysteresis, Identifiable) and bool((hysteresis.free_spread != 1.0).any())


class _Told(NamedTuple):
    """Derivatives of a record by the parameters (output, number, sample) and the weights, and the residual.

    record, start : whose they are

    residual : with all samples; every : number of samples averaged in the others
    """

    record: Record
    start: InitialState
    by_numbers: Array
    by_weights: tuple[Array, ...]
    left: Array
    residual: Array
    every: int


def _told_by(candidate: Candidate, record: Record, start: InitialState, scale: Array, every: int) -> _Told:
    """Derivatives by differences, each row about its mean; those of the weights are exact."""
    hysteresis, dynamics = candidate.hysteresis, candidate.dynamics

    def residual(block: Hysteresis[Any], axes: Any) -> Array:
        return Candidate(block, axes, candidate.sensor).residual(record, start)

    whole, x = residual(hysteresis, dynamics), beside_weights(hysteresis, dynamics)
    left = _averaged(whole, every)
    by_numbers = np.zeros((len(left), len(x), left.shape[1]))
    for i in np.flatnonzero(scale > 0.0):
        changed = x.copy()
        changed[i] += STEP * scale[i]
        moved = _averaged(residual(*with_beside_weights(hysteresis, dynamics, changed)), every)
        by_numbers[:, i] = (left - moved) / (STEP * scale[i])
    weights = [np.asarray(w) for w in hysteresis.weights]
    by_weights = [np.zeros((len(w), left.shape[1])) for w in weights]
    for j in range(max(map(len, weights))):
        more = [w + (np.arange(len(w)) == j) for w in weights]  # axes do not couple the outputs
        moved = left - _averaged(residual(hysteresis.with_weights(more), dynamics), every)
        for o, columns in enumerate(by_weights):
            columns[j : j + 1] = moved[o]
    return _Told(record, start, by_numbers, tuple(by_weights), left, whole, every)


def _averaged(rows: Array, every: int) -> Array:
    """Means of this many neighbours (row, sample), without the remainder at the end."""
    return np.asarray(rows[:, : rows.shape[1] // every * every].reshape(len(rows), -1, every).mean(axis=2))


class _Mean(NamedTuple):
    """What all records tell together; variance : (output,) [um^2]; misfit : its part that is no noise."""

    information: tuple[Array, ...]
    following: tuple[Array, ...]
    variance: Array
    misfit: Array
    samples: int


def _related(records: Sequence[Record]) -> int:
    """Samples over which what a model misses hangs together: it moves as the voltages do."""
    step_s = max(record.sample_time_s for record in records)
    fastest = max(float(fastest_rad_per_s(records).max()) * step_s, np.finfo(float).tiny)
    return int(np.clip(RELATED_RAD / fastest, 2, RELATED))


def _pooled(told: Sequence[_Told], hysteresis: Hysteresis[Any], related: int) -> _Mean:
    """Information (number, number) of each output on the numbers, with the weights eliminated."""
    samples = sum(one.residual.shape[1] for one in told)
    variance = np.sum([np.sum(one.residual**2, axis=1) for one in told], axis=0) / samples
    misfit = _misfit([one.residual for one in told], variance, related)
    information, following = [], []
    for o, (weights, s2) in enumerate(zip(hysteresis.weight_covariance or (), variance, strict=True)):
        alone = np.sum([one.every * one.by_numbers[o] @ one.by_numbers[o].T for one in told], axis=0)
        mixed = np.sum([one.every * one.by_weights[o] @ one.by_numbers[o].T for one in told], axis=0)
        gram = np.sum([one.every * one.by_weights[o] @ one.by_weights[o].T for one in told], axis=0)
        ways = weights.factor_um_per_v
        noise = float(np.linalg.norm(ways.T @ gram @ ways, 2))  # that of their fit; s^2, but for rounding
        drag = weights.covariance @ mixed / max(noise, np.finfo(float).tiny)
        following.append(-drag)
        information.append((alone - mixed.T @ drag) / max(float(s2), np.finfo(float).tiny))
    return _Mean(tuple(information), tuple(following), variance, misfit, samples)


def _misfit(left: Sequence[Array], variance: Array, n: int) -> Array:
    """Part (output,) of the residual that is correlated over n samples, beyond chance [um^2].

    The mean of n samples of white noise has the variance s^2 / n; any excess is not noise.
    """
    means = np.hstack([_averaged(row, n) for row in left])
    chance = np.sqrt(2.0 / max(means.shape[1], 1)) * variance / (n - 1)
    more = (n * np.mean(means**2, axis=1) - variance) / (n - 1) if means.size else 0.0 * variance
    return np.asarray(np.clip(more - chance, 0.0, variance))


def _of_fitted(mean: _Mean, told: Sequence[_Told], fitted: Indices, scale: Array) -> Array:
    """Matrix S (number, fitted), S S^T the covariance of the numbers that were fitted."""
    spread = np.zeros((len(scale), len(fitted)))
    if not fitted.size:
        return spread
    at = np.ix_(fitted, fitted)
    information = np.sum([one[at] for one in mean.information], axis=0)
    values, vectors = np.linalg.eigh(scale[fitted, None] * information * scale[fitted] + np.eye(len(fitted)))
    root = scale[fitted, None] * vectors / np.sqrt(np.maximum(values, 1.0))
    covariance = root @ root.T
    scores = np.array([score for one in told for score in _scores(one, mean, fitted)])
    related = np.linalg.norm(covariance @ scores.T, axis=1) / np.linalg.norm(root, axis=1)
    most = scale[fitted] / np.linalg.norm(root, axis=1)
    spread[fitted] = root * np.minimum(np.maximum(related, 1.0), most)[:, None]
    return spread


def _scores(one: _Told, mean: _Mean, fitted: Indices) -> Iterator[Array]:
    """Pull of each part of a record on the numbers fitted."""
    ends = np.linspace(0, one.left.shape[1], PARTS + 1).astype(int)
    moves = [
        one.every
        * (one.by_numbers[o] + mean.following[o].T @ columns)[fitted]
        / max(s2, np.finfo(float).tiny)
        for o, (columns, s2) in enumerate(zip(one.by_weights, mean.variance.tolist(), strict=True))
    ]
    for a, b in itertools.pairwise(ends):
        yield np.sum([m[:, a:b] @ left[a:b] for m, left in zip(moves, one.left, strict=True)], axis=0)


def _taken_by_axes(
    candidate: Candidate, told: Sequence[_Told], mean: _Mean, fitted: Indices, scale: Array
) -> Array:
    """Matrix S (number, output): by how much the numbers of the axes move beside columns of other laws."""
    spread, dynamics = np.zeros((len(scale), len(mean.misfit))), candidate.dynamics
    if not (isinstance(dynamics, AxesDynamics) and len(dynamics.free) and mean.misfit.any()):
        return spread
    swing, others = half_swing([one.record for one in told]), []
    for one in told:
        groups = other_columns(candidate, one.record, one.start, swing)
        others.append([[_averaged(x, one.every) for x in group] for group in groups])
    first = len(scale) - len(dynamics.free)
    for o, (axis, misfit) in enumerate(zip(dynamics.axes, mean.misfit.tolist(), strict=True)):
        own = np.arange(first, first + len(axis.free))
        first += len(axis.free)
        if own.size and misfit > 0.0:
            numbers = np.concatenate([fitted[fitted < len(scale) - len(dynamics.free)], own])
            change = moved_beside_other_laws(
                np.hstack([one.by_numbers[o][numbers] for one in told]),
                np.hstack([one.by_weights[o] for one in told]),
                np.hstack([np.vstack([group[o] for group in groups]) for groups in others]),
                np.hstack([one.left[o] for one in told]),
                scale[numbers] ** -2.0,
                misfit,
                float(mean.variance[o]) / told[0].every,
            )[-own.size :]
            spread[own, o] = np.clip(change, -scale[own], scale[own])
    return spread


def _excess(mean: _Mean) -> float:
    """Squares of all outputs that are no noise, each in parts of its variance."""
    return mean.samples * float(np.sum(mean.misfit / np.maximum(mean.variance, np.finfo(float).tiny)))


def _of_places(
    mean: _Mean, told: Sequence[_Told], fitted: Indices, places: Indices, scale: Array
) -> tuple[Array, float]:
    """Matrix S (number, place) of thresholds that err within their cells, and the squares they explain.

    The fitted parameters follow. With H the information on n thresholds and q the gradient of the residual,
    they explain q' H^-1 q, n of it by chance. The residual may contain more model error than the
    linearisation shows.
    """
    spread = np.zeros((len(scale), len(places)))
    if not places.size:
        return spread, 0.0
    spread[places] = np.diag(scale[places])
    others = np.setdiff1d(fitted, places)
    information = np.sum(mean.information, axis=0)
    if others.size:
        own = information[np.ix_(others, others)] + np.diag(1.0 / scale[others] ** 2)
        spread[others] = -np.linalg.solve(own, information[np.ix_(others, places)] * scale[places])
    values, vectors = np.linalg.eigh(spread.T @ information @ spread)
    told_of = values > TOLD * max(float(values[-1]), np.finfo(float).tiny)
    if not told_of.any():
        return np.zeros_like(spread), 0.0
    numbers = np.arange(len(scale))
    pull = vectors.T @ (spread.T @ np.sum([q for one in told for q in _scores(one, mean, numbers)], axis=0))
    explained = float(np.sum(pull[told_of] ** 2 / values[told_of])) - int(told_of.sum())
    return spread, max(explained, _excess(mean))


def _most(spread: Array, scale: Array) -> float:
    """Factor by which a spread (number, ...) can grow until one number reaches how far it can be."""
    wide = np.linalg.norm(spread, axis=1)
    moved = wide > 0.0
    return float((scale[moved] / wide[moved]).min()) if moved.any() else math.inf


def _size(
    candidate: Candidate, told: Sequence[_Told], mean: _Mean, spread: Array, squares: float, most: float
) -> float:
    """Factor k, ``most`` at most, for which draws of k S cause these squared errors on average.

    The linearisation gives the first value: with the information H, k S causes k^2 tr(S' H S). Where
    simulated draws cause less, because the error of plays does not grow with all their cells, the factor is
    larger.
    """
    line = float(np.sum(spread * (np.sum(mean.information, axis=0) @ spread)))
    if not (squares > 0.0 and line > 0.0):
        return 0.0
    hysteresis, dynamics = candidate.hysteresis, candidate.dynamics
    x, size = beside_weights(hysteresis, dynamics), min(math.sqrt(squares / line), most)
    normals = np.random.default_rng(0).standard_normal((DRAWS, spread.shape[1]))
    normals /= np.sqrt(np.mean(normals**2, axis=0))
    for _ in range(2):
        left = 0.0
        for change in size * normals @ spread.T:
            weights = [w + m @ change for w, m in zip(hysteresis.weights, mean.following, strict=True)]
            block, axes = with_beside_weights(hysteresis, dynamics, x + change)
            moved = Candidate(block.with_weights(weights), axes, candidate.sensor)
            for one in told:
                errors = moved.residual(one.record, one.start) - one.residual
                left += float(np.sum(np.sum(errors**2, axis=1) / mean.variance)) / DRAWS
        size = min(size * max(math.sqrt(squares / left), 1.0), most) if left > 0.0 else size
    return size

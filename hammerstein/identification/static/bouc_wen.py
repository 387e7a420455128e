"""The Bouc-Wen model from records: two numbers of each pair searched, its slopes projected out."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import BoucWen, BoucWenPair, WeightCovariance
from hammerstein.hysteresis.covariance import triangle
from hammerstein.identification.score import path_before
from hammerstein.identification.static.history import shortened
from hammerstein.identification.static.normal_equations import Bounds, Solution, coefficients, solve
from hammerstein.identification.static.regressors import Filter, Start, delayed
from hammerstein.identification.static.static_block import LEAST_SLOPE, direct_pairs, half_swing, path_filters
from hammerstein.records.record import Record

SEARCH_SAMPLES = 20_000
"""Samples with which the starts are tried and searched."""
FIRST_RATES = (0.5, 2.0, 8.0)
"""Rate beta + gamma tried first, in parts of one over half the swing."""
FIRST_SHARES = (0.35, 1.0, 2.5)
"""Share of beta in it tried first."""
RATES, SHARES = (1e-2, 1e3), (1e-3, 1e3)
"""Least and largest of both."""
SEARCHED = 4
"""Starts from which a search goes on; the best of them is searched with all samples."""
MOST_EVALUATIONS = 60
NEAR, FINE = (1e-4, 1e-6), (1e-9, 1e-12)
"""Steps of the shape and of the error, as parts of them, at which the search from each start ends, and the
last one, which goes on from the best of these; a rough one ends as early."""
KEPT = 4
"""Shapes of each input whose columns are kept: a search moves one input at a time."""


@dataclass(frozen=True, eq=False)
class BoucWenFit:
    """A Bouc-Wen model found by regression, and how well it fits.

    Parameters
    ----------
    hysteresis : the model, with the covariance of its slopes for its beta and gamma
    rms_um : (output,) rms of what is left [um]
    held : pairs (output, input) of which a slope stands at the least one that has an inverse
    """

    hysteresis: BoucWen
    rms_um: Array
    held: tuple[tuple[int, int], ...]


def fit_bouc_wen(
    records: Sequence[Record],
    *,
    invertible: bool = True,
    starts: Sequence[Start] = (),
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
    like: BoucWen | None = None,
    rough: bool = False,
) -> BoucWenFit:
    """Find d, a, beta and gamma of all pairs by least squares.

    Only beta + gamma and the share of beta in it are searched, from several starts; d and a follow by linear
    least squares (variable projection: Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413-432). With
    ``invertible`` all slopes of a direct pair stay above a twentieth of its gain.

    Parameters
    ----------
    records : at least one, all with the same axes
    invertible, starts, delay_samples, through : as for ``fit_static``
    like : model near the best one, from which alone the search goes on
    rough : whether the search ends early

    Raises
    ------
    IdentificationError : an input that never moves
    """
    reach = half_swing(records)
    if not reach.all():
        name = records[0].inputs[int(np.argmin(reach))]
        raise IdentificationError(f"input {name} never moves: no record tells what it does")
    begun = tuple(starts) or (Start("rest"),) * len(records)
    outputs = range(len(records[0].y_um))
    whole = [_Task.of(records, begun, delay_samples, through, o, reach) for o in outputs]
    if like is None:
        few, first = shortened(records, begun, SEARCH_SAMPLES)
        near = [_near(_Task.of(few, first, delay_samples, through, o, reach)) for o in outputs]
    else:
        near = [_shape_of(row, reach) for row in like.pairs]
    end = NEAR if rough else FINE
    shapes = [_search(task, begin, end) for task, begin in zip(whole, near, strict=True)]
    found = [task.solution(shape) for task, shape in zip(whole, shapes, strict=True)]
    held = _held(whole, shapes, found, reach) if invertible else []
    pairs = [task.pairs(shape, s) for task, shape, s in zip(whole, shapes, found, strict=True)]
    known = tuple(WeightCovariance(triangle(s.spread), int(s.at_bound.sum())) for s in found)
    rms = np.array([s.residual_rms for s in found])
    return BoucWenFit(BoucWen(tuple(pairs), known), rms, tuple(held))


def _held(
    tasks: Sequence[_Task], shapes: Sequence[Array], found: list[Solution], reach: Array
) -> list[tuple[int, int]]:
    """Hold the slopes of the direct pairs that would fall too low, in place; give the pairs."""
    free = BoucWen(tuple(t.pairs(x, s) for t, x, s in zip(tasks, shapes, found, strict=True)))
    gains, held = free.amplitude(reach) / reach, []
    for o, k in direct_pairs(gains):
        least = LEAST_SLOPE * float(gains[o, k])
        if min(np.sign(least) * slope for slope in free.pairs[o][k].slopes_um_per_v) < abs(least):
            found[o] = tasks[o].solution(shapes[o], (k, least))
            held.append((o, k))
    return held


def _near(quick: _Task) -> Array:
    """Shape (ln rate, ln share) of every input near the best one, from several starts."""
    begins = [np.log(each) for each in itertools.product(FIRST_RATES, FIRST_SHARES)]
    starts = [np.tile(each, len(quick.reach)) for each in begins]
    for k in range(len(quick.reach)):  # each input on its own, behind the best of the others
        best = min(starts, key=quick.error).copy()
        for each in begins:
            best[2 * k : 2 * k + 2] = each
            starts.append(best.copy())
    best_first = sorted(starts, key=quick.error)[:SEARCHED]
    return min((_search(quick, begin, NEAR) for begin in best_first), key=quick.error)


def _search(task: _Task, begin: Array, end: tuple[float, float]) -> Array:
    """Shape of every input with the least error, which steps from ``begin`` come to."""
    from scipy.optimize import least_squares

    xtol, ftol = end
    lower, upper = (
        np.tile(np.log([rate, share]), len(task.reach)) for rate, share in zip(RATES, SHARES, strict=True)
    )
    begin = np.clip(begin, lower + 1e-6, upper - 1e-6)
    found = least_squares(
        task.residual, begin, bounds=(lower, upper), max_nfev=MOST_EVALUATIONS, xtol=xtol, ftol=ftol
    )
    return np.asarray(found.x)


def _shape_of(row: Sequence[BoucWenPair], reach: Array) -> Array:
    """Shape of every input of one output of a model."""
    loads = [pair.beta_per_v + pair.gamma_per_v for pair in row]
    each = zip(row, loads, reach, strict=True)
    return np.concatenate([np.log([load * swing, pair.beta_per_v / load]) for pair, load, swing in each])


class _Recent:
    """Columns of the last shapes of every input."""

    def __init__(self, inputs: int) -> None:
        self._known: list[dict[tuple[float, float], Array]] = [{} for _ in range(inputs)]

    def column(self, k: int, rates: tuple[float, float], make: Callable[[], Array]) -> Array:
        """Column of an input with these rates, made where it is not one of the last."""
        known = self._known[k]
        known[rates] = found = known.pop(rates) if rates in known else make()
        if len(known) > KEPT:
            del known[next(iter(known))]
        return found


class _Task(NamedTuple):
    """What stays fixed while the shapes of one output are searched.

    before_v : voltages (input, turn) that went before each record
    straight : the voltages behind the path (input, counted sample), about their mean in each record
    y : readings likewise (counted sample,); reach : half swing of each input (input,) [V]
    recent : columns of the shapes that were tried last
    """

    records: Sequence[Record]
    starts: Sequence[Start]
    late_v: tuple[Array, ...]
    before_v: tuple[Array, ...]
    filters: tuple[tuple[Filter, ...], ...]
    straight: Array
    y: Array
    reach: Array
    recent: _Recent

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        starts: Sequence[Start],
        delay_samples: int,
        through: Sequence[LinearBlock],
        o: int,
        reach: Array,
    ) -> _Task:
        """Prepare one output."""
        each = list(zip(records, starts, strict=True))
        late = tuple(np.ascontiguousarray(delayed(*one, delay_samples)) for one in each)
        p, m = len(records[0].y_um), len(reach)
        filters = tuple(tuple(path_filters(through, i, o, m, p)) for i in range(len(records)))
        y = [_centred(record.y_um[[o], start.first :]) for record, start in each]
        before = tuple(path_before(*one) for one in each)
        readings, none = np.hstack(y)[0], np.empty((0, 0))
        empty = cls(records, starts, late, before, filters, none, readings, reach, _Recent(m))
        return empty._replace(straight=empty._behind(late, [turns[:, -1] for turns in before]))

    def _behind(self, rows: Sequence[Array], held: Sequence[Array]) -> Array:
        """Rows of every record behind its path, about their means, over the samples that count.

        Before, each row was held at its own value.
        """
        found = []
        for x, own, start, filters in zip(rows, held, self.starts, self.filters, strict=True):
            for path in filters:
                passed, state = path.respond(x, path.settled(own))
                x = path.respond(x, state)[0] if start.kind == "repeated" else passed
            found.append(_centred(x[:, start.first :]))
        return np.hstack(found)

    def rates(self, shape: Array) -> tuple[Array, Array]:
        """Give beta + gamma and beta - gamma of every input [1/V]."""
        load = np.exp(shape[::2]) / self.reach
        return load, load * (2.0 * np.exp(shape[1::2]) - 1.0)

    def columns(self, shape: Array) -> Array:
        """Regressors of d and a (weight, sample), input after input."""
        rates = zip(*(each.tolist() for each in self.rates(shape)), strict=True)
        rows = [self.recent.column(k, own, partial(self._lag, k, own)) for k, own in enumerate(rates)]
        both = np.stack([self.straight, np.stack(rows)], axis=1)
        return both.reshape(2 * len(self.reach), -1)

    def _lag(self, k: int, rates: tuple[float, float]) -> Array:
        """Regressor of a (sample,) of input k, which has these rates [1/V]."""
        from hammerstein.hysteresis.bouc_wen_kernels import lagging

        rows, held = [], []
        for u, turns, start in zip(self.late_v, self.before_v, self.starts, strict=True):
            z, begun = np.empty_like(u[k]), np.empty_like(turns[k])
            first = lagging(turns[k], *rates, 0.0, turns[k, 0], begun)
            end = lagging(u[k], *rates, first, turns[k, -1], z)
            if start.kind == "repeated":
                lagging(u[k], *rates, end, u[k, -1], z)
            rows.append(-z[None])
            held.append(-begun[-1:])
        return np.asarray(self._behind(rows, held)[0])

    def residual(self, shape: Array) -> Array:
        """What the best d and a leave (sample,) [um]."""
        x = self.columns(shape)
        return np.asarray(self.y - coefficients(x @ x.T, x @ self.y) @ x)

    def error(self, shape: Array) -> float:
        """Sum of its squares."""
        return float(np.sum(self.residual(shape) ** 2))

    def solution(self, shape: Array, least: tuple[int, float] | None = None) -> Solution:
        """Give d and a of every input; the slopes of one may be bound to be above a least one."""
        x = self.columns(shape)
        bounds = None
        if least is not None:
            k, slope = least
            steepest = _steepest(shape[2 * k + 1])
            basis, side, bound = np.eye(len(x)), np.zeros(len(x)), np.zeros(len(x))
            own = slice(2 * k, 2 * k + 2)  # d and d - steepest a are the unknowns
            basis[own, own] = [[1.0, 0.0], [1.0 / steepest, -1.0 / steepest]]
            side[own], bound[own] = np.sign(slope), slope
            bounds = Bounds(basis, side, bound)
        freedom = len(self.y) - len(self.records)
        return solve(x @ x.T, x @ self.y, float(self.y @ self.y), freedom, bounds=bounds)

    def pairs(self, shape: Array, solution: Solution) -> tuple[BoucWenPair, ...]:
        """Pairs of all inputs."""
        numbers = zip(*self.rates(shape), np.reshape(solution.coefficients, (-1, 2)), strict=True)
        return tuple(
            BoucWenPair(float(d), float(a), float(0.5 * (load + unload)), float(0.5 * (load - unload)))
            for load, unload, (d, a) in numbers
        )


def _steepest(log_share: float) -> float:
    """Largest dz/du: 1 while z grows from zero, twice the share of beta where it falls from its limit."""
    return max(1.0, 2.0 * float(np.exp(log_share)))


def _centred(rows: Array) -> Array:
    return np.asarray(rows - rows.mean(axis=1, keepdims=True))

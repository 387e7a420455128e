"""Model selection by cross-validation: the simplest model, and the fewest operators, as good as the best."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import (
    AxesDynamics,
    Dynamics,
    LinearBlock,
    StateSpaceDynamics,
    StaticDynamics,
    discretise,
    split_delay,
)
from hammerstein.identification.options import Partition
from hammerstein.identification.score import Candidate, columns_of, ranges
from hammerstein.identification.static.initial_state import shortened
from hammerstein.identification.static.normal_equations import (
    FOLDS,
    PARTS,
    Moments,
    coefficients,
    left_out,
    moments_of_folds,
    pooled,
    refitted,
    squares_left,
)
from hammerstein.identification.static.regressors import (
    InitialState,
    PlayColumns,
    Regressors,
    behind_filters,
    delayed,
)
from hammerstein.identification.static.static_block import input_grids, path_filters
from hammerstein.records.record import Record

FELT = 0.02
"""Relative gain below which a parameter is not worth it, however significant."""
IMPROVED = 0.1
"""Relative decrease of the error from which a block improves the model."""
MOST_WORSE = 0.05
"""Relative excess over the least error for a simpler model if the difference may be chance."""
ROUNDING = 1e-14
"""Mean squared error in parts of the range that counts as none: normal equations in double precision tell
coefficients to the root of a rounding error, so that of models below it none is the better one."""
READINGS = 3
"""Readings that a free number must have at least: with fewer, folds that lie between those that were fitted
are guessed from their neighbours."""
CLOSE = (
    f"within {100.0 * FELT:.0f} % of the lowest, or within {100.0 * MOST_WORSE:.0f} % and one "
    "standard error of it"
)
NO_BETTER = f"better by at most {100.0 * FELT:.0f} % or one standard error"
"""Texts: condition on the rms error of a simpler model, and statement on the larger one."""


def lowers(rms: float, before: float, part: float = FELT) -> bool:
    """Whether an rms error is below another one by more than the relevant fraction.

    Examples
    --------
    >>> lowers(0.97, 1.0), lowers(0.99, 1.0), lowers(0.97, 1.0, IMPROVED)
    (True, False, False)
    """
    return rms <= (1.0 - part) * before


@dataclass(frozen=True, eq=False)
class Trial:
    """A model that was tried.

    Parameters
    ----------
    name : its parts in words
    parameters : number of free parameters
    squares : (fold,) mean squared error of the outputs relative to their ranges, on each fold; infinite where
        the prediction is not finite or the model unstable
    usable : whether its direct pairs and its linear block are invertible, and no parameter ends at a limit,
        where the records do not determine it
    told : whether the records identify its dynamics and have ``READINGS`` for every free parameter; if not,
        it is listed for comparison only
    kept : whether it is the chosen model
    """

    name: str
    parameters: int
    squares: Array
    usable: bool = True
    told: bool = True
    kept: bool = False

    @property
    def percent(self) -> float:
        """Rms error in percent of the range; infinite for a model that cannot be used.

        Examples
        --------
        >>> Trial("linear", 1, np.array([1e-4, 1e-4])).percent
        1.0
        """
        return 100.0 * math.sqrt(float(np.mean(self.squares)))

    @property
    def counted(self) -> Array:
        """Squares (fold,) for the comparison: errors at rounding level are equal."""
        return np.maximum(self.squares, ROUNDING)

    @property
    def mean(self) -> float:
        """Mean of the counted squares."""
        return float(np.mean(self.counted))


def chosen(trials: Sequence[Trial]) -> int:
    """Selected trial: the one with the fewest parameters whose rms error is ``CLOSE`` to the least.

    The standard error is that of the difference from the best, over the folds (Breiman et al., Classification
    and Regression Trees, 1984, section 3.4.3). Alone it is no criterion: in long records with little noise,
    the smallest gain is many standard errors. A model without an inverse, or with a parameter at a limit, is
    kept only if no model without such a fault is as good; that model may then exceed the 5 %.

    Examples
    --------
    >>> squares = np.array([1.0, 1.1, 0.9, 1.0])
    >>> linear, small = Trial("linear", 1, 9.0 * squares), Trial("small", 5, squares)
    >>> chosen([linear, small, Trial("large", 9, 0.8 * squares)])
    2
    >>> chosen([linear, small, Trial("large", 9, 0.99 * squares)])
    1
    >>> chosen([Trial("blocked", 1, squares, False), Trial("small", 5, squares[::-1])])
    1
    >>> chosen([Trial("exact", 9, 1e-24 * squares), Trial("exact to rounding", 5, 1e-18 * squares)])
    1
    """
    close = as_good(trials)
    usable = [i for i in close if trials[i].usable]
    if not usable:
        chance = [i for i in _by_chance(trials) if trials[i].usable]
        usable = sorted(chance, key=lambda i: trials[i].mean)[:1]
    return min(usable or close, key=lambda i: trials[i].parameters)


def least(trials: Sequence[Trial]) -> int:
    """Trial with the least error among the identified ones; the smallest if several are equal."""
    told = [i for i in range(len(trials)) if trials[i].told] or list(range(len(trials)))
    return min(told, key=lambda i: (trials[i].mean, trials[i].parameters))


def as_good(trials: Sequence[Trial]) -> list[int]:
    """Trials whose rms error is ``CLOSE`` to the least, itself among them."""
    best = trials[least(trials)]
    chance = _by_chance(trials)
    if not np.isfinite(best.mean):
        return chance
    return [i for i in chance if trials[i].mean <= (1.0 + MOST_WORSE) ** 2 * best.mean]


def _by_chance(trials: Sequence[Trial]) -> list[int]:
    """Trials whose error is within one standard error of the least or hardly above it, itself among them."""
    i = least(trials)
    best = trials[i]
    if not np.isfinite(best.mean):
        return [i]
    return [k for k, trial in enumerate(trials) if k == i or (trial.told and _is_as_good(trial, best))]


def _is_as_good(trial: Trial, best: Trial) -> bool:
    """Whether the best lowers the error of a trial by so little that it does not matter, or may be chance."""
    matters = (1.0 - FELT) ** 2 * trial.mean > best.mean
    return not matters or trial.mean - best.mean <= _spread(trial, best)


def _spread(trial: Trial, best: Trial) -> float:
    """Standard error of the mean difference of two trials; 0 where one of them cannot be used."""
    difference = trial.counted - best.counted
    if len(difference) < 2 or not np.isfinite(difference).all():
        return 0.0
    return float(np.std(difference, ddof=1)) / math.sqrt(len(difference))


def trial_of(
    name: str,
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    *,
    invertible: bool,
    told: bool = True,
) -> Trial:
    """Cross-validation errors of a model, and whether it is usable.

    told : whether the records identify its dynamics
    """
    told = told and enough_readings(candidate, records)
    squares = fold_squares(candidate, records, starts)
    return Trial(name, parameters_of(candidate), squares, invertible and not candidate.at_limit, told)


def enough_readings(candidate: Candidate, records: Sequence[Record]) -> bool:
    """Whether there are at least three readings per free parameter."""
    return READINGS * parameters_of(candidate) <= sum(record.y_um.size for record in records)


def parameters_of(candidate: Candidate) -> int:
    """Number of free parameters: weights, thresholds shared by the outputs, and the linear block."""
    hysteresis, dynamics = candidate.hysteresis, candidate.dynamics
    weights = sum(sum(row) for row in hysteresis.operators)
    thresholds = hysteresis.n_beside_weights
    if isinstance(dynamics, StaticDynamics):
        return weights + thresholds
    if isinstance(dynamics, AxesDynamics):
        return weights + thresholds + len(dynamics.free)
    block = dynamics.block()
    n, p = len(block.A), len(block.D)
    return weights + thresholds + n * (2 * p + 1)


def is_stable(dynamics: Dynamics, sample_time_s: float) -> bool:
    """Whether all poles of a linear block are inside the unit circle."""
    block = discretise(dynamics.model_copy(update={"input_delay_s": 0.0}), sample_time_s)
    return bool((np.abs(np.linalg.eigvals(block.A)) < 1.0).all())


def fold_squares(candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]) -> Array:
    """Squared errors (record and fold,) with the weights fitted to the other folds of the same records.

    Each record is cut into 16 parts, and every fourth part belongs to one fold, so that each fold contains
    cycles from the whole record. The other parameters stay fixed, and so do weights that the other folds do
    not determine; the operators run through all parts. The error is infinite for a model that cannot be used.
    Every kind of hysteresis is judged in this way; validation records do not affect the choice.
    """
    if not is_stable(candidate.dynamics, records[0].sample_time_s):
        return np.full(FOLDS * len(records), np.inf)
    if isinstance(candidate.dynamics, StateSpaceDynamics):  # not fitted again: its parts are too many
        return _unfitted_squares(candidate, records, starts)
    span = ranges(records, starts)
    total = np.zeros((len(records), FOLDS))
    for o, size in enumerate(span):
        parts = moments_of_output(candidate, records, starts, o)
        weights = candidate.hysteresis.weights[o]
        whole = pooled([part[f] for part in parts for f in part])
        for fold in range(FOLDS):
            others = [part[f] for part in parts for f in part if f != fold]
            found = refitted(pooled(others), whole, weights) if others else weights
            for i, part in enumerate(parts):
                test = part.get(fold)
                if test is not None:
                    left = max(_left(test, found), _left(test, weights))
                    total[i, fold] += left / test.samples / size**2 / len(span)
    return np.where(np.isfinite(total), total, np.inf).ravel()


def _left(test: Moments, weights: Array) -> float:
    return squares_left(test.gram, test.cross[:, 0], float(test.power[0]), weights)


def moments_of_output(
    candidate: Candidate,
    records: Sequence[Record],
    starts: Sequence[InitialState],
    o: int,
    parts: int = PARTS,
) -> list[Mapping[int, Moments]]:
    """Moments of each fold of each record with the columns of one output behind its path."""
    n = len(candidate.hysteresis.weights[o])
    found: list[Mapping[int, Moments]] = []
    for record, start in zip(records, starts, strict=True):
        blocks = behind_path(candidate, record, start, o, columns_of(candidate.hysteresis, record, start, o))
        found.append(moments_of_folds(blocks, record.y_um[[o]], start.first, n, parts))
    return found


def behind_path(
    candidate: Candidate, record: Record, start: InitialState, o: int, columns: Regressors
) -> Iterator[tuple[int, Array]]:
    """First sample and rows (column, sample) of blocks of columns behind the linear block and the sensor."""
    whole, part_s = split_delay(candidate.dynamics.input_delay_s, record.sample_time_s)
    paths = candidate.sensor.paths(candidate.dynamics.model_copy(update={"input_delay_s": part_s}), [record])
    return columns.blocks(start, whole, path_filters(paths, 0, o, len(record.y_um)))


def _unfitted_squares(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> Array:
    """Squared errors (record and fold,) of a model as it is."""
    span, found = ranges(records, starts), []
    for record, start in zip(records, starts, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            squares = ((candidate.residual(record, start) / span[:, None]) ** 2).mean(axis=0)
        parts = [float(part.mean()) for part in np.array_split(squares, PARTS)]
        found += [float(np.mean(parts[fold::FOLDS])) for fold in range(FOLDS)]
    values = np.array(found)
    return np.where(np.isfinite(values), values, np.inf)


COUNTS = (1, 2, 3, 4, 6, 8, 10, 12, 15, 20, 25, 30, 40, 60)
"""Numbers of operators that are tried."""
CURVE_SAMPLES = 50_000
"""Samples of all records together with which numbers of operators are compared."""
ENOUGH = 0.02
"""A number of operators is enough if its error is within this part of the least."""


@dataclass(frozen=True)
class CurvePoint:
    """Cross-validation errors with one number of operators.

    Parameters
    ----------
    operators : thresholds of each pair
    nrmse_percent : (output,) rms error in percent of the range
    """

    operators: int
    nrmse_percent: tuple[float, ...]

    @property
    def mean_percent(self) -> float:
        """Mean over the outputs."""
        return float(np.mean(self.nrmse_percent))


def error_curve(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    *,
    partition: Partition = "time",
    delay_samples: int = 0,
    through: Sequence[LinearBlock] = (),
) -> tuple[CurvePoint, ...]:
    """Cross-validation error against the number of operators.

    Each record is cut into 16 parts; every fourth part is a fold. The plays run through all of them.

    Parameters
    ----------
    records, starts : fitted records and their initial states
    partition : placement of the thresholds
    delay_samples : delay of the outputs in whole samples
    through : linear block of each record, if there is one
    """
    few, begun = shortened(records, starts, CURVE_SAMPLES)
    span = ranges(few, begun)
    points = []
    for n in COUNTS:
        grids = input_grids(few, n, partition)
        columns = sum(map(len, grids))
        squares = np.zeros(len(span))
        samples = 0
        for o in range(len(span)):
            parts = []
            for i, (record, start) in enumerate(zip(few, begun, strict=True)):
                filters = path_filters(through, i, o, len(span))
                plays = PlayColumns.of(delayed(record, start, delay_samples), start, grids)
                blocks = behind_filters(plays, start, filters)
                parts.append(moments_of_folds(blocks, record.y_um[[o]], start.first, columns, PARTS))
            whole = pooled([moments for part in parts for moments in part.values()])
            found = partial(refitted, whole=whole, weights=coefficients(whole.gram, whole.cross[:, 0]))
            squares[o], samples = left_out(parts, found)
        points.append(CurvePoint(n, tuple((100.0 * np.sqrt(squares / samples) / span).tolist())))
    return tuple(points)


def enough_operators(curve: Sequence[CurvePoint]) -> int:
    """Smallest number of operators whose cross-validation error is within two percent of the least.

    Examples
    --------
    >>> enough_operators([CurvePoint(1, (7.0,)), CurvePoint(8, (0.81,)), CurvePoint(15, (0.8,))])
    8
    """
    least = min(point.mean_percent for point in curve)
    return next(point.operators for point in curve if point.mean_percent <= (1.0 + ENOUGH) * least)

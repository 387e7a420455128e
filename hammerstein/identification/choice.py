"""Which of several models is kept: the simplest that is as good as the best, on what it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import (
    AxesDynamics,
    Dynamics,
    StateSpaceDynamics,
    StaticDynamics,
    discretise,
    split_delay,
)
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.score import Candidate, ranges
from hammerstein.identification.static.folds import FOLDS, moments_of_folds
from hammerstein.identification.static.normal_equations import Moments, coefficients, pooled, squares_left
from hammerstein.identification.static.regressors import Filter, Start, delayed, regressor_blocks
from hammerstein.identification.static.static_block import SlopeColumns, path_filters
from hammerstein.records.record import Record

PARTS = 16
"""Parts into which every record falls; where no record is held back, every fourth is left out in turn."""
FELT = 0.02
"""Part of the error that a gain must be to matter: less is not worth a parameter, however sure it is."""
MOST_WORSE = 0.05
"""Part of the least error by which a simpler model may leave more where the difference may be chance."""
CLOSE = (
    f"within {100.0 * FELT:.0f} % of the least, or within {100.0 * MOST_WORSE:.0f} % and one standard error "
    "of it"
)
NO_BETTER = f"no better by more than {100.0 * FELT:.0f} % or chance"
"""The same in words: rms error of a simpler model that is kept, and what is said of the larger one."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A model that was tried.

    Parameters
    ----------
    name : what it consists of
    parameters : free numbers in it
    squares : (part,) mean squared error of the outputs in parts of their ranges, on each judged part;
        infinite where the prediction is not finite or the model unstable
    invertible : whether its main pairs and its linear block can be inverted
    told : whether the records tell the dynamics that it has; if not, it is only there to compare with
    kept : whether it is the model that is returned
    """

    name: str
    parameters: int
    squares: Array
    invertible: bool = True
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


def chosen(trials: Sequence[Trial]) -> int:
    """Trial to keep: the one with the fewest parameters whose rms error is ``CLOSE`` to the least.

    The standard error is that of the difference to the best, from part to part (Breiman et al.,
    Classification and Regression Trees, 1984, section 3.4.3). Alone it is no measure: in long records of
    little noise the smallest gain is many of them. A model without an inverse is kept only where none with an
    inverse is as good, which then may leave more than the 5 %.

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
    """
    best = least(trials)
    means = np.array([float(np.mean(trial.squares)) for trial in trials])
    if not np.isfinite(means[best]):
        return best
    chance = as_good(trials)
    close = [i for i in chance if means[i] <= (1.0 + MOST_WORSE) ** 2 * means[best]]
    usable = [i for i in close if trials[i].invertible]
    if not usable:
        usable = sorted((i for i in chance if trials[i].invertible), key=lambda i: means[i])[:1]
    return min(usable or close, key=lambda i: trials[i].parameters)


def least(trials: Sequence[Trial]) -> int:
    """Trial with the least error, of those whose dynamics the records tell."""
    told = [i for i in range(len(trials)) if trials[i].told]
    return min(told, key=lambda i: float(np.mean(trials[i].squares)))


def as_good(trials: Sequence[Trial]) -> list[int]:
    """Trials whose error is within one standard error of the least or hardly above it, itself among them."""
    i = least(trials)
    best = trials[i]
    if not np.isfinite(best.squares).all():
        return [i]
    return [i for i, trial in enumerate(trials) if trial.told and _is_as_good(trial, best)]


def _is_as_good(trial: Trial, best: Trial) -> bool:
    """Whether the best lowers the error of a trial by so little that it does not matter, or may be chance."""
    matters = (1.0 - FELT) * trial.percent > best.percent
    return not matters or float(np.mean(trial.squares) - np.mean(best.squares)) <= _spread(trial, best)


def _spread(trial: Trial, best: Trial) -> float:
    """Standard error of the mean difference of two trials; 0 where one of them cannot be used."""
    difference = trial.squares - best.squares
    if len(difference) < 2 or not np.isfinite(difference).all():
        return 0.0
    return float(np.std(difference, ddof=1)) / math.sqrt(len(difference))


def parameters_of(candidate: Candidate) -> int:
    """Free numbers of a model: weights, thresholds that are shared by the outputs, and the linear block."""
    hysteresis, dynamics = candidate.hysteresis, candidate.dynamics
    weights = sum(sum(row) for row in hysteresis.operators)
    thresholds = hysteresis.n_beside_weights
    if isinstance(dynamics, StaticDynamics):
        return weights + thresholds
    if isinstance(dynamics, AxesDynamics):
        each = [
            2 * (a.resonance_hz is not None) + (a.lag_s is not None) + 2 * len(a.creep) for a in dynamics.axes
        ]
        return weights + thresholds + sum(each)
    n, p = len(dynamics.A), len(dynamics.D)
    return weights + thresholds + n * (2 * p + 1)


def is_stable(dynamics: Dynamics, sample_time_s: float) -> bool:
    """Whether a linear block forgets: all poles inside the unit circle."""
    block = discretise(dynamics.model_copy(update={"input_delay_s": 0.0}), sample_time_s)
    return bool((np.abs(np.linalg.eigvals(block.A)) < 1.0).all())


def judged_squares(candidate: Candidate, records: Sequence[Record], starts: Sequence[Start]) -> Array:
    """Squared errors (part,) on records held back; infinite for a model that cannot be used."""
    span = ranges(records, starts)
    if not is_stable(candidate.dynamics, records[0].sample_time_s):
        return np.full(PARTS * len(records), np.inf)
    found = []
    for record, start in zip(records, starts, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):
            squares = ((candidate.residual(record, start) / span[:, None]) ** 2).mean(axis=0)
        found += [float(part.mean()) for part in np.array_split(squares, PARTS)]
    values = np.array(found)
    return np.where(np.isfinite(values), values, np.inf)


def crossed_squares(candidate: Candidate, records: Sequence[Record], starts: Sequence[Start]) -> Array:
    """Squared errors (record and fold,) where the weights were fitted to the other folds of the same records.

    Each record falls into 16 parts, every fourth of which is one fold: cycles of an experiment lie on
    both sides. Thresholds and linear block stay as they are; the plays run through all parts.
    """
    if isinstance(candidate.dynamics, StateSpaceDynamics):  # not fitted again: its parts are too many
        each = judged_squares(candidate, records, starts).reshape(len(records), -1, FOLDS)
        return np.asarray(each.mean(axis=1).ravel())
    if not is_stable(candidate.dynamics, records[0].sample_time_s):
        return np.full(FOLDS * len(records), np.inf)
    span, p = ranges(records, starts), len(records[0].y_um)
    assert isinstance(candidate.hysteresis, PrandtlIshlinskii)  # other kinds take their place afterwards
    layout = SlopeColumns.of([[pair.thresholds_v for pair in row] for row in candidate.hysteresis.pairs])
    columns = sum(map(len, layout.grids))
    whole, part_s = split_delay(candidate.dynamics.input_delay_s, records[0].sample_time_s)
    prompt = candidate.dynamics.model_copy(update={"input_delay_s": part_s})
    blocks = candidate.sensor.paths(prompt, records)
    total = np.zeros((len(records), FOLDS))
    for o in range(p):
        merge = layout.merge[o]
        parts = [
            _folds(record, start, layout, whole, path_filters(blocks, i, o, columns, p), o)
            for i, (record, start) in enumerate(zip(records, starts, strict=True))
        ]
        for fold in range(FOLDS):
            train = pooled([part[f] for part in parts for f in part if f != fold])
            found = merge @ coefficients(merge.T @ train.gram @ merge, merge.T @ train.cross[:, 0])
            for i, part in enumerate(parts):
                test = part.get(fold)
                if test is not None:
                    left = squares_left(test.gram, test.cross[:, 0], float(test.power[0]), found)
                    total[i, fold] += left / test.samples / span[o] ** 2 / p
    return total.ravel()


def _folds(
    record: Record, start: Start, layout: SlopeColumns, delay: int, filters: Sequence[Filter], o: int
) -> Mapping[int, Moments]:
    """Moments of each fold of one record."""
    blocks = regressor_blocks(delayed(record, start, delay), start, layout.grids, filters)
    columns = sum(map(len, layout.grids))
    return moments_of_folds(blocks, record.y_um[[o]], start.first, columns, PARTS)

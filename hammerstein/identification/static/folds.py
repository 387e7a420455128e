"""Cross-validation folds: parts of records that are excluded in turn."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.identification.static.normal_equations import (
    Moments,
    coefficients,
    moments_of,
    pooled,
    squares_left,
)

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

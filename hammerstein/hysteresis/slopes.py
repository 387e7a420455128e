"""Slope matrices that multivariable hysteresis can have."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import Hysteresis, slopes_of

LARGEST_NUMBER = 2_000_000
"""Combinations of slopes that are written down: 16 MB a pair."""


def slope_matrices(hysteresis: Hysteresis[Any], amplitude_v: float) -> Array:
    """All slope matrices J (combination, output, input) [um/V].

    Column k is a slope of all outputs while input k moves; every combination of columns can occur.

    amplitude_v : of the loops along which slopes are taken, for a kind that does not know all of its own [V]

    Raises SimulationError where there are too many to examine.
    """
    columns = [slopes_of(hysteresis, k, amplitude_v) for k in range(hysteresis.n_inputs)]
    return every_matrix(columns)


def outermost(columns: Array) -> Array:
    """Columns (choice, row) between which all others lie; all where they have no volume."""
    if columns.shape[1] == 1:
        return np.unique([columns.min(axis=0), columns.max(axis=0)], axis=0)
    from scipy.spatial import ConvexHull, QhullError

    found = np.unique(columns, axis=0)
    if len(found) <= columns.shape[1] + 1:
        return found
    try:
        return np.asarray(found[ConvexHull(found).vertices])
    except QhullError:
        return found


def every_matrix(columns: Sequence[Array]) -> Array:
    """Every matrix (combination, row, input) with one of the columns (choice, row) of each input."""
    if any(len(column) == 0 for column in columns):
        raise SimulationError("An input moves no output, so the model has no inverse.")
    number = int(np.prod([len(column) for column in columns], dtype=float))
    if number > LARGEST_NUMBER:
        raise SimulationError(
            f"The model has {number} slope matrices, too many to examine; use fewer operators."
        )
    indices = np.array(list(itertools.product(*(range(len(column)) for column in columns))))
    return np.stack([column[i] for column, i in zip(columns, indices.T, strict=True)], axis=2)

"""Slope matrices that a model of plays and dead-zones can have."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hammerstein.blocks import Array
from hammerstein.errors import SimulationError
from hammerstein.hysteresis.asymmetric import Asymmetric
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii

LARGEST_NUMBER = 2_000_000


def slope_matrices(hysteresis: PrandtlIshlinskii | Asymmetric) -> Array:
    """All slope matrices J (combination, output, input) [um/V].

    Column k is the slope of all outputs while the first 1, 2, ..., n_k operators of input k move, in every
    zone of its dead-zones; every combination of columns can occur.

    Raises SimulationError where there are too many to examine.
    """
    return every_matrix([hysteresis.slope_columns(k) for k in range(hysteresis.n_inputs)])


def every_matrix(columns: Sequence[Array]) -> Array:
    """Every matrix (combination, row, input) with one of the columns (choice, row) of each input."""
    if any(len(column) == 0 for column in columns):
        raise SimulationError("An input moves no output: the model has no inverse.")
    number = int(np.prod([len(column) for column in columns], dtype=float))
    if number > LARGEST_NUMBER:
        raise SimulationError(
            f"The model has {number} slope matrices, too many to examine; use fewer operators."
        )
    indices = np.array(list(itertools.product(*(range(len(column)) for column in columns))))
    return np.stack([column[i] for column, i in zip(columns, indices.T, strict=True)], axis=2)

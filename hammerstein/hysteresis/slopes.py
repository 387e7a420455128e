"""Slope matrices that a multivariable Prandtl-Ishlinskii model can have."""

from __future__ import annotations

import itertools

import numpy as np

from hammerstein.blocks import Array
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import PrandtlIshlinskii

LARGEST_NUMBER = 2_000_000


def slope_matrices(hysteresis: PrandtlIshlinskii) -> Array:
    """All slope matrices J (combination, output, input) [um/V].

    Column k is the slope of all outputs while the first 1, 2, ..., n_k operators of input k move; every
    combination of prefixes can occur.

    Raises SimulationError where there are too many to examine.
    """
    columns = [hysteresis.slope_columns(k) for k in range(hysteresis.n_inputs)]
    if any(len(column) == 0 for column in columns):
        raise SimulationError("An input moves no output: the model has no inverse.")
    number = int(np.prod([len(column) for column in columns], dtype=float))
    if number > LARGEST_NUMBER:
        raise SimulationError(
            f"The model has {number} slope matrices, too many to examine; use fewer operators."
        )
    indices = np.array(list(itertools.product(*(range(len(column)) for column in columns))))
    return np.stack([column[i] for column, i in zip(columns, indices.T, strict=True)], axis=2)

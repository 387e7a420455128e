"""Thresholds from a fine grid: coordinate exchange to the position of lowest error.

The error has many local minima over the thresholds: two thresholds may share a span where one is needed while
another span has none. Descent cannot move from one such minimum to another, but an exchange can (sequential
replacement: Miller, Subset Selection in Regression, 2002, section 3.4). The sums over the samples are
computed once for the fine grid; a play enters or leaves the regression by one sweep of their matrix
(Goodnight, Am. Stat. 33 (1979) 149-158).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from hammerstein.arrays import Array
from hammerstein.identification.static.normal_equations import Moments

Indices = NDArray[np.intp]

FINE_COLUMNS = 96  # places tried in all
LEAST_FINER, MOST_FINER = 3, 8
"""Places tried between neighbouring thresholds: so many that there are about 96 in all, but 3 to 8."""
WORTHWHILE = 1e-3
"""Part of the error that an exchange must gain."""
LEAST_GAP = 1e-3
"""Least distance of the last threshold from the largest half swing, in parts of it."""
LEAST_OWN = 1e-11
"""Part of a play's power that must not be explained by the chosen ones: less is rounding."""


def price(numbers: int, readings: int) -> float:
    """Part of the squared error that some fitted numbers must save, as a threshold with its weights.

    This is the criterion of Schwarz (Ann. Stat. 6 (1978) 461-464).

    Parameters
    ----------
    numbers : one for a threshold, and its weight for each output
    readings : samples of all outputs
    """
    return numbers * math.log(readings) / readings


def finer(grid: Array, reach_v: float) -> Array:
    """Grid from 0 to below the largest half swing that holds the given thresholds [V].

    Examples
    --------
    >>> finer(np.array([4.0]), 8.0)
    array([0. , 0.5, 1. , 1.5, 2. , 2.5, 3. , 3.5, 4. , 4.5, 5. , 5.5, 6. ,
           6.5, 7. , 7.5])
    """
    if not grid.size:
        return grid
    parts = int(np.clip(round(FINE_COLUMNS / grid.size), LEAST_FINER, MOST_FINER))
    ends = np.concatenate([[0.0], grid, [reach_v]])
    between = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(parts) / parts)
    return np.unique(between[(between <= (1.0 - LEAST_GAP) * reach_v) | np.isin(between, grid)])


def exchanged(
    moments: Sequence[Moments], fine: Sequence[Array], grids: Sequence[Array], unit: Array
) -> tuple[Array, ...]:
    """Thresholds of each input after all exchanges that lower the error; useless ones are removed.

    Parameters
    ----------
    moments : of each output with the differences of the plays of the fine grids
    fine : fine grid of each input [V]
    grids : thresholds of each input to begin with [V], all in the fine grids
    unit : (output,) squared error [um^2] that counts as one
    """
    sizes = [len(grid) for grid in fine]
    owner = np.repeat(np.arange(len(fine)), sizes)
    r = np.concatenate(fine)
    chosen = np.flatnonzero(np.concatenate([np.isin(*both) for both in zip(fine, grids, strict=True)]))
    swept = _within(moments, sizes, unit, chosen)
    for _ in range(2 * len(chosen)):
        found = _best(swept, owner, chosen)
        if found is None:
            break
        leaves, enters = found
        for matrix in swept:
            _sweep(matrix, chosen[leaves], -1.0)
            _sweep(matrix, enters, 1.0)
        chosen[leaves] = enters
    chosen = _worth(swept, owner, chosen, price(1 + len(moments), len(moments) * moments[0].freedom))
    return tuple(np.sort(r[chosen[owner[chosen] == k]]) for k in range(len(fine)))


def losses(moments: Sequence[Moments], grids: Sequence[Array], unit: Array) -> Array:
    """Increase of the squared error (threshold,) if one play is removed and all others are kept.

    Parameters
    ----------
    moments : of each output with the differences of the plays
    grids : thresholds of each input [V]; the only one of an input does not leave, at any price
    unit : (output,) squared error [um^2] that counts as one
    """
    sizes = [len(grid) for grid in grids]
    owner, chosen = np.repeat(np.arange(len(sizes)), sizes), np.arange(sum(sizes))
    return _lost(_within(moments, sizes, unit, chosen), owner, chosen)


def _within(moments: Sequence[Moments], sizes: Sequence[int], unit: Array, chosen: Indices) -> list[Array]:
    """Products of each output after the chosen plays entered the regression."""
    swept = [_scaled(moment, sizes, float(u)) for moment, u in zip(moments, unit, strict=True)]
    for matrix in swept:
        for j in chosen:
            _sweep(matrix, j, 1.0)
    return swept


def _lost(swept: Sequence[Array], owner: Indices, chosen: Indices) -> Array:
    """Squared error (chosen,) that comes back with each one; infinite for the only one of an input."""
    lost = np.sum([matrix[chosen, -1] ** 2 / -np.diag(matrix)[chosen] for matrix in swept], axis=0)
    return np.where(np.bincount(owner[chosen])[owner[chosen]] == 1, np.inf, lost)


def _worth(swept: Sequence[Array], owner: Indices, chosen: Indices, least: float) -> Indices:
    """The chosen plays without those that explain too little; every input keeps one."""
    while True:
        lost = _lost(swept, owner, chosen)
        i = int(np.argmin(lost))
        if not lost[i] < least * sum(float(matrix[-1, -1]) for matrix in swept):
            return chosen
        for matrix in swept:
            _sweep(matrix, chosen[i], -1.0)
        chosen = np.delete(chosen, i)


def _scaled(moment: Moments, sizes: Sequence[int], unit: float) -> Array:
    """Products of all plays, scaled to unit columns, and of the output in the last row and column.

    A play is the sum of the differences from its own on.
    """
    sums = np.asarray(block_diag(*[np.triu(np.ones((n, n))) for n in sizes if n]))
    gram = sums @ moment.gram @ sums.T
    norm = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    n = len(gram)
    matrix = np.empty((n + 1, n + 1))
    matrix[:n, :n] = gram / np.outer(norm, norm)
    matrix[:n, n] = matrix[n, :n] = (sums @ moment.cross[:, 0]) / norm / np.sqrt(unit)
    matrix[n, n] = moment.power[0] / unit
    return matrix


def _sweep(matrix: Array, j: int, way: float) -> None:
    """Let column j enter the regression (way 1) or leave it (way -1), in place.

    For columns j within it, row j holds the coefficients of all others, and the diagonal minus the inverse;
    the rest of the matrix holds the products of what these leave.
    """
    own = matrix[j, j]
    if way * own <= 0.5 * LEAST_OWN and way > 0.0:
        own = LEAST_OWN
    column = matrix[:, j].copy()
    matrix -= np.outer(column, column / own)
    matrix[:, j] = matrix[j] = way * column / own
    matrix[j, j] = -1.0 / own


def _best(swept: Sequence[Array], owner: Indices, chosen: Indices) -> tuple[int, int] | None:
    """Which of the chosen leaves and which column enters, of one input; None if no exchange is worth it."""
    lost = np.zeros((len(chosen), 1))
    gain = np.zeros((len(chosen), len(owner)))
    left = 0.0
    for matrix in swept:
        inverse, weights = -np.diag(matrix)[chosen, None], matrix[chosen, -1:]
        shares = matrix[chosen, :-1]
        own = np.diag(matrix)[:-1] + shares**2 / inverse
        told = matrix[-1, :-1] + shares * weights / inverse
        lost += weights**2 / inverse
        gain += np.where(own > LEAST_OWN, told**2 / np.maximum(own, LEAST_OWN), 0.0)
        left += float(matrix[-1, -1])
    gain[owner[chosen][:, None] != owner] = 0.0
    gain[:, chosen] = 0.0
    change = lost - gain
    leaves, enters = np.unravel_index(int(np.argmin(change)), change.shape)
    worthwhile = change[leaves, enters] < -WORTHWHILE * max(left, 0.0)
    return (int(leaves), int(enters)) if worthwhile else None

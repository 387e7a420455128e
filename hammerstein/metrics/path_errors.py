"""Figures of the error of a whole path, found in one pass; ``arrays`` says what each of them is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hammerstein.arrays import Array


@dataclass(frozen=True)
class PathErrors:
    """How far a path is from what it is compared with [um].

    rms, worst : (output,) root mean square and largest absolute error of each axis
    distance_rms, distance_worst : the same of the distance over all axes
    """

    rms: tuple[float, ...]
    worst: tuple[float, ...]
    distance_rms: float
    distance_worst: float

    @classmethod
    def of(cls, path: Array, target: Array) -> Self:
        """Errors of a path (output, sample) against a target (output, sample) [um]."""
        from hammerstein.metrics.error_sums_kernel import error_sums

        squares, largest = np.zeros(len(path) + 1), np.zeros(len(path) + 1)
        error_sums(_rows(path), _rows(target), squares, largest)
        *each, whole = np.sqrt(squares / path.shape[1]).tolist()
        *worst, farthest = np.sqrt(largest).tolist()
        return cls(tuple(each), tuple(worst), whole, farthest)


@dataclass(frozen=True)
class PlaneErrors:
    """Largest errors of the radius of a path of two axes [um], of reading and position."""

    radial: float
    radial_true: float

    @classmethod
    def of(cls, reference: Array, reading: Array, position: Array, middle: Array) -> Self:
        """Errors of reading and position (2, sample) against a reference, all counted from a middle (2,)."""
        from hammerstein.metrics.error_sums_kernel import plane_errors

        rows = (*_rows(reference), *_rows(reading), *_rows(position))
        radial, true = plane_errors(*rows, middle)
        return cls(float(radial), float(true))


def _rows(wire: Array) -> tuple[Array, ...]:
    """Rows of a wire one by one: those of a part of it lie in one piece each, the part does not."""
    return tuple(np.ascontiguousarray(row) for row in wire)

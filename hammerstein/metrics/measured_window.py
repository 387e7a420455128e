"""The measured window of one case and its errors, from which every figure of merit is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array
from hammerstein.metrics.arrays import LoopFigures, euclidean


@dataclass(frozen=True)
class PathErrors:
    """Errors of a path against its reference or prediction [um].

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


RECOVERY_S = 0.01  # a cut voltage leaves a resonance ringing


@dataclass(frozen=True, eq=False)
class Measured:
    """The wires of one case over the samples that are measured, and what they are compared with.

    reading_um, position_um : (output, sample) what the sensor says, and where the actuator is [um]
    saturated : (input, sample) where the drive's range cut the voltage
    target_reading_um, target_position_um : (output, sample) what reading and position are compared with: a
        reference, or the prediction of a model [um]; None where there is nothing
    reference_um : (output, sample) path that was asked for [um], where all axes are driven together
    cycle_samples : samples of a cycle, where several equal ones of a whole number of samples are measured
    middle_um : (output,) middle of that path [um]; zero if not given
    loops : (output,) loops of the readings against the one signal that is driven, where there is one
    """

    sample_time_s: float
    reading_um: Array
    position_um: Array
    saturated: NDArray[np.bool_]
    target_reading_um: Array | None = None
    target_position_um: Array | None = None
    reference_um: Array | None = None
    cycle_samples: int | None = None
    loops: Sequence[LoopFigures] | None = None
    middle_um: Array | None = None

    @cached_property
    def error_um(self) -> Array | None:
        """Reading minus reference or prediction (output, sample) [um]."""
        return None if self.target_reading_um is None else self.reading_um - self.target_reading_um

    @cached_property
    def true_error_um(self) -> Array | None:
        """True position minus reference or prediction (output, sample) [um]."""
        return None if self.target_position_um is None else self.position_um - self.target_position_um

    @cached_property
    def true_distance_um(self) -> Array | None:
        """Distance (sample,) of the true position from reference or prediction [um]."""
        return None if self.true_error_um is None else euclidean(self.true_error_um)

    @cached_property
    def errors(self) -> PathErrors | None:
        """How far the reading is from what it is compared with; None where there is nothing."""
        target = self.target_reading_um
        return None if target is None else PathErrors.of(self.reading_um, target)

    @cached_property
    def true_errors(self) -> PathErrors | None:
        """The same of the true position."""
        target = self.target_position_um
        return None if target is None else PathErrors.of(self.position_um, target)

    @cached_property
    def in_the_plane(self) -> PlaneErrors | None:
        """Reading and position against the path that was asked for; None where that has not two axes."""
        if self.reference_um is None or len(self.reference_um) != 2:
            return None
        return PlaneErrors.of(self.reference_um, self.reading_um, self.position_um, self.middle)

    @property
    def middle(self) -> Array:
        """Middle (output,) of the path [um], from which radii are counted."""
        return np.zeros(len(self.reading_um)) if self.middle_um is None else self.middle_um

    @cached_property
    def unsaturated(self) -> NDArray[np.bool_]:
        """Samples (sample,) at which no voltage is cut, nor was within the last ``RECOVERY_S``."""
        if not self.saturated.any():
            return np.ones(self.saturated.shape[1], dtype=np.bool_)
        cut = np.asarray(self.saturated.any(axis=0), dtype=np.float64)
        recovery = np.ones(round(RECOVERY_S / self.sample_time_s) + 1)
        return np.asarray(np.convolve(cut, recovery)[: cut.size] < 0.5)

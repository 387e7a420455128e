"""Joint covariance of all parameters of a model, and random actuators drawn from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from hammerstein.arrays import Array, ByValue, freeze_fields, frozen
from hammerstein.dynamics import AxesDynamics, Axis, Dynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Hysteresis, Normals
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.hysteresis.kind import PartFile, lower_rows, lower_triangle
from hammerstein.quantities import Entry, NoCycles


@dataclass(frozen=True, eq=False)
class ParameterCovariance(ByValue):
    """Covariance of the parameters other than weights, and sensitivity of the weights to them.

        x + d,   w + M d + (error of the weights for given x),   cov d = L L^T

    x are places and free numbers of the hysteresis, such as thresholds, then those of the axes: ln resonance,
    ln damping, ln time constant of a low-pass, gain and ln time constant of each slow mode.

    Parameters
    ----------
    factor : (number, number) lower triangle L, in the units of the numbers
    following : (output,) matrices M (weight, number)
    fitted : indices of the fitted numbers; the others were given, and their errors explain the residual of
        the records
    open : indices of fitted numbers that the records do not determine better than the neighbours do
    degrees : degrees of freedom of the draws, Student's t; 0 for normal ones
    """

    factor: Array
    following: tuple[Array, ...]
    fitted: tuple[int, ...] = ()
    open: tuple[int, ...] = ()
    degrees: int = 0

    def __post_init__(self) -> None:
        freeze_fields(self, "factor")
        object.__setattr__(self, "following", tuple(map(frozen, self.following)))
        if not all(np.isfinite(matrix).all() for matrix in (self.factor, *self.following)):
            raise InputError("covariance", "holds a value that is not finite")

    @property
    def errors(self) -> Array:
        """Standard errors (number,)."""
        return np.asarray(np.linalg.norm(self.factor, axis=1))

    def weight_errors(self, given: Sequence[Array]) -> tuple[Array, ...]:
        """Standard errors of the weights of each output [um/V], from those for given numbers beside them."""
        moved = [np.linalg.norm(m @ self.factor, axis=1) for m in self.following]
        return tuple(np.hypot(own, follow) for own, follow in zip(given, moved, strict=True))

    def beside_creep(self, before: Dynamics, after: AxesDynamics) -> ParameterCovariance:
        """Return the same for axes with additional slow modes, which are held constant."""
        axes = before.axes if isinstance(before, AxesDynamics) else (Axis(),) * len(after.axes)
        free = np.array([len(axis.free) for axis in axes])
        ends = len(self.factor) - free.sum() + np.cumsum(free)
        counts = np.array([len(axis.free) for axis in after.axes]) - free
        at = np.repeat(ends, counts)
        moved = np.arange(len(self.factor)) + np.searchsorted(at, np.arange(len(self.factor)), side="right")
        factor = np.insert(np.insert(self.factor, at, 0.0, axis=0), at, 0.0, axis=1)
        following = tuple(np.insert(one, at, 0.0, axis=1) for one in self.following)
        fitted, open_ = (tuple(moved[list(one)].tolist()) for one in (self.fitted, self.open))
        return ParameterCovariance(factor, following, fitted, open_, self.degrees)

    def misfit(self, hysteresis: Hysteresis[Any], dynamics: Dynamics) -> str | None:
        """Reason why it does not fit a model; empty if it does."""
        size, counts = len(beside_weights(hysteresis, dynamics)), [len(w) for w in hysteresis.weights]
        if len(self.factor) != size or [m.shape for m in self.following] != [(n, size) for n in counts]:
            return f"must have {size} rows, and for each of {len(counts)} outputs {size} numbers a weight"
        if not all(0 <= i < size for i in (*self.fitted, *self.open)):
            return f"names a number beyond the {size} numbers other than weights"
        return None


def beside_weights(hysteresis: Hysteresis[Any], dynamics: Dynamics) -> Array:
    """Parameters (number,) other than weights: places and free ones of the hysteresis, then the axes."""
    own = (*hysteresis.places, hysteresis.free) if isinstance(hysteresis, Identifiable) else ()
    axes = dynamics.free if isinstance(dynamics, AxesDynamics) else np.empty(0)
    return np.concatenate([*own, axes])


def with_beside_weights(
    hysteresis: Hysteresis[Any], dynamics: Dynamics, x: Array
) -> tuple[Hysteresis[Any], Dynamics]:
    """Return both blocks with other values of these parameters."""
    if isinstance(hysteresis, Identifiable):
        ends = np.cumsum([len(part) for part in (*hysteresis.places, hysteresis.free)])
        *places, free, x = np.split(x, ends)
        moved: Any = hysteresis.at_places(places) if places else hysteresis
        hysteresis = moved.at(free) if len(free) else moved
    return hysteresis, dynamics.at(x) if isinstance(dynamics, AxesDynamics) else dynamics


def drawn_blocks(
    hysteresis: Hysteresis[Any], dynamics: Dynamics, known: ParameterCovariance | None, generator: Normals
) -> tuple[Hysteresis[Any], Dynamics]:
    """Return random blocks, drawn with the errors of the parameters.

    known : covariance of the other parameters, which stay as they are if it is not given

    Raises InputError where the covariance of the weights is not known.
    """
    if known is None:
        return hysteresis.drawn(generator), dynamics
    normal = generator.standard_normal(len(known.factor))
    n = known.degrees
    size = math.sqrt(n / np.sum(generator.standard_normal(n) ** 2)) if n else 1.0
    change = size * known.factor @ normal
    each = zip(hysteresis.weights, hysteresis.drawn(generator).weights, known.following, strict=True)
    weights = [w + size * (own - w) + follow @ change for w, own, follow in each]
    moved, axes = with_beside_weights(hysteresis, dynamics, beside_weights(hysteresis, dynamics) + change)
    return moved.with_weights(weights), axes


class ParameterCovarianceFile(PartFile):
    """Covariance L L^T of the parameters other than weights, and sensitivity of the weights to them."""

    factor: Annotated[tuple[tuple[Entry, ...], ...], BeforeValidator(lower_rows)] = Field(
        description="rows of L, each up to its diagonal"
    )
    following: tuple[tuple[tuple[Entry, ...], ...], ...] = Field(
        description="for each output, one row for each weight: its change with each number"
    )
    fitted: tuple[NoCycles, ...] = Field(
        default=(), description="fitted numbers, counted from 0; the others were given"
    )
    open: tuple[NoCycles, ...] = Field(
        default=(), description="fitted numbers that the records do not determine, counted from 0"
    )
    degrees: int = Field(
        default=0,
        ge=0,
        le=1000,
        description="degrees of freedom of the draws, Student's t; 0 for normal ones",
    )

    def value(self) -> ParameterCovariance:
        """Return the covariance this describes."""
        n = len(self.factor)
        if any(len(row) != n for matrix in self.following for row in matrix):
            raise InputError("covariance", f"must have rows of {n} numbers for each output")
        following = tuple(np.array(matrix, dtype=float).reshape(len(matrix), n) for matrix in self.following)
        factor = lower_triangle("covariance", self.factor)
        return ParameterCovariance(factor, following, self.fitted, self.open, self.degrees)

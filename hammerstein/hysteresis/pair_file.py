"""Pairs and the covariance of their weights, as model files hold them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis.kind import refuse_unbuilt
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.quantities import NoCycles, Threshold, Weight, WeightError
from hammerstein.validation import Strict


class PartFile(Strict):
    """A part of a hysteresis in a model file; also made of the part itself, whose names it has."""

    model_config = ConfigDict(from_attributes=True)

    describes: ClassVar[Callable[..., Any]]
    """What makes the part of its own fields, by their names."""

    def value(self) -> Any:
        """Return the part this describes; InputError where it is none."""
        return self.describes(**self.model_dump())

    @model_validator(mode="after")
    def _is_a_part(self) -> Self:
        refuse_unbuilt(self.value)
        return self


class PairFile(PartFile):
    """One pair in a model file."""

    describes: ClassVar = Pair
    thresholds_v: tuple[Threshold, ...]
    weights_um_per_v: tuple[Weight, ...]
    weight_errors_um_per_v: tuple[WeightError, ...] | None = None


def lower_rows(factor: Any) -> Any:
    """Rows of a lower triangle, each up to its diagonal."""
    return [row[: i + 1] for i, row in enumerate(factor)] if isinstance(factor, np.ndarray) else factor


class CovarianceFile(PartFile):
    """Covariance L L^T of all weights of one output, pair after pair in the order of the inputs."""

    factor_um_per_v: Annotated[tuple[tuple[Weight, ...], ...], BeforeValidator(lower_rows)] = Field(
        description="rows of L, each up to its diagonal"
    )
    slopes_at_bound: NoCycles = Field(
        default=0, description="slopes at a bound of the fit: the covariance is that of the other slopes"
    )

    def value(self) -> WeightCovariance:
        """Return the covariance this describes."""
        return WeightCovariance(
            lower_triangle("weight_covariance", self.factor_um_per_v), self.slopes_at_bound
        )


def described(files: Any) -> Any:
    """What files of parts describe, in the same rows; None where there are none."""
    if files is None:
        return None
    return files.value() if isinstance(files, PartFile) else tuple(map(described, files))


def lower_triangle(where: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Lower triangle with zeros above, from what ``lower_rows`` gave."""
    n = len(rows)
    if [len(row) for row in rows] != list(range(1, n + 1)):
        raise InputError(where, "row i of a factor must hold i numbers, up to its diagonal")
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = [value for row in rows for value in row]
    return square

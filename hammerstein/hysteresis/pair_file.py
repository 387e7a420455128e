"""Pairs and the covariance of their weights, as model files hold them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis.kind import refuse_unbuilt
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.quantities import NoCycles, Threshold, Weight, WeightError
from hammerstein.validation import Strict


class PartFile(Strict, ABC):
    """A part of a hysteresis in a model file; also made of the part itself, whose names it has."""

    model_config = ConfigDict(from_attributes=True)

    @abstractmethod
    def value(self) -> object:
        """Return the part this describes; InputError where it is none."""

    @model_validator(mode="after")
    def _is_a_part(self) -> Self:
        refuse_unbuilt(self.value)
        return self


class PairFile(PartFile):
    """One pair in a model file."""

    thresholds_v: tuple[Threshold, ...]
    weights_um_per_v: tuple[Weight, ...]
    weight_errors_um_per_v: tuple[WeightError, ...] | None = None

    def value(self) -> Pair:
        """Return the pair this describes."""
        return Pair(**self.model_dump())


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


def covariances(files: Iterable[CovarianceFile] | None) -> tuple[WeightCovariance, ...] | None:
    """Covariances of the weights of each output, where a file has them."""
    return None if files is None else tuple(one.value() for one in files)


def lower_triangle(where: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Lower triangle with zeros above, from what ``lower_rows`` gave."""
    n = len(rows)
    if [len(row) for row in rows] != list(range(1, n + 1)):
        raise InputError(where, "row i of a factor must hold i numbers, up to its diagonal")
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = [value for row in rows for value in row]
    return square

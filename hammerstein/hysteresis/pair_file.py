"""Pairs and the covariance of their weights and thresholds, as model files hold them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Annotated, Any, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis.covariance import ThresholdCovariance
from hammerstein.hysteresis.kind import refuse_unbuilt
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.quantities import Entry, NoCycles, Threshold, Weight, WeightError
from hammerstein.validation import Strict


class PartFile(Strict, ABC):
    """A part of a hysteresis in a model file; also made of the part itself, whose names it has."""

    model_config = ConfigDict(from_attributes=True)

    @abstractmethod
    def value(self) -> object:
        """Give the part this describes; InputError where it is none."""

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
        """Give the pair this describes."""
        return Pair(**self.model_dump())


def _rows(factor: Any) -> Any:
    """Rows of a lower triangle, each up to its diagonal."""
    return [row[: i + 1] for i, row in enumerate(factor)] if isinstance(factor, np.ndarray) else factor


class CovarianceFile(PartFile):
    """Covariance L L^T of all weights of one output, pair after pair in the order of the inputs."""

    factor_um_per_v: Annotated[tuple[tuple[Weight, ...], ...], BeforeValidator(_rows)] = Field(
        description="rows of L, each up to its diagonal"
    )
    slopes_at_bound: NoCycles = Field(
        default=0, description="slopes held at a bound of the fit: the covariance is that of the others"
    )

    def value(self) -> WeightCovariance:
        """Give the covariance this describes."""
        return WeightCovariance(_square("weight_covariance", self.factor_um_per_v), self.slopes_at_bound)


def covariances(files: Iterable[CovarianceFile] | None) -> tuple[WeightCovariance, ...] | None:
    """Covariances of the weights of each output, where a file has them."""
    return None if files is None else tuple(one.value() for one in files)


class ThresholdCovarianceFile(PartFile):
    """Covariance L L^T of the fitted thresholds of all inputs, and how the best weights follow them."""

    factor_v: Annotated[tuple[tuple[Entry, ...], ...], BeforeValidator(_rows)] = Field(
        description="rows of L, each up to its diagonal"
    )
    following_um_per_v2: tuple[tuple[tuple[Entry, ...], ...], ...] = Field(
        description="of each output, a row a weight: what it changes by with each threshold"
    )
    open: tuple[NoCycles, ...] = Field(
        default=(), description="thresholds that the records leave open, counted from 0; they are held"
    )

    def value(self) -> ThresholdCovariance:
        """Give the covariance this describes."""
        n = len(self.factor_v)
        following = []
        for matrix in self.following_um_per_v2:
            if [len(row) for row in matrix] != [n] * n:
                raise InputError("threshold_covariance", f"must have {n} rows of {n} numbers for each output")
            following.append(np.array(matrix, dtype=float).reshape(n, n))
        factor = _square("threshold_covariance", self.factor_v)
        return ThresholdCovariance(factor, tuple(following), self.open)


def _square(where: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Lower triangle with zeros above, from what ``_rows`` gave."""
    n = len(rows)
    if [len(row) for row in rows] != list(range(1, n + 1)):
        raise InputError(where, "row i of a factor must hold i numbers, up to its diagonal")
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = [value for row in rows for value in row]
    return square

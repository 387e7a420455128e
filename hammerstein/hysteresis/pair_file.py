"""Pairs and the covariance of their weights and thresholds, as model files hold them."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis.covariance import ThresholdCovariance
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.quantities import Entry, NoCycles, Threshold, Weight, WeightError


class PairFile(BaseModel):
    """One pair in a model file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    thresholds_v: tuple[Threshold, ...]
    weights_um_per_v: tuple[Weight, ...]
    weight_errors_um_per_v: tuple[WeightError, ...] | None = None

    @model_validator(mode="after")
    def _is_a_pair(self) -> Self:
        try:
            self.pair()
        except InputError as error:
            raise ValueError("; ".join(f"{m.where} {m.what}" for m in error.mistakes)) from None
        return self

    def pair(self) -> Pair:
        """Give the pair this describes."""
        errors = self.weight_errors_um_per_v
        return Pair(
            np.asarray(self.thresholds_v, dtype=float),
            np.asarray(self.weights_um_per_v, dtype=float),
            None if errors is None else np.asarray(errors, dtype=float),
        )

    @classmethod
    def of(cls, pair: Pair) -> PairFile:
        """Describe a pair."""
        return cls.model_validate({name: getattr(pair, name) for name in cls.model_fields})


class CovarianceFile(BaseModel):
    """Covariance L L^T of all weights of one output, pair after pair in the order of the inputs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    factor_um_per_v: tuple[tuple[Weight, ...], ...] = Field(description="rows of L, each up to its diagonal")
    slopes_at_bound: NoCycles = Field(
        default=0, description="slopes held at a bound of the fit: the covariance is that of the others"
    )

    def covariance(self) -> WeightCovariance:
        """Give the covariance this describes."""
        return WeightCovariance(_square("weight_covariance", self.factor_um_per_v), self.slopes_at_bound)

    @classmethod
    def of(cls, found: WeightCovariance) -> CovarianceFile:
        """Describe a covariance."""
        return cls(factor_um_per_v=_rows(found.factor_um_per_v), slopes_at_bound=found.slopes_at_bound)


class ThresholdCovarianceFile(BaseModel):
    """Covariance L L^T of the fitted thresholds of all inputs, and how the best weights follow them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    factor_v: tuple[tuple[Entry, ...], ...] = Field(description="rows of L, each up to its diagonal")
    following_um_per_v2: tuple[tuple[tuple[Entry, ...], ...], ...] = Field(
        description="of each output, a row a weight: what it changes by with each threshold"
    )
    open: tuple[NoCycles, ...] = Field(
        default=(), description="thresholds that the records leave open, counted from 0; they are held"
    )

    def covariance(self) -> ThresholdCovariance:
        """Give the covariance this describes."""
        n = len(self.factor_v)
        following = []
        for matrix in self.following_um_per_v2:
            if [len(row) for row in matrix] != [n] * n:
                raise InputError("threshold_covariance", f"must have {n} rows of {n} numbers for each output")
            following.append(np.array(matrix, dtype=float).reshape(n, n))
        factor = _square("threshold_covariance", self.factor_v)
        return ThresholdCovariance(factor, tuple(following), self.open)

    @classmethod
    def of(cls, found: ThresholdCovariance) -> ThresholdCovarianceFile:
        """Describe a covariance."""
        following = tuple(tuple(map(tuple, matrix.tolist())) for matrix in found.following_um_per_v2)
        return cls(factor_v=_rows(found.factor_v), following_um_per_v2=following, open=found.open)


def _rows(triangle: Array) -> tuple[tuple[float, ...], ...]:
    """Rows of a lower triangle, each up to its diagonal."""
    return tuple(tuple(row[: i + 1].tolist()) for i, row in enumerate(triangle))


def _square(where: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Lower triangle with zeros above, from what ``_rows`` gave."""
    n = len(rows)
    if [len(row) for row in rows] != list(range(1, n + 1)):
        raise InputError(where, "row i of a factor must hold i numbers, up to its diagonal")
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = [value for row in rows for value in row]
    return square

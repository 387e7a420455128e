"""Pairs and the covariance of their weights, as model files hold them."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from hammerstein.errors import InputError
from hammerstein.hysteresis.pair import Pair, WeightCovariance
from hammerstein.quantities import NoCycles, Threshold, Weight, WeightError


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
        n = len(self.factor_um_per_v)
        if [len(row) for row in self.factor_um_per_v] != list(range(1, n + 1)):
            raise InputError("weight_covariance", "row i of a factor must hold i numbers, up to its diagonal")
        factor = np.zeros((n, n))
        factor[np.tril_indices(n)] = [value for row in self.factor_um_per_v for value in row]
        return WeightCovariance(factor, self.slopes_at_bound)

    @classmethod
    def of(cls, found: WeightCovariance) -> CovarianceFile:
        """Describe a covariance."""
        rows = tuple(tuple(row[: i + 1].tolist()) for i, row in enumerate(found.factor_um_per_v))
        return cls(factor_um_per_v=rows, slopes_at_bound=found.slopes_at_bound)

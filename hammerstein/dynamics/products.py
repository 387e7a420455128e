"""Products of the inputs of a hysteresis in the loop: static nonlinearity and coupling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hammerstein.arrays import Array, ByValue, Indices, freeze, freeze_fields, times
from hammerstein.quantities import Entry, InputNumber
from hammerstein.validation import Strict

MOST_FACTORS = 3
"""A product of three signals is the highest term of a cubic."""


@dataclass(frozen=True, eq=False)
class InputProducts(ByValue):
    """Weighted products of up to three z, each relative to its limit and clipped to it.

        w_i = sum over j of K_ij part_a part_b part_c,    part_k = z_k / limit_k within -1 to 1

    They are bounded, so they do not change the stability at large amplitudes.

    weights : K (q, M); limit : (h,); factors : (M, 3) numbers of the z in each product, h for none
    """

    weights: Array
    limit: Array
    factors: Indices

    def __post_init__(self) -> None:
        freeze_fields(self, "weights", "limit")
        freeze(self.factors)

    @classmethod
    def none(cls, inputs: int, outputs: int) -> InputProducts:
        """No product of so many z for so many w."""
        return cls(np.zeros((outputs, 0)), np.ones(inputs), np.zeros((0, MOST_FACTORS), dtype=np.int64))

    def at(self, z: Array) -> Array:
        """What they add to w (q,) or (q, sample) at z (h,) or (h, sample)."""
        part = np.clip((z.T / self.limit).T, -1.0, 1.0)
        each = np.prod(np.concatenate([part, np.ones_like(part[:1])])[self.factors], axis=1)
        return times(self.weights, each)


class ProductFile(Strict):
    """One product of inputs of the hysteresis in the loop, numbered from 1, and its weight on each output."""

    of: Annotated[tuple[InputNumber, ...], Field(min_length=1, max_length=MOST_FACTORS)]
    weights: tuple[Entry, ...]


class ProductsFile(Strict):
    """Products beside the hysteresis in a loop, and the inputs up to which they grow."""

    limits: tuple[Annotated[Entry, Field(gt=0.0)], ...]
    terms: Annotated[tuple[ProductFile, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _of_inputs(self) -> Self:
        if any(not 1 <= k <= len(self.limits) for term in self.terms for k in term.of):
            raise ValueError(f"terms are products of inputs 1 to {len(self.limits)}, as many as limits")
        return self

    @classmethod
    def of(cls, products: InputProducts) -> ProductsFile | None:
        """Return the form of some products in a file; None if there is none."""
        if not len(products.factors):
            return None
        h = len(products.limit)
        terms = [
            ProductFile(of=tuple(k + 1 for k in row if k < h), weights=tuple(weights))
            for row, weights in zip(products.factors.tolist(), products.weights.T.tolist(), strict=True)
        ]
        return cls(limits=tuple(products.limit.tolist()), terms=tuple(terms))

    def products(self) -> InputProducts:
        """Return the products this describes."""
        h = len(self.limits)
        rows = [[k - 1 for k in term.of] + [h] * (MOST_FACTORS - len(term.of)) for term in self.terms]
        weights = np.array([term.weights for term in self.terms]).T
        return InputProducts(weights, np.array(self.limits), np.array(rows, dtype=np.int64))

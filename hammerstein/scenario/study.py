"""Other values of any numeric key of a scenario: lists of them, or samples between limits."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hammerstein.quantities import Draws, Figure, Seed
from hammerstein.validation import Strict

MOST_VALUES = 1_000_000  # of a list in a file
TOGETHER = 1024  # samples of a Sobol sequence that are made at once

Values = Annotated[tuple[Figure, ...], Field(min_length=1, max_length=MOST_VALUES)]


class Study(Strict):
    """Runs of a scenario with other values of some keys, such as ``instruments.sensor.noise_um``.

    ``product`` is every combination of the values, ``zip`` the first values together, then the second ones.
    ``random`` and ``sobol`` take so many ``samples`` between the two values of each key.
    """

    how: Literal["product", "zip", "random", "sobol"] = Field(
        default="product",
        description="every combination of the values, the values in step, or random samples",
    )
    samples: Draws | None = Field(
        default=None, description="number of samples for random and sobol; for sobol a power of two"
    )
    seed: Seed = Field(default=1, description="seed of the samples")
    values: dict[str, Values] = Field(
        min_length=1,
        description=('values by key, such as "compensators[1].gain"; for samples, the two limits'),
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        lengths = {key: len(values) for key, values in self.values.items()}
        if self.how in ("random", "sobol"):
            if self.samples is None:
                raise ValueError(f"how = {self.how!r} needs samples")
            if bad := [
                key for key, values in self.values.items() if len(values) != 2 or values[0] >= values[1]
            ]:
                raise ValueError(f"{bad[0]} needs two limits, the lower one first")
            if self.how == "sobol" and self.samples & (self.samples - 1):
                near = 2 ** round(math.log2(self.samples))
                raise ValueError(f"samples must be a power of two for sobol; {near} is near")
        elif self.samples is not None:
            raise ValueError(f"samples belongs to random and sobol, not to {self.how}")
        elif self.how == "zip" and len(set(lengths.values())) != 1:
            told = ", ".join(f"{key} {length}" for key, length in lengths.items())
            raise ValueError(f"zip needs equally many values of each key: {told}")
        return self

    def count(self) -> int:
        """How many runs there are."""
        if self.samples is not None:
            return self.samples
        lengths = [len(values) for values in self.values.values()]
        return lengths[0] if self.how == "zip" else math.prod(lengths)

    def some(self, count: int) -> Iterator[dict[str, float]]:
        """Values of a given number of representative runs, or of all runs if there are fewer."""
        if self.samples is not None or self.count() <= count:
            yield from itertools.islice(self.points(), count)
            return
        chance = random.Random(self.seed)
        for _ in range(count):
            place = chance.random()
            places = {key: place if self.how == "zip" else chance.random() for key in self.values}
            yield {key: values[int(len(values) * places[key])] for key, values in self.values.items()}

    def ends(self) -> Iterator[dict[str, float]]:
        """Values of the runs in which a key is least or largest, and the others stand beside it."""
        for values, end in itertools.product(self.values.values(), (min, max)):
            place = values.index(end(values))
            yield {key: others[min(place, len(others) - 1)] for key, others in self.values.items()}

    def points(self) -> Iterator[dict[str, float]]:
        """Values of every run by key, one after the other; only a few are in the memory at a time."""
        keys, lists = list(self.values), list(self.values.values())
        if self.how in ("random", "sobol"):
            for place in self._places(len(keys)):
                ends = zip(keys, lists, place, strict=True)
                yield {key: low + (high - low) * at for key, (low, high), at in ends}
            return
        for found in itertools.product(*lists) if self.how == "product" else zip(*lists, strict=True):
            yield dict(zip(keys, found, strict=True))

    def _places(self, size: int) -> Iterator[list[float]]:
        """Samples in the unit cube."""
        import numpy as np
        from scipy.stats import qmc

        assert self.samples is not None
        generator = np.random.default_rng(self.seed)
        sampler = qmc.Sobol(size, rng=generator) if self.how == "sobol" else None
        for first in range(0, self.samples, TOGETHER):
            count = min(TOGETHER, self.samples - first)
            yield from (sampler.random(count) if sampler else generator.random((count, size))).tolist()

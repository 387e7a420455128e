"""Records during identification, and the models fitted to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import Dynamics, LinearBlock
from hammerstein.hysteresis import Hysteresis
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.axis_fit import AxisFit
from hammerstein.identification.score import Candidate
from hammerstein.identification.search import delay_in_samples
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit, Thresholds
from hammerstein.records.record import Record

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """Records with all information from before the fit of the candidates.

    Delays are those beside the sensor's. ``static_delay_samples`` is the delay that suits a model without
    dynamics, where it is another.
    """

    records: tuple[Record, ...]
    starts: tuple[InitialState, ...]
    thresholds_v: Thresholds
    delay_samples: float
    settings: Settings
    progress: Progress
    static_delay_samples: int | None = None

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.records[0].y_um)

    @property
    def readings(self) -> int:
        """Samples of all records and outputs."""
        return sum(record.y_um.size for record in self.records)

    def linear_thresholds(self) -> list[list[Array]]:
        """Return a single threshold of 0 to every pair: a linear gain."""
        return [[np.zeros(min(len(r), 1)) for r in row] for row in self.thresholds_v]

    @property
    def whole_delay(self) -> int:
        """Whole samples of the delay, which shift the plays; the remainder belongs to the path."""
        return math.floor(self.delay_samples)

    def delayed_as(self, dynamics: Dynamics) -> Task:
        """Return the task with the delay of a linear block."""
        delay = delay_in_samples(dynamics.input_delay_s, self.records[0].sample_time_s)
        return replace(self, delay_samples=delay)

    def paths(self, dynamics: Dynamics) -> list[LinearBlock]:
        """Discrete path of each record from the static block to the reading, with the part of a sample."""
        part_s = (self.delay_samples - self.whole_delay) * self.records[0].sample_time_s
        return self.settings.sensor.paths(dynamics.model_copy(update={"input_delay_s": part_s}), self.records)

    def candidate(self, hysteresis: Hysteresis[Any], dynamics: Dynamics) -> Candidate:
        """Static block and linear block as a model with the delay of the task."""
        delay_s = self.delay_samples * self.records[0].sample_time_s
        late = dynamics.model_copy(update={"input_delay_s": delay_s})
        return Candidate(hysteresis, late, self.settings.sensor)


@dataclass(frozen=True, eq=False)
class WeightFits:
    """Static block by several methods, behind the same linear block.

    ``chosen`` is by the requested solver; ``free`` and ``one_sign`` serve for comparison; ``fitted`` is true
    if the thresholds were fitted.
    """

    chosen: StaticFit
    free: StaticFit
    one_sign: StaticFit | None
    fitted: bool = False


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Fitted model with details of its fit."""

    candidate: Candidate
    blocks: WeightFits
    axes: tuple[AxisFit, ...] = ()


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """All fitted models: the best of each kind, and others by name.

    ``axes`` holds the fitted axes, also where the model has none; ``untold`` the parameters of the kind of
    hysteresis that the records do not identify, so that plays are as good; ``alone`` that kind without
    dynamics.
    """

    found: dict[Kind, FittedModel]
    kind: Kind
    axes: tuple[AxisFit, ...] = ()
    notes: tuple[str, ...] = ()
    others: tuple[tuple[str, FittedModel], ...] = ()
    untold: str = ""
    alone: Candidate | None = None

    @property
    def best(self) -> FittedModel:
        """Largest accepted model."""
        return self.found[self.kind]

    @property
    def candidates(self) -> dict[Kind, Candidate]:
        """The models by kind."""
        return {kind: found.candidate for kind, found in self.found.items()}


def thresholds_of(blocks: WeightFits) -> list[list[Array]]:
    """Thresholds (output, input) of the block by the requested solver [V]."""
    return [[pair.thresholds_v for pair in row] for row in blocks.chosen.hysteresis.pairs]

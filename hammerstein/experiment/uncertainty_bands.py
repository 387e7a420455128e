"""Bands of an uncertain actuator: the run repeated on draws of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.experiment.case_cache import CaseCache
from hammerstein.experiment.draws import Actuators, Figures, drawn_metrics, figures_on
from hammerstein.experiment.report import Band
from hammerstein.experiment.set_up import Case, Progress
from hammerstein.model.simulation import Plant
from hammerstein.runtime.fanning import Jobs
from hammerstein.scenario.uncertainty import Uncertainty

SEED_STEP = 7919  # keeps the noise of one draw apart from that of another scenario's seed
NO_PART = {"draws", "sensitivity"}
"""Keys of an uncertainty that change no draw."""


@dataclass(frozen=True, eq=False)
class DrawnActuators(Actuators):
    """Draws of an uncertain actuator; each has another noise."""

    uncertainty: Uncertainty
    nominal: Plant
    scenario_seed: int
    what = "drawing actuators"

    @property
    def key(self) -> str:
        """How uncertain it is."""
        return self.uncertainty.model_dump_json(exclude=NO_PART)

    @property
    def count(self) -> int:
        """How many are drawn."""
        return self.uncertainty.draws

    def plant(self, number: int) -> Plant:
        """Give the draw of a number."""
        return Plant(*self.uncertainty.draw(self.nominal.model, self.nominal.instruments, number))

    def seed(self, number: int) -> int:
        """Give the seed of its noise."""
        return self.scenario_seed + SEED_STEP * (number + 1)


def bands_of(
    kept: CaseCache, cases: Sequence[Case], jobs: Jobs, progress: Progress | None
) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws; nothing where the scenario has no uncertainty."""
    scenario = kept.setup.scenario
    if scenario.uncertainty is None:
        return ()
    drawn = DrawnActuators(scenario.uncertainty, kept.setup.plant, scenario.seed)
    found = figures_on(drawn, kept, cases, jobs, progress)
    return tuple(band for figures in found for band in _bands(figures))


def _bands(figures: Figures) -> Iterator[Band]:
    """Bands of every row of one case."""
    for r, row in enumerate(figures.rows):
        for m, metric in enumerate(drawn_metrics()):
            values = figures.values[:, r, m]
            known = values[~np.isnan(values)]
            if len(known):
                low, middle, high = np.percentile(known, [5.0, 50.0, 95.0]).tolist()
                yield Band(metric=metric, p5_um=low, median_um=middle, p95_um=high, **row.key())

"""Bands of an uncertain actuator: the run repeated on draws of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hammerstein.experiment.draws import Actuators, Figures, drawn_metrics, figures_on
from hammerstein.experiment.kept import KeptCases
from hammerstein.experiment.prepare import Case, Progress
from hammerstein.experiment.report import Band
from hammerstein.simulation import Plant

SEED_STEP = 7919  # keeps the noise of one draw apart from that of another scenario's seed
NO_PART = {"draws", "sensitivity"}
"""Keys of an uncertainty that change no draw."""


def bands_of(
    kept: KeptCases, cases: Sequence[Case], jobs: int, progress: Progress | None
) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws; nothing where the scenario has no uncertainty.

    Each draw has another noise.
    """
    uncertainty, nominal = kept.setup.scenario.uncertainty, kept.setup.plant
    if uncertainty is None:
        return ()

    def plant(number: int) -> Plant:
        return Plant(*uncertainty.draw(nominal.model, nominal.instruments, number))

    seed, key = kept.setup.scenario.seed, uncertainty.model_dump_json(exclude=NO_PART)
    drawn = Actuators(
        "drawing actuators", key, uncertainty.draws, plant, lambda number: seed + SEED_STEP * (number + 1)
    )
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

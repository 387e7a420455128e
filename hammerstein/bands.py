"""Bands of an uncertain actuator: the run repeated on draws of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hammerstein.measure import rows_of
from hammerstein.plant import Plant
from hammerstein.report import Band
from hammerstein.rows import Row
from hammerstein.setup import Case, Progress, SetUp

METRICS = ("rms_um", "rms_true_um", "max_true_um", "euclidean_max_true_um")


@dataclass(frozen=True, eq=False)
class _Draw:
    """One actuator near the nominal one, with the laws that were built for the nominal one."""

    setup: SetUp
    number: int

    def rows(self, cases: Sequence[Case]) -> tuple[Row, ...]:
        nominal = self.setup
        uncertainty = nominal.scenario.uncertainty
        assert uncertainty is not None  # held by bands_of
        drawn = Plant(*uncertainty.draw(nominal.plant.model, nominal.plant.instruments, self.number))
        seed = nominal.scenario.seed + 7919 * (self.number + 1)  # another noise in every draw
        setup = replace(nominal, plant=drawn, scenario=nominal.scenario.model_copy(update={"seed": seed}))
        return tuple(row for case in cases for row in rows_of(setup, case).rows)


def bands_of(setup: SetUp, cases: Sequence[Case], jobs: int, progress: Progress | None) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws; nothing where the scenario has no uncertainty.

    The draws run side by side; the numbers do not depend on ``jobs``.
    """
    from joblib import Parallel, delayed

    uncertainty = setup.scenario.uncertainty
    if uncertainty is None:
        return ()
    draws: list[tuple[Row, ...]] = []
    parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator")
    tasks = (delayed(_Draw(setup, number).rows)(cases) for number in range(uncertainty.draws))
    for rows in parallel(tasks):
        draws.append(rows)
        if progress:
            progress("drawing actuators", len(draws), uncertainty.draws)
    return tuple(band for same in zip(*draws, strict=True) for band in _bands(same))


def _bands(same: Sequence[Row]) -> list[Band]:
    """Bands of one row over its draws."""
    bands = []
    for metric in METRICS:
        values = [value for row in same if (value := getattr(row, metric)) is not None]
        if values:
            low, middle, high = np.percentile(values, [5.0, 50.0, 95.0]).tolist()
            bands.append(Band(metric=metric, p5_um=low, median_um=middle, p95_um=high, **same[0].key()))
    return bands

"""Bands of an uncertain actuator: the run repeated on draws of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hammerstein.experiment.measure import drawn_rows
from hammerstein.experiment.prepare import Case, Progress, SetUp
from hammerstein.experiment.report import Band
from hammerstein.metrics import METRICS, Row
from hammerstein.simulation import Plant

SEED_STEP = 7919  # keeps the noise of one draw apart from that of another scenario's seed


def bands_of(setup: SetUp, cases: Sequence[Case], jobs: int, progress: Progress | None) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws; nothing where the scenario has no uncertainty.

    The laws are those of the nominal actuator. The cases run side by side; the numbers do not depend on
    ``jobs``.
    """
    from joblib import Parallel, delayed

    uncertainty, nominal = setup.scenario.uncertainty, setup.plant
    if uncertainty is None:
        return ()
    drawn = (uncertainty.draw(nominal.model, nominal.instruments, n) for n in range(uncertainty.draws))
    plants = [Plant(*pair) for pair in drawn]
    bands: list[Band] = []
    parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator")
    tasks = (delayed(_over_draws)(setup, case, plants) for case in cases)
    for done, draws in enumerate(parallel(tasks), start=1):
        bands += (band for same in zip(*draws, strict=True) for band in _bands(same))
        if progress:
            progress("drawing actuators", done, len(cases))
    return tuple(bands)


def _over_draws(setup: SetUp, case: Case, plants: Sequence[Plant]) -> list[tuple[Row, ...]]:
    """Rows of one case, draw by draw; each draw has another noise."""
    experiment, seed = setup.experiment(case), setup.scenario.seed
    return [
        drawn_rows(setup, case, experiment(plant, seed + SEED_STEP * number))
        for number, plant in enumerate(plants, start=1)
    ]


def _bands(same: Sequence[Row]) -> list[Band]:
    """Bands of one row over its draws."""
    bands = []
    for metric in METRICS:
        values = [value for row in same if (value := row.figures.get(metric)) is not None]
        if values:
            low, middle, high = np.percentile(values, [5.0, 50.0, 95.0]).tolist()
            bands.append(Band(metric=metric, p5_um=low, median_um=middle, p95_um=high, **same[0].key()))
    return bands

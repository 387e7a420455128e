"""Bands of an uncertain actuator: the run repeated on draws of it."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hammerstein.experiment.kept import KeptCases, rows_from
from hammerstein.experiment.measure import drawn_rows
from hammerstein.experiment.prepare import Case, Experiment, Progress
from hammerstein.experiment.report import Band
from hammerstein.metrics import METRICS, Row
from hammerstein.runtime.store import Kept
from hammerstein.scenario.uncertainty import Uncertainty
from hammerstein.simulation import Plant

Array = NDArray[np.float64]

SEED_STEP = 7919  # keeps the noise of one draw apart from that of another scenario's seed
TOGETHER = 25  # draws that are worked out, and kept, in one piece


@dataclass(frozen=True, eq=False)
class Drawn:
    """Figures of one case over some draws.

    rows : what tells the rows apart
    values : (draw, row, metric) in the order of ``METRICS``; NaN where a figure has no meaning
    """

    rows: tuple[Row, ...]
    values: Array


def bands_of(
    kept: KeptCases, cases: Sequence[Case], jobs: int, progress: Progress | None
) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws; nothing where the scenario has no uncertainty.

    The laws are those of the nominal actuator. Pieces of the draws run side by side; the numbers do not
    depend on ``jobs``.
    """
    from joblib import Parallel, delayed

    uncertainty = kept.setup.scenario.uncertainty
    if uncertainty is None:
        return ()
    runs = [_Run(kept, case) for case in cases]
    pieces = [
        range(first, min(first + TOGETHER, uncertainty.draws))
        for first in range(0, uncertainty.draws, TOGETHER)
    ]
    parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator")
    found: list[list[Drawn]] = []
    for done, piece in enumerate(parallel(delayed(_over)(runs, piece) for piece in pieces), start=1):
        found.append(piece)
        if progress:
            progress("drawing actuators", done, len(pieces))
    return tuple(band for same in zip(*found, strict=True) for band in _bands(same))


class _Run:
    """One case, to be done on many actuators: its voltages are worked out once, when they are needed."""

    def __init__(self, kept: KeptCases, case: Case) -> None:
        self.kept, self.case = kept, case
        self._lock = threading.Lock()

    @property
    def experiment(self) -> Experiment:
        """What is done to an actuator."""
        with self._lock:
            return self._experiment

    @cached_property
    def _experiment(self) -> Experiment:
        return self.kept.setup.experiment(self.case)

    def key(self, uncertainty: Uncertainty, numbers: range) -> str:
        """Key of the figures over these draws; how many are drawn in all is no part of it."""
        more = [uncertainty.model_dump_json(exclude={"draws"}), numbers.start, numbers.stop]
        return self.kept.key(self.case, "draws", more)

    def over(self, plants: Sequence[Plant], numbers: range) -> Drawn:
        """Figures on these draws; each has another noise."""
        setup, seed = self.kept.setup, self.kept.setup.scenario.seed
        drawn = [
            drawn_rows(setup, self.case, self.experiment(plant, seed + SEED_STEP * (number + 1)))
            for plant, number in zip(plants, numbers, strict=True)
        ]
        names = list(METRICS)
        values = [[[row.figures.get(name, np.nan) for name in names] for row in rows] for rows in drawn]
        return Drawn(tuple(Row(**row.key()) for row in drawn[0]), np.array(values, dtype=np.float64))


def _over(runs: Sequence[_Run], numbers: range) -> list[Drawn]:
    """Figures of every case on some draws, which are made once for all cases that are not kept."""
    kept = runs[0].kept
    uncertainty, nominal, store = kept.setup.scenario.uncertainty, kept.setup.plant, kept.store
    assert uncertainty is not None  # who draws has it
    plants: list[Plant] = []
    found = []
    for run in runs:
        key = run.key(uncertainty, numbers) if store is not None else ""
        entry = store.read(key) if store is not None else None
        if entry is None:
            plants = plants or list(_plants(uncertainty, nominal, numbers))
            drawn = run.over(plants, numbers)
            if store is not None:
                store.write(key, Kept([row.key() for row in drawn.rows], {"values": drawn.values}))
        else:
            drawn = Drawn(rows_from(entry.document), entry.arrays["values"])
        found.append(drawn)
    return found


def _plants(uncertainty: Uncertainty, nominal: Plant, numbers: range) -> Iterator[Plant]:
    for number in numbers:
        yield Plant(*uncertainty.draw(nominal.model, nominal.instruments, number))


def _bands(same: Sequence[Drawn]) -> Iterator[Band]:
    """Bands of every row of one case over all draws."""
    values = np.concatenate([drawn.values for drawn in same])
    for r, row in enumerate(same[0].rows):
        for m, metric in enumerate(METRICS):
            known = values[:, r, m][~np.isnan(values[:, r, m])]
            if len(known):
                low, middle, high = np.percentile(known, [5.0, 50.0, 95.0]).tolist()
                yield Band(metric=metric, p5_um=low, median_um=middle, p95_um=high, **row.key())

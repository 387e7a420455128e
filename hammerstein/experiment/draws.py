"""A run repeated on many actuators: pieces of them side by side, each kept, memory that of the figures."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.experiment.kept import KeptCases, rows_from
from hammerstein.experiment.measure import drawn_rows
from hammerstein.experiment.prepare import Case, Experiment, Progress
from hammerstein.metrics import METRICS, Row
from hammerstein.runtime.store import Kept
from hammerstein.simulation import Plant

Array = NDArray[np.float64]

TOGETHER = 25  # actuators that are worked out, and kept, in one piece


@dataclass(frozen=True, eq=False)
class Actuators:
    """Many actuators near the nominal one.

    what : for a person who watches
    key : everything that tells them from others, as plain JSON; how many there are does not count
    count : how many there are
    plant : gives the one of a number
    seed : gives the seed of its noise
    """

    what: str
    key: Any
    count: int
    plant: Callable[[int], Plant]
    seed: Callable[[int], int]


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of one case on some actuators.

    rows : what tells the rows apart
    values : (actuator, row, metric) in the order of ``drawn_metrics``; NaN where a figure has no meaning
    """

    rows: tuple[Row, ...]
    values: Array


def drawn_metrics() -> list[str]:
    """Names of the figures that are found on every actuator."""
    return [metric.name for metric in METRICS.values() if metric.drawn]


def figures_on(
    actuators: Actuators, kept: KeptCases, cases: Sequence[Case], jobs: int, progress: Progress | None
) -> list[Figures]:
    """Figures of every case on all actuators.

    The laws are those of the nominal actuator. Pieces run side by side; the numbers do not depend on
    ``jobs``.
    """
    from joblib import Parallel, delayed

    runs = [_Run(actuators, kept, case) for case in cases]
    starts = range(0, actuators.count, TOGETHER)
    pieces = [range(first, min(first + TOGETHER, actuators.count)) for first in starts]
    parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator")
    found: list[list[Figures]] = []
    for piece in parallel(delayed(_over)(runs, piece) for piece in pieces):
        found.append(piece)
        if progress:
            progress(actuators.what, len(found), len(pieces))
    return [
        Figures(same[0].rows, np.concatenate([part.values for part in same]))
        for same in zip(*found, strict=True)
    ]


class _Run:
    """One case, to be done on many actuators: its voltages are worked out once, when they are needed."""

    def __init__(self, actuators: Actuators, kept: KeptCases, case: Case) -> None:
        self.actuators, self.kept, self.case = actuators, kept, case
        self._lock = threading.Lock()

    @property
    def experiment(self) -> Experiment:
        """What is done to an actuator."""
        with self._lock:
            return self._experiment

    @cached_property
    def _experiment(self) -> Experiment:
        return self.kept.setup.experiment(self.case)

    def key(self, numbers: range) -> str:
        """Key of the figures on these actuators."""
        return self.kept.key(self.case, "draws", [self.actuators.key, numbers.start, numbers.stop])

    def over(self, plants: Sequence[Plant], numbers: range) -> Figures:
        """Figures on these actuators."""
        setup, names = self.kept.setup, drawn_metrics()
        drawn = [
            drawn_rows(setup, self.case, self.experiment(plant, self.actuators.seed(number)))
            for plant, number in zip(plants, numbers, strict=True)
        ]
        values = [[[row.figures.get(name, np.nan) for name in names] for row in rows] for rows in drawn]
        return Figures(tuple(Row(**row.key()) for row in drawn[0]), np.array(values, dtype=np.float64))


def _over(runs: Sequence[_Run], numbers: range) -> list[Figures]:
    """Figures of every case on some actuators, which are made once for all cases that are not kept."""
    return list(_each(runs, numbers))


def _each(runs: Sequence[_Run], numbers: range) -> Iterator[Figures]:
    plants: list[Plant] = []
    for run in runs:
        store = run.kept.store
        key = "" if store is None else run.key(numbers)
        entry = None if store is None else store.read(key)
        if entry is not None:
            yield Figures(rows_from(entry.document), entry.arrays["values"])
            continue
        plants = plants or [run.actuators.plant(number) for number in numbers]
        figures = run.over(plants, numbers)
        if store is not None:
            store.write(key, Kept([row.key() for row in figures.rows], {"values": figures.values}))
        yield figures

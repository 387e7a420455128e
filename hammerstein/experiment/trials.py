"""Trials of a compensator that learns: on each actuator, each from the readings of the one before."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Sequence
from weakref import WeakKeyDictionary

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Learner
from hammerstein.errors import InputError
from hammerstein.model.simulation import Plant, Response

WHOLE = 1e-6  # samples that a period may miss a whole number by


def whole_period(samples: float, label: str) -> int:
    """Samples of a period; InputError where they are no whole number, which no table can hold."""
    where = f"compensator {label!r}"
    if not np.isfinite(samples):
        raise InputError(where, "learns from one period to the next, but this path does not repeat")
    found = round(samples)
    if abs(samples - found) > WHOLE or found < 2:
        raise InputError(
            where,
            f"needs a path whose period is a whole number of samples; it has {samples:.6g}. Choose "
            "another frequency or sample time",
        )
    return found


class IlcRun:
    """The trials of one learner on one actuator.

    Each trial repeats one period of voltages from rest, for as long as a run of the scenario. The next trial
    learns from the sensor's readings in the measured window.

    Parameters
    ----------
    law : learning law
    reference_um : (p, N) path of the whole run
    first : sample from which on a run is measured
    period : samples of a period
    seed : of the sensor's noise; each trial has its own
    """

    def __init__(
        self, law: Learner, reference_um: Array, first: int, period: int, seed: Sequence[int]
    ) -> None:
        self._law, self._whole, self._first = law, reference_um, first
        self._seed = list(seed)
        self._path = reference_um[:, first : first + period]
        self._drives: list[Array] = []
        self._before: tuple[Array, Array] | None = None  # drive and reading of the trial before the last
        self._ended = False  # a trial was worse than the one before, whose drive is kept from then on
        self._lock = threading.Lock()

    def trial(self, plant: Plant, number: int) -> Response:
        """Response of a trial, counted from 1; those before it are done where they were not."""
        with self._lock:
            while len(self._drives) < number:
                self._drives.append(self._next(plant))
        return self._played(plant, number)

    def _next(self, plant: Plant) -> Array:
        done = len(self._drives)
        if not done:
            return self._law.first(self._path)
        if self._ended:
            return self._drives[-1]
        read = self._played(plant, done).reading_um[:, self._first :]
        following = self._law.following(self._path, self._drives[-1], read, self._before)
        self._ended = self._before is not None and following is self._before[0]
        self._before = (self._drives[-1], read)
        return following

    def _played(self, plant: Plant, number: int) -> Response:
        drive, samples = self._drives[number - 1], self._whole.shape[1]
        periods = -(-samples // drive.shape[1])
        requested = np.tile(drive, (1, periods))[:, :samples]
        return plant.respond(requested, [*self._seed, number], self._whole)


class IlcRuns:
    """IlcRuns by actuator, as long as there is the actuator."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: WeakKeyDictionary[Plant, dict[Hashable, IlcRun]] = WeakKeyDictionary()

    def __reduce__(self) -> tuple[type[IlcRuns], tuple[()]]:
        """Another process begins its own: the numbers are the same."""
        return IlcRuns, ()

    def of(self, plant: Plant, key: Hashable, new: Callable[[], IlcRun]) -> IlcRun:
        """The run of a key on an actuator; a new one if there is none."""
        with self._lock:
            ilc_runs = self._found.setdefault(plant, {})
            if key not in ilc_runs:
                ilc_runs[key] = new()
            return ilc_runs[key]

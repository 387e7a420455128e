"""Paths in files: their samples on the drive's grid, and what these cost before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.path_units import in_um
from hammerstein.errors import InputError, SimulationError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import duration, size
from hammerstein.runtime.resources import free_bytes
from hammerstein.signals.signal_files import chosen, read_signal


class PathCost(NamedTuple):
    """Memory [bytes] and time [s] of one sample of two axes, measured with a million of them."""

    bytes: float
    seconds: float


DRIVE_COST = PathCost(450.0, 15e-6)
CYCLE_COST = PathCost(1300.0, 75e-6)
PLAYED_COST = PathCost(450.0, 15e-6)


@dataclass(frozen=True)
class PathWork:
    """What a path costs: samples on the drive's grid, and the cost of each."""

    samples: int
    sample_time_s: float
    cost: PathCost

    @property
    def bytes(self) -> float:
        """Memory at most [bytes]."""
        return self.samples * self.cost.bytes

    @property
    def seconds(self) -> float:
        """Time [s]."""
        return self.samples * self.cost.seconds

    def statement(self) -> str:
        """Say samples, memory and time."""
        return (
            f"{self.samples:,} samples of {self.sample_time_s:g} s: about {size(self.bytes)} of memory and "
            f"{duration(self.seconds)}"
        )

    def refuse_too_large(self, path: Path | str) -> None:
        """Raise SimulationError where the memory that is free does not hold it."""
        free = free_bytes()
        if self.bytes > free:
            raise SimulationError(
                f"{path}: {self.samples:,} samples of {self.sample_time_s:g} s need about "
                f"{size(self.bytes)} of memory, but {size(free)} are free. Cut the path into parts. "
                "If its times are not in s, name their unit in the header, such as t [ms]."
            )


def _nothing(_: Any) -> None:
    """Nobody listens."""


class Onlooker(NamedTuple):
    """Who is told of a path: ``begin`` gets its cost before the work, ``tell`` what is being done."""

    begin: Callable[[PathWork], None] = _nothing
    tell: Callable[[str], None] = _nothing


UNWATCHED = Onlooker()


def read_path(
    path: Path,
    model: HammersteinModel,
    sample_time_s: float,
    word: str = "reference",
    cost: PathCost = DRIVE_COST,
    onlooker: Onlooker = UNWATCHED,
    units: str | None = None,
) -> tuple[Array, Array, bool]:
    """Times (sample,), positions (output, sample) on the drive's grid, and whether they were resampled.

    Parameters
    ----------
    path : CSV file, see ``read_signal``
    word : what a column of a file of ours holds, ``reference`` or ``reading``
    cost : of a sample, in what is done with the path
    onlooker : told the cost before the grid is made
    units : of the columns that name none

    Raises
    ------
    InputError : the file is no such path, or its unit must be named, see ``in_um``
    SimulationError : its samples do not fit the memory
    """
    times, values, names = read_signal(path)
    columns = chosen(path, names, model.outputs, "displacement", word)
    values = in_um(path, [names[i] for i in columns], values[columns], model, units)
    samples = math.floor((times[-1] - times[0]) / sample_time_s + 1e-6) + 1
    if samples < 2:
        raise InputError(str(path), f"is shorter than two samples of {sample_time_s:g} s")
    work = PathWork(samples, sample_time_s, cost)
    work.refuse_too_large(path)
    onlooker.begin(work)
    grid = times[0] + np.arange(samples) * sample_time_s
    same = samples == len(times) and bool(np.abs(times - grid).max() < 1e-3 * sample_time_s)
    reference = values if same else np.stack([np.interp(grid, times, row) for row in values])
    return grid, np.ascontiguousarray(reference), not same

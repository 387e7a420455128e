"""From the files of a trial to the next drive."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.axis_names import column
from hammerstein.compensators.cycle import Cycle, Design, design_of
from hammerstein.compensators.drive_file import Terms
from hammerstein.compensators.learning.ilc_update import MEASURED, IlcUpdate, ilc_update
from hammerstein.compensators.learning.model_uncertainty import ModelUncertainty
from hammerstein.compensators.path_file import CYCLE_COST, UNWATCHED, Onlooker, read_path
from hammerstein.errors import InputError, naming
from hammerstein.model import HammersteinModel
from hammerstein.signals.signal_files import read_signal


def learn_from_files(
    model_path: str,
    path: Path,
    law: str,
    options: Mapping[str, Any],
    trial: tuple[Path, Path],
    uncertainty: ModelUncertainty,
    terms: Terms,
    onlooker: Onlooker = UNWATCHED,
    before: tuple[Path, Path] | None = None,
) -> tuple[Cycle, IlcUpdate]:
    """Next period of voltages, and what was learned from the trial.

    Parameters
    ----------
    path : one period of the path
    trial : the drive file that was played, and what the sensor read: ``time_s`` and one column an output in
        um, whole settled periods, zero where the actuator stood before
    uncertainty : relative uncertainty of the model
    onlooker : receives the cost of the path before the work
    before : the files of the trial before; its drive is kept if this trial was worse

    Raises InputError for files that do not belong together, and what ``cycle_of`` does.
    """
    design = design_of(model_path, path, law, options, terms, onlooker)
    found, _ = _taught(design, trial, uncertainty, terms.units)
    if before is not None:
        found = found.after(*_taught(design, before, uncertainty, terms.units))
    return design.cycle(found.drive_v, terms), found


def _taught(
    design: Design, trial: tuple[Path, Path], uncertainty: ModelUncertainty, units: str | None
) -> tuple[IlcUpdate, Array]:
    """What the files of a trial teach, and its drive (m, N)."""
    samples, time_s = design.reference_um.shape[1], design.model.instruments.drive.sample_time_s
    drive = _drive_of(trial[0], design.model, samples)
    _, measured, resampled = read_path(trial[1], design.model, time_s, "reading", CYCLE_COST, units=units)
    if resampled:
        raise InputError(
            str(trial[1]),
            f"is not sampled every {time_s:g} s like the drive; record it at this sample time",
        )
    bandwidth = design.model.instruments.sensor.bandwidth_hz
    with naming(str(trial[1]), instead_of=MEASURED):
        found = ilc_update(
            design.model, design.law, design.reference_um, drive, measured, uncertainty, bandwidth
        )
    return found, drive


def _drive_of(path: Path, model: HammersteinModel, samples: int) -> Array:
    """Voltages (m, N) of a drive file, by the names of its columns."""
    _, values, names = read_signal(path)
    wanted = [column("drive", name, "v") for name in model.inputs]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InputError(str(path), f"has no column {missing[0]}; give the drive file of this trial")
    drive = np.ascontiguousarray(values[[names.index(name) for name in wanted]])
    if drive.shape[1] != samples:
        raise InputError(str(path), f"has {drive.shape[1]} rows, but a period of the path has {samples}")
    return drive

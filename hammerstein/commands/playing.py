"""Simulation of the voltages of a file."""

import re
import warnings
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.drive_file import DRIVEN_TO, INITIAL_STATE, beyond_records
from hammerstein.compensators.path_file import DRIVE_COST, UNWATCHED, Onlooker, PathWork, Tell, drive_csv
from hammerstein.errors import InputError, Notice, SimulationError
from hammerstein.escaping import clean
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Response
from hammerstein.quantities import interval
from hammerstein.runtime.staging import Owner
from hammerstein.signals.signal_files import chosen, read_signal

PLAYED = Owner("play", single=True)
VOLTS_ON = re.compile(r"(-?\d+(?:\.\d+)?(?:e[-+]\d+)?) V on ([^,]+)")  # of its start
MADE_FOR = "Model "  # how a drive file of ours begins the line on its model
EVENLY = 1e-3
"""Allowed deviation of the time of a row, in parts of a sample time."""


class Played(NamedTuple):
    """Response of a model to voltages.

    source : name of the model; time_s : (sample,) as in the file; with_sensor : whether it was read
    """

    model: HammersteinModel
    source: str
    time_s: Array
    response: Response
    with_sensor: bool
    conditioned: bool
    begins_v: list[float]

    def to_csv(self, tell: Tell | None = None) -> str:
        """Text of the file: time, voltages, positions and, with a sensor, readings."""
        groups = [
            ("played", "v", self.model.inputs, self.response.drive_v),
            ("position", "um", self.model.outputs, self.response.position_um),
        ]
        if self.with_sensor:
            groups.append(("reading", "um", self.model.outputs, self.response.reading_um))
        before = "after its highest, then its lowest recorded voltage" if self.conditioned else "at rest"
        start = ", ".join(f"{u:.6g} V" for u in self.begins_v)
        said = f"Response of model {self.source} to these voltages, {before}, from {start}, where it is zero."
        return drive_csv(self.time_s, groups, [said], tell)

    def summary(self) -> dict[str, Any]:
        """Lowest and highest voltage and position, as plain JSON."""
        inputs = zip(self.model.inputs, self.response.drive_v, strict=True)
        outputs = zip(self.model.outputs, self.response.position_um, strict=True)
        return {
            "inputs": {name: [float(row.min()), float(row.max())] for name, row in inputs},
            "outputs": {name: [float(row.min()), float(row.max())] for name, row in outputs},
        }


def initial_state(path: Path, model: HammersteinModel) -> str:
    """Initial state as a drive file of ours says it, else nothing; a note if it is for another model."""
    with path.open(encoding="utf-8", errors="replace") as lines:
        notes = [line.removeprefix("# ").strip() for line in lines if line.startswith("# ")]
    line = next((note for note in notes if note.startswith(MADE_FOR)), "")
    made_for = re.split(r"(?<=\))[.:]", line)[0].strip()
    if made_for and f"({clean(model.origin)})" not in made_for:
        text = f"{path}: these voltages were computed for another model: {made_for}"
        warnings.warn(text, Notice, stacklevel=2)
    return next((note for note in notes if INITIAL_STATE in note), "")


def played(
    model_path: str,
    drive_path: Path,
    with_sensor: bool = False,
    onlooker: Onlooker = UNWATCHED,
    conditioned: bool | None = None,
) -> Played:
    """Simulate the voltages of a file from the working point of a model.

    Parameters
    ----------
    model_path : model file, or name of a packaged actuator
    drive_path : CSV file: ``time_s`` and one column for each input, absolute [V]; a file written by
        ``compensate`` also works
    with_sensor : whether to include converter and sensor of the model
    onlooker : informed of the cost before the work
    conditioned : whether both ends of the recorded range were visited before; if not given, as the file says,
        or as before the model's records

    Raises
    ------
    InputError : a file is wrong
    SimulationError : the response diverges, or the samples do not fit into memory
    """
    model = HammersteinModel.load(model_path)
    rest_v = model.recorded.working_point_v
    time_s, values, names = read_signal(drive_path)
    if list(model.outputs) == names != list(model.inputs):
        what = "has the columns of a path, not of voltages; compute its drive with hammerstein compensate"
        raise InputError(str(drive_path), what)
    u = values[chosen(drive_path, names, model.inputs, "voltage", "drive")]
    sample_time_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    steps, usual_s = np.diff(time_s), float(np.median(np.diff(time_s)))
    if (np.abs(steps - sample_time_s) > EVENLY * sample_time_s).any():
        odd = int(np.argmax(np.abs(steps - usual_s)))
        raise InputError(
            str(drive_path),
            f"its times are not evenly spaced: row {odd + 2} comes after {interval(steps[odd])}, most rows "
            f"after {interval(usual_s)}; resample it",
        )
    work = PathWork(len(time_s), sample_time_s, DRIVE_COST)
    work.refuse_too_large(drive_path)
    onlooker.begin(work)
    onlooker.tell("playing")
    start = initial_state(drive_path, model)
    if conditioned is None:
        conditioned = DRIVEN_TO in start if start else model.recorded.conditioned
    named = {name: float(volts) for volts, name in VOLTS_ON.findall(start)}
    begins = [named.get(name, rest) for name, rest in zip(model.inputs, rest_v, strict=True)]
    ends = (model.recorded.highest_v, model.recorded.lowest_v)
    top, low = (", ".join(f"{u:.6g} V" for u in end) for end in ends)
    made_as = f"{DRIVEN_TO} {top}, then to {low}" if conditioned else "at rest"
    if start and f", {made_as}" not in start:
        how = "after both ends of the recorded range" if conditioned else "from rest"
        said = f"{drive_path}: played {how}, but the drive is not made for that."
        warnings.warn(f"{said} {start}", Notice, stacklevel=2)
    beyond = beyond_records(model, u)
    if beyond:
        warnings.warn(f"{drive_path}: {beyond} The positions there are extrapolated.", Notice, stacklevel=2)
    instruments = model.instruments if with_sensor else None
    try:
        response = model.simulate(
            u,
            sample_time_s,
            instruments=instruments,
            conditioned=conditioned,
            start_v=None if begins == list(rest_v) else begins,
        )
    except SimulationError as error:
        raise SimulationError(f"{drive_path}: {error}") from None
    return Played(model, PurePath(model_path).name, time_s, response, with_sensor, conditioned, begins)

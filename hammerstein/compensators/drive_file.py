"""From a reference file to the voltages that a person can send."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from hammerstein.blocks import Law
from hammerstein.compensators.exact.reach import Reach, Shortfall, reach, require_reach, shortfall
from hammerstein.compensators.feedback.pid import Feedback
from hammerstein.compensators.specs import Compensator, NoCompensation
from hammerstein.errors import InputError, SimulationError
from hammerstein.escaping import cell
from hammerstein.files import Content
from hammerstein.instruments import Drive
from hammerstein.model import HammersteinModel
from hammerstein.signals import read_signal
from hammerstein.validation import mistakes_of

Array = NDArray[np.float64]
CONTENT = Content("drive file", sign="time_s,drive_")


@dataclass(frozen=True, eq=False)
class Compensation:
    """A drive for real hardware, and what the model says of it.

    time_s : (sample,) on the drive's sample time; reference_um : (output, sample)
    drive_v : (input, sample) rounded to the converter's steps and within its range
    reach : what slow paths can reach
    shortfall : predicted position and error, and where the voltage stands at the range
    resampled : whether the file was interpolated onto the drive's sample time
    """

    model: HammersteinModel
    law: Law[Any]
    reach: Reach
    time_s: Array
    reference_um: Array
    drive_v: Array
    shortfall: Shortfall
    resampled: bool

    def unreached_samples(self) -> dict[str, int]:
        """Samples at the range, by input."""
        counts = self.shortfall.at_range.sum(axis=1)
        return {name: int(n) for name, n in zip(self.model.inputs, counts, strict=True)}

    def summary(self) -> dict[str, Any]:
        """Give reach, predicted error and what was not reached, as plain JSON."""
        axes = {
            name: {
                "reach_alone_um": float(self.reach.alone_um[o]),
                "reach_together_um": float(self.reach.together_um[o]),
                "reference_max_um": float(np.abs(self.reference_um[o]).max()),
                "predicted_rms_um": float(np.sqrt(np.mean(self.shortfall.error_um[o] ** 2))),
                "predicted_max_um": float(np.abs(self.shortfall.error_um[o]).max()),
            }
            for o, name in enumerate(self.model.outputs)
        }
        largest = {
            n: float(np.abs(row).max()) for n, row in zip(self.model.inputs, self.drive_v, strict=True)
        }
        return {
            "axes": axes,
            "largest_v": largest,
            "statements": self.statements(),
            "unreached_samples": self.unreached_samples(),
        }

    def statements(self) -> list[str]:
        """Say what a user must know of the numbers before the voltages are sent."""
        said = [
            "Predicted: the error if the actuator were exactly the model. Its fit report says how far it is."
        ]
        said += [text] if (text := self.law.statement()) else []
        if self.resampled:
            said.append(
                "The file was interpolated linearly onto the drive's sample time; corners may need filter_hz."
            )
        return said

    def to_csv(self) -> str:
        """Text of the drive file: time, voltages to send, reference, predicted position."""
        import pandas as pd

        columns = {"time_s": self.time_s}
        columns |= {f"drive_{n}_v": row for n, row in zip(self.model.inputs, self.drive_v, strict=True)}
        for word, rows in (("reference", self.reference_um), ("predicted", self.shortfall.predicted_um)):
            columns |= {f"{word}_{n}_um": row for n, row in zip(self.model.outputs, rows, strict=True)}
        shown = {cell(name): column for name, column in columns.items()}
        return str(pd.DataFrame(shown).to_csv(index=False, lineterminator="\n"))


def compensate(
    model_path: str,
    reference_path: Path,
    law: str,
    options: Mapping[str, Any],
    clip: bool = False,
    range_v: float | None = None,
) -> Compensation:
    """Voltages for a reference file (``time_s`` and one column an axis, in um).

    Parameters
    ----------
    model_path : model file, or name of a packaged actuator
    reference_path : CSV file
    law, options : a law and its options, by their names in a scenario
    clip : accept a path that is partly out of reach
    range_v : range of the drive [V]; that of the model file if not given, and where that is unlimited, the
        largest voltage for which the model was found

    Raises
    ------
    InputError : a file or an option is wrong
    SimulationError : the law cannot work, or the path is out of reach
    """
    model = HammersteinModel.load(model_path)
    drive = _drive(model, range_v)
    time_s, reference, resampled = _on_grid(reference_path, model, drive.sample_time_s)
    built = _spec(model_path, law, options).build(model, drive.range_v, drive.sample_time_s)
    if isinstance(built, Feedback):
        raise InputError("--law", "feedback needs the sensor's readings: it has no drive to send ahead")
    held, _ = drive.apply(built.drive_for(reference))
    predicted = shortfall(model, built, reference, held, drive.range_v, drive.sample_time_s)
    reachable = reach(model, drive.range_v, run_anyway=True)
    if not clip:
        try:
            require_reach(predicted, model.inputs, model.outputs)
        except SimulationError as error:
            slow = reachable.statement(model.outputs)
            raise SimulationError(f"{reference_path}: {error} {slow} Or accept it with --clip.") from None
    return Compensation(model, built, reachable, time_s, reference, held, predicted, resampled)


def _drive(model: HammersteinModel, range_v: float | None) -> Drive:
    """Drive of the model within a finite range."""
    own = model.instruments.drive
    if range_v is not None and not (math.isfinite(range_v) and range_v > 0.0):
        raise InputError("--range", f"must be a positive voltage, not {range_v:g}")
    if range_v is None:
        range_v = own.range_v if math.isfinite(own.range_v) else model.amplitude_v
    return own.model_copy(update={"range_v": range_v})


def _on_grid(path: Path, model: HammersteinModel, sample_time_s: float) -> tuple[Array, Array, bool]:
    """Times (sample,), reference (output, sample) on the drive's grid, and whether it was resampled."""
    times, values, names = read_signal(path)
    if len(values) != len(model.outputs):
        raise InputError(
            str(path), f"has {len(values)} columns beside time_s; the model has {len(model.outputs)} outputs"
        )
    if set(names) == set(model.outputs):  # named like the outputs: their order in the file does not matter
        values = values[[names.index(name) for name in model.outputs]]
    samples = math.floor((times[-1] - times[0]) / sample_time_s + 1e-6) + 1
    grid = times[0] + np.arange(samples) * sample_time_s
    same = samples == len(times) and bool(np.abs(times - grid).max() < 1e-3 * sample_time_s)
    if samples < 2:
        raise InputError(str(path), f"is shorter than two samples of {sample_time_s:g} s")
    reference = values if same else np.stack([np.interp(grid, times, row) for row in values])
    return grid, np.ascontiguousarray(reference), not same


def _spec(model_path: str, law: str, options: Mapping[str, Any]) -> Compensator:
    given = {name: value for name, value in options.items() if value is not None}
    try:
        return TypeAdapter(Compensator).validate_python(
            {"label": law or "law", "law": law, "model": model_path, **given}
        )
    except ValidationError as error:
        raise InputError("compensate", mistakes_of(error, NoCompensation)) from None

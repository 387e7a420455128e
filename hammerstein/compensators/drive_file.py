"""From a reference file to the voltages that a person can send."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from hammerstein.arrays import Array
from hammerstein.blocks import Law, checked_reference
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators import COMPENSATORS, Compensator, HammersteinInverse
from hammerstein.compensators.drive_csv import Tell, drive_csv
from hammerstein.compensators.path_file import UNWATCHED, Onlooker, read_path
from hammerstein.compensators.reach import Reach, Shortfall, reach, require_reach, shortfall
from hammerstein.errors import HammersteinError, IdentificationError, InputError, SimulationError
from hammerstein.files import Content
from hammerstein.model import HammersteinModel
from hammerstein.validation import mistakes_of

CONTENT = Content("drive file", sign="time_s,drive_")

HEADING = "Voltages to send, as they are: absolute, in V. Times in s, positions in um."
FILTER_TRIALS, FILTER_DECADES = 16, 300.0
LOST_SHARE = 0.2
"""Part of a path, in rms, that a filter may take away to be proposed."""

LawLike = str | Compensator
"""A law by its name in a scenario, or a compensator."""


@dataclass(frozen=True, eq=False)
class Compensation:
    """A drive for real hardware, and what the model says of it.

    time_s : (sample,) on the drive's sample time; reference_um : (output, sample), counted from the start
    drive_v : (input, sample) as it is sent: absolute, on the converter's steps and within the range
    reach : what slow paths can reach
    shortfall : predicted position and error, and where the voltage stands at the range
    resampled : whether the file was interpolated onto the drive's sample time
    source : name of the model
    """

    model: HammersteinModel
    law: Law[Any]
    reach: Reach
    time_s: Array
    reference_um: Array
    drive_v: Array
    shortfall: Shortfall
    resampled: bool
    source: str

    def __repr__(self) -> str:
        drive, error = self.drive_v, self.shortfall.error_um
        return (
            f"Compensation({drive.shape[1]} samples of {self.law!r}; drive {drive.min():.4g} to "
            f"{drive.max():.4g} V, predicted error up to {np.abs(error).max():.3g} um)"
        )

    def unreached_samples(self) -> dict[str, int]:
        """Samples at the range, by input."""
        counts = self.shortfall.at_range.sum(axis=1)
        return {name: int(n) for name, n in zip(self.model.inputs, counts, strict=True)}

    def summary(self) -> dict[str, Any]:
        """Give voltages, reach, predicted error and what was not reached, as plain JSON."""
        axes = {
            name: {
                "reach_alone_um": self.reach.alone_um[o].tolist(),
                "reach_together_um": self.reach.together_um[o].tolist(),
                "reference_um": [float(self.reference_um[o].min()), float(self.reference_um[o].max())],
                "predicted_rms_um": float(np.sqrt(np.mean(self.shortfall.error_um[o] ** 2))),
                "predicted_max_um": float(np.abs(self.shortfall.error_um[o]).max()),
            }
            for o, name in enumerate(self.model.outputs)
        }
        limits = self.law.range
        inputs = {
            name: {
                "drive_v": [float(row.min()), float(row.max())],
                "range_v": [float(limits.low_v[k]), float(limits.high_v[k])],
                "start_v": float(limits.start_v[k]),
                "recorded_v": [self.model.recorded.lowest_v[k], self.model.recorded.highest_v[k]],
            }
            for k, (name, row) in enumerate(zip(self.model.inputs, self.drive_v, strict=True))
        }
        return {
            "axes": axes,
            "inputs": inputs,
            "statements": self.statements(),
            "unreached_samples": self.unreached_samples(),
        }

    def statements(self) -> list[str]:
        """Say what a user must know before the voltages are sent."""
        said = [f"Model {self.source}, found from {self.model.recorded.statement(self.model.inputs)}."]
        said += verdict_statements(self.model)
        said += [self._start(), f"Range {self.law.range.words(self.model.inputs)}."]
        verdict = self.model.verdict
        off = verdict.error(self.model.outputs) if verdict is not None else ""
        said.append(
            "Predicted: the error if the actuator were exactly the model. "
            + (
                f"By its fit report the model is off by {off}."
                if off
                else "Its file does not say how far off it is."
            )
        )
        if not self.shortfall.complete:
            said.append(self.shortfall.statement(self.model.inputs, self.model.outputs))
        said += [text] if (text := self.law.statement()) else []
        if self.resampled:
            said.append(
                "The file was interpolated linearly onto the drive's sample time; corners may need filter_hz."
            )
        return said

    def _start(self) -> str:
        """Say how the actuator must come to the first row."""
        limits, names = self.law.range, self.model.inputs
        start = ", ".join(f"{u:.6g} V on {n}" for n, u in zip(names, limits.start_v, strict=True))
        rest = ", ".join(f"{u:.6g} V" for u in limits.working_point_v)
        text = f"Before the first row the actuator stands at {start}, from where the path counts: "
        if limits.conditioned:
            top, low = (", ".join(f"{u:.6g} V" for u in ends) for ends in (limits.high_v, limits.low_v))
            return f"{text}driven to {top}, then to {low}, then straight to there."
        if (limits.start_v == limits.working_point_v).all():
            return f"{text}at rest, as the records began."
        return f"{text}at rest at {rest} before, then straight to there."

    def to_csv(self, tell: Tell | None = None) -> str:
        """Text of the drive file: time, voltages to send, reference, predicted position.

        tell : told how many rows are written
        """
        inputs, outputs = self.model.inputs, self.model.outputs
        groups = (
            ("drive", "v", inputs, self.drive_v),
            ("reference", "um", outputs, self.reference_um),
            ("predicted", "um", outputs, self.shortfall.predicted_um),
        )
        return drive_csv(self.time_s, groups, [HEADING, *self.statements()], tell)


def verdict_statements(model: HammersteinModel) -> list[str]:
    """What the model's own identification warns of."""
    verdict, said = model.verdict, []
    if verdict is not None and verdict.flagged:
        said.append("FLAGGED by its fit report: " + "; ".join(verdict.statements or ("see there",)) + ".")
    if verdict is not None and not verdict.held_out:
        said.append("Warning: no record was held back, so that nothing has tested this model (--validate).")
    return said


@dataclass(frozen=True)
class Terms:
    """What a person allows a drive to do.

    range_v : (low, high) for all inputs or one after the other [V]; one number N stands for -N to N; the
        range of the records, as far as the model's own drive gives it, if not given
    start_v : voltage of each input before the first row [V]; the working point if not given
    conditioned : whether the actuator was driven to both ends of the range before it came to the start
    clip : accept a path that is partly out of reach
    beyond_records : accept voltages that the records did not cover
    accept_flagged : accept a model that its own fit report flagged
    """

    range_v: tuple[float, ...] | None = None
    start_v: tuple[float, ...] | None = None
    conditioned: bool = False
    clip: bool = False
    beyond_records: bool = False
    accept_flagged: bool = False


def compensate(
    model_path: str,
    reference_path: Path,
    law: str,
    options: Mapping[str, Any],
    terms: Terms | None = None,
    onlooker: Onlooker = UNWATCHED,
) -> Compensation:
    """Voltages for a reference file (``time_s`` and one column an axis, in um).

    The voltages are absolute. The positions of the file count from where the actuator stands at the start.

    Parameters
    ----------
    model_path : model file, or name of a packaged actuator
    reference_path : CSV file
    law, options : a law and its options, by their names in a scenario
    terms : range, start, and what is accepted
    onlooker : told the cost of the path before the work

    Raises
    ------
    InputError : a file or an option is wrong
    SimulationError : the law cannot work, the path is out of reach or does not fit the memory, or the drive
        leaves the records
    IdentificationError : the model's own fit report flagged it
    """
    model, source = HammersteinModel.load(model_path), PurePath(model_path).name
    sample_time_s = model.instruments.drive.sample_time_s
    time_s, reference, resampled = read_path(reference_path, model, sample_time_s, onlooker=onlooker)
    onlooker.tell("designing the drive")
    try:
        found = compensation_of(model, reference, law, options, terms, source)
    except SimulationError as error:
        raise SimulationError(f"{reference_path}: {error}") from None
    return replace(found, time_s=time_s, resampled=resampled)


def compensation_of(
    model: HammersteinModel,
    reference_um: ArrayLike,
    law: LawLike,
    options: Mapping[str, Any],
    terms: Terms | None = None,
    source: str | None = None,
) -> Compensation:
    """Voltages for a reference (output, sample) [um] on the sample time of the model's drive.

    source : what the model is called in messages; its name if not given. The rest is that of ``compensate``.
    """
    terms, called = terms or Terms(), source or model.name
    refuse_flagged(model, called, terms)
    limits = allowed_range(model, terms)
    drive = model.instruments.drive.model_copy(
        update={"range_v": tuple(zip(limits.low_v.tolist(), limits.high_v.tolist(), strict=True))}
    )
    reference = checked_reference(reference_um, len(model.outputs))
    compensator = compensator_of(law, options)
    built = sensorless_law(compensator, {}, model, limits, drive.sample_time_s)
    asked = built.drive_for(reference)
    held, _ = drive.apply(asked)
    predicted = shortfall(model, built, reference, asked, drive.sample_time_s, held)
    reachable = reach(model, limits, run_anyway=True)
    if not terms.clip:
        try:
            require_reach(predicted, model.inputs, model.outputs)
        except SimulationError as error:
            volts = f"With {limits.words(model.inputs)} (--range), counted from the start (--start):"
            remedy = _slower(model, limits, compensator, reference, drive.sample_time_s)
            raise SimulationError(
                f"{error} {volts} {reachable.statement(model.outputs)} {remedy}Or accept it with --clip."
            ) from None
    if not terms.beyond_records:
        refuse_beyond(model, held)
    time_s = np.arange(reference.shape[1], dtype=np.float64) * drive.sample_time_s
    return Compensation(model, built, reachable, time_s, reference, held, predicted, False, called)


def refuse_flagged(model: HammersteinModel, path: str, terms: Terms) -> None:
    """Refuse a model that its own fit report flags, unless that is accepted.

    Raises IdentificationError with what the report says.
    """
    verdict = model.verdict
    if verdict is not None and verdict.flagged and not terms.accept_flagged:
        what = "; ".join(verdict.statements) or "see its fit report"
        raise IdentificationError(
            f"{path}: its own fit report flags this model: {what}. Identify it again, or send its voltages "
            "all the same with --accept-flagged."
        )


def allowed_range(model: HammersteinModel, terms: Terms) -> DriveRange:
    """What the drive may do: the recorded range, or what is asked for.

    Raises InputError for a range or a start that does not fit the model.
    """
    m = len(model.inputs)
    recorded = np.array([model.recorded.lowest_v, model.recorded.highest_v])
    low, high = recorded
    if terms.range_v is not None:
        low, high = _asked_range(model, terms.range_v, m)
    own = model.instruments.drive.limits(m)
    wide = (low < own[0]) | (high > own[1])
    if terms.range_v is not None and wide.any():
        k = int(np.argmax(wide))
        raise InputError(
            "--range",
            f"{low[k]:g} to {high[k]:g} V is more than the drive in the model file gives on "
            f"{model.inputs[k]}, {own[0, k]:g} to {own[1, k]:g} V",
        )
    if terms.start_v is not None and len(terms.start_v) not in (1, m):
        raise InputError("--start", f"names {len(terms.start_v)} voltages; the model has {m} inputs")
    start = None if terms.start_v is None else np.broadcast_to(np.array(terms.start_v), m)
    ends = np.stack([np.maximum(low, own[0]), np.minimum(high, own[1])], axis=1)
    return DriveRange.of(ends, model, start, terms.conditioned)


def _asked_range(model: HammersteinModel, given: tuple[float, ...], m: int) -> Array:
    """Lowest and highest voltage (2, m) from the numbers of an option."""
    one_sided = model.recorded.one_sided()
    if len(given) == 1 and one_sided:
        k = one_sided[0]
        low, high = model.recorded.lowest_v[k], model.recorded.highest_v[k]
        raise InputError(
            "--range",
            f"{given[0]:g} would mean {-given[0]:g} to {given[0]:g} V, but {model.inputs[k]} was recorded "
            f"on one side, from {low:.6g} to {high:.6g} V; give LOW,HIGH",
        )
    if len(given) not in (1, 2, 2 * m):
        raise InputError("--range", f"has {len(given)} numbers; give LOW,HIGH, or one pair for each input")
    pairs = np.reshape(given if len(given) > 1 else (-given[0], given[0]), (-1, 2))
    ends = np.broadcast_to(pairs, (m, 2)).T
    if not (np.isfinite(ends).all() and (ends[0] < ends[1]).all()):
        raise InputError("--range", "must be finite voltages, each LOW below its HIGH, or one N above 0")
    return np.asarray(ends, dtype=np.float64)


def refuse_beyond(model: HammersteinModel, drive_v: Array) -> None:
    """Refuse voltages that the records did not cover.

    Raises SimulationError with the range of the records.
    """
    recorded = model.recorded
    for name, row, low, high in zip(
        model.inputs, drive_v, recorded.lowest_v, recorded.highest_v, strict=True
    ):
        outside = (row < low) | (row > high)
        if outside.any():
            raise SimulationError(
                f"The drive goes from {row.min():.6g} to {row.max():.6g} V on {name}; the records behind the "
                f"model cover {low:.6g} to {high:.6g} V, {int(outside.sum())} of {row.size} samples lie "
                "outside. Record that range too, or accept it with --beyond-records."
            )


def _slower(
    model: HammersteinModel,
    limits: DriveRange,
    compensator: Compensator,
    reference: Array,
    sample_time_s: float,
) -> str:
    """Bandwidth of the reference filter with which the path is within reach, as a sentence; or nothing.

    A filter that takes the path itself away is none.
    """
    if not isinstance(compensator, HammersteinInverse) or compensator.filter_hz is not None:
        return ""
    nyquist = 0.5 / sample_time_s
    lowest = max(2.0 / (reference.shape[1] * sample_time_s), nyquist / FILTER_DECADES)
    best, most = None, LOST_SHARE * float(np.std(reference, axis=1).max())
    for frequency in np.geomspace(0.75 * nyquist, lowest, FILTER_TRIALS):
        rounded = float(f"{frequency:.2g}")
        try:
            filtered = compensator.model_copy(update={"filter_hz": rounded})
            built = sensorless_law(filtered, {}, model, limits, sample_time_s)
            found = shortfall(model, built, reference, built.drive_for(reference), sample_time_s)
        except HammersteinError:
            break
        if found.complete:
            lost = float(np.sqrt(np.mean(found.error_um**2, axis=1)).max())
            best = (rounded, float(np.abs(found.error_um).max())) if lost < most else None
            break
    if best is None:
        return "Ask for a smaller or a slower path. "
    return (
        f"With --filter-hz {best[0]:g} it is within reach: what is faster is then left out, up to "
        f"{best[1]:.3g} um of it. "
    )


def sensorless_law(
    law: LawLike,
    options: Mapping[str, Any],
    model: HammersteinModel,
    limits: DriveRange,
    sample_time_s: float,
) -> Law[Any]:
    """Design the law that is named; InputError where it needs the sensor, or its options are wrong."""
    compensator = compensator_of(law, options)
    built = compensator.design(model, limits, sample_time_s)
    if not isinstance(built, Law):
        what = f"{compensator.law} needs the sensor's readings: it has no drive to send ahead"
        raise InputError("--law", what)
    return built


def compensator_of(law: LawLike, options: Mapping[str, Any]) -> Compensator:
    """Give the compensator that is named, with its options, or that is there already.

    Raises InputError for an unknown law or option.
    """
    if isinstance(law, Compensator):
        if options:
            names = ", ".join(sorted(options))
            raise InputError("compensate", f"give {names} to {type(law).__name__} itself")
        return law
    given = {name: value for name, value in options.items() if value is not None}
    try:
        return COMPENSATORS.value({"law": law, **given})
    except ValidationError as error:
        raise InputError("compensate", mistakes_of(error, COMPENSATORS.adapter())) from None

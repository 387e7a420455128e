"""From a reference file to voltages for the real actuator."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.blocks import Law as Law, checked_reference  # a type of what a drive file inherits
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators.added_motion import approached, lead_in
from hammerstein.compensators.attempt import (
    Attempt,
    LawLike as LawLike,
    MissedPath,
    Prediction,
    compensator_of,
    stated_error_um,
)
from hammerstein.compensators.base import Compensator
from hammerstein.compensators.path_file import (
    UNWATCHED,
    Onlooker,
    Tell,
    drive_csv,
    predicted_groups,
    read_path,
)
from hammerstein.compensators.reach import Reach, Shortfall as Shortfall, reach
from hammerstein.dynamics import WithLoop
from hammerstein.errors import HammersteinError, IdentificationError, InputError, SimulationError
from hammerstein.files import write_atomic
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length
from hammerstein.records.turning_points import noise_rms
from hammerstein.runtime.staging import Owner

DRIVE = Owner("drive", single=True)

ROUGH, AMPLIFIED = 1e-3, 10.0
"""Noise of a drive, relative to its span, and its ratio to the relative noise of the path, from which it is
named: a path rounded to 1 nm became steps of 15 V for a stage of 200 Hz on a grid of 20 kHz."""
LARGE_STEP = 0.1  # of the range, from which a step between two samples is named
ALTERNATES = 0.01  # of the range, from which a step counts that the next one takes back
FEWEST = 10  # such steps, of an input, from which the drive is said to alternate
SMOOTHER = (0.5, 0.25, 0.125, 0.0625)
"""Bandwidths of a filter that are tried against it, in parts of Nyquist's frequency."""
FASTER = 3.0  # than the records, from which a drive is said to go beyond them; forces grow with the square
FINEST = 1e-8  # rounding of a path, relative to its span, below which it is not what makes a drive rough
HEADING = "Voltages to send: absolute, in V. Times in s, positions in um."


INITIAL_STATE, AT_REST = "Initial state, where the path is zero", "at rest, without history"
DRIVEN_TO = "driven to"
NOTHING = 1e-5
"""Error, in parts of a path, that never counts as out of reach."""
EARLIER = " Earlier motion shifts the position"
FORGOTTEN = "; less so after both ends of the range (--conditioned)"


@dataclass(frozen=True, eq=False)
class Compensation(Attempt):
    """Drive for real hardware, and its prediction by the model.

    law : law of the drive
    reference_um : path (output, sample), its lead-in included, counted from the start [um]
    drive_v : voltages (input, sample) to send: absolute, on the converter's steps, in the range
    prediction : parts of the error
    reach : what slow paths can reach
    time_s : (sample,) on the drive's sample time; the path begins at its own time, a lead-in before it
    resampled : how the file was interpolated onto the drive's sample time; empty if it was not
    source : name of the model
    held : whether the drive is limited by the range, at an error smaller than that of the model
    approach : statement on the holds of the path that are approached from one side, if requested
    alternating : statement on a drive that alternates from sample to sample, see ``alternating``
    """

    model: HammersteinModel
    prediction: Prediction
    reach: Reach
    time_s: Array
    resampled: str
    source: str
    held: bool = False
    approach: str = ""
    alternating: str = ""

    def __repr__(self) -> str:
        drive, error = self.drive_v, self.shortfall.error_um
        return (
            f"Compensation({drive.shape[1]} samples of {self.law!r}; drive {drive.min():.4g} to "
            f"{drive.max():.4g} V, predicted error up to {np.abs(error).max():.3g} um)"
        )

    def summary(self) -> dict[str, Any]:
        """Return voltages, reach, predicted error and what was not reached, as plain JSON."""
        axes = {
            name: {
                "reach_alone_um": self.reach.alone_um[o].tolist(),
                "reach_together_um": self.reach.together_um[o].tolist(),
                "reference_um": [float(self.reference_um[o].min()), float(self.reference_um[o].max())],
                "predicted_rms_um": float(self.path_rms_um[o]),
                "predicted_max_um": float(self.path_error_um[o]),
                "expected_error": self.prediction.summary(o),
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
            "unreached_samples": dict(zip(inputs, self.shortfall.at_range.sum(axis=1).tolist(), strict=True)),
        }

    def essentials(self) -> list[str]:
        """Summarise in at most three lines what to check before sending; the file has the details."""
        warned = [*verdict_statements(self.model), *self._path_statements()]
        expected = self.prediction.statement(self.model.outputs)
        return [*([" ".join(warned)] if warned else []), self._start(), expected]

    def statements(self) -> list[str]:
        """All statements on the voltages."""
        inputs, recorded = self.model.inputs, self.model.recorded
        said = [f"Model {self.source} ({self.model.origin}): {recorded.statement(inputs)}."]
        said += [*verdict_statements(self.model), self._start(), f"Range {self.law.range.words(inputs)}."]
        said.append(self.prediction.statement(self.model.outputs))
        if self.lead:
            seconds = self.lead * (self.time_s[1] - self.time_s[0])
            said.append(f"The first {seconds:.4g} s move from the initial position to the start of the path.")
        said += [text] if (text := self.law.statement()) else []
        return said + self._path_statements()

    def _path_statements(self) -> list[str]:
        """Say where the drive follows another path than the file has."""
        said = [self.approach] if self.approach else []
        if self.held:
            said.append(self._held())
        elif not self.shortfall.complete:
            said.append(self.shortfall.statement(self.model.inputs, self.model.outputs, self.lead))
        said += [*filter(None, [self.alternating]), *self._amplified, *self._stepping, *self._faster]
        said += filter(None, [beyond_records(self.model, self.drive_v)])
        if self.resampled:
            said.append(self.resampled)
        return said

    def _held(self) -> str:
        """Say that the range limits the drive, and by how much less than the model errs."""
        lead, limited = self.lead, self.shortfall.at_range.any(axis=0)
        if limited[lead:].any():
            return "The drive reaches the limit of its range; the error that this adds is below the model's."
        most = f"{np.abs(self.shortfall.error_um[:, :lead]).max():.2g} um"
        return (
            f"The range limits the lead-in, by up to {most}; the error that this adds on the path is below "
            "the model's."
        )

    @cached_property
    def _amplified(self) -> list[str]:
        """Say where the law turns the rounding or noise of the path into a noise of the drive."""
        path, drive = self.reference_um[:, self.lead :], self.drive_v[:, self.lead :]
        rough_um, span_um = max(map(noise_rms, path)), float(np.ptp(path, axis=1).max())
        if rough_um < FINEST * span_um:
            return []
        for name, row in zip(self.model.inputs, drive, strict=True):
            rough_v, span_v = noise_rms(row), float(np.ptp(row))
            if rough_v > ROUGH * span_v and rough_v * span_um > AMPLIFIED * rough_um * span_v:
                return [
                    f"The law amplifies rounding or noise of the path, {rough_um:.1g} um rms, to "
                    f"{rough_v:.1g} V rms on {name}: give the path more digits, or use --filter-hz."
                ]
        return []

    @property
    def _stepping(self) -> Iterator[str]:
        """Name a step between two samples, or from the start to the first, that is large in the range."""
        limits = self.law.range
        each = zip(self.model.inputs, self.drive_v, limits.start_v, limits.span_v, strict=True)
        for name, row, start, span in each:
            steps = np.abs(np.diff(row, prepend=start))
            if (largest := float(steps.max())) <= LARGE_STEP * span:
                continue
            if largest == steps[0] and not self.lead:
                yield f"The first sample of {name} is {largest:.3g} V from the start: --lead-in leads there."
            else:
                yield f"Largest step of {name} between two samples: {largest:.3g} V."

    @property
    def _faster(self) -> Iterator[str]:
        """Name an input that changes much faster than in the records: its error there is untested."""
        model = self.model
        fastest = np.abs(np.diff(self.drive_v)).max(axis=1) / model.instruments.drive.sample_time_s
        for name, here, known in zip(model.inputs, fastest, model.recorded.fastest_v_per_s, strict=False):
            if here > FASTER * known:
                yield (
                    f"{name} changes by up to {1e-3 * here:.3g} V/ms, in the records by {1e-3 * known:.3g}: "
                    "the error of the model at such rates is untested."
                )

    def _start(self) -> str:
        """Say how the actuator must come to the first row."""
        limits, names = self.law.range, self.model.inputs
        start = ", ".join(f"{u:.6g} V on {n}" for n, u in zip(names, limits.start_v, strict=True))
        rest = ", ".join(f"{u:.6g} V" for u in limits.working_point_v)
        text = f"{INITIAL_STATE}: {start}, "
        if limits.conditioned:
            low, top = (", ".join(f"{u:.6g} V" for u in ends) for ends in limits.conditioning_v)
            return f"{text}{DRIVEN_TO} {top}, then to {low}, then directly to the start."
        forgotten = FORGOTTEN * (not isinstance(self.model.dynamics, WithLoop))  # whose laws begin at rest
        earlier = f"{EARLIER}{forgotten}." if self.prediction.rest is None else ""
        if (limits.start_v == limits.working_point_v).all():
            return f"{text}{AT_REST}.{earlier}"
        return f"{text}at rest at {rest} before, then directly to the start.{earlier}"

    def to_csv(self, path: Path | str | None = None, *, tell: Tell | None = None) -> str:
        """Text of the drive file: time, voltages to send, reference, predicted position.

        path : file to write; tell : receives the number of rows written so far
        """
        groups = predicted_groups(self.model, self.drive_v, self.reference_um, self.shortfall.predicted_um)
        text = drive_csv(self.time_s, groups, [HEADING, *self.statements()], tell)
        if path is not None:
            write_atomic(Path(path), text)
        return text


def verdict_statements(model: HammersteinModel) -> list[str]:
    """Warnings from the model's identification."""
    verdict, said = model.verdict, []
    if verdict is not None and verdict.flagged:
        said.append("FLAGGED by its fit report: " + "; ".join(verdict.statements or ("see there",)) + ".")
    if verdict is not None and not verdict.held_out:
        said.append("Warning: no validation record has tested this model (--validate).")
    return said


@dataclass(frozen=True)
class Terms:
    """Limits that the user sets for a drive.

    range_v : (low, high) for all inputs or one after the other [V]; one number N stands for -N to N; the
        range of the records, as far as the model's own drive gives it, if not given
    start_v : voltage of each input before the first row [V]; the working point if not given
    conditioned : whether the actuator was driven to the highest, then to the lowest voltage of the range
        before it came to the start; if not given, to those of the records, where these began like that
    clip : accept a path that is partly out of reach
    beyond_records : accept voltages that the records did not cover
    accept_flagged : accept a model that its own fit report flagged
    lead_in : move from the actuator's position to the beginning of the path first
    offset_um : added to the positions of each output, or of all [um]
    approach_um : distance by which a detour goes past each hold, see ``approached`` [um]
    units : of positions in a file whose columns name none, such as nm
    step_v : of the converter [V]; that of the model file if not given
    """

    range_v: tuple[float, ...] | None = None
    start_v: tuple[float, ...] | None = None
    conditioned: bool | None = None
    clip: bool = False
    beyond_records: bool = False
    accept_flagged: bool = False
    lead_in: bool = False
    offset_um: tuple[float, ...] | None = None
    approach_um: tuple[float, ...] | None = None
    units: str | None = None
    step_v: float | None = None

    def loaded(self, model_path: str) -> HammersteinModel:
        """Model of a file, or a packaged one, with the converter that these terms name."""
        model = HammersteinModel.load(model_path)
        if self.step_v is None:
            return model
        if not 0.0 <= self.step_v < np.inf:
            raise InputError("--converter-step", f"must be at least 0 V, not {self.step_v:g}")
        drive = model.instruments.drive.model_copy(update={"resolution_v": self.step_v})
        return replace(model, instruments=model.instruments.model_copy(update={"drive": drive}))

    def refuse_flagged(self, model: HammersteinModel, path: str) -> None:
        """Refuse a model whose fit report has flags, unless they are accepted.

        Raises IdentificationError with the flags of the report.
        """
        verdict = model.verdict
        if verdict is not None and verdict.flagged and not self.accept_flagged:
            what = "; ".join(verdict.statements) or "see its fit report"
            raise IdentificationError(
                f"{path}: its own fit report flags this model: {what}. Run hammerstein compare on its "
                "records, which tries other kinds; --accept-flagged uses the model anyway."
            )

    def allowed_range(self, model: HammersteinModel) -> DriveRange:
        """Range of the drive: that of the records, or the requested one.

        Raises InputError for a range or a start that does not fit the model.
        """
        m = len(model.inputs)
        low, high = np.array([model.recorded.lowest_v, model.recorded.highest_v])
        if self.range_v is not None:
            low, high = _asked_range(model, self.range_v, m)
        own = model.instruments.drive.limits(m)
        wide = (low < own[0]) | (high > own[1])
        if self.range_v is not None and wide.any():
            k = int(np.argmax(wide))
            raise InputError(
                "--range",
                f"{low[k]:g} to {high[k]:g} V exceeds the range of {model.inputs[k]} in the model file "
                f"(instruments.drive.range_v), {own[0, k]:g} to {own[1, k]:g} V",
            )
        if self.start_v is not None and len(self.start_v) not in (1, m):
            raise InputError("--start", f"names {len(self.start_v)} voltages; the model has {m} inputs")
        start = None if self.start_v is None else np.broadcast_to(np.array(self.start_v), m)
        ends = np.stack([np.maximum(low, own[0]), np.minimum(high, own[1])], axis=1)
        if self.conditioned is not None:
            return DriveRange.of(ends, model, start, self.conditioned)
        between = np.array([model.recorded.lowest_v, model.recorded.highest_v])
        return DriveRange.of(ends, model, start, model.recorded.conditioned, between)

    def moved(self, path_um: Array) -> Array:
        """Path (p, N) with the offset added to each output [um]; InputError for another number of them."""
        offset_um = self.offset_um
        if offset_um is None:
            return path_um
        if len(offset_um) not in (1, len(path_um)) or not np.isfinite(offset_um).all():
            raise InputError(
                "--offset", f"names {len(offset_um)} offsets; the model has {len(path_um)} outputs"
            )
        return np.asarray(path_um + np.broadcast_to(np.array(offset_um), len(path_um))[:, None])

    def refuse_beyond(self, model: HammersteinModel, drive_v: Array) -> None:
        """Refuse voltages that the records did not cover, unless they are accepted.

        Raises SimulationError with the range of the records.
        """
        beyond = "" if self.beyond_records else beyond_records(model, drive_v)
        if beyond:
            raise SimulationError(f"{beyond} Record this range too, or accept it with --beyond-records.")


def _asked_range(model: HammersteinModel, given: tuple[float, ...], m: int) -> Array:
    """Lowest and highest voltage (2, m) from the numbers of an option."""
    one_sided = model.recorded.one_sided()
    if len(given) == 1 and one_sided:
        k = one_sided[0]
        low, high = model.recorded.lowest_v[k], model.recorded.highest_v[k]
        raise InputError(
            "--range",
            f"{given[0]:g} means {-given[0]:g} to {given[0]:g} V, but {model.inputs[k]} was recorded "
            f"on one side only, from {low:.6g} to {high:.6g} V; give LOW,HIGH",
        )
    if len(given) not in (1, 2, 2 * m):
        raise InputError("--range", f"has {len(given)} numbers; give LOW,HIGH, or one pair for each input")
    pairs = np.reshape(given if len(given) > 1 else (-given[0], given[0]), (-1, 2))
    ends = np.broadcast_to(pairs, (m, 2)).T
    if not (np.isfinite(ends).all() and (ends[0] < ends[1]).all()):
        raise InputError("--range", "must be finite voltages, each LOW below its HIGH, or a single N above 0")
    return np.asarray(ends, dtype=np.float64)


def compensate(
    model_path: str,
    reference_path: Path,
    law: str,
    options: Mapping[str, Any],
    terms: Terms | None = None,
    onlooker: Onlooker = UNWATCHED,
) -> Compensation:
    """Voltages for a reference file (``time_s`` and one column for each axis, in um).

    The voltages are absolute. The positions of the file are relative to the actuator's position at the start.

    Parameters
    ----------
    model_path : model file, or name of a packaged actuator
    reference_path : CSV file
    law, options : a law and its options, by their names in a scenario
    terms : range, start, and what is accepted
    onlooker : receives the cost of the path before the work

    Raises
    ------
    InputError : a file or an option is wrong
    SimulationError : the law cannot work, the path is out of reach or does not fit the memory, or the drive
        leaves the records
    IdentificationError : the model's own fit report flagged it
    """
    terms = terms or Terms()
    model, source = terms.loaded(model_path), PurePath(model_path).name
    sample_time_s = model.instruments.drive.sample_time_s
    time_s, reference, resampled = read_path(
        reference_path, model, sample_time_s, onlooker=onlooker, units=terms.units
    )
    onlooker.tell("computing the drive")
    try:
        found = compensation_of(model, reference, law, options, terms, source)
    except SimulationError as error:
        raise SimulationError(f"{reference_path}: {error}") from None
    return replace(found, time_s=time_s[0] + found.time_s, resampled=resampled)


def compensation_of(
    model: HammersteinModel,
    reference_um: ArrayLike,
    law: LawLike,
    options: Mapping[str, Any],
    terms: Terms | None = None,
    source: str | None = None,
) -> Compensation:
    """Voltages for a reference (output, sample) [um] on the sample time of the model's drive.

    source : name of the model in messages. The other parameters are those of ``compensate``.
    """
    terms, called = terms or Terms(), source or model.name
    terms.refuse_flagged(model, called)
    limits = terms.allowed_range(model)
    time_step = model.instruments.drive.sample_time_s
    path, approach = terms.moved(checked_reference(reference_um, len(model.outputs))), ""
    if terms.approach_um is not None:
        detours = approached(path, terms.approach_um, time_step)
        path, approach = detours.path_um, detours.statement(model.outputs)
    before = lead_in(path, time_step) if terms.lead_in else path[:, :0]
    compensator = compensator_of(law, options)
    found = Attempt.of(model, limits, compensator, np.hstack([before, path]), before.shape[1])
    prediction = Prediction.of(model, found)
    own = NOTHING * np.ptp(path, axis=1)
    if (stated := stated_error_um(model)) is not None:
        own = np.maximum(own, stated)
    held = found.within_error(model, limits, compensator, own)
    reachable = reach(model, limits, run_anyway=True)
    if not (terms.clip or held or found.complete):
        missed = MissedPath(model, limits, compensator, path, own, reachable, terms.offset_um, found)
        raise SimulationError(f"out of reach: {missed.statement()}")
    terms.refuse_beyond(model, found.drive_v)
    time_s = (np.arange(found.reference_um.shape[1], dtype=np.float64) - found.lead) * time_step
    attempt = (found.law, found.reference_um, found.lead, found.drive_v, found.shortfall)
    rings = _alternation(model, limits, compensator, found)
    return Compensation(*attempt, model, prediction, reachable, time_s, "", called, held, approach, rings)


def alternating(model: HammersteinModel, drive_v: Array, limits: DriveRange) -> str:
    """Name the input (of m) whose drive (m, N) alternates most from sample to sample; empty if none does.

    The response of a resonance to a held voltage has a zero near -1 (Astrom, Hagander and Sternby, Zeros of
    sampled systems, 1984). Its inverse rings at half the sample rate after every corner of the path: on the
    samples the model follows, and an amplifier cannot.
    """
    steps = np.diff(drive_v)
    back = np.minimum(np.abs(steps[:, 1:]), np.abs(steps[:, :-1])) * (steps[:, 1:] * steps[:, :-1] < 0.0)
    often = (back > ALTERNATES * limits.span_v[:, None]).sum(axis=1) >= FEWEST
    volts = np.where(often, back.max(axis=1, initial=0.0), 0.0)
    if not volts.any():
        return ""
    k = int(np.argmax(volts))
    return (
        f"The drive of {model.inputs[k]} alternates from sample to sample, by up to {volts[k]:.3g} V: the "
        "inverse rings after corners of the path."
    )


def _alternation(
    model: HammersteinModel, limits: DriveRange, compensator: Compensator, found: Attempt
) -> str:
    """Say that the drive alternates, see ``alternating``, and name the filter that prevents it."""
    said = alternating(model, found.drive_v, limits)
    nyquist_hz = 0.5 / model.instruments.drive.sample_time_s
    filtered = SMOOTHER if said and hasattr(compensator, "filter_hz") else ()
    for hz in (float(f"{part * nyquist_hz:.2g}") for part in filtered):
        try:
            tried = compensator.model_copy(update={"filter_hz": hz})
            smooth = Attempt.of(model, limits, tried, found.reference_um, found.lead)
        except HammersteinError:
            continue
        if not alternating(model, smooth.drive_v, limits):
            left = length(float(smooth.path_error_um.max()), 2)
            return f"{said} --filter-hz {hz:g} prevents it (error {left} um)."
    return f"{said} Round them." if said else ""


def beyond_records(model: HammersteinModel, drive_v: Array) -> str:
    """State where voltages (m, N) [V] exceed those of the records; empty if they do not."""
    recorded = model.recorded
    for name, row, low, high in zip(
        model.inputs, drive_v, recorded.lowest_v, recorded.highest_v, strict=True
    ):
        outside = (row < low) | (row > high)
        if outside.any():
            return (
                f"The drive goes from {row.min():.6g} to {row.max():.6g} V on {name}, but the records "
                f"cover {low:.6g} to {high:.6g} V; {int(outside.sum())} of {row.size} samples are outside."
            )
    return ""

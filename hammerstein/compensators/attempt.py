"""One law on one path: drive, predicted motion, expected error, and remedies where it does not reach."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from pydantic import ValidationError

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Drive
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.added_motion import lead_in
from hammerstein.compensators.path_file import half_span_v
from hammerstein.compensators.reach import Reach, Shortfall, shortfall
from hammerstein.errors import HammersteinError, InputError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length
from hammerstein.validation import mistakes_of

LARGEST_OF_NOISE = 4.5
"""Largest noise over its rms: one of 150,000 samples exceeds it."""
WIDER = 100.0
"""Extension of the range beyond each end, in spans, to find the voltage that a path needs."""
LawLike = str | Compensator
"""A law by its name in a scenario, or a compensator."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """Drive of a law for a path, and the predicted motion. The first ``lead`` samples are a lead-in.

    drive_v : (m, N) as sent; shortfall : predicted, of all samples
    """

    law: Law[Any]
    reference_um: Array
    lead: int
    drive_v: Array
    shortfall: Shortfall

    @classmethod
    def of(
        cls,
        model: HammersteinModel,
        limits: DriveRange,
        compensator: Compensator,
        reference_um: Array,
        lead: int = 0,
    ) -> Attempt:
        """Design the law, and drive the model with it."""
        drive = drive_within(model, limits)
        law = sensorless_law(compensator, model, limits, drive.sample_time_s)
        asked = law.drive_for(reference_um)
        sent, _ = drive.apply(asked)
        predicted = shortfall(model, law, reference_um, asked, drive.sample_time_s, sent)
        return cls(law, reference_um, lead, sent, predicted)

    def limited_um(self, model: HammersteinModel, limits: DriveRange, compensator: Compensator) -> Array:
        """Largest change (p,) of the motion on the path that the range causes [um].

        It excludes the law's own error. If no drive is found without range, it is the whole error.
        """
        wide = widened(limits)
        if wide is None or self.law.softens(self.reference_um):
            return self.path_error_um
        try:
            free = Attempt.of(model, wide, compensator, self.reference_um, self.lead)
        except HammersteinError:
            return self.path_error_um
        change = self.shortfall.error_um - free.shortfall.error_um
        return np.asarray(np.abs(change[:, self.lead :]).max(axis=1))

    def within_error(
        self, model: HammersteinModel, limits: DriveRange, compensator: Compensator, own_um: Array
    ) -> bool:
        """Whether the range limits the drive, but the path by less than the model errs, own_um (p,)."""
        return not self.complete and bool(
            (self.path_error_um <= own_um).all()
            or (self.limited_um(model, limits, compensator) <= own_um).all()
        )

    @property
    def complete(self) -> bool:
        """Whether the drive never reaches its range and follows the path."""
        return self.shortfall.complete and not self.law.softens(self.reference_um)

    @property
    def path_error_um(self) -> Array:
        """Largest error of each output (p,) on the path, without its lead-in [um]."""
        return np.asarray(np.abs(self.shortfall.error_um[:, self.lead :]).max(axis=1))

    @property
    def path_rms_um(self) -> Array:
        """Rms error of each output (p,) there [um]."""
        return np.sqrt(np.mean(self.shortfall.error_um[:, self.lead :] ** 2, axis=1))


def drive_within(model: HammersteinModel, limits: DriveRange) -> Drive:
    """Drive of a model with another range."""
    ends = tuple(zip(limits.low_v.tolist(), limits.high_v.tolist(), strict=True))
    return model.instruments.drive.model_copy(update={"range_v": ends})


def widened(limits: DriveRange) -> DriveRange | None:
    """The range with its ends far away, after the same history; None without ends."""
    span, before = WIDER * limits.span_v, limits.conditioning_v
    if not np.isfinite(span).all():
        return None
    return replace(limits, low_v=limits.low_v - span, high_v=limits.high_v + span, between_v=before)


def sensorless_law(
    compensator: Compensator, model: HammersteinModel, limits: DriveRange, sample_time_s: float
) -> Law[Any]:
    """Design a law; InputError if it needs the sensor."""
    built = compensator.design(model, limits, sample_time_s)
    if not isinstance(built, Law):
        what = f"{compensator.law} needs the sensor's readings, so it has no drive to send in advance"
        raise InputError("--law", what)
    return built


def compensator_of(law: LawLike, options: Mapping[str, Any]) -> Compensator:
    """Return the compensator of a name, with its options, or a compensator itself.

    Raises InputError for an unknown law or option.
    """
    if isinstance(law, Compensator):
        if options:
            names = ", ".join(sorted(options))
            raise InputError("compensate", f"pass {names} to {type(law).__name__} itself")
        return law
    given = {name: value for name, value in options.items() if value is not None}
    try:
        return COMPENSATORS.value({"law": law, **given})
    except ValidationError as error:
        raise InputError("compensate", mistakes_of(error, COMPENSATORS.adapter())) from None


def _figures_um(model: HammersteinModel, name: str) -> Array | None:
    """Figures (p,) of the model's verdict [um]; None where it does not have one for each output."""
    found = getattr(model.verdict, name, ())
    return np.array(found) if len(found) == len(model.outputs) else None


def stated_error_um(model: HammersteinModel) -> Array | None:
    """Rms error of the model on validation records, else fitted ones (p,) [um]; None without any.

    It includes their noise.
    """
    return _figures_um(model, "rms_um")


def model_error_um(model: HammersteinModel) -> Array | None:
    """Rms error of the model itself (p,) [um], without the noise of the records; None if untested."""
    stated, noise = stated_error_um(model), _figures_um(model, "noise_um")
    if stated is None or noise is None:
        return stated
    return np.sqrt(np.maximum(stated**2 - noise**2, 0.0))


def _largest_um(model: HammersteinModel) -> Array | None:
    """Largest error of the model (p,) on these records [um], less the largest noise."""
    largest, noise = _figures_um(model, "largest_um"), _figures_um(model, "noise_um")
    return None if largest is None or noise is None else largest - LARGEST_OF_NOISE * noise


def model_statement(model: HammersteinModel) -> str:
    """State the error of the model, which adds to that of a drive for the model."""
    own = model_error_um(model)
    if own is None or model.verdict is None:
        return "The error of the model comes on top; it is untested."
    records = "validation records" if model.verdict.held_out else "fitted records, more on others"
    each = ", ".join(f"{um:.2g} um rms on {name}" for name, um in zip(model.outputs, own, strict=True))
    rest = zip(model.outputs, model.verdict.rest_um, strict=False)
    off = ", ".join(f"{um:.2g} um on {name}" for name, um in rest)
    zero = f" The initial position, from which the path counts, is predicted within {off} rms." if off else ""
    return f"The error of the model comes on top: {each} ({records}).{zero}"


@dataclass(frozen=True, eq=False)
class Prediction:
    """Contributions to the rms error of a drive, each (p,) in um; all but the path's are from the model file.

    path : of the drive if the actuator were exactly the model; most : the largest error of that kind
    model : of the model about its mean, None if untested; validated : whether on a validation record
    largest : error of the model there, see ``_largest_um``
    rest : of the initial position, from which a path counts; None if no record began at rest
    converter : of rounding to steps, uniformly distributed, as a measure: the path's has it already
    noise : of the sensor
    """

    path: Array
    most: Array
    model: Array | None
    largest: Array | None
    validated: bool
    rest: Array | None
    converter: Array
    noise: float

    @classmethod
    def of(cls, model: HammersteinModel, attempt: Attempt) -> Prediction:
        """Contributions to the error of a drive."""
        half, verdict = half_span_v(model), model.verdict
        volts = float(half.max()) if np.isfinite(half).all() else 1.0
        step_v = model.instruments.drive.resolution_v / np.sqrt(12.0)
        return cls(
            path=attempt.path_rms_um,
            most=attempt.path_error_um,
            model=model_error_um(model),
            largest=_largest_um(model),
            validated=verdict is not None and verdict.held_out,
            rest=_figures_um(model, "rest_um"),
            converter=np.asarray(step_v * np.abs(model.gain(volts)).sum(axis=1)),
            noise=float(model.instruments.sensor.noise_um),
        )

    @property
    def rms_um(self) -> Array:
        """Rms of all contributions together (p,): independent errors add in squares."""
        known = [part for part in (self.model, self.rest) if part is not None]
        squares = [part**2 for part in (self.path, *known)]
        return np.asarray(np.sqrt(sum(squares) + self.noise**2))

    def summary(self, o: int) -> dict[str, Any]:
        """Contributions to the error of one output, as plain JSON."""
        return {
            "path_rms_um": float(self.path[o]),
            "path_max_um": float(self.most[o]),
            "model_um": None if self.model is None else float(self.model[o]),
            "model_largest_um": None if self.largest is None else float(self.largest[o]),
            "model_validated": self.validated,
            "rest_um": None if self.rest is None else float(self.rest[o]),
            "converter_um": float(self.converter[o]),
            "noise_um": self.noise,
            "rms_um": float(self.rms_um[o]),
        }

    def statement(self, outputs: Sequence[str]) -> str:
        """Name the contributions and their rms for each output."""
        each = "; ".join(self._of(o, name) for o, name in enumerate(outputs))
        told = f"Expected rms error: {each}."
        if self.converter.any():
            return told
        what = "--converter-step V includes them"
        return f"{told} Converter steps are not included; {what}."

    def _of(self, o: int, name: str) -> str:
        steps = " with converter steps" * bool(self.converter[o])
        parts, more = [f"path {length(float(self.path[o]), 2)}{steps}"], ""
        if self.model is None:
            parts, more = [*parts, "model untested"], " without the error of the model"
        else:
            where = "validation" if self.validated else "fitted"
            largest = 0.0 if self.largest is None else self.largest[o]
            most = f", largest {largest:.2g}," if largest > self.model[o] else ""
            parts.append(f"model {self.model[o]:.2g}{most} on {where} records")
            more = " plus an untested constant offset" if self.rest is None else ""
        parts += ["rest position untested"] if self.rest is None else [f"rest position {self.rest[o]:.2g}"]
        parts += [f"sensor noise {self.noise:.2g}"] if self.noise else []
        least = "" if self.validated else "at least "
        return f"{name} {least}{self.rms_um[o]:.2g} um{more} ({', '.join(parts)})"


FILTER_TRIALS, FILTER_DECADES = 16, 300.0  # frequencies tried, and how far below Nyquist
MOVED = (0.125, 0.25, 0.5, 1.0)
"""Offsets that are tried for a path, in parts of the distance to the middle of the reach."""
SOFTENED = (0.002, 0.005, 0.01, 0.02, 0.05)
"""Softenings that are tried, in parts of the range."""


OFFSET = "--offset"


def _offset(offset_um: Iterable[float]) -> str:
    return f"{OFFSET}={','.join(f'{value:g}' for value in offset_um)}"


def _option(name: str, value: float) -> str:
    return f"--{name.replace('_', '-')} {value:g}"


@dataclass(frozen=True, eq=False)
class Missed(ABC):
    """A path that is out of reach, and the start of the search for remedies.

    own_um : (p,) error of the model itself; smaller deviations do not count
    offset_um : that of the command
    """

    model: HammersteinModel
    limits: DriveRange
    compensator: Compensator
    path_um: Array
    own_um: Array
    reach: Reach
    offset_um: tuple[float, ...] | None

    LEADS_IN: ClassVar[str] = ""
    """Option that an offset path needs."""

    @property
    @abstractmethod
    def clipped_um(self) -> float:
        """Largest error with ``--clip`` [um]."""

    @cached_property
    def kept(self) -> tuple[str, ...]:
        """Offset, softening and filter of the command, which a remedy keeps where it has no other."""
        smooths = {name: getattr(self.compensator, name, None) for name in ("softening_v", "filter_hz")}
        moved = (_offset(self.offset_um),) if self.offset_um else ()
        return (*moved, *(_option(name, value) for name, value in smooths.items() if value))

    @property
    def given(self) -> str:
        """Option that the path needs beside others, if the command has it already."""
        return ""

    @cached_property
    def prefix(self) -> str:
        """Option that the path needs in addition to others."""
        return ""

    @abstractmethod
    def _limits_hit(self) -> str:
        """State which limit is hit, and the error of the path."""

    @abstractmethod
    def _attempt(self, compensator: Compensator, path_um: Array) -> tuple[float, bool]:
        """Largest error on a path [um], and whether it is within reach."""

    def statement(self) -> str:
        """Limit, excess and place; remedies; and, where none helps completely, the reach."""
        found = self.remedies()
        listed = ", ".join(f"{self._whole(option)} ({length(error, 2)} um)" for error, option in found)
        alone = self._doubt() or ("" if len(found) > 1 else "; or use a smaller or slower path")
        told = f"{self._limits_hit()}\nRemedies, with the remaining error: {listed}{alone}."
        if found[0][0] <= self.own_um.max():
            return told
        within = self.limits.words(self.model.inputs)
        return f"{told}\n{self.reach.statement(self.model.outputs)} Range: {within} (--range)."

    def _whole(self, remedy: str) -> str:
        """Return a remedy with the options of the command that it keeps."""
        return " ".join([remedy, *(one for one in self.kept if one.split()[0] not in remedy.split())])

    def _doubt(self) -> str:
        """Doubt the unit of a path that goes farther than every slow path can."""
        far, asked = float(np.abs(self.reach.alone_um).max()), float(np.abs(self.path_um).max())
        if asked <= far:
            return ""
        return f"; or check its unit: the path goes to {asked:.3g} um, slow paths reach {far:.3g} um"

    def remedies(self) -> list[tuple[float, str]]:
        """Remaining error [um] and options of each remedy that helps, the best one first."""
        clipped = f"{self.given} --clip".strip()
        led, complete = self._attempt(self.compensator, self.path_um)
        if self.prefix and complete:
            return [(led, self.prefix), (self.clipped_um, clipped)]
        tried = [*self._moved(), *self._softened(), *self._filtered(self.path_um, self.prefix)]
        for share in () if tried else MOVED:  # corners of a path that does not even begin within reach
            tried += [found for moved in self._towards_the_middle(share) for found in self._filtered(*moved)]
            if tried:
                break
        tried.append((led, f"{self.prefix} --clip".strip()))
        helping = sorted(one for one in tried if one[0] < self.clipped_um)
        return [*helping, (self.clipped_um, clipped)]

    def _towards_the_middle(self, share: float) -> list[tuple[Array, str]]:
        """The path moved to the middle of the reach, and the options for it; none if it was moved already."""
        middle = self.reach.alone_um.mean(axis=1) - 0.5 * (
            self.path_um.max(axis=1) + self.path_um.min(axis=1)
        )
        if any(one.startswith(OFFSET) for one in self.kept) or not np.isfinite(middle).all():
            return []
        offset = np.array([float(f"{share * value:.3g}") for value in middle])
        return [(self.path_um + offset[:, None], f"{self.LEADS_IN} {_offset(offset)}".strip())]

    def _moved(self) -> Iterator[tuple[float, str]]:
        """The path moved towards the middle of what can be reached, as little as brings it within reach."""
        for path_um, words in (moved for share in MOVED for moved in self._towards_the_middle(share)):
            left, within = self._attempt(self.compensator, path_um)
            if within:
                yield left, words
                return

    def _softened(self) -> Iterator[tuple[float, str]]:
        """The least softening, above that of the command, with which the path is within reach."""
        span, present = float(self.limits.span_v.max()), getattr(self.compensator, "softening_v", np.inf)
        if np.isfinite(span):
            more = (part * span for part in SOFTENED if part * span > present)
            yield from self._first(self.path_um, self.prefix, "softening_v", more)

    def _filtered(self, path_um: Array, prefix: str) -> Iterator[tuple[float, str]]:
        """The highest bandwidth of the reference filter, below the command's, that is within reach.

        prefix : options that the path needs beside it
        """
        if not hasattr(self.compensator, "filter_hz"):
            return
        nyquist = 0.5 / self.model.instruments.drive.sample_time_s
        lowest = max(4.0 * nyquist / path_um.shape[1], nyquist / FILTER_DECADES)
        highest = 0.75 * min(self.compensator.filter_hz or nyquist, nyquist)
        if highest > lowest:
            yield from self._first(path_um, prefix, "filter_hz", np.geomspace(highest, lowest, FILTER_TRIALS))

    def _first(
        self, path_um: Array, prefix: str, option: str, values: Iterable[float]
    ) -> Iterator[tuple[float, str]]:
        """The first value of an option, of two digits, with which a path is within reach."""
        for value in (float(f"{each:.2g}") for each in values):
            tried = self.compensator.model_copy(update={option: value})
            left, within = self._attempt(tried, path_um)
            if within:
                yield left, f"{prefix} {_option(option, value)}".strip()
                return


@dataclass(frozen=True, eq=False)
class MissedPath(Missed):
    """Path out of reach that is driven once, from beginning to end."""

    found: Attempt

    LEADS_IN: ClassVar[str] = "--lead-in"

    @property
    def clipped_um(self) -> float:
        """Largest error with ``--clip`` [um]."""
        return float(self.found.path_error_um.max())

    @cached_property
    def prefix(self) -> str:
        """``--lead-in`` where the path begins away from the initial position."""
        away = lead_in(self.path_um, self.model.instruments.drive.sample_time_s).shape[1] > 0
        return self.LEADS_IN if away else ""

    @property
    def given(self) -> str:
        """Option that leads in, where the drive does."""
        return self.LEADS_IN if self.found.lead else ""

    def _limits_hit(self) -> str:
        """State the voltages needed without limits, and the error of the path with them."""
        found, inputs = self.found.shortfall, self.model.inputs
        parts, free_v = [], None
        if self.prefix and not self.given:  # the voltages of a jump say nothing
            away = np.abs(self.path_um[:, 0]).max()
            afar = f"{length(float(away), 3)} um away from the initial position"
            parts.append(f"the path begins {afar if away > self.own_um.max() else 'in motion'}")
        else:
            free_v = self._free_drive()
        for k in np.flatnonzero(found.at_range.any(axis=1)):
            end, limit = ("lower", found.limits.low_v) if found.at_low[k] else ("upper", found.limits.high_v)
            when = f"first {self._when(int(np.argmax(found.at_range[k])))}"
            more = when if free_v is None else self._needed(free_v[k], bool(found.at_low[k]))
            parts.append(f"input {inputs[k]} hits its {end} limit, {limit[k]:.6g} V ({more})")
        error = np.abs(found.error_um)
        output, sample = divmod(int(np.argmax(error)), error.shape[1])
        parts.append(
            f"output {self.model.outputs[output]} has an error of up to {error[output, sample]:.3g} "
            f"um {self._when(sample)}"
        )
        return f"{'; '.join(parts)}."

    def _when(self, sample: int) -> str:
        return self.found.shortfall.when(sample, self.found.lead)

    def _needed(self, volts: Array, at_low: bool) -> str:
        """The most extreme of the voltages (N,) that an input would need."""
        worst = int(np.argmin(volts) if at_low else np.argmax(volts))
        return f"the path needs {volts[worst]:.4g} V {self._when(worst)}"

    def _free_drive(self) -> Array | None:
        """Voltages (m, N) that the path needs where nothing limits them; None where there are none."""
        wide, drive = widened(self.limits), self.model.instruments.drive
        if wide is None:
            return None
        try:
            law = sensorless_law(self.compensator, self.model, wide, drive.sample_time_s)
            return law.drive_for(self.found.reference_um)
        except HammersteinError:
            return None

    def _attempt(self, compensator: Compensator, path_um: Array) -> tuple[float, bool]:
        """Largest error on a path that is led in [um], and whether the path is within reach."""
        before = lead_in(path_um, self.model.instruments.drive.sample_time_s)
        try:
            found = Attempt.of(
                self.model, self.limits, compensator, np.hstack([before, path_um]), before.shape[1]
            )
        except HammersteinError:
            return np.inf, False
        within = found.complete or found.within_error(self.model, self.limits, compensator, self.own_um)
        return float(found.path_error_um.max()), within

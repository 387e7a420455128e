"""Remedies for a path out of reach, each tried on the model before it is named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators import Compensator
from hammerstein.compensators.added_motion import lead_in
from hammerstein.compensators.attempt import Attempt, sensorless_law, widened
from hammerstein.compensators.reach import Reach
from hammerstein.errors import HammersteinError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length

FILTER_TRIALS, FILTER_DECADES = 16, 300.0  # frequencies tried, and how far below Nyquist
SOFTENED = (0.002, 0.005, 0.01, 0.02, 0.05)
"""Parts of the range over which the jump at a reversal is spread."""


@dataclass(frozen=True, eq=False)
class Missed:
    """A path that is out of reach, and what tries to mend it start from.

    own_um : (p,) error of the model itself: what is missed by less is no miss
    moved : whether an offset is in the path already
    """

    model: HammersteinModel
    limits: DriveRange
    compensator: Compensator
    path_um: Array
    found: Attempt
    own_um: Array
    reach: Reach
    moved: bool = False

    def statement(self) -> str:
        """Limit, excess and place in the first line, remedies in the second."""
        listed = ", ".join(f"{option} ({length(error, 2)} um)" for error, option in self.remedies())
        alone = "" if "," in listed else "; or use a smaller or slower path"
        return f"{self._limits_hit()}\nRemedies, with the remaining error: {listed}{alone}."

    def remedies(self) -> list[tuple[float, str]]:
        """Remaining error [um] and options of each remedy that helps, the best one first."""
        clipped = float(self.found.path_error_um.max())
        led, complete = self._attempt(self.compensator, self.path_um)
        if self.prefix and complete:
            return [(led, self.prefix), (clipped, "--clip")]
        tried = [*self._moved(), *self._softened(), *self._filtered(self.path_um, self.prefix)]
        if not tried:  # corners of a path that does not even begin within reach
            tried += [found for moved in self._centred for found in self._filtered(*moved)]
        tried.append((led, f"{self.prefix} --clip".strip()))
        return [*sorted(helping for helping in tried if helping[0] < clipped), (clipped, "--clip")]

    @cached_property
    def prefix(self) -> str:
        """Option that leads in, where the path begins elsewhere and nothing leads in yet."""
        away = lead_in(self.path_um, self.model.instruments.drive.sample_time_s).shape[1] > 0
        return "--lead-in" if away and not self.found.lead else ""

    def _limits_hit(self) -> str:
        """Say what the voltages would have to be without limits, and how far off the path is with them."""
        found, inputs = self.found.predicted, self.model.inputs
        free_v = self._free_drive()
        parts = []
        for k in np.flatnonzero(found.at_range.any(axis=1)):
            end, limit = ("lower", found.limits.low_v) if found.at_low[k] else ("upper", found.limits.high_v)
            first = int(np.argmax(found.at_range[k]))
            more = "" if free_v is None else self._needed(free_v[k], bool(found.at_low[k]))
            parts.append(
                f"input {inputs[k]} hits its {end} limit, {limit[k]:.6g} V, "
                f"first at {self._when(first)}{more}"
            )
        error = np.abs(found.error_um)
        output, sample = divmod(int(np.argmax(error)), error.shape[1])
        parts.append(
            f"output {self.model.outputs[output]} has an error of up to {error[output, sample]:.3g} "
            f"um at {self._when(sample)}"
        )
        return f"{'; '.join(parts)}."

    def _when(self, sample: int) -> str:
        """Time of a sample, counted from the beginning of the path."""
        return f"{(sample - self.found.lead) * self.model.instruments.drive.sample_time_s:.4g} s"

    def _needed(self, volts: Array, at_low: bool) -> str:
        """The most extreme of the voltages (N,) that an input would need."""
        worst = int(np.argmin(volts) if at_low else np.argmax(volts))
        return f", and would need {volts[worst]:.4g} V at {self._when(worst)}"

    def _free_drive(self) -> Array | None:
        """Voltages (m, N) that the path needs where nothing limits them; None where there are none."""
        wide, drive = widened(self.limits), self.model.instruments.drive
        if wide is None:
            return None
        try:
            law = sensorless_law(self.compensator, {}, self.model, wide, drive.sample_time_s)
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
        within = found.predicted.complete or bool((found.path_error_um <= self.own_um).all())
        return float(found.path_error_um.max()), within

    @cached_property
    def _centred(self) -> list[tuple[Array, str]]:
        """The path moved to the middle of the reach, and the options for it; none if it was moved already."""
        middle = self.reach.alone_um.mean(axis=1) - 0.5 * (
            self.path_um.max(axis=1) + self.path_um.min(axis=1)
        )
        if self.moved or not np.isfinite(middle).all():
            return []
        offset = np.array([float(f"{value:.3g}") for value in middle])
        words = f"--lead-in --offset={','.join(f'{value:g}' for value in offset)}"
        return [(self.path_um + offset[:, None], words)]

    def _moved(self) -> Iterator[tuple[float, str]]:
        """The path moved to the middle of what can be reached."""
        for path_um, words in self._centred:
            left, within = self._attempt(self.compensator, path_um)
            if within:
                yield left, words

    def _softened(self) -> Iterator[tuple[float, str]]:
        """The least softening with which the path is within reach."""
        span = float(self.limits.span_v.max())
        if getattr(self.compensator, "softening_v", None) != 0.0 or not np.isfinite(span):
            return
        for part in SOFTENED:
            volts = float(f"{part * span:.2g}")
            softer = self.compensator.model_copy(update={"softening_v": volts})
            left, within = self._attempt(softer, self.path_um)
            if within:
                yield left, f"{self.prefix} --softening-v {volts:g}".strip()
                return

    def _filtered(self, path_um: Array, prefix: str) -> Iterator[tuple[float, str]]:
        """The highest bandwidth of the reference filter with which a path is within reach.

        prefix : options that the path needs beside it
        """
        if not hasattr(self.compensator, "filter_hz") or self.compensator.filter_hz is not None:
            return
        nyquist = 0.5 / self.model.instruments.drive.sample_time_s
        lowest = max(4.0 * nyquist / path_um.shape[1], nyquist / FILTER_DECADES)
        for frequency in np.geomspace(0.75 * nyquist, lowest, FILTER_TRIALS):
            rounded = float(f"{frequency:.2g}")
            slower = self.compensator.model_copy(update={"filter_hz": rounded})
            left, within = self._attempt(slower, path_um)
            if within:
                yield left, f"{prefix} --filter-hz {rounded:g}".strip()
                return

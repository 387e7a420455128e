"""What brings a path within reach, tried on the model before it is named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators import Compensator
from hammerstein.compensators.attempt import Attempt
from hammerstein.compensators.lead_in import lead_in
from hammerstein.compensators.reach import Reach
from hammerstein.errors import HammersteinError
from hammerstein.model import HammersteinModel

FILTER_TRIALS, FILTER_DECADES = 16, 300.0
SOFTENED = (0.002, 0.005, 0.01, 0.02, 0.05)
"""Parts of the range over which the jump at a reversal is spread."""


@dataclass(frozen=True, eq=False)
class Missed:
    """A path that is out of reach, and what tries to mend it start from.

    own_um : (p,) error of the model itself: what is missed by less is no miss
    """

    model: HammersteinModel
    limits: DriveRange
    compensator: Compensator
    path_um: Array
    found: Attempt
    own_um: Array
    reach: Reach

    def remedies(self) -> list[tuple[float, str]]:
        """Error that is left [um] and option of each remedy that helps, the best one first."""
        clipped = float(self.found.path_error_um.max())
        tried = [*self._from_elsewhere(), *self._softened(), *self._filtered()]
        helping = [(error, option) for error, option in tried if error < clipped]
        return [*sorted(helping), (clipped, "--clip")]

    def statement(self) -> str:
        """Say what helps, by the error that each remedy leaves."""
        listed = ", ".join(f"{option} ({error:.2g} um)" for error, option in self.remedies())
        alone = "" if "," in listed else "; or ask for a smaller or a slower path"
        return f"What helps, with the error that it leaves: {listed}{alone}."

    def _left(self, compensator: Compensator, path_um: Array, with_lead: bool) -> float | None:
        """Largest error that a try leaves on the path [um]; None where it is out of reach itself."""
        before = lead_in(path_um, self.model.instruments.drive.sample_time_s)[:, : None if with_lead else 0]
        try:
            found = Attempt.of(
                self.model, self.limits, compensator, np.hstack([before, path_um]), before.shape[1]
            )
        except HammersteinError:
            return None
        within = found.predicted.complete or (found.path_error_um <= self.own_um).all()
        return float(found.path_error_um.max()) if within else None

    def _from_elsewhere(self) -> Iterator[tuple[float, str]]:
        """A lead-in, alone or to a path that is moved to the middle of what can be reached."""
        if self.found.lead:
            return
        left = self._left(self.compensator, self.path_um, with_lead=True)
        if left is not None:
            yield left, "--lead-in"
            return
        middle = self.reach.alone_um.mean(axis=1) - 0.5 * (
            self.path_um.max(axis=1) + self.path_um.min(axis=1)
        )
        if not np.isfinite(middle).all():
            return
        offset = np.array([float(f"{value:.3g}") for value in middle])
        left = self._left(self.compensator, self.path_um + offset[:, None], with_lead=True)
        if left is not None:
            yield left, f"--lead-in --offset={','.join(f'{value:g}' for value in offset)}"

    def _softened(self) -> Iterator[tuple[float, str]]:
        """The least softening with which the path is within reach."""
        span = float(self.limits.span_v.max())
        if getattr(self.compensator, "softening_v", None) != 0.0 or not np.isfinite(span):
            return
        for part in SOFTENED:
            volts = float(f"{part * span:.2g}")
            softer = self.compensator.model_copy(update={"softening_v": volts})
            left = self._left(softer, self.found.reference_um, with_lead=False)
            if left is not None:
                yield left, f"--softening-v {volts:g}"
                return

    def _filtered(self) -> Iterator[tuple[float, str]]:
        """The highest bandwidth of the reference filter with which the path is within reach."""
        if not hasattr(self.compensator, "filter_hz") or self.compensator.filter_hz is not None:
            return
        nyquist = 0.5 / self.model.instruments.drive.sample_time_s
        lowest = max(4.0 * nyquist / self.path_um.shape[1], nyquist / FILTER_DECADES)
        for frequency in np.geomspace(0.75 * nyquist, lowest, FILTER_TRIALS):
            rounded = float(f"{frequency:.2g}")
            slower = self.compensator.model_copy(update={"filter_hz": rounded})
            left = self._left(slower, self.found.reference_um, with_lead=False)
            if left is not None:
                yield left, f"--filter-hz {rounded:g}"
                return

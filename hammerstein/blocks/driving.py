"""Drive range of a model: allowed voltages, and the voltages before the first sample.

Outside, voltages are absolute: as recorded and as sent. The plays of a model count them from its working
point, at which they rest. A law turns the one into the other here and nowhere else; forwards it is done by
``HammersteinModel.static_response``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Flags
from hammerstein.blocks.instruments import Drive, slack_v
from hammerstein.blocks.voltages import Voltages
from hammerstein.errors import InputError


class Recorded(Protocol):
    """Model with the voltages of its records."""

    @property
    def recorded(self) -> Voltages:
        """Working point and range of the records."""
        ...


@dataclass(frozen=True, eq=False)
class DriveRange:
    """Allowed voltages of a law, and the history of the actuator up to its start voltage.

    Parameters
    ----------
    low_v, high_v : (m,) lowest and highest voltage of each input [V]
    working_point_v : (m,) voltage from which the model counts [V]
    start_v : (m,) voltage before the first sample [V]
    conditioned : False: the actuator rested at the working point and went straight to the start; True: it was
        driven to the highest, then to the lowest voltage, then to the start, so that nothing older counts
    between_v : these (2, m) lowest and highest voltages, where they are not those of the range [V]
    """

    low_v: Array
    high_v: Array
    working_point_v: Array
    start_v: Array
    conditioned: bool = False
    between_v: Array | None = None

    def __post_init__(self) -> None:
        outside = (self.start_v < self.low_v) | (self.start_v > self.high_v)
        if outside.any():
            k = int(np.argmax(outside))
            if (self.start_v == self.working_point_v).all():
                raise InputError(
                    "range",
                    f"the actuator rests at {self.start_v[k]:g} V on input {k + 1}, outside "
                    f"{self.low_v[k]:g} to {self.high_v[k]:g} V; give a wider range, here and as "
                    "instruments.drive.range_v of the model, or a start inside it",
                )
            raise InputError(
                "start",
                f"{self.start_v[k]:g} V of input {k + 1} is outside the range {self.low_v[k]:g} to "
                f"{self.high_v[k]:g} V; give a start inside it, or another range",
            )
        if self.conditioned and not np.isfinite(self.conditioning_v).all():
            raise InputError(
                "conditioning", "needs a finite range, because the actuator is driven to both ends of it"
            )

    @classmethod
    def of(
        cls,
        given: RangeLike,
        model: Recorded,
        start_v: ArrayLike | None = None,
        conditioned: bool = False,
        between_v: Array | None = None,
    ) -> DriveRange:
        """Range for a model from N (for -N to N), (low, high), or one of these per input [V].

        start_v : (m,) voltage at which the actuator stands; the working point if not given
        """
        if isinstance(given, DriveRange):
            return given
        wanted: Any = given.tolist() if isinstance(given, np.ndarray) else given
        try:
            low, high = Drive(range_v=wanted).limits(len(model.recorded.working_point_v))
        except ValueError:
            raise InputError("range", f"{given!r} is neither N for -N to N nor (low, high) in V") from None
        rest = np.array(model.recorded.working_point_v)
        start = rest if start_v is None else np.asarray(start_v, dtype=np.float64)
        return cls(low, high, rest, start, conditioned, between_v)

    @property
    def span_v(self) -> Array:
        """Span of the range (m,) [V]."""
        return np.asarray(self.high_v - self.low_v)

    @property
    def conditioning_v(self) -> Array:
        """Lowest and highest voltage (2, m) between which a conditioned actuator was driven [V]."""
        return np.stack([self.low_v, self.high_v]) if self.between_v is None else self.between_v

    @property
    def counted(self) -> tuple[Array, Array]:
        """Lowest and highest voltage (m,), relative to the working point [V]."""
        return self.low_v - self.working_point_v, self.high_v - self.working_point_v

    def history(self) -> Array:
        """Voltages (m, steps) from rest, which comes first, to the start; relative to the working point."""
        low, high = self.conditioning_v - self.working_point_v
        start, rest = self.start_v - self.working_point_v, np.zeros(len(self.start_v))
        if self.conditioned:
            return np.stack([rest, high, low, start], axis=1)
        return np.stack([rest, start] if start.any() else [rest], axis=1)

    def absolute(self, counted_v: Array) -> Array:
        """Absolute voltages (m, N) from those relative to the working point."""
        if not self.working_point_v.any():
            return counted_v
        sent = counted_v + self.working_point_v[:, None]
        return np.clip(sent, self.low_v[:, None], self.high_v[:, None])

    def reached(self, drive_v: Array) -> Flags:
        """Whether voltages (m, N) are at an end of the range."""
        low, high = self.ends[:, :, None]
        return np.asarray((drive_v >= high) | (drive_v <= low))

    @cached_property
    def ends(self) -> Array:
        """Voltages (2, m) from which a voltage counts as at the lowest or highest end [V]."""
        limits = np.stack([self.low_v, self.high_v])
        return np.asarray(limits + np.array([[1.0], [-1.0]]) * slack_v(limits))

    def words(self, inputs: Sequence[str]) -> str:
        """State the range of each input."""
        ends = [f"{low:.6g} to {high:.6g} V" for low, high in zip(self.low_v, self.high_v, strict=True)]
        if len(set(ends)) == 1:
            return ends[0]
        return ", ".join(f"{end} on {name}" for name, end in zip(inputs, ends, strict=True))


RangeLike = DriveRange | ArrayLike
"""A range, or an argument of ``DriveRange.of``."""

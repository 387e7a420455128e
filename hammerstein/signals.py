"""Test signals as frozen values: sine, triangle, circle, spiral, Lissajous, multisine, or a file.

A signal has no unit of its own: it is a drive in V or a reference in um, as the scenario says.
Every signal gives values (axis, sample) for an array of times.
"""

from __future__ import annotations

import io
import math
import sys
from abc import ABC, abstractmethod
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, model_validator

from hammerstein.errors import InputError
from hammerstein.plugins import Family

Array = NDArray[np.float64]


PEAK_POINTS = 16  # of a multisine, in a period of its highest line


class Shape(BaseModel, ABC):
    """A signal of any kind.

    ``smooth_start_s`` lets it grow from zero by a smooth step, so that a path which begins away from zero
    is reached without a jump.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    if TYPE_CHECKING:  # a field of every kind, behind its others
        kind: str

    smooth_start_s: float = Field(default=0.0, ge=0.0, description="time in which the signal grows from zero")

    def sample(self, time_s: Array, n_axes: int) -> Array:
        """Values (axis, sample) at the given times (sample,) [s]."""
        values = self._values(time_s, n_axes)
        if self.smooth_start_s > 0.0:
            values = values * smooth_step(time_s / self.smooth_start_s)
        return values

    @abstractmethod
    def _values(self, time_s: Array, n_axes: int) -> Array:
        """Values (axis, sample) without the smooth start."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time after which the signal repeats; for one that does not, the time it lasts."""

    @property
    def periodic(self) -> bool:
        """Whether the signal has cycles, so that it can be left to settle."""
        return True

    @property
    def repeats(self) -> bool:
        """Whether every cycle is like the one before."""
        return self.periodic

    @property
    @abstractmethod
    def highest_frequency_hz(self) -> float:
        """Highest frequency named in the signal; it must stay below half the sample rate."""


def smooth_step(x: Array) -> Array:
    """Fifth-order step from 0 at x <= 0 to 1 at x >= 1, with two continuous derivatives.

    >>> smooth_step(np.array([-1.0, 0.5, 2.0])).tolist()
    [0.0, 0.5, 1.0]
    """
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 + x * (6.0 * x - 15.0))


class OneFrequency(Shape, ABC):
    """A signal of one frequency."""

    frequency_hz: PositiveFloat

    @property
    def period_s(self) -> float:
        """One period."""
        return 1.0 / self.frequency_hz

    @property
    def highest_frequency_hz(self) -> float:
        """The frequency."""
        return self.frequency_hz


class OnAxes(OneFrequency, ABC):
    """The same wave on one axis, on each axis in turn, or on all axes together."""

    axis: int | Literal["each", "all"] = Field(
        default="each", description='number of the axis from 1, "each" in turn, or "all" together'
    )
    amplitude: PositiveFloat
    offset: float = Field(default=0.0, description="added to the wave on the axes that are driven")
    phase_deg: float = 0.0

    @abstractmethod
    def _wave(self, cycles: Array) -> Array:
        """Wave of unit amplitude over cycles."""

    def _values(self, time_s: Array, n_axes: int) -> Array:
        wave = self.offset + self.amplitude * self._wave(self.frequency_hz * time_s + self.phase_deg / 360.0)
        values = np.zeros((n_axes, len(time_s)))
        if self.axis == "all":
            values[:] = wave
        elif self.axis != "each":
            values[self.axis - 1] = wave
        return values


class Sine(OnAxes):
    """A sin(2 pi (f t + phase/360))."""

    kind: Literal["sine"] = "sine"

    def _wave(self, cycles: Array) -> Array:
        return np.sin(2.0 * np.pi * cycles)


class Triangle(OnAxes):
    """A symmetric triangle wave that starts at zero and rises."""

    kind: Literal["triangle"] = "triangle"

    def _wave(self, cycles: Array) -> Array:
        return 1.0 - 4.0 * np.abs((cycles + 0.25) % 1.0 - 0.5)


class Circle(OneFrequency):
    """x = R cos(2 pi f t + phase), y = R sin(2 pi f t + phase) (paper, section 5.4)."""

    kind: Literal["circle"] = "circle"
    radius: PositiveFloat
    phase_deg: float = 0.0

    def _values(self, time_s: Array, n_axes: int) -> Array:
        _require_two_axes(n_axes, "circle")
        angle = 2.0 * np.pi * self.frequency_hz * time_s + math.radians(self.phase_deg)
        return self.radius * np.stack([np.cos(angle), np.sin(angle)])


class Spiral(OneFrequency):
    """A circle until the trigger, then one whose radius decays as exp(-t / tau) (paper, section 5.4)."""

    kind: Literal["spiral"] = "spiral"
    radius: PositiveFloat
    trigger_s: float = Field(ge=0.0, description="time at which the decay starts")
    decay_s: PositiveFloat = Field(description="time constant of the decay")
    phase_deg: float = 0.0

    def _values(self, time_s: Array, n_axes: int) -> Array:
        _require_two_axes(n_axes, "spiral")
        angle = 2.0 * np.pi * self.frequency_hz * time_s + math.radians(self.phase_deg)
        decay = np.exp(-np.maximum(time_s - self.trigger_s, 0.0) / self.decay_s)
        return np.asarray(self.radius * decay * np.stack([np.cos(angle), np.sin(angle)]))

    @property
    def repeats(self) -> bool:
        """Its cycles shrink."""
        return False


class Lissajous(Shape):
    """x = A cos(2 pi f_x t + phase), y = A sin(2 pi f_y t + phase) (paper, section 5.4)."""

    kind: Literal["lissajous"] = "lissajous"
    amplitude: PositiveFloat
    frequency_x_hz: PositiveFloat
    frequency_y_hz: PositiveFloat
    phase_deg: float = 0.0

    def _values(self, time_s: Array, n_axes: int) -> Array:
        _require_two_axes(n_axes, "lissajous")
        phase = math.radians(self.phase_deg)
        x = np.cos(2.0 * np.pi * self.frequency_x_hz * time_s + phase)
        y = np.sin(2.0 * np.pi * self.frequency_y_hz * time_s + phase)
        return self.amplitude * np.stack([x, y])

    @property
    def period_s(self) -> float:
        """Time after which both axes repeat together (for a ratio of whole numbers up to 100)."""
        from fractions import Fraction

        ratio = Fraction(self.frequency_x_hz / self.frequency_y_hz).limit_denominator(100)
        return ratio.numerator / self.frequency_x_hz

    @property
    def highest_frequency_hz(self) -> float:
        """The higher of the two frequencies."""
        return max(self.frequency_x_hz, self.frequency_y_hz)


class Multisine(Shape):
    """Sum of equal sines on a grid of lines with random phases from a seed, another one on each axis.

    The rms of each axis is ``amplitude`` / 3, so that peaks seldom pass the amplitude; larger ones are
    scaled down to it.
    """

    kind: Literal["multisine"] = "multisine"
    amplitude: PositiveFloat
    lowest_hz: PositiveFloat
    highest_hz: PositiveFloat
    seed: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _band_is_ordered(self) -> Self:
        if self.highest_hz <= self.lowest_hz:
            raise ValueError("highest_hz must be above lowest_hz")
        return self

    def _values(self, time_s: Array, n_axes: int) -> Array:
        generator = np.random.default_rng(self.seed)
        count = math.floor(self.highest_hz / self.lowest_hz)
        lines = self.lowest_hz * np.arange(1, count + 1, dtype=np.float64)
        phases = generator.uniform(0.0, 2.0 * np.pi, (n_axes, len(lines)))
        size = self.amplitude / 3.0 * math.sqrt(2.0 / len(lines))
        # The peak of a period, not of the times asked for: a part of a signal is what it is in the whole.
        period = np.linspace(0.0, self.period_s, PEAK_POINTS * len(lines), endpoint=False)
        peak = size * np.abs(_sum_of_sines(period, lines, phases)).max(axis=1, keepdims=True)
        return np.asarray(
            size * np.minimum(1.0, self.amplitude / peak) * _sum_of_sines(time_s, lines, phases)
        )

    @property
    def period_s(self) -> float:
        """Period of the lowest line."""
        return 1.0 / self.lowest_hz

    @property
    def highest_frequency_hz(self) -> float:
        """Frequency of the highest line."""
        return self.highest_hz


def _sum_of_sines(time_s: Array, lines_hz: Array, phases: Array) -> Array:
    wave = np.zeros((len(phases), len(time_s)))
    for line, phase in zip(lines_hz, phases.T, strict=True):
        wave += np.sin(2.0 * np.pi * line * time_s + phase[:, None])
    return wave


class FromFile(Shape):
    """Values from a CSV file: one column named ``time_s``, then one column an axis.

    Between its rows the signal is interpolated linearly, after the last row it holds its value.
    """

    kind: Literal["file"] = "file"
    path: str
    scale: float = 1.0

    def _values(self, time_s: Array, n_axes: int) -> Array:
        times, values, _ = self.table()
        if len(values) != n_axes:
            raise InputError(self.path, f"has {len(values)} axes beside time_s, the actuator has {n_axes}")
        return self.scale * np.stack([np.interp(time_s, times, axis) for axis in values])

    def table(self) -> tuple[Array, Array, list[str]]:
        """Times (row,) from the first row on [s], values (axis, row) and column names.

        InputError names the row that is wrong.
        """
        times, values, names = read_signal(Path(self.path))
        return times - times[0], values, names

    @property
    def periodic(self) -> bool:
        """A file is run once, from its first row to its last."""
        return False

    @property
    def period_s(self) -> float:
        """Length of the file."""
        times, _, _ = self.table()
        return float(times[-1] - times[0])

    @property
    def highest_frequency_hz(self) -> float:
        """Zero: a file names no frequency."""
        return 0.0


def read_signal(path: Path) -> tuple[Array, Array, list[str]]:
    """Read a CSV file with a column ``time_s`` and one column an axis.

    Returns times (row,) [s], values (axis, row), and the names of the axes' columns.
    InputError names the row and column that are wrong.
    """
    import pandas as pd

    from hammerstein.files import read_limited

    text = read_limited(path, what="CSV file")
    try:
        frame = pd.read_csv(io.StringIO(text), skipinitialspace=True, comment="#")
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(str(path), f"is not a CSV table: {error}") from None
    if "time_s" not in frame.columns or frame.shape[1] < 2:
        raise InputError(str(path), "needs a header with a column time_s and one column for each axis")
    first_row = 2 + sum(line.lstrip().startswith("#") for line in text.splitlines()[:20])
    numbers = frame.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    bad = np.argwhere(~np.isfinite(numbers))
    if len(bad):
        row, column = (int(i) for i in bad[0])
        value = frame.iloc[row, column]
        raise InputError(
            str(path),
            f"row {row + first_row}, column {frame.columns[column]}: {value!s} is not a finite number",
        )
    times = frame["time_s"].to_numpy(dtype=float)
    if len(times) < 2:
        raise InputError(str(path), "has a single row; a signal needs at least two")
    late = np.nonzero(np.diff(times) <= 0)[0]
    if len(late):
        raise InputError(str(path), f"row {int(late[0]) + first_row + 1}: time_s does not increase")
    axes = frame.drop(columns="time_s")
    return times, axes.to_numpy(dtype=float).T, [str(name) for name in axes.columns]


def _require_two_axes(n_axes: int, kind: str) -> None:
    if n_axes != 2:
        raise InputError("reference", f"a {kind} needs two axes, the actuator has {n_axes}")


SIGNALS: Family[Shape] = Family(Shape, "kind")  # type: ignore[type-abstract]  # its kinds are concrete
for _kind in (Sine, Triangle, Circle, Spiral, Lissajous, Multisine, FromFile):
    SIGNALS.register(_kind)

_SIZED = {"amplitude", "offset", "radius"}


@cache
def _in_unit(kind: type[Shape], unit: str) -> type[Shape]:
    """The same kind with a unit in the names of the fields whose unit depends on what the signal is for."""
    if not _SIZED & set(kind.model_fields):
        return kind
    config = ConfigDict(
        alias_generator=lambda name: f"{name}_{unit}" if name in _SIZED else name, serialize_by_alias=True
    )
    name = f"{kind.__name__}{unit.capitalize()}"
    body = {"__doc__": kind.__doc__, "__module__": kind.__module__, "model_config": config}
    twin = type(name, (kind,), body)
    setattr(sys.modules[kind.__module__], name, twin)  # where another process looks for it
    return twin


Reference = Annotated[Shape, SIGNALS.field(partial(_in_unit, unit="um"))]
"""A signal as a path to follow [um]."""
Excitation = Annotated[Shape, SIGNALS.field(partial(_in_unit, unit="v"))]
"""A signal as a voltage [V]."""

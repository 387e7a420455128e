"""Test signals as frozen values: sine, triangle, circle, spiral, Lissajous, multisine, or a file.

A signal has no unit of its own: the scenario uses it as a drive in V or as a reference in um.
Every signal gives values (axis, sample) for an array of times.
"""

import math
import sys
from abc import ABC, abstractmethod
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field, model_validator

from hammerstein.arrays import Array, Flags
from hammerstein.errors import InputError
from hammerstein.plugins import Family
from hammerstein.quantities import (
    Axes,
    Cycles,
    FileName,
    Frequency,
    Length,
    Offset,
    Phase,
    Scale,
    Seed,
    Size,
    Wait,
)
from hammerstein.signals.signal_files import read_signal
from hammerstein.validation import Strict

MOST_LINES = 2000  # of a multisine
FARTHEST_RATIO = 100  # of the two frequencies of a Lissajous figure
PEAK_POINTS = 16  # of a multisine, in a period of its highest line


class Shape(Strict, ABC):
    """A signal of any kind.

    ``smooth_start_s`` lets it grow from zero by a smooth step, so that a path which begins away from zero
    is reached without a jump.
    """

    if TYPE_CHECKING:  # a field of every kind, behind its others
        kind: str

    pointwise: ClassVar[bool] = False
    """Whether a part of the signal takes a part of the work of the whole."""
    periodic: ClassVar[bool] = True
    """Whether the signal has cycles, so that the response can settle."""
    smooth: ClassVar[bool] = True
    """Whether its path has no corners."""

    smooth_start_s: Wait = Field(default=0.0, description="time in which the signal grows from zero")
    offset: Offset | tuple[Offset, ...] | None = Field(
        default=None,
        description="centre of the signal, one number or one for each axis; for a voltage, the "
        "actuator's working point if omitted",
    )

    def sample(self, time_s: Array, n_axes: int, rest: ArrayLike = 0.0) -> Array:
        """Values (axis, sample) at the given times (sample,) [s].

        rest : (axis,) where the actuator stands before, and the middle of a signal without an offset
        """
        before = np.broadcast_to(np.asarray(rest, dtype=np.float64), n_axes)
        values, middle = self._values(time_s, n_axes), self.middle(n_axes, before)
        if middle.any():
            values = values + middle[:, None]
        if self.smooth_start_s > 0.0:
            values = values * smooth_step(time_s / self.smooth_start_s)
        return values + before[:, None] if before.any() else values

    def middle(self, n_axes: int, rest: Array) -> Array:
        """Middle (axis,) of the signal, counted from rest (axis,).

        Raises InputError where the offset has another number of axes.
        """
        if self.offset is None:
            return np.zeros(n_axes)
        if np.size(self.offset) not in (1, n_axes):
            raise InputError("offset", f"has {np.size(self.offset)} numbers; there are {n_axes} axes")
        middle = np.broadcast_to(np.asarray(self.offset, dtype=np.float64), n_axes) - rest
        moved = np.ones(n_axes, dtype=np.bool_) if isinstance(self.offset, tuple) else self._moved(n_axes)
        return np.where(moved, middle, 0.0)

    def _moved(self, n_axes: int) -> Flags:
        """Axes (axis,) that one number for all of them belongs to."""
        return np.ones(n_axes, dtype=np.bool_)

    @abstractmethod
    def _values(self, time_s: Array, n_axes: int) -> Array:
        """Values (axis, sample) without the smooth start."""

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time after which the signal repeats; for one that does not, the time it lasts."""

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

    frequency_hz: Frequency = Field(description="frequency in Hz")

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

    pointwise: ClassVar[bool] = True

    axis: Axes | Literal["each", "all"] = Field(
        default="each", description='number of the axis from 1, "each" in turn, or "all" together'
    )
    amplitude: Size = Field(description="half of the peak-to-peak value, in the unit of the key")
    phase_deg: Phase = Field(default=0.0, description="phase at time 0, in degrees")

    @abstractmethod
    def _wave(self, cycles: Array) -> Array:
        """Wave of unit amplitude over cycles."""

    def _values(self, time_s: Array, n_axes: int) -> Array:
        wave = self.amplitude * self._wave(self.frequency_hz * time_s + self.phase_deg / 360.0)
        return np.where(self._moved(n_axes)[:, None], wave, 0.0)

    def _moved(self, n_axes: int) -> Flags:
        """Those that are driven."""
        return np.array([self.axis in ("all", k + 1) for k in range(n_axes)])


class Sine(OnAxes):
    """A sin(2 pi (f t + phase/360))."""

    kind: Literal["sine"] = "sine"

    def _wave(self, cycles: Array) -> Array:
        return np.sin(2.0 * np.pi * cycles)


class Triangle(OnAxes):
    """A symmetric triangle wave that starts at zero and rises."""

    smooth: ClassVar[bool] = False

    kind: Literal["triangle"] = "triangle"

    def _wave(self, cycles: Array) -> Array:
        return 1.0 - 4.0 * np.abs((cycles + 0.25) % 1.0 - 0.5)


class Degauss(OnAxes):
    """A sine for one period, then A (1 - (f t - 1) / cycles) sin(2 pi f t + phase), down to zero. It erases
    the memory of plays. From one peak to the next, the amplitude falls by A / (2 cycles). A play with a
    threshold below A ends within half of this step from its middle, whatever its past.
    """

    periodic: ClassVar[bool] = False

    kind: Literal["degauss"] = "degauss"
    cycles: Cycles = Field(
        default=40, description="periods in which the amplitude falls to zero, after a first period"
    )

    def _wave(self, cycles: Array) -> Array:
        gone = np.clip((cycles - self.phase_deg / 360.0 - 1.0) / self.cycles, 0.0, 1.0)
        return np.asarray((1.0 - gone) * np.sin(2.0 * np.pi * cycles))

    @property
    def period_s(self) -> float:
        """Time until the amplitude is zero."""
        return (self.cycles + 1) / self.frequency_hz


class Circle(OneFrequency):
    """x = R cos(2 pi f t + phase), y = R sin(2 pi f t + phase) (paper, section 5.4)."""

    pointwise: ClassVar[bool] = True

    kind: Literal["circle"] = "circle"
    radius: Size = Field(description="radius, in the unit of the key")
    phase_deg: Phase = Field(default=0.0, description="phase at time 0, in degrees from the first axis")

    def _values(self, time_s: Array, n_axes: int) -> Array:
        _require_two_axes(n_axes, "circle")
        return _round(time_s, self.radius, self.frequency_hz, self.phase_deg)


class Spiral(OneFrequency):
    """Circle until the trigger; then its radius decays as exp(-t / tau) (paper, section 5.4)."""

    pointwise: ClassVar[bool] = True
    repeats: ClassVar[bool] = False  # its cycles shrink

    kind: Literal["spiral"] = "spiral"
    radius: Size = Field(description="radius before the decay, in the unit of the key")
    trigger_s: Wait = Field(description="time at which the decay starts")
    decay_s: Length = Field(description="time constant of the decay")
    phase_deg: Phase = Field(default=0.0, description="phase at time 0, in degrees from the first axis")

    def _values(self, time_s: Array, n_axes: int) -> Array:
        _require_two_axes(n_axes, "spiral")
        decay = np.exp(-np.maximum(time_s - self.trigger_s, 0.0) / self.decay_s)
        return np.asarray(self.radius * decay * _round(time_s, 1.0, self.frequency_hz, self.phase_deg))


class Lissajous(Shape):
    """x = A cos(2 pi f_x t + phase), y = A sin(2 pi f_y t + phase) (paper, section 5.4)."""

    pointwise: ClassVar[bool] = True

    kind: Literal["lissajous"] = "lissajous"
    amplitude: Size = Field(description="half of the width and of the height, in the unit of the key")
    frequency_x_hz: Frequency = Field(description="frequency of the first axis in Hz")
    frequency_y_hz: Frequency = Field(description="frequency of the second axis in Hz")
    phase_deg: Phase = Field(default=0.0, description="phase of both axes at time 0, in degrees")

    @model_validator(mode="after")
    def _repeats_soon(self) -> Self:
        if not 1 / FARTHEST_RATIO <= self.frequency_x_hz / self.frequency_y_hz <= FARTHEST_RATIO:
            raise ValueError(
                f"frequency_x_hz and frequency_y_hz must be within a factor of {FARTHEST_RATIO} of each other"
            )
        return self

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
    """Sum of equal sines on a grid of lines, with random phases from a seed that differ between axes.

    The rms of each axis is ``amplitude`` / 3, so peaks seldom exceed the amplitude; a signal with larger
    peaks is scaled down to it.
    """

    kind: Literal["multisine"] = "multisine"
    amplitude: Size = Field(description="largest value, three times the rms, in the unit of the key")
    lowest_hz: Frequency = Field(description="lowest line and distance of the lines, in Hz")
    highest_hz: Frequency = Field(description="upper limit of the lines in Hz")
    seed: Seed = Field(default=0, description="seed of the random phases")

    @model_validator(mode="after")
    def _band_is_ordered(self) -> Self:
        if self.highest_hz <= self.lowest_hz:
            raise ValueError("highest_hz must be above lowest_hz")
        if self.highest_hz / self.lowest_hz > MOST_LINES:
            raise ValueError(
                f"highest_hz must be at most {MOST_LINES} times lowest_hz, the spacing of its lines"
            )
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


def _round(time_s: Array, radius: float, frequency_hz: float, phase_deg: float) -> Array:
    """Path (2, sample) of a circle at given times (sample,) [s]."""
    from hammerstein.signals.circle_kernel import go_round

    times, path = np.ascontiguousarray(time_s, dtype=np.float64), np.empty((2, len(time_s)))
    go_round(times, float(radius), float(frequency_hz), phase_deg / 360.0, path)
    return path


def _sum_of_sines(time_s: Array, lines_hz: Array, phases: Array) -> Array:
    wave = np.zeros((len(phases), len(time_s)))
    for line, phase in zip(lines_hz, phases.T, strict=True):
        wave += np.sin(2.0 * np.pi * line * time_s + phase[:, None])
    return wave


class FromFile(Shape):
    """Values from a CSV file: one column named ``time_s``, then one column for each axis.

    The signal is interpolated linearly between rows and constant after the last row.
    """

    periodic: ClassVar[bool] = False
    smooth: ClassVar[bool] = False
    highest_frequency_hz: ClassVar[float] = 0.0  # a file names no frequency

    kind: Literal["file"] = "file"
    path: FileName = Field(description="CSV file: time_s and one column for each axis, in their order")
    scale: Scale = Field(default=1.0, description="factor for all values of the file")

    def middle(self, n_axes: int, rest: Array) -> Array:
        """A file of voltages holds them as they are."""
        return super().middle(n_axes, rest) if self.offset is not None else -rest

    def _values(self, time_s: Array, n_axes: int) -> Array:
        times, values, _ = self.table()
        if len(values) != n_axes:
            raise InputError(
                self.path, f"has {len(values)} axes beside time_s, but the actuator has {n_axes}"
            )
        return self.scale * np.stack([np.interp(time_s, times, axis) for axis in values])

    def table(self) -> tuple[Array, Array, list[str]]:
        """Times (row,) from the first row on [s], values (axis, row) and column names.

        InputError names the row that is wrong.
        """
        times, values, names = read_signal(Path(self.path))
        return times - times[0], values, names

    @property
    def period_s(self) -> float:
        """Length of the file."""
        times, _, _ = self.table()
        return float(times[-1] - times[0])


def _require_two_axes(n_axes: int, kind: str) -> None:
    if n_axes != 2:
        raise InputError("reference", f"a {kind} needs two axes, but the actuator has {n_axes}")


SIGNALS: Family[Shape] = Family(Shape, "kind")  # type: ignore[type-abstract]  # its kinds are concrete
for _kind in (Sine, Triangle, Degauss, Circle, Spiral, Lissajous, Multisine, FromFile):
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


def written(signal: Shape, unit: str) -> dict[str, Any]:
    """What a scenario file holds of a signal in this unit.

    >>> written(Circle(radius=10.0, frequency_hz=50.0), "um")
    {'kind': 'circle', 'frequency_hz': 50.0, 'radius_um': 10.0}
    """
    known = signal.model_dump(by_alias=False, exclude_defaults=True)
    sized = {f"{name}_{unit}" if name in _SIZED else name: value for name, value in known.items()}
    return {SIGNALS.tag: getattr(signal, SIGNALS.tag), **sized}


Reference = Annotated[Shape, SIGNALS.field(partial(_in_unit, unit="um"))]
"""A signal as a path to follow [um]."""
Excitation = Annotated[Shape, SIGNALS.field(partial(_in_unit, unit="v"))]
"""A signal as a voltage [V]."""

"""Drive and sensor of a set-up."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from hammerstein.arrays import Array, Flags
from hammerstein.blocks.voltages import Voltages
from hammerstein.errors import InputError
from hammerstein.quantities import END_V, Bandwidth, End, Limit, Noise, SampleTime, Step
from hammerstein.validation import WithInfinity

Interval = tuple[End, End]

ALLOWED = 1e-9
"""Excess over the range, in parts of it, from which a voltage counts as clipped."""


def intervals(given: Any) -> Interval | tuple[Interval, ...]:
    """Lowest and highest voltage from a file: N (for -N to N), [low, high], or one of these per input.

    Raises ValueError for anything else.

    >>> intervals(10), intervals([0, 150]), intervals([[0, 150], [-20, 120]])
    ((-10.0, 10.0), (0.0, 150.0), ((0.0, 150.0), (-20.0, 120.0)))
    """
    if isinstance(given, list | tuple) and given and all(isinstance(one, list | tuple) for one in given):
        return tuple(_interval(one) for one in given)
    return _interval(given)


def _interval(given: Any) -> Interval:
    """One interval of voltages."""
    ends = given if isinstance(given, list | tuple) else [given]
    try:
        numbers = [float(end) for end in ends if not isinstance(end, bool)]
    except (TypeError, ValueError, OverflowError):
        numbers = []
    if not all(END_V.holds(number) for number in numbers):
        raise ValueError(f"{END_V.words()} V at each end")
    if len(numbers) == 1 == len(ends) and numbers[0] > 0.0:
        return -numbers[0], numbers[0]
    if len(numbers) == 2 == len(ends) and numbers[0] < numbers[1]:
        return numbers[0], numbers[1]
    raise ValueError("must be a positive number N (for -N to N), or [low, high] with low below high")


RangeV = Annotated[
    Interval | tuple[Interval, ...],
    BeforeValidator(intervals, json_schema_input_type=Limit | Interval | tuple[Interval, ...]),
]


def slack_v(limits: Array) -> Array:
    """Excess of voltages (m,) over the limits (2, m) that still counts as within them [V]."""
    ends = np.abs(limits)
    return np.asarray(ALLOWED * np.max(np.where(np.isfinite(ends), ends, 0.0), axis=0))


NOISE_BLOCK = 4096
"""Samples of noise drawn at a time, so that they fit the cache."""


class Drive(WithInfinity):
    """Digital-to-analogue converter and amplifier: clips, rounds and holds the voltage.

    An infinite range or a resolution of zero disables the effect. The published set-up (paper,
    section 5.1) is the default; the paper names the converter, not its resolution: 16 bits are assumed.
    """

    range_v: RangeV = Field(
        default=(-10.0, 10.0),
        description="[lowest, highest] voltage, for all inputs or a list with one pair for each "
        "input; a single number N is [-N, N]; inf: no limit",
    )
    resolution_v: Step = Field(default=20.0 / 2**16, description="step of the converter; 0: none")
    sample_time_s: SampleTime = Field(default=50e-6, description="time for which a voltage is constant")

    def limits(self, inputs: int) -> Array:
        """Lowest and highest voltage (2, input) of each input [V].

        Raises InputError where the range names another number of inputs.
        """
        ends = np.array(self.range_v, dtype=np.float64).reshape(-1, 2)
        if len(ends) not in (1, inputs):
            raise InputError("drive.range_v", f"names {len(ends)} inputs; the actuator has {inputs}")
        return np.ascontiguousarray(np.broadcast_to(ends, (inputs, 2)).T)

    def steps(self, inputs: int) -> Array:
        """Lowest and highest step of the converter (2, input) within the range [V]."""
        limits = self.limits(inputs)
        if self.resolution_v == 0.0:
            return limits.copy()  # of the type of the other: loops are compiled once
        count = limits / self.resolution_v
        inside = np.stack([np.ceil(count[0] - 1e-9), np.floor(count[1] + 1e-9)])
        return np.asarray(inside * self.resolution_v)

    def apply(self, u_v: Array, out: Array | None = None) -> tuple[Array, Flags]:
        """Output voltages of the converter (input, sample), and samples at which the range clipped them.

        A voltage up to the range, as of a sine, is not cut.

        out : (input, sample) where the voltages are put; a new array if not given
        """
        from hammerstein.blocks.instrument_kernels import convert

        asked = np.ascontiguousarray(u_v, dtype=np.float64)
        drive = np.empty(asked.shape) if out is None else out
        cut = np.empty(asked.shape, dtype=np.bool_)
        convert(asked, *_ends(self, len(asked)), self.resolution_v, drive, cut)
        return drive, cut


@lru_cache(maxsize=64)
def _ends(drive: Drive, inputs: int) -> tuple[Array, Array]:
    """Steps, and voltages beyond which the range clips one (2, input) [V]; of a drive they stay the same."""
    limits = drive.limits(inputs)
    return drive.steps(inputs), limits + np.array([[-1.0], [1.0]]) * slack_v(limits)


class Sensor(WithInfinity):
    """Displacement sensor: first-order bandwidth, noise, range and resolution.

    The published set-up (paper, section 5.1) is the default. The paper gives the resolution of 40 nm
    and no noise: it is read both as the converter's step and as the rms noise.
    """

    range_um: Limit = Field(default=250.0, description="largest absolute reading; inf: no limit")
    resolution_um: Step = Field(default=0.04, description="step of the reading; 0: none")
    bandwidth_hz: Bandwidth = Field(default=2000.0, description="-3 dB of the first-order lag; inf: none")
    noise_um: Noise = Field(default=0.04, description="rms of the white noise; 0: none")

    def read(self, filtered_um: Array, generator: np.random.Generator) -> Array:
        """Readings (output, sample) of positions after the sensor's low-pass."""
        reading = np.array(filtered_um, dtype=np.float64, order="C")
        self.read_in_place(reading, generator, 0, reading.shape[1])
        return reading

    def read_in_place(self, um: Array, generator: np.random.Generator, first: int, stop: int) -> None:
        """Replace such positions (output, sample) by their readings, for a range of samples."""
        from hammerstein.blocks.instrument_kernels import digitise

        drawn = np.zeros((um.shape[0], NOISE_BLOCK))
        for begin in range(first, stop, NOISE_BLOCK):
            here = drawn[:, : min(NOISE_BLOCK, stop - begin)]
            if self.noise_um != 0.0:
                here[:] = generator.standard_normal(here.shape[::-1]).T  # drawn sample by sample
            digitise(here, self.noise_um, self.range_um, self.resolution_um, begin, um)

    def clipped(self, reading_um: Array) -> int:
        """Samples of the readings (output, sample) that the range clipped, or may have clipped."""
        if math.isinf(self.range_um):
            return 0
        step = self.resolution_um
        largest = np.round(self.range_um / step) * step if step else self.range_um
        nearly = largest * (1.0 - 1e-12)
        if reading_um.size == 0 or (-nearly < reading_um.min() and reading_um.max() < nearly):
            return 0
        return int((np.abs(reading_um) >= nearly).any(axis=0).sum())


def standard_noise(generator: np.random.Generator, outputs: int, samples: int) -> Array:
    """Standard normal numbers (output, sample), drawn sample by sample, so that pieces equal the whole."""
    return np.ascontiguousarray(generator.standard_normal((samples, outputs)).T)


class Instruments(WithInfinity):
    """Drive and sensor of one set-up."""

    drive: Drive = Field(default=Drive(), description="converter and amplifier")
    sensor: Sensor = Field(default=Sensor(), description="position sensor")

    @classmethod
    def ideal(cls, sample_time_s: float = 50e-6) -> Instruments:
        """Ideal instruments: only the hold remains."""
        return cls(
            drive=Drive(range_v=(-math.inf, math.inf), resolution_v=0.0, sample_time_s=sample_time_s),
            sensor=Sensor(range_um=math.inf, resolution_um=0.0, bandwidth_hz=math.inf, noise_um=0.0),
        )

    def reaching(self, recorded: Voltages) -> Instruments:
        """Return the same with a drive that covers the recorded voltages, if it has no range."""
        low, high = np.array(recorded.lowest_v), np.array(recorded.highest_v)
        limits = self.drive.limits(len(low))
        if "range_v" in self.drive.model_fields_set or ((low >= limits[0]) & (high <= limits[1])).all():
            return self
        ends = tuple(zip(recorded.lowest_v, recorded.highest_v, strict=True))
        return self.model_copy(update={"drive": self.drive.model_copy(update={"range_v": ends})})

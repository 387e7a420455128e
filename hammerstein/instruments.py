"""Drive and sensor: what stands between the computer and the actuator."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from hammerstein.quantities import Bandwidth, Limit, SampleTime, Step

Array = NDArray[np.float64]


class Drive(BaseModel):
    """Digital-to-analogue converter and amplifier: clips, rounds and holds the voltage.

    An infinite range or a resolution of zero switches that effect off. The published set-up (paper,
    section 5.1) is the default; the paper names the converter, not its resolution: 16 bits are assumed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    range_v: Limit = Field(default=10.0, description="largest voltage of either sign; inf: no limit")
    resolution_v: Step = Field(default=20.0 / 2**16, description="step of the converter; 0: none")
    sample_time_s: SampleTime = Field(default=50e-6, description="time for which a voltage is held")

    def apply(self, u_v: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Voltages that leave the converter (input, sample), and where the range cut them."""
        saturated = np.abs(u_v) > self.range_v * (1.0 + 1e-9)  # a sine up to the range is not cut
        held = np.clip(u_v, -self.range_v, self.range_v)
        return _rounded(held, self.resolution_v), saturated


class Sensor(BaseModel):
    """Displacement sensor: first-order bandwidth, noise, range and resolution.

    The published set-up (paper, section 5.1) is the default. The paper gives the resolution of 40 nm
    and no noise: it is read both as the converter's step and as the rms noise.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    range_um: Limit = Field(default=250.0, description="largest reading of either sign; inf: no limit")
    resolution_um: Step = Field(default=0.04, description="step of the reading; 0: none")
    bandwidth_hz: Bandwidth = Field(default=2000.0, description="-3 dB of the first-order lag; inf: none")
    noise_um: Step = Field(default=0.04, description="rms of the white noise; 0: none")

    def read(self, filtered_um: Array, generator: np.random.Generator) -> Array:
        """Readings (output, sample) of positions that have passed the sensor's bandwidth."""
        noise = standard_noise(generator, *filtered_um.shape) if self.noise_um else 0.0
        noisy = filtered_um + self.noise_um * noise
        return _rounded(np.clip(noisy, -self.range_um, self.range_um), self.resolution_um)

    def clipped(self, reading_um: Array) -> int:
        """Samples of the readings (output, sample) at which the range cut one of them, or may have."""
        if math.isinf(self.range_um):
            return 0
        largest = float(_rounded(np.array([self.range_um]), self.resolution_um)[0])
        return int((np.abs(reading_um) >= largest * (1.0 - 1e-12)).any(axis=0).sum())


def standard_noise(generator: np.random.Generator, outputs: int, samples: int) -> Array:
    """Standard normal numbers (output, sample), drawn sample by sample: a run in pieces draws the same."""
    return np.ascontiguousarray(generator.standard_normal((samples, outputs)).T)


class Instruments(BaseModel):
    """Drive and sensor of one set-up."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")

    drive: Drive = Drive()
    sensor: Sensor = Sensor()

    @classmethod
    def ideal(cls, sample_time_s: float = 50e-6) -> Instruments:
        """Switch every effect off but the hold."""
        return cls(
            drive=Drive(range_v=math.inf, resolution_v=0.0, sample_time_s=sample_time_s),
            sensor=Sensor(range_um=math.inf, resolution_um=0.0, bandwidth_hz=math.inf, noise_um=0.0),
        )


def _rounded(values: Array, step: float) -> Array:
    return values if step == 0.0 else np.round(values / step) * step

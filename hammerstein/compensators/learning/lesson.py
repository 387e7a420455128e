"""The next drive of a periodic path, from the last one and what a sensor read meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.compensators.cycle import centred, played
from hammerstein.compensators.learning.unsure import Unsure
from hammerstein.errors import InputError
from hammerstein.metrics import rms
from hammerstein.model import HammersteinModel

SIGNIFICANT = 3.0  # standard deviations of the noise: what an error must exceed to be learnt
LEAST_PERIODS = 3
MEASURED = "measured"
"""What the readings of a trial are called in messages, as long as they are no file."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """What a trial taught.

    drive_v : (m, N) the next period of voltages; that of the trial where nothing is left to learn
    error_um : (p, N) mean error of the trial, the sensor's lag taken out
    noise_um : rms of the noise in the mean that was read
    lifted : by how much that noise is larger in the error, for the sensor's lag is taken out of it, too
    learnt : lines of the spectrum that were corrected; slowest : what a trial leaves of an error at worst
    limit_hz : from where on the model is too unsure to learn; inf if nowhere
    """

    drive_v: Array
    error_um: Array
    noise_um: float
    lifted: float
    learnt: int
    slowest: float
    limit_hz: float

    @property
    def error_rms_um(self) -> float:
        """Rms of the mean error, with the noise in it taken off."""
        return float(np.sqrt(max(rms(self.error_um) ** 2 - (self.lifted * self.noise_um) ** 2, 0.0)))

    @property
    def finished(self) -> bool:
        """Whether what is left cannot be told from the sensor's noise."""
        return self.learnt == 0

    def statement(self) -> str:
        """Say what the error was, whether to go on, and why that converges."""
        found = (
            f"Error of this trial {self.error_rms_um:.3g} um rms, noise of its mean {self.noise_um:.2g} um."
        )
        if self.finished:
            return f"{found} What is left is the sensor's noise: keep this drive."
        limit = "" if np.isinf(self.limit_hz) else f" Above {self.limit_hz:.4g} Hz the model is too unsure."
        return (
            f"{found} Learnt at {self.learnt} lines of the spectrum. If the model is as sure as stated, a "
            f"trial leaves at most {self.slowest:.2g} of an error there: it converges.{limit}"
        )


def lesson(
    model: HammersteinModel,
    law: Law[Any],
    reference_um: Array,
    drive_v: Array,
    measured_um: Array,
    unsure: Unsure | None = None,
    sensor_bandwidth_hz: float = np.inf,
) -> Lesson:
    """Learn from a trial.

    The error behind the sensor's lag, ``E = R - Y / S``, is added to what the model does with the last
    drive, where it is more than noise and the model is sure enough (``Unsure``); the model's own inverse
    gives the drive of that path.

    Parameters
    ----------
    model, law : the model and its inverse, designed for the drive
    reference_um : (p, N) one period, counted from the start
    drive_v : (m, N) the period that was played
    measured_um : (p, periods N) settled periods that the sensor read, zero where the actuator stood
    unsure : how sure the model is
    sensor_bandwidth_hz : first-order lag of the sensor

    Raises
    ------
    InputError : no whole number of periods, or fewer than three
    """
    samples, time_s = reference_um.shape[1], model.instruments.drive.sample_time_s
    mean, spread = _mean_period(measured_um, samples)
    frequency: Array = np.asarray(np.fft.rfftfreq(samples, time_s), dtype=np.float64)
    lag = 1.0 / (1.0 + 1j * frequency / sensor_bandwidth_hz)
    error = np.fft.rfft(reference_um, axis=1) - np.fft.rfft(mean, axis=1) / lag
    noise = spread[:, None] * np.sqrt(samples) / np.abs(lag)
    delta = (unsure or Unsure()).relative(model, frequency, time_s).T
    share = Unsure.share(delta)
    above_noise = (np.abs(error) > SIGNIFICANT * noise) & (share > 0.0)
    drive = drive_v
    if above_noise.any():
        now, _ = played(model, law.range, drive_v, time_s)
        change = np.fft.irfft(np.where(above_noise, share * error, 0.0), samples, axis=1)
        drive = centred(law, model, now + change)
    slowest = float((1.0 - share[above_noise] * (1.0 - delta[above_noise])).max(initial=0.0))
    unsure_at = frequency[(share == 0.0).any(axis=0)]
    return Lesson(
        drive,
        np.fft.irfft(error, samples, axis=1),
        rms(spread),
        _lifted(samples, time_s, sensor_bandwidth_hz),
        int(above_noise.sum()),
        slowest,
        float(unsure_at.min(initial=np.inf)),
    )


def _lifted(samples: int, sample_time_s: float, sensor_bandwidth_hz: float) -> float:
    """By how much white noise grows where a first-order lag is taken out of it."""
    frequency = np.fft.fftfreq(samples, sample_time_s)
    return float(np.sqrt(np.mean(1.0 + (frequency / sensor_bandwidth_hz) ** 2)))


def _mean_period(measured_um: Array, samples: int) -> tuple[Array, Array]:
    """Mean period (p, N), and the standard deviation of its noise (p,)."""
    periods = measured_um.shape[1] // samples
    if measured_um.shape[1] % samples or periods < LEAST_PERIODS:
        raise InputError(
            MEASURED,
            f"has {measured_um.shape[1]} samples; give whole periods of {samples}, {LEAST_PERIODS} or more, "
            "recorded when the path had settled",
        )
    each = measured_um.reshape(len(measured_um), periods, samples)
    mean = each.mean(axis=1)
    variance = ((each - mean[:, None]) ** 2).sum(axis=(1, 2)) / ((periods - 1) * samples)
    return mean, np.asarray(np.sqrt(variance / periods))

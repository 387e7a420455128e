"""Readings of "bandwidth between 400 and 500 Hz" (paper, section 5.2), and the actuators that follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, natural_frequency_hz
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.paper.actuators import block_behind

BANDWIDTH_HZ = (430.0, 470.0)
RISE = 10.0 ** (3.0 / 20.0)


def rising_resonance_hz(frequency_hz: float, damping_ratio: float) -> float:
    """Resonance of a second-order axis whose gain has risen by 3 dB at a frequency.

        (1 - q)^2 + 4 zeta^2 q = 10^(-3/10),   q = (f / f_n)^2, the smaller root

    Raises InputError where the gain never rises so far.

    >>> round(rising_resonance_hz(430.0, 0.05), 1)
    792.9
    """
    half = 1.0 - 2.0 * damping_ratio**2
    inner = half**2 - (1.0 - RISE**-2)
    if inner < 0.0 or half <= 0.0:
        raise InputError("damping_ratio", f"{damping_ratio:g} is too much for a rise of 3 dB")
    return frequency_hz / math.sqrt(half - math.sqrt(inner))


READINGS: dict[str, Callable[[float, float], float]] = {
    "-3 dB": natural_frequency_hz,
    "resonance": lambda frequency_hz, damping_ratio: frequency_hz,
    "+3 dB": rising_resonance_hz,
}
"""What "bandwidth" may mean: from its frequency and the damping to the resonance of the axis [Hz]."""


def actuator_of(
    printed: HammersteinModel, reading: str | None, damping_ratio: float, lag: bool
) -> HammersteinModel:
    """Actuator whose loop at 50 Hz and 10 V is the printed one under a reading.

    Parameters
    ----------
    printed : the printed table, without dynamics
    reading : one of ``READINGS``; None: no dynamics
    damping_ratio : of both axes
    lag : whether the sensor has its 2 kHz, in identification and judgement; else its reading is prompt
    """
    sensor = printed.instruments.sensor
    if not lag:
        sensor = sensor.model_copy(update={"bandwidth_hz": Instruments.ideal().sensor.bandwidth_hz})
    instruments = printed.instruments.model_copy(update={"sensor": sensor})
    told = replace(printed, instruments=instruments)
    dynamics: AxesDynamics | StaticDynamics = StaticDynamics(n_outputs=len(printed.outputs))
    if reading is not None:
        resonances = (READINGS[reading](frequency, damping_ratio) for frequency in BANDWIDTH_HZ)
        dynamics = AxesDynamics(
            axes=tuple(Axis(resonance_hz=f, damping_ratio=damping_ratio) for f in resonances)
        )
    return replace(told, hysteresis=block_behind(told, dynamics), dynamics=dynamics)

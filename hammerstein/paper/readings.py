"""Readings of "bandwidth between 400 and 500 Hz" (paper, section 5.2), and the actuators that follow."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise, natural_frequency_hz
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, play
from hammerstein.model import HammersteinModel

FREQUENCY_HZ = 50.0  # of the sine that the paper identifies with
SMOOTHNESS = 1.0  # weight of a second difference of 1 um/V against an error of 1 um in one of 400 samples
CYCLES = 12  # the resonances ring for four cycles; the last one is used
BANDWIDTH_HZ = (430.0, 470.0)
"""Bandwidths of the two axes (section 5.1: 400-500 Hz)."""
RISE = 10.0 ** (3.0 / 20.0)
"""A gain 3 dB above that at rest."""


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


def block_behind(printed: HammersteinModel, dynamics: AxesDynamics | StaticDynamics) -> PrandtlIshlinskii:
    """Static block that gives the printed loop when it is measured through dynamics and sensor.

    printed : the printed table, without dynamics
    dynamics : the axes in front of which the block shall stand
    """
    instruments = printed.instruments
    sample_time_s = instruments.drive.sample_time_s
    period = round(1.0 / (FREQUENCY_HZ * sample_time_s))
    time_s = np.arange(CYCLES * period) * sample_time_s
    u = printed.amplitude_v * np.sin(2.0 * np.pi * FREQUENCY_HZ * time_s)
    block = discretise(dynamics, sample_time_s, instruments.sensor.bandwidth_hz)
    rows = []
    assert isinstance(printed.hysteresis, PrandtlIshlinskii)
    for o, row in enumerate(printed.hysteresis.pairs):
        rows.append(tuple(_pair_behind(pair, u, block.respond, o, period) for pair in row))
    return PrandtlIshlinskii(tuple(rows))


def _pair_behind(pair: Pair, u: Array, respond, output: int, period: int) -> Pair:  # type: ignore[no-untyped-def]
    plays = play(u, pair.thresholds_v)
    outputs = 2
    regressors = []
    for operator in plays:
        v = np.zeros((outputs, len(u)))
        v[output] = operator
        both, _ = respond(v)
        regressors.append(both[outputs + output, -period:])
    wanted = (pair.weights_um_per_v @ plays)[-period:]
    return Pair(pair.thresholds_v, _smoothest(np.array(regressors), wanted))


def _smoothest(regressors: Array, wanted: Array) -> Array:
    """Weights (operator,) whose partial sums explain a loop and bend least."""
    n = len(regressors)
    to_weights = np.eye(n) - np.eye(n, k=-1)  # weights are the differences of the slopes
    bends = np.diff(np.eye(n), 2, axis=0)
    rows = np.vstack([regressors.T @ to_weights, SMOOTHNESS * bends])
    slopes, *_ = np.linalg.lstsq(rows, np.concatenate([wanted, np.zeros(n - 2)]), rcond=None)
    return np.asarray(to_weights @ slopes)


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

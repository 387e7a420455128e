"""The packaged actuators of the paper, from its table.

The paper prints a static block that was identified through the dynamics of the cantilever and the sensor.
Here the block in front of the dynamics is found, so that the loop measured at 50 Hz and 10 V is the printed
one: with the printed thresholds and the dynamics fixed, each play operator is passed through dynamics and
sensor, and the weights follow from linear least squares over one settled cycle.

Through a resonance, the loop hardly determines neighbouring weights: plain least squares gives slopes that
jump between 4.3 and 5.6 um/V. Of all blocks that explain the loop nearly as well, the one with the smoothest
slopes is used (Phillips-Tikhonov): a small penalty on the second differences of the
slopes moves the rms residual on x from 0.070 to 0.083 um of a loop 117 um high.

The dense actuator has other thresholds than the printed partition, so that a model identified with that
partition cannot be the actuator itself; its slopes follow those of the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    CreepMode,
    StaticDynamics,
    discretise,
    natural_frequency_hz,
)
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, play
from hammerstein.model import HammersteinModel

COMMAND = "python -m tests.shipped"
SOURCE = "paper, equations 12 and 13, static block found behind dynamics and sensor"
DENSE = 28  # thresholds of the dense actuator, uniform in voltage
LEAST_DAMPING = 0.12  # the least that keeps a 10 V sine up to 420 Hz within the sensor's range

# Name, reading of "bandwidth", damping, whether the sensor lags, and what it is: see reports/paper/readings.
READ = (
    ("duo_bimorph", "-3 dB", LEAST_DAMPING, True, "-3 dB at 430 and 470 Hz"),
    ("duo_bimorph_resonant", "resonance", 0.15, True, "resonance at 430 and 470 Hz"),
    ("duo_bimorph_paper", "+3 dB", 0.01, False, "gain up by 3 dB at 430 and 470 Hz, sensor without lag"),
    ("duo_bimorph_static_read", None, 0.0, True, "no dynamics, printed table corrected for the sensor"),
)

# Slow modes as soft PZT has them (some per cent a decade); the paper gives no numbers, only that creep is
# felt below 0.05 Hz.
CREEP = tuple(CreepMode(gain=g, time_constant_s=t) for g, t in ((0.03, 3.0), (0.05, 30.0), (0.05, 300.0)))

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


def with_thresholds(block: PrandtlIshlinskii, thresholds_v: Array, amplitude_v: float) -> PrandtlIshlinskii:
    """Static block with other thresholds, whose slopes lie on the line through those of a given block.

    A slope, the sum of the weights up to a threshold, stands for the middle between it and the next one.

    Parameters
    ----------
    block : static block to follow
    thresholds_v : (operator,) thresholds of every pair [V], increasing, below the amplitude
    amplitude_v : end of the last step between thresholds [V]
    """

    def middles(r: Array) -> Array:
        return np.asarray(0.5 * (r + np.append(r[1:], amplitude_v)))

    def pair(old: Pair) -> Pair:
        slopes = np.interp(middles(thresholds_v), middles(old.thresholds_v), np.cumsum(old.weights_um_per_v))
        return Pair(thresholds_v, np.diff(slopes, prepend=0.0))

    return PrandtlIshlinskii(tuple(tuple(map(pair, row)) for row in block.pairs))


def build(folder: Path) -> list[Path]:
    """Write the actuators of the paper into a folder; the printed table must stand there."""
    printed = HammersteinModel.load(folder / "duo_bimorph_static.json")
    made = [
        _named(actuator_of(printed, reading, damping, lag), name, words)
        for name, reading, damping, lag, words in READ
    ]
    made += [_creeping(made[0]), _dense(made[0])]
    for model in made:
        model.save(folder / f"{model.name}.json")
    return [folder / f"{model.name}.json" for model in made]


def _named(model: HammersteinModel, name: str, words: str) -> HammersteinModel:
    """An actuator that follows from a reading of the paper, with its origin."""
    return replace(model, name=name, provenance={"source": SOURCE, "bandwidth": words, "command": COMMAND})


def _creeping(model: HammersteinModel) -> HammersteinModel:
    """The same actuator with creep behind its axes."""
    assert isinstance(model.dynamics, AxesDynamics)
    axes = tuple(axis.model_copy(update={"creep": CREEP}) for axis in model.dynamics.axes)
    creeping = replace(model, dynamics=AxesDynamics(axes=axes))
    return _named(creeping, "duo_bimorph_creep", f"{READ[0][-1]}, with creep")


def _dense(model: HammersteinModel) -> HammersteinModel:
    """Slopes of an actuator through other thresholds than a model that is identified has."""
    thresholds = model.amplitude_v * np.arange(DENSE) / DENSE
    assert isinstance(model.hysteresis, PrandtlIshlinskii)
    return replace(
        model,
        name="duo_bimorph_dense",
        hysteresis=with_thresholds(model.hysteresis, thresholds, model.amplitude_v),
        provenance={
            "source": f"slopes of {model.name}, drawn through {DENSE} thresholds uniform in voltage",
            "command": COMMAND,
        },
    )

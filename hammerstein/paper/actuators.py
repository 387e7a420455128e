"""Build the packaged actuators of the paper from its table: ``python -m hammerstein.paper.actuators``.

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

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import JsonValue

import hammerstein.actuators
from hammerstein.arrays import Array
from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    CreepMode,
    natural_frequency_hz,
)
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.paper.readings import actuator_of, block_behind

COMMAND = "python -m hammerstein.paper.actuators"
DENSE = 28  # thresholds of the dense actuator, uniform in voltage

# Name, reading of "bandwidth", damping, whether the sensor lags, and what it is: see reports/paper/readings.
READ = (
    ("duo_bimorph_paper", "+3 dB", 0.01, False, "gain up by 3 dB at 430 and 470 Hz, sensor without lag"),
    ("duo_bimorph_static_read", None, 0.0, True, "no dynamics, printed table corrected for the sensor"),
)


# Slow modes as soft PZT has them (some per cent a decade); the paper gives no numbers, only that creep is
# felt below 0.05 Hz.
CREEP = tuple(CreepMode(gain=g, time_constant_s=t) for g, t in ((0.03, 3.0), (0.05, 30.0), (0.05, 300.0)))


def bandwidth_axes() -> AxesDynamics:
    """Axes whose -3 dB bandwidth is 430 and 470 Hz (paper, section 5.2: between 400 and 500 Hz)."""
    damping = 0.12  # the least that keeps a 10 V sine up to 420 Hz within the sensor's range
    return AxesDynamics(
        axes=tuple(
            Axis(resonance_hz=natural_frequency_hz(f, damping), damping_ratio=damping) for f in (430.0, 470.0)
        )
    )


def resonant_axes() -> AxesDynamics:
    """Axes whose resonance is at 430 and 470 Hz: the other reading of "bandwidth"."""
    return AxesDynamics(axes=tuple(Axis(resonance_hz=f, damping_ratio=0.15) for f in (430.0, 470.0)))


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
    creeping = AxesDynamics(
        axes=tuple(axis.model_copy(update={"creep": CREEP}) for axis in bandwidth_axes().axes)
    )
    made = {
        "duo_bimorph": (bandwidth_axes(), bandwidth_axes(), "-3 dB at 430 and 470 Hz"),
        "duo_bimorph_resonant": (resonant_axes(), resonant_axes(), "resonance at 430 and 470 Hz"),
        "duo_bimorph_creep": (bandwidth_axes(), creeping, "-3 dB at 430 and 470 Hz, with creep"),
    }
    paths = []
    for name, (fast, dynamics, reading) in made.items():
        model = replace(
            printed,
            name=name,
            hysteresis=block_behind(printed, fast),
            dynamics=dynamics,
            provenance={
                "source": "paper, equations 12 and 13, static block found behind dynamics and sensor",
                "bandwidth": reading,
                "command": COMMAND,
            },
        )
        paths.append(folder / f"{name}.json")
        model.save(paths[-1])
    paths += [_read(folder, printed, *told) for told in READ]
    return [*paths, _dense(folder, HammersteinModel.load(paths[0]))]


def _read(
    folder: Path,
    printed: HammersteinModel,
    name: str,
    reading: str | None,
    damping: float,
    lag: bool,
    words: str,
) -> Path:
    """An actuator that follows from a reading of the paper."""
    provenance: JsonValue = {
        "source": "paper, equations 12 and 13, static block found behind dynamics and sensor",
        "bandwidth": words,
        "command": COMMAND,
    }
    model = replace(actuator_of(printed, reading, damping, lag), name=name, provenance=provenance)
    path = folder / f"{name}.json"
    model.save(path)
    return path


def _dense(folder: Path, model: HammersteinModel) -> Path:
    thresholds = model.amplitude_v * np.arange(DENSE) / DENSE
    assert isinstance(model.hysteresis, PrandtlIshlinskii)
    dense = replace(
        model,
        name="duo_bimorph_dense",
        hysteresis=with_thresholds(model.hysteresis, thresholds, model.amplitude_v),
        provenance={
            "source": f"slopes of {model.name}, drawn through {DENSE} thresholds uniform in voltage",
            "command": COMMAND,
        },
    )
    path = folder / f"{dense.name}.json"
    dense.save(path)
    return path


if __name__ == "__main__":
    (PACKAGED,) = map(Path, hammerstein.actuators.__path__)
    for written in build(Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGED):
        sys.stdout.write(f"{written}\n")

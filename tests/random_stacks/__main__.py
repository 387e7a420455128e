"""Identify made-up stacks, predict where they resonate, and follow a path with them.

    python -m tests.random_stacks [FIRST [LAST [FILE]]]

Each has its seed: one to three axes, loops 5 to 20 % wide, resonances of 200 to 2000 Hz, noise of 0.5 %. It
is identified from multisines at three levels. The resonance is then predicted at a level between, and at one
30 % above; last, a multisine is followed. What came of one is a row of results.csv beside this file, or of
another FILE; its minutes are those of the processors.
"""

from __future__ import annotations

import csv
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from hammerstein import HammersteinInverse
from hammerstein.errors import HammersteinError
from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from hammerstein.records.record import Record

from .truth import PER_RESONANCE, at_random

RESULTS = Path(__file__).with_name("results.csv")
ACTUATORS = 30
SAMPLES = 2048
LEVELS_V = (1 / 3, 2 / 3, 1.0)
"""Rms of each input of the records."""
BETWEEN_V, ABOVE_V = 0.85, 1.3
WIDE, SLOW = 9, 3
"""Experiments of one period each, as many at every level: over the whole band, and of slow motion."""
NOISE = 0.005
PATH_V, PATH_PART = 0.6, 0.6
"""The path is what this level moves, up to this part of the lowest resonance."""
SETTINGS = LoopSettings(minutes=float("inf"))
"""No clock: a search ends after its own steps, so that a busy computer gives the same rows."""


def multisine(seed, axes, highest_hz, time_s):
    """One period (axis, SAMPLES) of rms 1 in all lines up to a frequency."""
    lines = np.zeros((axes, SAMPLES // 2 + 1), dtype=complex)
    last = int(highest_hz * time_s * SAMPLES)
    turns = np.random.default_rng(seed).uniform(size=(axes, last))
    lines[:, 1 : last + 1] = np.exp(2j * np.pi * turns)
    u = np.fft.irfft(lines)
    return u / u.std(axis=1, keepdims=True)


def settled(respond, u):
    return respond(np.tile(u, 4))[:, -SAMPLES:]


def records(stacks, highest_hz, seed):
    """Those that resonate, then those up to the frequency of the path, whose loops are smaller."""
    found, slow_hz = [], PATH_PART * stacks.numbers[:, 0].min() / 2.0 / np.pi
    for k in range(WIDE + SLOW):
        band = highest_hz if k < WIDE else slow_hz
        u = LEVELS_V[k % 3] * multisine([seed, k], stacks.axes, band, stacks.time_s)
        y = stacks.position_um(np.tile(u, 4))[:, -2 * SAMPLES :]
        noise = np.random.default_rng([seed, 100 + k]).normal(size=y.shape)
        y = y + NOISE * y.std(axis=1, keepdims=True) * noise
        names = [tuple(f"{axis}{i + 1}" for i in range(stacks.axes)) for axis in "uy"]
        found.append(Record(np.tile(u, 2), y, stacks.time_s, *names, period_samples=SAMPLES))
    return found


def resonances_hz(respond, axes, level_v, near_hz, highest_hz, time_s):
    """Resonance of each output under a multisine of its own input at a level: poles of its response."""
    found = []
    for i, near in enumerate(near_hz):
        u = np.zeros((axes, SAMPLES))
        u[i] = level_v * multisine([9, i], 1, highest_hz, time_s)[0]
        hertz = np.fft.rfftfreq(SAMPLES, time_s)
        within = (hertz > 0.7 * near) & (hertz < 1.3 * near) & (hertz < highest_hz)
        driven, moved = (np.fft.rfft(row)[within] for row in (u[i], settled(respond, u)[i]))
        found.append(_pole_hz(hertz[within], moved / driven))
    return np.array(found)


def _pole_hz(hertz, response):
    """Frequency of b / (f0^2 - f^2 + 2 i d f0 f) + c that is nearest to a response."""
    size = np.abs(response).max()
    peak = hertz[np.argmax(np.abs(response))]

    def left(p):
        f0, d = p[0] * peak, p[1]
        flexible = 1.0 / (f0**2 - hertz**2 + 2j * d * f0 * hertz)
        basis = np.stack([flexible, np.ones_like(flexible)], axis=1)
        rest = response - basis @ np.linalg.lstsq(basis, response, rcond=None)[0]
        return np.concatenate([rest.real, rest.imag]) / size

    return float(least_squares(left, [1.0, 0.03], bounds=([0.8, 1e-4], [1.2, 0.5])).x[0] * peak)


def followed(stacks, model, lowest_hz, highest_hz, seed):
    """Error of a followed multisine over the noise of a reading of it, and over that of the smallest records.

    It swells from rest and dies away. The drive leaves hardly anything of the model; the rest is its error.
    """
    path = multisine([seed, 77], stacks.axes, PATH_PART * lowest_hz, stacks.time_s)
    swell = np.sin(np.pi * np.arange(SAMPLES) / SAMPLES) ** 2
    slow_v = 0.3 * multisine([seed, 5], stacks.axes, 0.2 * lowest_hz, stacks.time_s)
    gain = stacks.position_um(slow_v).std(axis=1, keepdims=True) / 0.3
    wanted = PATH_V * gain * path * swell
    drive = HammersteinInverse().design(model, 4.0, stacks.time_s).drive_for(wanted)
    error = stacks.position_um(drive) - wanted
    recorded = min((one.y_um.std(axis=1) for one in records(stacks, highest_hz, seed)), key=np.sum)
    return [float((error.std(axis=1) / (NOISE * size)).max()) for size in (wanted.std(axis=1), recorded)]


def tried(seed):
    """One row of the table."""
    stacks, widths = at_random(seed)
    near = stacks.numbers[:, 0] / 2.0 / np.pi
    highest = 1.0 / PER_RESONANCE / stacks.time_s
    band = 1.6 * highest
    row = {
        "seed": seed,
        "axes": stacks.axes,
        "resonance_hz": round(float(near.max()), 1),
        "width": round(float(widths.max()), 3),
    }
    begun = time.process_time()
    try:
        model, fit = identify_in_loop(records(stacks, band, seed), SETTINGS)
    except HammersteinError as error:
        return row | {"failed": str(error)}

    def simulated(u):
        return model.simulate(u, stacks.time_s).position_um

    for name, level in {"between": BETWEEN_V, "above": ABOVE_V, "moves": 1 / 3}.items():
        true, told = (
            resonances_hz(respond, stacks.axes, level, near, band, stacks.time_s)
            for respond in (stacks.position_um, simulated)
        )
        if name == "moves":
            at_1 = resonances_hz(stacks.position_um, stacks.axes, 1.0, near, band, stacks.time_s)
            row["moves_percent"] = round(100 * float(np.abs(at_1 / true - 1.0).max()), 3)
        else:
            row[f"{name}_percent"] = round(100 * float(np.abs(told / true - 1.0).max()), 4)
    held = next(trial.percent for trial in fit.trials if trial.kept)
    row["linear_percent"], row["held_percent"] = f"{fit.trials[0].percent:.4g}", f"{held:.4g}"
    ratios = followed(stacks, model, near.min(), band, seed)
    row["followed_in_noise"], row["in_noise_of_records"] = (round(ratio, 2) for ratio in ratios)
    return row | {"minutes": round((time.process_time() - begun) / 60.0, 1)}


def main(first=0, last=ACTUATORS - 1, results=RESULTS):
    rows = []
    for seed in range(int(first), int(last) + 1):
        rows.append(tried(seed))
        print(rows[-1], flush=True)
        write(rows, Path(results))


def write(rows, results):
    """Write all rows so far: an interrupted campaign loses one."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with results.open("w", encoding="utf-8", newline="") as out:
        table = csv.DictWriter(out, names, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])

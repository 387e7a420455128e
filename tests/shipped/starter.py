"""What ``hammerstein init`` copies: records of a simulated stage, its model, the numbers of a scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from hammerstein.actuators import DEFAULT
from hammerstein.experiment.run import run
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.reading import read_records
from hammerstein.regression.compare import Baseline
from hammerstein.reporting.fit_page import write_fit
from hammerstein.reporting.folder import Writer
from hammerstein.signals import Multisine, Sine

SAMPLE_TIME_S, AMPLITUDE_V = 50e-6, 10.0
"""Converter of 20 kHz, and the range of the packaged actuators."""
SINE_HZ, SINE_SAMPLES, MULTISINE_SAMPLES = 20.0, 3000, 3000
"""Three periods of a slow sine, and a multisine as long."""
COLUMNS = ("u_x", "u_y"), ("x", "y")


def build(folder: Path) -> None:
    """Write them into a folder in which the scenario ``circle.toml`` lies."""
    write_paths(folder)
    files = [write_record(folder, axis) for axis in range(2)]
    identify_stage(files, folder / "stage.json")
    report = run(folder / "circle.toml")
    Writer(folder / "reports")(report)
    Baseline.of(report).save(folder / "reports/baseline/circle.json")


def write_record(folder: Path, axis: int) -> Path:
    """Drive one input, hold the other, read the sensor."""
    sine = Sine(amplitude=AMPLITUDE_V, frequency_hz=SINE_HZ, axis=1)
    multisine = Multisine(amplitude=AMPLITUDE_V, lowest_hz=5.0, highest_hz=450.0)
    parts = [
        signal.sample(SAMPLE_TIME_S * np.arange(samples, dtype=np.float64), 1)[0]
        for signal, samples in ((sine, SINE_SAMPLES), (multisine, MULTISINE_SAMPLES))
    ]
    u = np.zeros((2, SINE_SAMPLES + MULTISINE_SAMPLES))
    u[axis] = np.concatenate(parts)
    actuator = HammersteinModel.load(DEFAULT)
    response = actuator.simulate(u, SAMPLE_TIME_S, instruments=actuator.instruments, seed=axis)
    inputs, outputs = COLUMNS
    table = {"time_s": SAMPLE_TIME_S * np.arange(u.shape[1])}
    table |= dict(zip(inputs, response.drive_v, strict=True))
    table |= dict(zip(outputs, response.reading_um, strict=True))
    place = folder / f"record_{outputs[axis]}.csv"
    pd.DataFrame(table).round(5).to_csv(place, index=False, lineterminator="\n")
    return place


def write_paths(folder: Path) -> None:
    """A circle of 20 um at 50 Hz: four turns that grow from rest, and one whole period."""
    for name, samples, growing in (("path", 1600, 400), ("period", 400, 1)):
        n = np.arange(samples)
        time_s, grown = SAMPLE_TIME_S * n, np.minimum(1.0, n / growing) ** 2
        turn = 2.0 * np.pi * 50.0 * time_s
        path = {"time_s": time_s, "x": 20.0 * grown * np.sin(turn), "y": 20.0 * grown * (1.0 - np.cos(turn))}
        pd.DataFrame(path).round(6).to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")


def identify_stage(files: list[Path], place: Path) -> None:
    """Write the model of the records, and its fit report."""
    inputs, outputs = COLUMNS
    records = read_records(files, inputs=inputs, outputs=outputs, time="time_s")
    sensor = HammersteinModel.load(DEFAULT).instruments.sensor  # its bandwidth stands on a data sheet
    settings = Settings(dynamics="second_order", sensor_bandwidth_hz=sensor.bandwidth_hz)
    model, fit = identify(records, settings, name=place.stem)
    write_fit(model, fit, place, place.parent / f"{place.stem}_fit")

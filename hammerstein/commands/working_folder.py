"""The folder that ``hammerstein init`` makes: records, a model, a scenario, a baseline, what to do next."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from hammerstein.actuators import DEFAULT
from hammerstein.errors import InputError
from hammerstein.files import drop_cleanup, register_cleanup
from hammerstein.plugins import load_plugins
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import behind_link, staged
from hammerstein.scenario.assessment import ASSESSMENTS

Say = Callable[[str], None]

STARTER = Path(__file__).parents[1] / "starter"
SAMPLE_TIME_S, AMPLITUDE_V = 50e-6, 10.0
"""Converter of 20 kHz, and the range of the packaged actuators."""
SINE_HZ, SINE_SAMPLES, MULTISINE_SAMPLES = 20.0, 3000, 3000
"""Three periods of a slow sine, and a multisine as long."""
COLUMNS = ("u_x", "u_y"), ("x", "y")
CI = ".github/workflows/hammerstein.yml"
INIT = Owner("init", single=True, listed=False)


def own_folder(target: Path, say: Say) -> None:
    """Make a working folder for one's own actuator.

    Parameters
    ----------
    target : folder; created if it does not exist
    say : called with each step

    Raises
    ------
    InputError : a file has one of these names already, or the folder cannot be written
    """
    refuse_started(target)
    with _scratch() as room, staged(behind_link(target), INIT) as stage:
        _copy(STARTER / "README.md", room / "README.md")
        _copy(STARTER / "circle.toml", room / "circle.toml")
        _copy(STARTER / "hammerstein.yml", room / CI)
        say("1 of 3: recording a simulated stage")
        _write_path(room / "path.csv")
        files = [_write_record(room, axis) for axis in range(2)]
        _identify(files, room / "stage.json", lambda what: say(f"2 of 3: identifying its model: {what}"))
        _run(room, lambda what, done, of: say(f"3 of 3: running the scenario: {what}, {done} of {of}"))
        stage.take(room)
        refuse_existing(target, stage.names)


def folder_of(assessment: str, target: Path) -> None:
    """Copy the scenarios that a kind of assessment brings, and the numbers that were accepted for them.

    Raises InputError as ``own_folder`` does, and where no such kind brings any.
    """
    load_plugins()
    brought = {name: files for name, kind in ASSESSMENTS.kinds.items() if (files := kind.shipped())}
    if assessment not in brought:
        raise InputError("--of", f"nothing is available for {assessment!r}; give one of {', '.join(brought)}")
    with staged(behind_link(target), INIT) as stage:
        for name, file in brought[assessment].items():
            stage.write(name, file.read_bytes())
        refuse_existing(target, stage.names)


@contextmanager
def _scratch() -> Iterator[Path]:
    """A folder that is removed afterwards, however the program ends."""
    with tempfile.TemporaryDirectory(prefix="hammerstein-") as name:
        room = Path(name)
        register_cleanup(room, partial(shutil.rmtree, room, ignore_errors=True))
        try:
            yield room
        finally:
            drop_cleanup(room)


def refuse_existing(target: Path, names: Sequence[str]) -> None:
    """Refuse a folder that holds one of these files: nothing is ever written over; InputError names them.

    A file or a link where a folder is to be stands in the way, too.
    """
    folders = {place for name in names for place in Path(name).parents if place != Path(".")}
    there = [name for name in names if os.path.lexists(target / name)]
    there += sorted(f.as_posix() for f in folders if (target / f).is_symlink() or (target / f).is_file())
    if there:
        listed = ", ".join(there[:5]) + (f" and {len(there) - 5} more" if len(there) > 5 else "")
        raise InputError(str(target), f"already holds {listed}; nothing was written. Choose another folder")


def refuse_started(target: Path) -> None:
    """Refuse, before the work, what ``own_folder`` would refuse after it; InputError."""
    names = ["README.md", "circle.toml", "path.csv", "record_x.csv", "record_y.csv", "stage.json", CI]
    names += ["stage_fit/fit.json", "reports/circle/report.json", "reports/baseline/circle.json"]
    refuse_existing(target, names)


def _copy(source: Path, place: Path) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(source.read_bytes())


def _write_record(room: Path, axis: int) -> Path:
    """Drive one input, hold the other, read the sensor."""
    import pandas as pd

    from hammerstein.model import HammersteinModel
    from hammerstein.signals import Multisine, Sine

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
    place = room / f"record_{outputs[axis]}.csv"
    pd.DataFrame(table).round(5).to_csv(place, index=False, lineterminator="\n")
    return place


def _write_path(place: Path) -> None:
    """A circle of 20 um that begins at rest."""
    import pandas as pd

    time_s = SAMPLE_TIME_S * np.arange(1600)
    grown, turn = np.minimum(1.0, time_s / 0.02) ** 2, 2.0 * np.pi * 50.0 * time_s
    path = {"time_s": time_s, "x": 20.0 * grown * np.sin(turn), "y": 20.0 * grown * (1.0 - np.cos(turn))}
    pd.DataFrame(path).round(6).to_csv(place, index=False, lineterminator="\n")


def _identify(files: list[Path], place: Path, say: Say) -> None:
    from hammerstein.identification.identify import identify
    from hammerstein.identification.settings import Settings
    from hammerstein.model import HammersteinModel
    from hammerstein.records.reading import read_records
    from hammerstein.reporting.fit_page import write_fit

    inputs, outputs = COLUMNS
    records = read_records(files, inputs=inputs, outputs=outputs, time="time_s")
    sensor = HammersteinModel.load(DEFAULT).instruments.sensor  # its bandwidth stands on a data sheet
    settings = Settings(dynamics="second_order", sensor_bandwidth_hz=sensor.bandwidth_hz)
    model, fit = identify(records, settings, name=place.stem, progress=say)
    say("drawing")
    write_fit(model, fit, place, place.parent / f"{place.stem}_fit")


def _run(room: Path, progress: Callable[[str, int, int], None]) -> None:
    """Write the report of the scenario, and accept its numbers."""
    from hammerstein.experiment.run import run
    from hammerstein.regression.baseline import Baseline
    from hammerstein.reporting.folder import write_report

    report = run(room / "circle.toml", progress=progress)
    write_report(report, room / "reports/circle")
    Baseline.of(report).save(room / "reports/baseline/circle.json")

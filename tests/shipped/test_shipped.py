"""The shipped files are what their commands make."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pandas as pd
import pytest

from hammerstein.actuators import DEFAULT
from hammerstein.commands.start import STARTER
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel, packaged_actuators
from hammerstein.records.reading import read_records
from hammerstein.runtime.staging import Manifest, digest_of
from shipped import paper_actuators, stacks, starter

MADE = ("path.csv", "period.csv", "record_x.csv", "record_y.csv")
RECORDS = MADE[2:]


def test_packaged_actuators_are_what_their_command_makes(tmp_path):
    static = HammersteinModel.load("duo_bimorph_static")
    static.save(tmp_path / "duo_bimorph_static.json")
    made = paper_actuators.build(tmp_path) + stacks.build(tmp_path)
    assert sorted([p.stem for p in made] + ["duo_bimorph_static"]) == packaged_actuators()
    for path in made:
        fresh, packaged = HammersteinModel.load(path), HammersteinModel.load(path.stem)
        assert fresh.provenance == packaged.provenance
        assert fresh.dynamics == packaged.dynamics
        assert fresh.hysteresis.describe() == packaged.hysteresis.describe()
        for weights, same in zip(fresh.hysteresis.weights, packaged.hysteresis.weights, strict=True):
            np.testing.assert_allclose(weights, same, atol=1e-6)


def test_records_and_path_of_the_starter_are_what_its_command_makes(tmp_path):
    starter.write_paths(tmp_path)
    for axis in range(2):
        starter.write_record(tmp_path, axis)
    for name in MADE:
        fresh, shipped = (pd.read_csv(folder / name) for folder in (tmp_path, STARTER))
        pd.testing.assert_frame_equal(fresh, shipped, rtol=0.0, atol=2e-5)  # the last digit written


def test_the_first_command_of_the_readme_follows_the_shipped_records_to_their_noise():
    """Noise and rounding are left; coarse thresholds once kept a low-pass of 2.5 us in the model."""
    inputs, outputs = starter.COLUMNS
    records = read_records(
        [STARTER / name for name in RECORDS], inputs=inputs, outputs=outputs, time="time_s"
    )
    model, fit = identify(records, Settings(sensor_bandwidth_hz=2000.0))
    plant = HammersteinModel.load(DEFAULT)
    sensor = plant.instruments.sensor
    noise_um = np.hypot(sensor.noise_um, sensor.resolution_um / np.sqrt(12.0))
    np.testing.assert_allclose(fit.fit[fit.kind].rms_um, noise_um, rtol=0.02)
    assert model.dynamics.input_delay_s == 0.0
    for axis, true in zip(model.dynamics.axes, plant.dynamics.axes, strict=True):
        assert axis.lag_s is None
        assert axis.resonance_hz == pytest.approx(true.resonance_hz, rel=5e-4)
        assert axis.damping_ratio == pytest.approx(true.damping_ratio, rel=5e-3)


@pytest.mark.full
def test_the_starter_is_what_its_command_makes(tmp_path):
    """Identified, run and drawn anew: the same files, the same model, the same accepted numbers."""
    shutil.copy(STARTER / "circle.toml", tmp_path)
    starter.build(tmp_path)
    made = {path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()}
    by_hand = {STARTER / "README.md", STARTER / ".github/workflows/hammerstein.yml"}
    there = {path for path in STARTER.rglob("*") if path.is_file()} - by_hand
    assert made == {path.relative_to(STARTER) for path in there}
    fresh, shipped = (HammersteinModel.load(folder / "stage.json") for folder in (tmp_path, STARTER))
    assert fresh.hysteresis.gain(10.0) == pytest.approx(shipped.hysteresis.gain(10.0), rel=2e-3, abs=2e-3)
    for axis, same in zip(fresh.dynamics.axes, shipped.dynamics.axes, strict=True):
        assert axis.resonance_hz == pytest.approx(same.resonance_hz, rel=2e-3)
    rows, same_rows = (
        json.loads((folder / "reports/baseline/circle.json").read_text())["rows"]
        for folder in (tmp_path, STARTER)
    )
    for row, same in zip(rows, same_rows, strict=True):
        assert row["key"] == same["key"]
        assert row["numbers"]["rms_um"] == pytest.approx(same["numbers"]["rms_um"], rel=0.05, abs=0.01)


@pytest.mark.parametrize("folder", [".", "stage_fit", "reports/circle"])
def test_nobody_has_changed_what_the_starter_lists(folder):
    """A file that differs from its manifest would be taken for a person's own, and kept aside."""
    listed = Manifest.read(STARTER / folder).files
    assert listed
    for name, entry in listed.items():
        assert digest_of(STARTER / folder / name) == entry.sha256, name


@pytest.mark.parametrize("html", ["stage_fit/report.html", "reports/circle/report.html"])
def test_pages_of_the_starter_have_the_style_and_script_of_today(html):
    """Else make them anew: ``python -m tests.shipped``."""
    text = (STARTER / html).read_text(encoding="utf-8")
    for part in ("page.css", "page.js"):
        assert (STARTER.parent / "templates" / part).read_text(encoding="utf-8").strip() in text, part

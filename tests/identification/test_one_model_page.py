"""The page of the mirror: what its fit may read, and what its table is made of."""

import importlib.util
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from identification.test_in_loop import made_up, multisine

from hammerstein import HammersteinModel
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.state_space_candidates import gain_model

PAGE = Path(__file__).parents[2] / "reports" / "measured" / "one_model" / "make.py"
SECOND = 1.0 / 6400.0


@pytest.fixture
def one_model(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("one_model", PAGE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "HERE", tmp_path)
    return module


def mirror():
    """The made-up mirror as a model: nothing precedes its loop."""
    loop = made_up().dynamics(SECOND)
    return HammersteinModel("truth", gain_model(np.eye(2)), loop, 1.5, ("u1", "u2"), ("y1", "y2"))


def write(folder, parts, error_um=0.0):
    """Records of a made-up mirror: two experiments of each level, two periods, positions in m."""
    truth = made_up()
    for part, level in [(part, level) for part in parts for level in (100, 200, 300)]:
        u = np.stack([multisine(7 * k + level, level / 100.0) for k in range(2)])
        y = np.stack([truth.simulate(row, 1500) for row in u]) + error_um
        for axis, values in (("u", u), ("y", 1e-6 * y)):
            periods = np.stack([values, values], axis=-1)  # experiment, channel, sample, period
            np.save(folder / f"{axis}_{level}mV_{part}.npy", np.transpose(periods, (2, 1, 0, 3)))


def test_the_fit_reads_the_training_records_alone(one_model, tmp_path, monkeypatch):
    """Test records are not there; the model and every structure that was tried are written."""
    write(tmp_path, ["train"])
    truth = mirror()
    tried = [Trial("linear", 9, np.array([4e-4])), Trial("plays", 12, np.array([1e-4]), kept=True)]
    monkeypatch.setattr(
        one_model, "identify_in_loop", lambda *asked, **more: (truth, SimpleNamespace(trials=tried))
    )
    one_model.fit(tmp_path, 1.0)
    assert HammersteinModel.load(tmp_path / "model.json").dynamics == truth.dynamics
    kept = json.loads((tmp_path / "trials.json").read_text())
    assert one_model.structures(kept["trials"]).splitlines()[2:] == [
        "| linear | 2 % |",
        "| **plays** | 1 % |",
    ]


def test_training_records_are_those_of_all_levels_with_both_periods(one_model, tmp_path):
    write(tmp_path, ["train"])
    found = one_model.training(tmp_path)
    u, y = one_model.records(tmp_path, 300, "train")
    assert [record.period_samples for record in found] == [u.shape[-1]] * 6
    np.testing.assert_array_equal(found[-1].u_v, np.hstack([u[-1, 0], u[-1, 1]]))
    np.testing.assert_array_equal(found[-1].y_um, np.hstack([y[-1, 0], y[-1, 1]]))


def test_the_table_is_the_error_of_the_test_records(one_model, tmp_path):
    """The truth judges records that stand 0.25 um beside it, and training records that do not."""
    write(tmp_path, ["train"])
    write(tmp_path, ["test"], 0.25)
    truth = mirror()
    truth.save(tmp_path / "model.json")
    (tmp_path / "trials.json").write_text('{"minutes": 2, "trials": []}')
    (tmp_path / "notes.md").write_text("{table} in {minutes} minutes {structures}")
    one_model.write_table(tmp_path)
    text = (tmp_path / "README.md").read_text()
    assert "| **this model, test records** | 0.250 | 0.250 | 0.250 |" in text
    assert "| this model, training records | 0.000 | 0.000 | 0.000 |" in text
    assert "in 2 minutes" in text
    assert "| noise of one period, test records | 0.000 | 0.000 | 0.000 |" in text

"""The page of the mirror: what its fit may read, and what its table is made of."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from identification.test_in_loop import made_up, multisine

from hammerstein import HammersteinModel

PAGE = Path(__file__).parents[2] / "reports" / "measured" / "one_model" / "make.py"
SECOND = 1.0 / 6400.0


@pytest.fixture
def one_model(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("one_model", PAGE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "HERE", tmp_path)
    return module


def write(folder, parts, error_um=0.0):
    """Records of a made-up mirror: two experiments of each level, two periods, positions in m."""
    truth = made_up()
    for part, level in [(part, level) for part in parts for level in (100, 200, 300)]:
        u = np.stack([multisine(7 * k + level, level / 100.0) for k in range(2)])
        y = np.stack([truth.simulate(row, 1500) for row in u]) + error_um
        for axis, values in (("u", u), ("y", 1e-6 * y)):
            periods = np.stack([values, values], axis=-1)  # experiment, channel, sample, period
            np.save(folder / f"{axis}_{level}mV_{part}.npy", np.transpose(periods, (2, 1, 0, 3)))


def test_the_fit_needs_no_test_records(one_model, tmp_path):
    """They are not there; it fits all training records, and lowers their error."""
    write(tmp_path, ["train"])
    truth, search = made_up(), tmp_path / "search.json"
    truth.at(truth.vector() * 1.02).save(search)
    one_model.fit(tmp_path, search, 0.0)
    found = HammersteinModel.load(tmp_path / "model.json")
    u, y = one_model.records(tmp_path, 300, "train")
    before = truth.at(truth.vector() * 1.02).model("before", SECOND, 1.5, ["u1", "u2"], ["y1", "y2"])
    left = [float((y - one_model.simulated(model, u)).std()) for model in (before, found)]
    assert left[1] < 0.5 * left[0]


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
    truth = made_up().model("truth", SECOND, 1.5, ["u1", "u2"], ["y1", "y2"])
    truth.save(tmp_path / "model.json")
    one_model.write_alone(truth, tmp_path, "plays", 120.0)
    (tmp_path / "notes.md").write_text("{table}")
    one_model.write_table(tmp_path)
    text = (tmp_path / "README.md").read_text()
    assert "| **this model, test records** | 0.250 | 0.250 | 0.250 |" in text
    assert "| this model, training records | 0.000 | 0.000 | 0.000 |" in text
    assert "| found with defaults in 2 minutes, test records | 0.250 | 0.250 | 0.250 |" in text
    assert "| noise of one period, test records | 0.000 | 0.000 | 0.000 |" in text

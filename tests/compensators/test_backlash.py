"""Plain backlash of a stage, such as that of a lead screw: record, model, inverse, and the inverse in C."""

import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import theory

from hammerstein import HammersteinModel
from hammerstein.commands.cli import main
from hammerstein.identification.identify import identify
from hammerstein.records.record import Record

STEP_S, GAIN_UM_PER_V, HALF_BACKLASH_V = 1e-3, 1.5, 2.0
NOISE_UM = 0.01
TRIANGLES = [0.0, 1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 12.0], [0.0, 0.0, 100.0, 0.0, 100.0, 30.0, 70.0, 70.0]


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    assert not caught.value.code


def _moved(u_v):
    """Where the stage goes: nothing moves until the play is taken up."""
    return GAIN_UM_PER_V * theory.play(u_v, HALF_BACKLASH_V)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """Model of two triangles with noise."""
    folder = tmp_path_factory.mktemp("backlash")
    t = STEP_S * np.arange(12000)
    u = np.interp(t, *TRIANGLES)
    y = _moved(u) + np.random.default_rng(5).normal(0.0, NOISE_UM, len(t))
    table = pd.DataFrame({"time_s": t, "u_v": u, "y_um": y})
    table.to_csv(folder / "record.csv", index=False)
    _call("identify", folder / "record.csv", "--out", folder / "stage.json", "--no-figures")
    return folder


@pytest.mark.full
def test_its_half_width_and_gain_are_identified(stage):
    pair = HammersteinModel.load(stage / "stage.json").hysteresis.pairs[0][0]
    weights, thresholds_v = pair.weights_um_per_v, pair.thresholds_v
    noise_v = NOISE_UM / GAIN_UM_PER_V  # by which one play may be parted in two neighbours
    assert weights.sum() == pytest.approx(GAIN_UM_PER_V, rel=1e-3)
    assert weights @ thresholds_v / weights.sum() == pytest.approx(HALF_BACKLASH_V, abs=noise_v)
    assert (np.abs(thresholds_v - HALF_BACKLASH_V)[np.abs(weights) > 0.01 * GAIN_UM_PER_V] < 0.1).all()


def test_its_inverse_takes_the_backlash_up_at_each_turn(stage):
    t = STEP_S * np.arange(4000)
    path = 75.0 * np.minimum(1.0, t) + 30.0 * np.sin(2.0 * np.pi * t) * np.clip(t - 1.0, 0.0, 1.0)
    pd.DataFrame({"time_s": t, "y_um": path}).to_csv(stage / "path.csv", index=False)
    out = stage / "drive.csv"
    _call("compensate", stage / "stage.json", stage / "path.csv", "--law", "exact_inverse", "--out", out)
    drive = pd.read_csv(out, comment="#")["drive_u_v"].to_numpy()
    error = np.abs(_moved(drive) - path)
    assert np.abs(_moved(path / GAIN_UM_PER_V) - path).max() > 0.9 * GAIN_UM_PER_V * HALF_BACKLASH_V
    assert error.max() < 0.02
    jumps = np.abs(np.diff(drive))
    assert jumps.max() == pytest.approx(2.0 * HALF_BACKLASH_V, abs=0.2)


@pytest.mark.full
@pytest.mark.skipif(shutil.which("make") is None or shutil.which("cc") is None, reason="needs make and cc")
def test_its_inverse_in_c_has_the_same_bits(stage):
    code = stage / "code"
    _call("export", stage / "stage.json", "--law", "exact_inverse", "--softening-v", 0.5, "--out", code)
    done = subprocess.run(["make", "-C", str(code), "check"], capture_output=True, text=True, check=True)
    assert "0 numbers differ" in done.stdout


@pytest.mark.full
@pytest.mark.parametrize("seed", range(8, 12))
def test_a_wrong_first_delay_does_not_keep_its_thresholds(seed):
    """The noise alone is left: thresholds fitted with a delay of 4 samples left up to five times as much."""
    u = np.interp(STEP_S * np.arange(12000), *TRIANGLES)
    y = _moved(u) + np.random.default_rng(seed).normal(0.0, NOISE_UM, len(u))
    _, fit = identify([Record([u], [y], STEP_S)])
    assert fit.fit[fit.kind].rms_um[0] == pytest.approx(NOISE_UM, rel=0.03)

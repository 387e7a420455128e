"""What went before the records goes before the drive: a unipolar stack stands on its descending branch."""

import numpy as np
import pytest
import theory
from typer.testing import CliRunner

from hammerstein.commands.cli import app
from hammerstein.errors import Notice
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

T, TOP = 1e-3, 100.0
R, W = np.array([0.0, 4.0, 11.0, 22.0, 35.0]), np.array([0.5, 0.1, 0.08, 0.06, 0.05])
PAST = {"never driven": [0.0], "after both ends": [0.0, TOP, 0.0]}
SETTINGS = Settings(thresholds_v=R.tolist(), dynamics="none", solver="least_squares", delay_samples=0)


def stage(u, past):
    """Positions counted from where the stage stands after earlier voltages."""
    before = np.array(past)
    y = theory.prandtl_ishlinskii([np.concatenate([before, u])], [[R]], [[W]])[0]
    return y[len(before) :] - y[len(before) - 1]


def rise_and_fall(*tips):
    """From 0 V at rest to each of these and back."""
    each = [0.5 * tip * (1.0 - np.cos(2.0 * np.pi * np.arange(200) / 200)) for tip in tips]
    return np.concatenate([np.zeros(50), *each, np.zeros(20)])


def path_um():
    """From 0 to 35 um, then 20 um about it: never driven, the stage does not come back to 0."""
    turn = 2.0 * np.pi * np.arange(400) / 200
    return np.concatenate(
        [np.zeros(30), 17.5 * (1.0 - np.cos(0.25 * turn[:200])), 35.0 + 20.0 * np.sin(turn)]
    )


def fitted(past, noise_um=0.0):
    g = np.random.default_rng(4)
    records = []
    for tips in ((100.0, 60.0), (100.0, 85.0, 30.0)):
        u = rise_and_fall(*tips)
        y = stage(u, past)
        records.append(Record([u], [y + noise_um * g.standard_normal(y.size)], T, source=f"{tips}"))
    return identify(records, SETTINGS)[0]


@pytest.mark.parametrize("noise_um", [0.0, 0.02])
@pytest.mark.parametrize("past", list(PAST))
def test_a_drive_begins_in_the_state_in_which_the_records_began(past, noise_um, tmp_path):
    """The drive of the model follows the path on the stage, and the file says from which state."""
    model = fitted(PAST[past], noise_um)
    assert model.recorded.conditioned == (past == "after both ends")
    assert ("after both ends" in model.recorded.statement(["u1"])) == model.recorded.conditioned
    path = path_um()
    drive = model.compensate([path], law="exact_inverse")
    error = stage(drive.drive_v[0], PAST[past]) - path
    expected = np.sqrt(np.mean(np.square(error)))
    assert expected < 1e-9 + 2.0 * noise_um
    assert drive.prediction.rms_um[0] == pytest.approx(expected, abs=1e-6 + 1.5 * noise_um)
    told = "driven to 100 V, then to 0 V" if model.recorded.conditioned else "at rest, without history"
    assert any(told in said for said in drive.statements())
    again = HammersteinModel.from_json(model.to_json())
    assert again.recorded == model.recorded
    assert again.digest() == model.digest()


@pytest.mark.parametrize("past", list(PAST))
def test_play_begins_as_the_drive_file_says_and_positions_count_from_there(past, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = fitted(PAST["after both ends"])
    model.save("model.json")
    path = path_um()
    table = np.column_stack([T * np.arange(path.size), path])
    np.savetxt("path.csv", table, delimiter=",", header="time_s,y1_um", comments="")
    history = "--at-rest" if past == "never driven" else "--conditioned"

    def call(*words):
        result = CliRunner().invoke(app, list(words))
        assert result.exit_code == 0, result.output
        return result.output

    call("compensate", "model.json", "path.csv", "--law", "exact_inverse", "--out", "drive.csv", history)
    call("play", "model.json", "drive.csv")
    drive, found = (np.genfromtxt(name, delimiter=",", names=True) for name in ("drive.csv", "played.csv"))
    np.testing.assert_allclose(found["position_y1_um"], stage(found["played_u1_v"], PAST[past]), atol=1e-6)
    np.testing.assert_allclose(found["position_y1_um"], drive["predicted_y1_um"], atol=1e-6)
    other = "--conditioned" if past == "never driven" else "--at-rest"
    with pytest.warns(Notice, match="not made for that"):
        CliRunner().invoke(app, ["play", "model.json", "drive.csv", other, "--out", "other.csv"])


@pytest.mark.parametrize("narrow", [[], ["--range", "20,80"]])
def test_a_start_within_a_narrower_range_is_played_after_the_history_of_the_records(
    narrow, tmp_path, monkeypatch
):
    """A range limits the drive. What was before it stays: from 0 to 100 V, to 0 V, then to 50 V.

    With 80 and 20 V in their place the stage was 1 um off.
    """
    monkeypatch.chdir(tmp_path)
    fitted(PAST["after both ends"]).save("model.json")
    path = 5.0 * np.sin(2.0 * np.pi * np.arange(400) / 200)
    table = np.column_stack([T * np.arange(path.size), path])
    np.savetxt("path.csv", table, delimiter=",", header="time_s,y1_um", comments="")
    for words in (
        ["compensate", "model.json", "path.csv", "--law", "exact_inverse", "--start", "50", *narrow],
        ["play", "model.json", "drive.csv"],
    ):
        result = CliRunner().invoke(app, words)
        assert result.exit_code == 0, result.output
    drive, played = (np.genfromtxt(name, delimiter=",", names=True) for name in ("drive.csv", "played.csv"))
    np.testing.assert_allclose(stage(drive["drive_u1_v"], [0.0, TOP, 0.0, 50.0]), path, atol=1e-6)
    np.testing.assert_allclose(played["position_y1_um"], path, atol=1e-6)


@pytest.mark.parametrize(("words", "conditioned"), [([], True), (["--start", "rest"], False)])
def test_the_initial_state_can_be_given(words, conditioned, tmp_path, monkeypatch):
    """A stage on its descending branch, and a person who says that it was never driven."""
    monkeypatch.chdir(tmp_path)
    u = rise_and_fall(100.0, 60.0)
    table = np.column_stack([T * np.arange(u.size), u, stage(u, PAST["after both ends"])])
    np.savetxt("r.csv", table, delimiter=",", header="time_s,u_V,x_um", comments="")
    asked = [
        "--thresholds",
        "0,4,11,22,35",
        "--dynamics",
        "none",
        "--solver",
        "least_squares",
        "--no-figures",
    ]
    result = CliRunner().invoke(app, ["identify", "r.csv", "--out", "m.json", *asked, *words])
    assert result.exit_code == 0, result.output
    assert HammersteinModel.load("m.json").recorded.conditioned == conditioned

import json

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main
from hammerstein.compensators.drive_file import compensate
from hammerstein.model import HammersteinModel
from hammerstein.signals import smooth_step

T = 50e-6


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


def _circle(path, x=30.0, y=30.0, sample_time_s=T, samples=1200):
    t = np.arange(samples) * sample_time_s
    start, angle = smooth_step(t / 0.02), 2 * np.pi * 50.0 * t
    frame = pd.DataFrame({"time_s": t, "x": x * start * np.cos(angle), "y": y * start * np.sin(angle)})
    frame.to_csv(path, index=False)
    return frame


def test_drive_sent_to_the_actuator_gives_the_path(tmp_path):
    reference = _circle(tmp_path / "path.csv")
    out = tmp_path / "drive.csv"
    assert _call("compensate", "duo_bimorph", tmp_path / "path.csv", "--out", out) == 0
    table = pd.read_csv(out, comment="#")
    drive = table[["drive_x_v", "drive_y_v"]].to_numpy().T
    assert np.abs(drive).max() < 10.0
    # What is sent is on the converter's steps; what is predicted is where an independent run ends up.
    np.testing.assert_allclose(np.round(drive / (20 / 2**16)), drive / (20 / 2**16), atol=1e-6)
    model = HammersteinModel.load("duo_bimorph")
    from hammerstein.dynamics import discretise

    position, _ = discretise(model.dynamics, T).respond(model.hysteresis.respond(drive)[0])
    np.testing.assert_allclose(position, table[["predicted_x_um", "predicted_y_um"]].to_numpy().T, atol=1e-9)
    assert np.abs(position - reference[["x", "y"]].to_numpy().T).max() < 0.01


def test_the_reach_of_a_block_that_knows_the_rate_is_that_of_slow_paths(tmp_path, capsys):
    _circle(tmp_path / "path.csv", 10.0, 10.0, samples=300)
    out = ("--law", "inverse_multiplicative", "--out", tmp_path / "d.csv", "--json")
    assert _call("compensate", "rate_dependent_stack", tmp_path / "path.csv", *out) == 0
    axes = json.loads(capsys.readouterr().out)["axes"]
    model = HammersteinModel.load("rate_dependent_stack")
    slow = model.hysteresis.on_grid(1e6)
    swept = slow.respond([[0.0, 10.0, -10.0, 10.0], [0.0, 0.0, 0.0, 0.0]])[0][0]
    assert np.ptp(swept[1:]) == pytest.approx(np.ptp(axes["x"]["reach_alone_um"]), rel=0.02)


def test_a_start_out_of_the_range_names_its_option(tmp_path, capsys):
    _circle(tmp_path / "path.csv", samples=30)
    path, out = tmp_path / "path.csv", tmp_path / "d.csv"
    assert _call("compensate", "duo_bimorph_static", path, "--out", out, "--start", "50") == 2
    assert "--start: 50 V of input 1 lies outside" in capsys.readouterr().err


def test_summary_is_one_object(tmp_path, capsys):
    _circle(tmp_path / "path.csv")
    options = ("--law", "exact_inverse", "--out", tmp_path / "d.csv", "--json")
    assert _call("compensate", "duo_bimorph_static", tmp_path / "path.csv", *options) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["axes"]["x"]["predicted_max_um"] < 0.01
    assert content["unreached_samples"] == {"x": 0, "y": 0}
    together, alone = (content["axes"]["y"][f"reach_{n}_um"] for n in ("together", "alone"))
    assert alone[0] < together[0] < 0.0 < together[1] < alone[1]


def test_path_on_another_grid_is_interpolated(tmp_path, capsys):
    _circle(tmp_path / "path.csv", sample_time_s=130e-6, samples=500)
    assert _call("compensate", "duo_bimorph", tmp_path / "path.csv", "--out", tmp_path / "d.csv") == 0
    assert "interpolated" in capsys.readouterr().out
    times = pd.read_csv(tmp_path / "d.csv", comment="#")["time_s"].to_numpy()
    np.testing.assert_allclose(np.diff(times), T, rtol=1e-9)


def test_partly_out_of_reach_is_refused_unless_asked_for(tmp_path, capsys):
    _circle(tmp_path / "far.csv", x=57.0, y=52.0)
    out = tmp_path / "d.csv"
    assert _call("compensate", "duo_bimorph", tmp_path / "far.csv", "--out", out) == 3
    error = capsys.readouterr().err
    assert "input y stands at its range in" in error
    assert "--clip" in error
    assert not out.exists()
    assert _call("compensate", "duo_bimorph", tmp_path / "far.csv", "--out", out, "--clip", "--json") == 0
    assert json.loads(capsys.readouterr().out)["unreached_samples"]["y"] > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--law", "exact_invers"), "did you mean exact_inverse?"),
        (("--law", "exact_inverse", "--filter-hz", "100"), "--filter-hz"),
        (("--filter-hz", "-1"), "--filter-hz  must be 1e-6 to 1e8, not -1"),
        (("--law", "inverse_multiplicative", "--gain", "big"), "must be auto or identity"),
    ],
)
def test_wrong_options(tmp_path, capsys, arguments, message):
    _circle(tmp_path / "path.csv")
    assert _call("compensate", "duo_bimorph", tmp_path / "path.csv", *arguments) == 2
    assert message in capsys.readouterr().err


def test_wrong_number_of_axes(tmp_path, capsys):
    (tmp_path / "one.csv").write_text("time_s,x\n0,0\n0.1,1\n")
    assert _call("compensate", "duo_bimorph", tmp_path / "one.csv") == 2
    assert "has the columns x; give one for each axis: x, y" in capsys.readouterr().err


def test_columns_are_taken_by_their_names(tmp_path):
    frame = _circle(tmp_path / "path.csv", x=30.0, y=10.0)
    frame[["time_s", "y", "x"]].to_csv(tmp_path / "swapped.csv", index=False)
    for name in ("path", "swapped"):
        out = tmp_path / f"{name}_drive.csv"
        assert _call("compensate", "duo_bimorph", tmp_path / f"{name}.csv", "--out", out) == 0
    assert (tmp_path / "path_drive.csv").read_bytes() == (tmp_path / "swapped_drive.csv").read_bytes()


def test_an_unlimited_model_is_driven_no_further_than_it_was_found(tmp_path, capsys):
    from dataclasses import replace

    from hammerstein.blocks.instruments import Instruments

    model = replace(HammersteinModel.load("duo_bimorph"), instruments=Instruments.ideal())
    model.save(tmp_path / "stage.json")
    _circle(tmp_path / "far.csv", x=70.0, y=40.0)
    command = ("compensate", tmp_path / "stage.json", tmp_path / "far.csv", "--out", tmp_path / "d.csv")
    assert _call(*command) == 3
    assert "out of reach" in capsys.readouterr().err
    assert _call(*command, "--range", "15") == 3
    assert "--beyond-records" in capsys.readouterr().err
    assert not (tmp_path / "d.csv").exists()
    assert _call(*command, "--range", "15", "--beyond-records") == 0


@pytest.mark.parametrize("name", ["path.csv", "."])
def test_input_files_are_not_overwritten(tmp_path, capsys, name):
    _circle(tmp_path / "path.csv")
    before = (tmp_path / "path.csv").read_bytes()
    assert _call("compensate", "duo_bimorph", tmp_path / "path.csv", "--out", tmp_path / name) == 2
    assert "choose another name" in capsys.readouterr().err or name == "."
    assert (tmp_path / "path.csv").read_bytes() == before


def test_the_drive_keeps_the_time_of_the_reference_file(tmp_path):
    time_s = 3.0 + 50e-6 * np.arange(400)
    wave = 10.0 * np.sin(2.0 * np.pi * 50.0 * (time_s - 3.0))
    for name, start in (("late", 0.0), ("early", 3.0)):
        pd.DataFrame({"time_s": time_s - start, "x": wave, "y": 0.5 * wave}).to_csv(
            tmp_path / f"{name}.csv", index=False
        )
    late, early = (
        compensate("duo_bimorph", tmp_path / f"{n}.csv", "exact_inverse", {}) for n in ("late", "early")
    )
    assert late.time_s[0] == pytest.approx(3.0)
    assert early.time_s[0] == 0.0
    assert (late.drive_v == early.drive_v).all()
    assert not late.resampled
    assert late.summary()["statements"] == late.statements()


@pytest.mark.parametrize(("frequency_hz", "proposed"), [(30.0, True), (3000.0, False)])
def test_a_filter_is_proposed_where_the_path_itself_is_left(tmp_path, capsys, frequency_hz, proposed):
    """A slow triangle keeps its shape without its corners; of a fast sine nothing would be left."""
    t = np.arange(2000) * T
    turn = frequency_hz * t
    x = (
        45.0 * (np.abs((turn - 0.25) % 1.0 - 0.5) * 4.0 - 1.0)
        if proposed
        else 15.0 * np.sin(2 * np.pi * turn)
    )
    frame = pd.DataFrame({"time_s": t, "x": x * smooth_step(t / 0.02), "y": 0.0 * t})
    frame.to_csv(tmp_path / "path.csv", index=False)
    assert _call("compensate", "duo_bimorph", tmp_path / "path.csv", "--out", tmp_path / "drive.csv") == 3
    said = capsys.readouterr().err
    assert ("With --filter-hz" in said) == proposed
    assert ("Ask for a smaller or a slower path" in said) != proposed
    assert "output x is missed" in said
    assert "output y is missed" not in said

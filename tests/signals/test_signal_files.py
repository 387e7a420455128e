"""Columns of a path or a drive: their unit and their axis are read, and never guessed against their names."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from hammerstein import HammersteinModel, Scenario, simulate
from hammerstein.commands.cli import main
from hammerstein.errors import InputError, Notice
from hammerstein.signals.signal_files import chosen, read_signal

SAMPLE_TIME_S = 50e-6


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


def path_um(samples=800):
    turn = 2.0 * np.pi * 50.0 * SAMPLE_TIME_S * np.arange(samples)
    grown = np.minimum(1.0, turn / 3.0) ** 2
    return np.array([10.0 * grown * np.sin(turn), 4.0 * grown * (1.0 - np.cos(turn))])


def write(place, **columns):
    """A table with times and these columns."""
    values = next(iter(columns.values()))
    pd.DataFrame({"time_s": SAMPLE_TIME_S * np.arange(len(values)), **columns}).to_csv(place, index=False)
    return place


def drive(tmp_path, **columns):
    """Voltages (input, sample) that ``compensate`` sends for a path with these columns."""
    out = tmp_path / "drive.csv"
    path = write(tmp_path / "path.csv", **columns)
    assert call("compensate", "duo_bimorph_static", path, "--law", "exact_inverse", "--out", out) == 0
    return pd.read_csv(out, comment="#")[["drive_x_v", "drive_y_v"]].to_numpy().T


@pytest.mark.parametrize(
    ("names", "per_um"), [(("x_mm", "y_mm"), 1e-3), (("x [nm]", "y [nm]"), 1e3), (("X (um)", "Y (um)"), 1.0)]
)
def test_a_path_in_another_unit_gives_the_same_voltages(tmp_path, names, per_um):
    x, y = path_um()
    wanted = drive(tmp_path, x=x, y=y)
    found = drive(tmp_path, **dict(zip(names, (x * per_um, y * per_um), strict=True)))
    assert np.abs(wanted).max() > 1.0
    assert np.allclose(found, wanted, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "per_s"), [("time_s", 1.0), ("t [ms]", 1e3), ("Time (us)", 1e6), ("t", 1.0), ("Zeit", 1.0)]
)
def test_time_is_read_in_its_unit(tmp_path, name, per_s):
    seconds = np.array([0.0, 1e-3, 2.5e-3])
    place = tmp_path / "path.csv"
    pd.DataFrame({"x": [1.0, 2.0, 3.0], name: per_s * seconds}).to_csv(place, index=False)
    times, values, names = read_signal(place)
    assert times == pytest.approx(seconds)
    assert values.tolist() == [[1.0, 2.0, 3.0]]
    assert names == ["x"]


@pytest.mark.parametrize("names", [("x", "y"), ("t", "time [s]", "x"), ("time_s", "5")])
def test_a_table_without_one_column_of_time_is_refused(tmp_path, names):
    place = tmp_path / "path.csv"
    pd.DataFrame(np.eye(3)[:, : len(names)], columns=list(names)).to_csv(place, index=False)
    with pytest.raises(InputError, match=r"needs a header with a column time_s .* none of them a number"):
        read_signal(place)


@pytest.mark.parametrize("names", [("y", "x"), ("y_um", "x_um"), ("reference_y_um", "reference_x_um")])
def test_columns_go_to_the_axes_that_they_are_named_after(tmp_path, names):
    x, y = path_um()
    wanted = drive(tmp_path, x=x, y=y)
    found = drive(tmp_path, **dict(zip(names, (y, x), strict=True)))
    assert np.array_equal(found, wanted)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("y", "z"), "has the columns y, z; give one for each axis: x, y"),
        (("x", "x_um"), "has the columns x, x_um; give one for each axis: x, y"),
        (("x_mV", "y_mV"), "column x_mV is in mV, which is not a displacement"),
    ],
)
def test_columns_that_contradict_the_axes_are_refused(tmp_path, capsys, names, said):
    x, y = path_um()
    path = write(tmp_path / "path.csv", **dict(zip(names, (x, y), strict=True)))
    out = tmp_path / "drive.csv"
    assert call("compensate", "duo_bimorph", path, "--out", out) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()


def test_columns_of_other_names_are_taken_in_their_order_and_that_is_told(tmp_path):
    with pytest.warns(Notice, match="in their order: left for x, right for y"):
        assert chosen("path.csv", ["left", "right"], ["x", "y"], "displacement", "reference") == [0, 1]


def test_voltages_in_millivolts_are_played_as_such(tmp_path):
    volts = 0.5 * path_um()
    model = HammersteinModel.load("duo_bimorph")
    wanted = model.simulate(volts, SAMPLE_TIME_S).position_um
    drive_file = write(tmp_path / "drive.csv", **{"y": volts[1], "x [mV]": 1e3 * volts[0]})
    out = tmp_path / "played.csv"
    assert call("play", "duo_bimorph", drive_file, "--out", out) == 0
    played = pd.read_csv(out, comment="#")[["position_x_um", "position_y_um"]].to_numpy().T
    assert np.allclose(played, wanted, rtol=0.0, atol=1e-6)
    _, values, _ = read_signal(drive_file)
    assert np.allclose(values, volts[::-1], rtol=1e-12)


def test_a_drive_of_another_stage_is_named(tmp_path, capsys):
    path = write(tmp_path / "path.csv", **dict(zip("xy", path_um(), strict=True)))
    drive_file, out = tmp_path / "drive.csv", tmp_path / "played.csv"
    assert call("compensate", "duo_bimorph_static", path, "--law", "exact_inverse", "--out", drive_file) == 0
    for model, other in (("duo_bimorph_static", False), ("duo_bimorph", True)):
        capsys.readouterr()
        assert call("play", model, drive_file, "--out", out, "--overwrite") == 0
        said = capsys.readouterr().err
        assert ("another model: Model duo_bimorph_static (duo_bimorph_static)" in said) == other


@pytest.mark.parametrize(
    ("start", "needs"),
    [
        ([], None),
        (["--start", "3,-2"], None),
        (["--start", "3,-2", "--conditioned"], None),
        (["--start", "3,-2", "--conditioned", "--range", "8"], "driven to 8 V, 8 V, then to -8 V, -8 V"),
    ],
)
def test_a_drive_is_played_from_its_own_state_and_another_history_is_named(tmp_path, capsys, start, needs):
    """Played from rest it was off by 14 um from its own prediction, without a word on the terminal."""
    path = write(tmp_path / "path.csv", **dict(zip("xy", path_um(), strict=True)))
    drive_file, out = tmp_path / "drive.csv", tmp_path / "played.csv"
    law = ("--law", "exact_inverse", *start)
    assert call("compensate", "duo_bimorph_static", path, *law, "--out", drive_file) == 0
    capsys.readouterr()
    assert call("play", "duo_bimorph_static", drive_file, "--out", out) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert ("the drive is not made for that" in said) == (needs is not None)
    assert needs is None or needs in said
    drive, played = (pd.read_csv(file, comment="#") for file in (drive_file, out))
    off = np.abs(
        drive[["predicted_x_um", "predicted_y_um"]].to_numpy() - played[["position_x_um", "position_y_um"]]
    )
    assert (off.to_numpy().max() < 1e-6) == (needs is None)


def test_a_record_is_no_path(tmp_path, capsys):
    stage = HammersteinModel.load("duo_bimorph_static")
    named = replace(stage, inputs=("u_x", "u_y"))
    named.save(tmp_path / "stage.json")
    x, y = path_um()
    record = write(tmp_path / "record.csv", u_x=x, u_y=y, x=x, y=y)
    assert call("compensate", tmp_path / "stage.json", record, "--out", tmp_path / "no.csv") == 2
    assert "looks like a record: it holds u_x, u_y too" in capsys.readouterr().err
    path = write(tmp_path / "path.csv", u_x=x, x=x, y=y)  # one voltage makes no record
    asked = ("--law", "exact_inverse", "--out", tmp_path / "drive.csv")
    assert call("compensate", tmp_path / "stage.json", path, *asked) == 0


def scenario(path, **more):
    return Scenario.model_validate(
        {
            "question": "?",
            "actuator": "duo_bimorph_static",
            "reference": {"kind": "file", "path": str(path), **more},
            "compensators": [{"label": "a", "law": "exact_inverse", "model": "duo_bimorph_static"}],
        }
    )


def test_a_file_of_a_scenario_is_read_in_its_unit(tmp_path):
    x, y = path_um()
    wanted = simulate(scenario(write(tmp_path / "um.csv", x=x, y=y)))
    found = simulate(scenario(write(tmp_path / "mm.csv", x_mm=x * 1e-3, y_mm=y * 1e-3)))
    assert np.allclose(found.reference_um, wanted.reference_um, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("y_um", "x_um"), "one for each of x, y, in this order"),
        (("x_V", "y_V"), "is in V, which is not a displacement"),
    ],
)
def test_a_file_of_a_scenario_that_contradicts_the_axes_is_refused(tmp_path, names, said):
    path = write(tmp_path / "path.csv", **dict(zip(names, path_um(), strict=True)))
    with pytest.raises(InputError, match=said):
        simulate(scenario(path))


@pytest.mark.full
def test_a_table_of_more_than_50_megabytes_is_read(tmp_path):
    """A drive of two minutes at 20 kHz has 250 MB, and ``play`` has to read what ``compensate`` wrote."""
    place = write(tmp_path / "drive.csv", x=np.arange(100.0))
    with place.open("a") as file:
        file.writelines("# " + "x" * 999_997 + "\n" for _ in range(60))
    assert place.stat().st_size > 55e6
    _, values, _ = read_signal(place)
    assert values[0].tolist() == list(range(100))


def test_a_table_that_the_memory_does_not_hold_is_refused(tmp_path, monkeypatch):
    place = write(tmp_path / "drive.csv", x=np.arange(100.0))
    monkeypatch.setattr("hammerstein.signals.signal_files.free_bytes", lambda: 1000.0)
    with pytest.raises(InputError, match=r"GB of memory to read, but 1e-06 GB are free; cut it into parts"):
        read_signal(place)

"""A path whose numbers cannot be um is asked about once; what its unit is, is an option or a header."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main
from hammerstein.compensators.path_file import read_path
from hammerstein.model import HammersteinModel

T = 50e-6
RADIUS_UM = 0.05
N = 400


def _call(*words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0


def _write(path, factor, names=("x", "y"), radius_um=RADIUS_UM):
    angle = 2.0 * np.pi * np.arange(N) / N
    columns = (
        np.arange(N) * T,
        factor * radius_um * (np.cos(angle) - 1.0),
        factor * radius_um * np.sin(angle),
    )
    pd.DataFrame(dict(zip(("time_s", *names), columns, strict=True))).to_csv(path, index=False)
    return path


def _reference(path):
    return pd.read_csv(path, comment="#")[["reference_x_um", "reference_y_um"]].to_numpy()


def _drive(path, out, *more):
    return _call("compensate", "duo_bimorph_static", path, "--law", "exact_inverse", "--out", out, *more)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e-3), ("nm", 1e3), ("um", 1.0), ("m", 1e-6)])
def test_a_small_path_is_asked_about_once_and_its_unit_counts(tmp_path, capsys, unit, factor):
    path, out = _write(tmp_path / "path.csv", factor), tmp_path / "drive.csv"
    if unit != "nm":  # 50 nm are 50 um to who does not know better
        assert _drive(path, out) == 2
        assert "x, y have no unit" in (said := capsys.readouterr().err)
        assert "--units nm, um or mm" in said
        assert not out.exists()
    assert _drive(path, out, "--units", unit) == 0
    assert np.abs(_reference(out)).max() == pytest.approx(2.0 * RADIUS_UM, rel=1e-9)
    named = _write(tmp_path / "named.csv", factor, (f"x ({unit})", f"y [{unit}]"))
    assert _drive(named, tmp_path / "named_drive.csv") == 0
    np.testing.assert_allclose(_reference(tmp_path / "named_drive.csv"), _reference(out), atol=1e-9)


def test_a_path_far_above_the_travel_is_asked_about(tmp_path, capsys):
    path = _write(tmp_path / "path.csv", 1e3, radius_um=20.0)
    assert _drive(path, tmp_path / "drive.csv") == 2
    assert "in um the path goes to 4e+04 um, but the model travels" in capsys.readouterr().err
    path = _write(tmp_path / "path.csv", 1.0, radius_um=150.0)  # more than it travels, less than ten times
    assert _drive(path, tmp_path / "drive.csv") == 3
    assert "check its unit: the path goes to 300 um, slow paths reach" in capsys.readouterr().err


def test_inches_are_inches(tmp_path):
    path, out = _write(tmp_path / "path.csv", 1.0 / 25_400.0, ("x_inch", "y_inch")), tmp_path / "drive.csv"
    assert _drive(path, out) == 0
    assert np.abs(_reference(out)).max() == pytest.approx(2.0 * RADIUS_UM, rel=1e-9)


def test_a_period_has_the_unit_of_its_option(tmp_path, capsys):
    path, out = _write(tmp_path / "path.csv", 1e-3), tmp_path / "drive.csv"
    assert _drive(path, out, "--cycle") == 2
    assert "--units" in capsys.readouterr().err
    assert _drive(path, out, "--cycle", "--units", "mm") == 0
    assert np.ptp(_reference(out)[:, 0]) == pytest.approx(2.0 * RADIUS_UM, rel=1e-9)


def test_a_unit_that_the_columns_contradict_or_nobody_knows_is_refused(tmp_path, capsys):
    path, out = _write(tmp_path / "path.csv", 1.0, ("x_um", "y_um"), 5.0), tmp_path / "drive.csv"
    assert _drive(path, out, "--units", "nm") == 2
    assert "name their units: x_um, y_um" in capsys.readouterr().err
    assert _drive(_write(path, 1.0), out, "--units", "ell") == 2
    assert "--units: 'ell' is not one of um, nm" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["record.csv", "record.npy"])
def test_a_record_given_as_a_model_names_what_makes_one(tmp_path, capsys, name):
    (tmp_path / name).write_bytes(b"\x93NUMPY" if name.endswith("npy") else b"time_s,x\n0,1\n")
    path = _write(tmp_path / "path.csv", 1.0, ("x_um", "y_um"))
    assert _call("compensate", tmp_path / name, path, "--out", tmp_path / "drive.csv") == 2
    assert "hammerstein identify RECORD --out model.json" in capsys.readouterr().err


def test_a_drive_names_the_model_and_the_records_it_came_from(tmp_path, capsys):
    """So that a drive for another stage is seen before it is sent."""
    model = HammersteinModel.load("duo_bimorph_static")
    origin = {"records": ["left_stage_x.csv", "left_stage_y.csv"]}
    replace(model, name="left stage", provenance=origin).save(tmp_path / "model.json")
    path, out = _write(tmp_path / "path.csv", 1.0, ("x_um", "y_um"), 5.0), tmp_path / "drive.csv"
    assert _call("compensate", tmp_path / "model.json", path, "--law", "exact_inverse", "--out", out) == 0
    words = "left stage, from left_stage_x.csv, left_stage_y.csv"
    assert words in capsys.readouterr().out
    assert words in out.read_text()


@pytest.mark.parametrize(("cell", "what"), [("nan", "has no number"), ("2e12", "is 2e+12, beyond 1e+09")])
def test_a_cell_without_a_position_is_named_with_its_remedy(tmp_path, capsys, cell, what):
    path = _write(tmp_path / "path.csv", 1.0)
    lines = path.read_text().splitlines()
    lines[7] = f"{lines[7].split(',')[0]},{cell},0.0"
    path.write_text("\n".join(lines))
    assert _drive(path, tmp_path / "drive.csv") == 2
    assert f"column x, row 8  {what}; correct it, or remove the row" in capsys.readouterr().err


def test_a_period_of_larger_steps_has_its_length(tmp_path):
    """The first row follows the last one a step later, whatever the sample time of the drive."""
    model = HammersteinModel.load("duo_bimorph")
    for rows in (160, 200, 400):
        turn = 2.0 * np.pi * np.arange(rows) / rows
        table = np.stack([0.02 * np.arange(rows) / rows, np.cos(turn), np.sin(turn)], axis=1)
        np.savetxt(tmp_path / "p.csv", table, delimiter=",", header="time_s,x_um,y_um", comments="")
        _, path, _ = read_path(tmp_path / "p.csv", model, 50e-6, periodic=True)
        expected = np.cos(2.0 * np.pi * np.arange(400) / 400)
        np.testing.assert_allclose(path[0], expected, atol=0.5 * (2.0 * np.pi / rows) ** 2 / 4)

"""A decaying alternation leaves half of a step from peak to peak in each play, whatever came before."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
import theory

import hammerstein
from hammerstein.commands.cli import main
from hammerstein.model import HammersteinModel
from hammerstein.signals import Degauss


def _call(*words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code or 0


@pytest.mark.parametrize("cycles", [5, 40])
@pytest.mark.parametrize("before_v", [-10.0, 7.0, 10.0])
def test_a_play_forgets_all_but_half_a_step(cycles, before_v):
    signal = Degauss(amplitude=10.0, frequency_hz=1.0, cycles=cycles, axis="all")
    u = signal.sample(np.linspace(0.0, cycles + 2.0, 2000 * (cycles + 2)), 1)[0]
    assert u[-1] == 0.0
    for r in (0.4, 1.7, 3.3, 9.2):
        p = theory.play(np.concatenate([[before_v], u]), r)
        assert abs(p[-1]) <= 10.0 / (4.0 * cycles) + 1e-3


def test_a_scenario_and_the_command_take_as_many_cycles(tmp_path, capsys):
    assert _call("degauss", "duo_bimorph_static", "--out", tmp_path / "drive.csv") == 0
    assert f" {Degauss(amplitude=1.0, frequency_hz=1.0).cycles} falling periods" in capsys.readouterr().out


def test_without_a_number_of_cycles_a_part_in_160_of_the_amplitude_is_left_at_most():
    signal = Degauss(amplitude=160.0, frequency_hz=1.0, axis="all")
    u = signal.sample(np.linspace(0.0, signal.period_s, 16401), 1)[0]
    kept = [abs(theory.play(u, r)[-1]) for r in np.linspace(20.0, 24.0, 41)]
    assert 0.9 < max(kept) <= 1.0


def test_the_drive_of_the_command_erases_the_history(tmp_path, capsys):
    out = tmp_path / "degauss.csv"
    words = ("degauss", "duo_bimorph_static", "--cycles", "50", "--frequency", "20", "--out", out)
    assert _call(*words, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    drive = pd.read_csv(out, comment="#")[["drive_x_v", "drive_y_v"]].to_numpy().T
    assert np.abs(drive).max() <= 10.0
    assert (drive[:, -1] == 0.0).all()
    model = HammersteinModel.load("duo_bimorph_static")
    ends = [
        model.hysteresis.respond(np.hstack([np.full((2, 1), end), drive]))[0][:, -1] for end in (-10.0, 10.0)
    ]
    weights = np.array([sum(np.abs(row).sum() for row in rows) for rows in model.hysteresis.weights])
    assert (np.abs(ends[1] - ends[0]) <= 10.0 / (2.0 * 50) * weights).all()
    np.testing.assert_allclose(found["after_um"], np.abs(ends[1] - ends[0]), atol=1e-9)
    assert (np.array(found["after_um"]) < 0.05 * np.array(found["before_um"])).all()


def test_a_one_sided_range_is_erased_about_its_middle(tmp_path, capsys):
    words = ("degauss", "duo_bimorph_static", "--range", "0,10", "--out", tmp_path / "d.csv")
    assert _call(*words) == 0
    assert "about 5 V on x, 5 V on y" in (said := capsys.readouterr().out)
    assert "not at the working point" in said
    drive = pd.read_csv(tmp_path / "d.csv", comment="#")["drive_x_v"].to_numpy()
    assert drive[0] == 0.0
    assert drive[-1] == 5.0
    assert drive.min() >= 0.0


def test_voltages_beyond_the_records_are_refused_until_they_are_accepted(tmp_path, capsys):
    """The packaged model is known up to 10 V."""
    model = HammersteinModel.load("duo_bimorph_static")
    wide = model.instruments.drive.model_copy(update={"range_v": (-40.0, 40.0)})
    instruments = model.instruments.model_copy(update={"drive": wide})
    dataclasses.replace(model, instruments=instruments).save(tmp_path / "wide.json")
    words = ("degauss", tmp_path / "wide.json", "--range=-20,30", "--out", tmp_path / "d.csv")
    assert _call(*words) == 3
    assert "accept it with --beyond-records" in capsys.readouterr().err
    assert not (tmp_path / "d.csv").exists()
    assert _call(*words, "--beyond-records") == 0


def test_a_frequency_that_the_converter_cannot_give_is_refused(tmp_path, capsys):
    assert _call("degauss", "duo_bimorph_static", "--frequency", "9000", "--out", tmp_path / "d.csv") == 2
    assert "--frequency: must be at most 1000 Hz" in capsys.readouterr().err


def test_a_scenario_runs_it_once():
    drive = {"kind": "degauss", "amplitude_v": 10.0, "frequency_hz": 50.0, "cycles": 20, "axis": "all"}
    report = hammerstein.run({"question": "?", "actuator": "duo_bimorph_static", "drive": drive})
    assert len(report.rows) == 2

"""What used to go wrong in silence, or with a traceback, is one message with its exit code."""

import json
import os
import re

import numpy as np
import pytest

from hammerstein.commands.cli import main
from hammerstein.model import HammersteinModel

DRIVE = """
question = "How large is the loop?"
actuator = "{actuator}"
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
"""


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


@pytest.fixture
def run(tmp_path, capsys):
    """Run the text of a scenario; exit code and what was said."""

    def call(text, *options, command="run"):
        path = tmp_path / "s.toml"
        path.write_text(text)
        more = ["--no-figures", "--out", tmp_path / "reports"] if command == "run" else []
        code = _call(command, path, *more, *options)
        output = capsys.readouterr()
        assert "Traceback" not in output.err
        return code, output.err + output.out

    return call


def _linear_model(tmp_path, a, sample_time_s=None, **more):
    content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    content["dynamics"] = {"kind": "state_space", "A": [[a]], "B": [[1.0, 0.0]], "C": [[1.0], [0.0]],
                           "D": [[1.0, 0.0], [0.0, 1.0]], **more}  # fmt: skip
    if sample_time_s:
        content["dynamics"]["sample_time_s"] = sample_time_s
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("a", "sample_time_s", "pole"), [(50.0, None, "50"), (2.0, 50e-6, "2"), (1.0, 50e-6, "1")]
)
def test_an_unstable_model_is_refused_on_loading(run, tmp_path, a, sample_time_s, pole):
    path = _linear_model(tmp_path, a, sample_time_s)
    code, said = run(DRIVE.format(actuator=path.name))
    assert code == 2
    assert "dynamics.A" in said
    assert "is not stable" in said
    assert pole in said
    assert "allow_unstable" in said


def test_an_unstable_model_that_is_allowed_ends_with_3_and_no_baseline(run, tmp_path):
    path = _linear_model(tmp_path, 2.0, 50e-6, allow_unstable=True)
    code, said = run(DRIVE.format(actuator=path.name))
    assert code == 3
    assert re.search(r"hysteresis|position of axis 1 reaches .* um after", said)
    code, _ = run(
        DRIVE.format(actuator=path.name), "--update-baseline", "--baseline", tmp_path / "b", command="check"
    )
    assert code == 3
    assert not (tmp_path / "b").exists()


def test_a_model_beside_the_actuator_may_not_leave_all_bounds_either(run, tmp_path):
    path = _linear_model(tmp_path, 2.0, 50e-6, allow_unstable=True)
    text = DRIVE.format(actuator="duo_bimorph") + f'[[models]]\nlabel = "wild"\nmodel = "{path.name}"\n'
    code, said = run(text)
    assert code == 3
    assert "prediction of" in said


def test_a_cut_reading_gets_a_statement_of_its_own(run, tmp_path):
    text = DRIVE.format(actuator="duo_bimorph") + "[instruments.sensor]\nrange_um = 20\n"
    assert run(text)[0] == 0
    report = (tmp_path / "reports/s/report.md").read_text()
    assert "The sensor's range clipped " in report
    statements = json.loads((tmp_path / "reports/s/report.json").read_text())["statements"]
    assert any(
        "the sensor's range clipped" in statement and "range_um" in statement for statement in statements
    )
    text = DRIVE.format(actuator="duo_bimorph")
    assert run(text)[0] == 0
    assert "sensor's range clipped" not in (tmp_path / "reports/s/report.md").read_text()


def test_a_compensator_that_is_never_tested_is_a_mistake(run):
    text = """
question = "?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[[compensators]]
label = "never"
law = "none"
model = "duo_bimorph"
only_at_hz = [51]
"""
    code, said = run(text)
    assert code == 2
    assert "there is no run at 51 Hz" in said
    assert "the frequencies of this scenario are 50" in said


def test_inputs_and_outputs_may_have_other_names(run, tmp_path):
    content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json()) | {"inputs": ["u_x", "u_y"]}
    (tmp_path / "named.json").write_text(json.dumps(content))
    code, said = run(DRIVE.format(actuator="named.json"))
    assert code == 0
    assert "(drive in V)" in said


@pytest.mark.parametrize("change", ["amplitude_v = 0.0001", "amplitude_v = 1\noffset_v = 500"])
def test_a_drive_that_the_converter_leaves_still_is_out_of_reach(run, change):
    code, said = run(DRIVE.format(actuator="duo_bimorph").replace("amplitude_v = 10", change))
    assert code == 3
    assert "the drive is constant at" in said
    assert "at -0 V" not in said


@pytest.mark.full
def test_identification_at_a_low_frequency_is_told_as_what_it_is(run):
    text = """
question = "?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[[compensators]]
label = "slow"
law = "exact_inverse"
identification = { method = "hammerstein", frequencies_hz = [5] }
"""
    code, said = run(text)
    assert code in (0, 4)
    assert "internal" not in said


def test_plot_wants_one_scenario(tmp_path, capsys):
    (tmp_path / "a.toml").write_text(DRIVE.format(actuator="duo_bimorph"))
    (tmp_path / "b.toml").write_text(DRIVE.format(actuator="duo_bimorph"))
    assert _call("plot", tmp_path, "--out", tmp_path) == 2
    assert "is a folder; give one scenario file" in capsys.readouterr().err


def test_a_fault_of_ours_is_one_line_a_code_of_its_own_and_a_file(run, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "t"))
    (tmp_path / "t").mkdir()

    def broken(*_):
        raise ZeroDivisionError("a fault put in by a test")

    monkeypatch.setattr("hammerstein.experiment.case_cache.rows_of", broken)
    code, said = run(DRIVE.format(actuator="duo_bimorph"))
    assert code == 70
    (line,) = [line for line in said.splitlines() if "internal error" in line]
    (file,) = (tmp_path / "t").iterdir()
    assert str(file) in line
    assert "a fault put in by a test" in line
    assert "in broken" in file.read_text()
    monkeypatch.setattr("hammerstein.experiment.run.load_all", broken)
    code, said = run(DRIVE.format(actuator="duo_bimorph"))
    assert (code, said.count("\n")) == (70, 1)


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="needs a user whom permissions bind")
def test_a_folder_that_may_not_be_entered(tmp_path, capsys):
    folder = tmp_path / "closed"
    folder.mkdir()
    (folder / "s.toml").write_text(DRIVE.format(actuator="duo_bimorph"))
    folder.chmod(0o600)
    try:
        assert _call("run", folder / "s.toml") == 2
    finally:
        folder.chmod(0o700)
    assert str(folder) in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "check", "plot"])
def test_a_name_that_is_too_long_is_one_message(command, capsys):
    assert _call(command, "n" * 3000 + ".toml") == 2
    output = capsys.readouterr().err
    assert "too long" in output or "does not exist" in output


def test_no_figure_leaves_a_run_that_is_not_finite():
    from hammerstein.metrics import Row

    row = Row("a", "x", "x", 50.0, figures={"rms_um": 1.0, "gain": float("nan")})
    assert row.not_finite() == "gain"
    assert Row("a", "x", "x", 50.0, figures={"rms_um": 1.0}).not_finite() == ""


def test_bounds_of_wires():
    from hammerstein.errors import SimulationError
    from hammerstein.model.simulation import refuse_unbounded

    wire = np.zeros((2, 100))
    refuse_unbounded("position_um", wire, 1e-3)
    for value in (np.nan, np.inf, -1e10):
        wire[1, 70] = value
        with pytest.raises(SimulationError, match=r"position of axis 2 reaches .* um after 0\.07 s"):
            refuse_unbounded("position_um", wire, 1e-3)

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main

SMALL = """
question = "How round is a small circle?"
actuator = "duo_bimorph"
[reference]
kind = "circle"
radius_um = 15
frequency_hz = 50
[[compensators]]
label = "paper"
law = "inverse_multiplicative"
identification = { frequency_hz = 50 }
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "small.toml").write_text(SMALL)
    return tmp_path


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    return caught.value.code or 0


def test_run_writes_a_report(folder, capsys):
    assert _call("run", "scenarios", "--no-figures") == 0
    output = capsys.readouterr()
    assert "small" in output.out
    assert "paper" in output.out
    assert [line for line in output.err.splitlines() if not line.startswith("compiling ")] == []
    report = folder / "reports" / "small"
    assert {".hammerstein.json", "report.html", "report.json", "report.md", "rms.csv"} == {
        p.name for p in report.iterdir()
    }
    table = pd.read_csv(report / "rms.csv")
    wanted = {"compensator", "excited_axis", "measured_axis", "frequency_hz", "rms_um", "max_um"}
    assert wanted <= set(table.columns)
    assert table["measured_axis"].tolist() == ["x", "y"]
    assert table["rms_um"].notna().all()


CUT = """
question = "What does a small range clipped of a path from a file?"
actuator = "duo_bimorph"
instruments = { drive = { range_v = [-2, 2] } }
[reference]
kind = "file"
path = "path.csv"
[[compensators]]
label = "fast"
law = "hammerstein_inverse"
model = "duo_bimorph"
"""


@pytest.mark.full
def test_the_table_counts_a_cut_sample_once_and_names_no_frequency_of_a_file(folder, capsys):
    t = 50e-6 * np.arange(4000)
    path = 7.0 * np.sin(2.0 * np.pi * 450.0 * t)
    pd.DataFrame({"time_s": t, "x": path, "y": 0.8 * path}).to_csv(folder / "path.csv", index=False)
    (folder / "cut.toml").write_text(CUT)
    assert _call("run", "cut.toml", "--no-figures") == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if " fast " in line)
    table, report = pd.read_csv("reports/cut/rms.csv"), Path("reports/cut/report.md").read_text()
    (samples,) = set(table["saturated_samples"])
    assert len(table) == 2
    assert samples > 0
    assert line.split()[:2] == ["cut", "fast"]
    assert line.split()[-1] == str(samples)
    assert len(line.split()) == 6  # no frequency
    assert f"fast, all axes: the drive's range clipped {samples} samples" in report


def test_two_runs_write_the_same_bytes(folder):
    assert _call("run", "scenarios", "--no-figures", "--out", "a") == 0
    assert _call("run", "scenarios", "--no-figures", "--out", "b", "--jobs", "1") == 0
    for name in ("report.json", "report.md", "rms.csv"):
        assert (folder / "a/small" / name).read_bytes() == (folder / "b/small" / name).read_bytes()


def test_json_is_one_object(folder, capsys):
    assert _call("run", "scenarios", "--no-figures", "--json") == 0
    content = json.loads(capsys.readouterr().out)
    assert [report["name"] for report in content["reports"]] == ["small"]
    assert content["errors"] == []


@pytest.mark.parametrize("kind", ["csv", "mat"])
def test_traces_hold_every_wire(folder, kind):
    assert _call("run", "scenarios", "--no-figures", "--traces", kind) == 0
    (file,) = (folder / "reports/small/traces").iterdir()
    if kind == "csv":
        table = pd.read_csv(file)
    else:
        from scipy.io import loadmat

        table = {k: v.ravel() for k, v in loadmat(file).items() if not k.startswith("__")}
    wires = ["time_s", "reference_x_um", "requested_x_v", "drive_y_v", "hysteresis_x_um", "position_x_um"]
    for name in [*wires, "reading_y_um"]:
        assert len(table[name]) == 800
    assert abs(table["position_x_um"][0] - 15) < 5.0


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        (("radius_um", "radus_um"), 2, "did you mean radius_um?"),
        (("radius_um = 15", "radius_um = -15"), 2, "must be 1e-6 to 1e6, not -15"),
        (("frequency_hz = 50\n[[", "frequency_hz = 10000\n[["), 2, "half the sample rate"),
        (("radius_um = 15", "radius_um = 70"), 3, "needs 70 um"),
        (('"inverse_multiplicative"', '"inverse_multiplicative"\ngain = "identity"'), 3, "does not converge"),
        (("frequency_hz = 50 }", "frequency_hz = 900 }"), 4, "too few"),
        (('"duo_bimorph"', '"missing.json"'), 2, "no such file"),
    ],
)
def test_mistakes_are_one_message_and_an_exit_code(folder, capsys, change, code, message):
    path = folder / "scenarios" / "small.toml"
    assert change[0] in SMALL
    path.write_text(SMALL.replace(*change, 1))
    assert _call("run", str(path), "--no-figures") == code
    output = capsys.readouterr()
    assert message in output.err
    assert "Traceback" not in output.err
    assert not (folder / "reports" / "small").exists()


def test_one_bad_scenario_does_not_stop_the_others(folder, capsys):
    (folder / "scenarios" / "far.toml").write_text(SMALL.replace("radius_um = 15", "radius_um = 70"))
    assert _call("run", "scenarios", "--no-figures", "--jobs", "1") == 3
    assert (folder / "reports" / "small" / "report.json").exists()
    assert "far: the reference needs 70 um" in capsys.readouterr().err


def test_every_file_is_read_before_the_first_is_run(folder, capsys):
    (folder / "scenarios" / "wrong.toml").write_text("question = 1")
    (folder / "scenarios" / "empty.toml").write_text("")
    assert _call("run", "scenarios") == 2
    error = capsys.readouterr().err
    assert "wrong.toml" in error
    assert "empty.toml" in error
    assert not (folder / "reports").exists()


def test_missing_path_and_empty_folder(folder, capsys):
    assert _call("run", "nowhere.toml") == 2
    (folder / "nothing").mkdir()
    assert _call("run", "nothing") == 2
    error = capsys.readouterr().err
    assert "nowhere.toml: does not exist" in error
    assert "nothing: holds no scenario" in error


def test_unwritable_output(folder, capsys):
    (folder / "file").write_text("")
    assert _call("run", "scenarios", "--no-figures", "--out", "file") == 2
    assert "file is a file, not a folder; choose another place" in capsys.readouterr().err


def test_schema_is_one_that_validators_accept(capsys):
    assert _call("schema") == 0
    schema = json.loads(capsys.readouterr().out)
    assert "question" in schema["required"]
    assert "radius_um" in schema["$defs"]["CircleUm"]["properties"]


def test_actuators_are_listed(capsys):
    assert _call("actuators") == 0
    assert "duo_bimorph_resonant" in capsys.readouterr().out
    assert _call("actuators", "--json") == 0
    assert len(json.loads(capsys.readouterr().out)) >= 3


def test_check_fails_without_baseline_then_passes_then_sees_a_change(folder, capsys):
    assert _call("check", "scenarios") == 1
    assert _call("check", "scenarios", "--update-baseline") == 0
    assert _call("check", "scenarios", "--junit", "out/junit.xml", "--markdown", "out/check.md") == 0
    assert (folder / "out/junit.xml").read_text().startswith("<?xml")
    path = folder / "scenarios" / "small.toml"
    path.write_text(SMALL.replace("radius_um = 15", "radius_um = 16"))
    assert _call("check", "scenarios") == 1
    assert "scenario" in capsys.readouterr().out


@pytest.mark.full
@pytest.mark.parametrize("wait_s", [2.0, *(pytest.param(s, marks=pytest.mark.long) for s in (1.0, 3.0))])
def test_ctrl_c_while_the_processes_begin_is_quiet(folder, wait_s):
    for k in range(4):
        (folder / "scenarios" / f"s{k}.toml").write_text(SMALL)
    command = [sys.executable, "-m", "hammerstein", "run", "scenarios", "--jobs", "2"]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, **options) as process:
        time.sleep(wait_s)
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode in (130, 0)  # it may have been quicker
    assert "Traceback" not in error
    assert "Exception" not in error


@pytest.mark.parametrize("jobs", ["1", "2"])
@pytest.mark.full
def test_ctrl_c_keeps_what_is_finished_and_leaves_no_half_file(folder, jobs):
    many = ", ".join(str(5 + 0.01 * i) for i in range(3000))
    slow = SMALL.replace("[[", f"[sweep]\nfrequency_hz = [{many}]\n[[", 1)
    (folder / "scenarios" / "tardy.toml").write_text(slow)  # after the small one, which is finished first
    command = [sys.executable, "-m", "hammerstein", "run", "scenarios", "--no-figures", "--jobs", jobs]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, **options) as process:
        done = folder / "reports" / "small" / "report.json"
        deadline = time.monotonic() + 300  # the time loops may have to be compiled first
        while not done.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.2)
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in error
    assert "Traceback" not in error
    files = [p for p in (folder / "reports").rglob("*") if p.is_file()]
    assert not [p for p in files if p.parent.name == "tardy"]
    assert all(p.name == ".hammerstein.json" or not p.name.startswith(".") for p in files)
    json.loads(done.read_text())

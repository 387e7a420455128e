"""What a person without a clone has: a working folder, words on files, voltages on a model, help."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import Result
from typer.testing import CliRunner

from hammerstein.commands.cli import app, main
from hammerstein.model import HammersteinModel
from hammerstein.records.readers import array_columns
from hammerstein.regression.compare import Baseline
from hammerstein.runtime.staging import Manifest

KEPT_MB = "100"
COMMANDS = [command.name or command.callback.__name__ for command in app.registered_commands]


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("start") / "my stage"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAMMERSTEIN_CACHE_MB", KEPT_MB)
        assert call("init", folder) == 0
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the working folder, in which a command may do what it likes."""
    place = tmp_path / "here"
    shutil.copytree(made, place)
    monkeypatch.chdir(place)
    return place


@pytest.mark.parametrize("options", [[], ["--of", "paper"]])
@pytest.mark.parametrize("linked", [True, False])
def test_init_writes_nothing_past_what_stands_in_the_way_of_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], linked: bool
) -> None:
    target, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    target.mkdir()
    elsewhere.mkdir()
    if linked:
        (target / "reports").symlink_to(elsewhere)
    else:
        (target / "reports").write_text("mine")
    assert call("init", target, *options) == 2
    assert "already holds reports" in capsys.readouterr().err
    assert [path.name for path in target.iterdir()] == ["reports"]
    assert not list(elsewhere.iterdir())


def test_an_init_that_fails_in_the_middle_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    target, replace = tmp_path / "new" / "here", os.replace

    def full(source: Path, place: Path) -> None:
        if Path(place).name == "static_inverse.json":
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(source, place)

    monkeypatch.setattr("os.replace", full)
    assert call("init", target, "--of", "paper") == 2
    assert f"{target}: cannot be written (no space left on device)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def commands_of(page: Path) -> list[str]:
    blocks = re.findall(r"^```\n(.*?)^```$", page.read_text(), flags=re.M | re.S)
    return [line for block in blocks for line in block.splitlines()]


@pytest.mark.full
def test_every_command_of_the_page_that_init_writes_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identifying gives the model that lies there, but for rounding; results are kept, as for a person."""
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", KEPT_MB)
    before = HammersteinModel.load("stage.json")
    commands = commands_of(folder / "README.md")
    assert len(commands) >= 7
    for command in commands:
        drawn = ["--no-figures"] if " identify " in command else []  # init has drawn the same
        assert call(*shlex.split(command)[1:], *drawn) == 0, command
    again = HammersteinModel.load("stage.json").hysteresis.gain(10.0)
    assert again == pytest.approx(before.hysteresis.gain(10.0), rel=2e-3, abs=2e-3)  # as of another processor
    own = HammersteinModel.load("duo_bimorph").hysteresis.gain(10.0)
    assert before.hysteresis.gain(10.0) == pytest.approx(own, abs=0.05)


def test_what_init_makes_is_the_person_s_own_but_for_the_model(folder: Path) -> None:
    """A file in the manifest may be replaced by a command; the scenario and the records may not."""
    assert Manifest.read(folder).files.keys() == {"stage.json"}
    assert "report.html" in Manifest.read(folder / "reports/circle").files


def test_nothing_is_ever_written_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere/path.csv").write_text("mine")
    for target in (folder, folder / "elsewhere"):
        before = {path: path.read_bytes() for path in target.rglob("*") if path.is_file()}
        assert call("init", target) == 2
        assert re.search("already holds .*path.csv", capsys.readouterr().err)
        assert {path: path.read_bytes() for path in target.rglob("*") if path.is_file()} == before


def test_the_paper_comes_with_its_accepted_numbers(tmp_path: Path) -> None:
    assert call("init", tmp_path / "paper", "--of", "paper") == 0
    names = {path.stem for path in (tmp_path / "paper").glob("*.toml")}
    held = {path.stem for path in (tmp_path / "paper/reports/baseline").glob("*.json")}
    assert names == held == {path.stem for path in (Path(__file__).parents[2] / "scenarios").glob("*.toml")}
    assert call("init", tmp_path / "paper", "--of", "paper") == 2


def test_init_of_something_unknown_names_what_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("init", tmp_path / "new", "--of", "papr") == 2
    assert "--of: nothing is available for 'papr'; give one of paper" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_play_does_what_compensate_predicts(folder: Path) -> None:
    assert call("compensate", "stage.json", "path.csv", "--out", "drive.csv") == 0
    assert call("play", "stage.json", "drive.csv", "--out", "played.csv") == 0
    drive, played = (pd.read_csv(name, comment="#") for name in ("drive.csv", "played.csv"))
    for axis in "xy":
        predicted = drive[f"predicted_{axis}_um"].to_numpy()
        assert played[f"position_{axis}_um"].to_numpy() == pytest.approx(predicted, abs=1e-9)
        voltages = drive[f"drive_u_{axis}_v"].to_numpy()  # older pandas is off in the last bit
        assert played[f"played_u_{axis}_v"].to_numpy() == pytest.approx(voltages, rel=1e-12, abs=1e-14)


def test_play_reads_plain_columns_and_adds_the_sensor(folder: Path) -> None:
    time_s = 50e-6 * np.arange(400)
    table = {"time_s": time_s, "first": 5.0 * np.sin(300.0 * time_s), "second": 0.0 * time_s}
    pd.DataFrame(table).to_csv("plain.csv", index=False)
    assert call("play", "duo_bimorph", "plain.csv", "--sensor") == 0
    found = pd.read_csv("played.csv", comment="#")
    wanted = HammersteinModel.load("duo_bimorph")
    response = wanted.simulate(
        np.vstack([table["first"], table["second"]]), 50e-6, instruments=wanted.instruments
    )
    assert found["reading_x_um"].to_numpy() == pytest.approx(response.reading_um[0], abs=1e-9)


@pytest.mark.parametrize(("top_v", "told"), [(9.9, False), (12.0, True)])
def test_play_says_where_voltages_leave_the_records(
    folder: Path, capsys: pytest.CaptureFixture[str], top_v: float, told: bool
) -> None:
    """The records of the stage cover -10 to 10 V."""
    pd.DataFrame({"time_s": [0.0, 1e-3, 2e-3], "u_x": [0.0, top_v, 0.0], "u_y": 0.0}).to_csv(
        "far.csv", index=False
    )
    assert call("play", "stage.json", "far.csv") == 0
    assert ("1 of 3 samples are outside" in capsys.readouterr().err) is told


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("time_s,a\n0,1\n1,2\n", "has the columns a; give one for each axis: u_x, u_y"),
        ("time_s,a,b\n0,1,1\n1,2,2\n5,0,0\n", "not evenly spaced: row 2"),
        (
            "time_s,a,b\n0,1,1\n1,2,2\n2,0,0\n20,1,1\n",
            "row 4 comes after 18 s, most rows after 1 s; resample it",
        ),
        ("a,b\n0,1\n", "needs a header with a column time_s"),
        ("time,a\n", "no numbers below it"),
        ("time_s,x,y\n0,1,1\n1,2,2\n", "bad.csv: has the columns of a path, not of voltages; compute"),
    ],
)
def test_play_says_what_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str], table: str, message: str
) -> None:
    Path("bad.csv").write_text(table)
    assert call("play", "stage.json", "bad.csv") == 2
    assert message in capsys.readouterr().err
    assert not Path("played.csv").exists()


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("stage.json", ["model", "u_x, u_y", "recorded"]),
        ("circle.toml", ["scenario", "How far", "hysteresis and dynamics", "20, 50, 100"]),
        ("record_x.csv", ["6000", "u_x", "-10 to 10"]),
        ("stage_fit/fit.json", ["fit report", "record_x.csv"]),
        ("reports/circle/report.json", ["report", "How far"]),
        ("reports/baseline/circle.json", ["baseline", "rows"]),
        ("duo_bimorph", ["model", "15 operators", "279.7 Hz"]),
    ],
)
def test_show_tells_what_a_file_holds(
    folder: Path, capsys: pytest.CaptureFixture[str], file: str, words: list[str]
) -> None:
    assert call("show", file) == 0
    printed = capsys.readouterr().out
    assert [word for word in words if word not in printed] == []
    assert call("show", file, "--json") == 0


REPORT = {
    "format": "hammerstein-report/1",
    "name": "a",
    "actuator": "b",
    "scenario": {"question": "?"},
    "rows": [],
    "verdicts": [{"verdict": "met"}, {"verdict": "not met"}, {"verdict": "met"}],
}


def test_show_counts_what_is_met(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("claims.json").write_text(json.dumps(REPORT))
    assert call("show", "claims.json") == 0
    assert "2 of 3 claims met" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("no.json", "{", "is not JSON"),
        ("no.npz", "no archive", "cannot be read as a .npz file (it contains other things than numbers)"),
        ("digits.json", "9" * 5000, "is not JSON: Exceeds the limit (4300 digits)"),
        ("other.json", "{}", "is not a model"),
        ("twice.json", '{"a": [{"b": 1, "b": 2}]}', "contains the key 'b' twice in one object; delete one"),
        ("none.csv", None, "does not exist"),
        ("none.npz", None, "does not exist"),
        ("report.html", "<p>1 2 3", "is a page for reading"),
        ("report.json", json.dumps(REPORT | {"rows": 3}), "rows  must be a list"),
        ("asked.json", json.dumps(REPORT | {"scenario": [1]}), "scenario  must be a table"),
        ("claims.json", json.dumps(REPORT | {"verdicts": [1]}), "verdicts[1]  must be a table"),
        ("baseline.json", '{"format": "hammerstein-baseline/1", "rows": null}', "rows  must be a list"),
        ("fit.json", '{"held_records": 5}', "held_records  must be a list"),
        ("comparison.json", '{"format": "hammerstein-comparison/1", "models": [5]}', "models[1]  must be a"),
    ],
)
def test_show_says_what_is_wrong(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, text: str | None, told: str
) -> None:
    if text is not None:
        Path(name).write_text(text)
    assert call("show", name) == 2
    error = capsys.readouterr().err
    assert name in error
    assert told in re.sub("  +", "  ", error)
    assert "sys." not in error


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with a name here")
@pytest.mark.parametrize("command", ["show", "loops"])
def test_a_pipe_is_not_waited_for(folder: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    if not Path("pipe.csv").exists():
        os.mkfifo("pipe.csv")
    columns = ["--inputs", "1", "--outputs", "2", "--rate", "9"] if command == "loops" else []
    assert call(command, "pipe.csv", *columns) == 2
    assert "pipe.csv: is not a regular file" in capsys.readouterr().err


def help_of(*command: str) -> Result:
    return CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": "80"})


LENGTHY = ("compare", "identify")  # the lines of guide and fixtures are run, too


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in LENGTHY else n for n in COMMANDS]
)
@pytest.mark.full
def test_every_help_has_one_example_that_works_as_typed(
    name: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = help_of(name).output
    (example,) = re.findall(r"^ *Example: (hammerstein .*)$", told, flags=re.M)
    words = shlex.split(example.partition(" > ")[0])
    assert words[1] == name
    if name == "play":
        assert call("compensate", "stage.json", "path.csv") == 0
    assert call(*words[1:]) == 0, capsys.readouterr().err


@pytest.mark.full
def test_quiet_prints_what_is_asked_for_alone(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", KEPT_MB)
    assert call("-q", "run", ".", "--no-figures") == 0
    assert capsys.readouterr().out == ""
    assert call("-q", "run", ".", "--no-figures", "--json") == 0
    assert capsys.readouterr().out.startswith("{")
    assert call("-q", "show", "stage.json") == 0
    assert "u_x" in capsys.readouterr().out
    Path("reports/baseline/circle.json").unlink()
    assert call("-q", "check", ".") == 1
    assert capsys.readouterr().out == ""
    assert call("check", ".") == 1  # the next command speaks again
    assert "has no baseline" in capsys.readouterr().out


def test_the_accepted_numbers_are_those_of_a_run(folder: Path) -> None:
    baseline = Baseline.load(Path("reports/baseline/circle.json"))
    errors = {
        dict(key)["compensator"]: numbers["euclidean_max_true_um"]
        for key, numbers in baseline.rows.items()
        if dict(key)["frequency_hz"] == 100.0
    }
    others = [value for label, value in errors.items() if label != "hysteresis and dynamics"]
    assert len(others) == 2
    assert errors["hysteresis and dynamics"] < 0.2 * min(others)


def test_its_best_compensator_leaves_little(folder: Path) -> None:
    """With thresholds uniform in time 0.5 um would be left: those of the stage lie elsewhere."""
    rows = json.loads((folder / "reports/circle/report.json").read_text())["rows"]
    worst = max(row["max_true_um"] for row in rows if row["compensator"] == "hysteresis and dynamics")
    assert worst < 0.15


def test_completion_is_offered() -> None:
    assert "--install-completion" in help_of().output


@pytest.mark.parametrize(("words", "wanted"), [("identify --ope", "--operators"), ("iden", "identify")])
def test_the_shell_completes_commands_and_their_options(words: str, wanted: str) -> None:
    """A shell gives its words in the environment, not as arguments."""
    code = "import sys; sys.argv = ['hammerstein']; from hammerstein.__main__ import main; main()"
    asked = {"COMP_WORDS": f"hammerstein {words}", "COMP_CWORD": str(len(words.split()))}
    asked |= {"_HAMMERSTEIN_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | asked, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [wanted]


def test_show_lists_the_arrays_of_a_file_and_how_their_columns_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = np.arange(40.0)
    np.savez(tmp_path / "both.npz", u=np.stack([rows, rows]), t=rows, gain=np.float64(2.0))
    np.save(tmp_path / "one.npy", np.zeros((40, 3, 2)))
    assert call("show", tmp_path / "both.npz", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["u"] == "40 samples; its columns are u:1 to u:2"
    assert found["t"] == "40 samples; its columns are t"
    assert found["gain"] == "a single number"
    assert array_columns(tmp_path / "both.npz", ["u:2", "t"])[0].shape == (2, 40)
    assert call("show", tmp_path / "one.npy") == 0
    assert "40 samples; its columns are 1:1 to 3:2" in capsys.readouterr().out
    assert array_columns(tmp_path / "one.npy", ["3:2"])[0].shape == (1, 40)


def test_show_names_the_unit_of_a_column_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "\n".join(f"{k};{2 * k},5;{k}" for k in range(30))
    (tmp_path / "weg.csv").write_text(f"Zeit;Weg;u (V)\n[ms];[nm];\n{rows}\n")
    assert call("show", tmp_path / "weg.csv") == 0
    printed = capsys.readouterr().out
    for words in ("Zeit [ms] ", "Weg [nm] ", "u (V)  "):
        assert words in printed


def test_a_run_writes_where_init_pointed(tmp_path, monkeypatch):
    """From above the folder: beside the scenario, where reports lie already; else into the working folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stage" / "reports").mkdir(parents=True)
    scenario = (
        "question = 'How far?'\nactuator = 'duo_bimorph'\n[reference]\nkind = 'circle'\nradius_um = 5\n"
        "frequency_hz = 100\n[[compensators]]\nlabel = 'none'\nlaw = 'none'\nmodel = 'duo_bimorph'\n"
    )
    for folder, place in (("stage", "stage/reports"), ("plain", "reports")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / f"{folder}_sine.toml").write_text(scenario)
        with pytest.raises(SystemExit) as caught:
            main(["run", folder, "--no-figures"])
        assert not caught.value.code
        assert (tmp_path / place / f"{folder}_sine" / "report.json").is_file()


def test_show_reads_a_table_as_records_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Line by line, in the encoding that is found: no text that a record may hold is refused here."""
    rows = "".join(f"{k * 1e-3:.3f},{k % 7},{k % 5}\n" for k in range(40))
    (tmp_path / "r.csv").write_bytes(f"t_s,u_v,y_um\n{rows}# in µm\n".encode("latin-1"))
    with pytest.raises(SystemExit) as ended:
        main(["show", str(tmp_path / "r.csv")])
    assert not ended.value.code
    assert "in µm" in capsys.readouterr().out

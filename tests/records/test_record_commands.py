import json

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main
from hammerstein.hysteresis import play
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant

T = 50e-6


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Two CSV files: the published actuator without dynamics, one input driven at a time."""
    folder = tmp_path_factory.mktemp("records")
    plant = Plant(*(lambda m: (m, m.instruments))(HammersteinModel.load("duo_bimorph_static")))
    time_s = np.arange(2000) * T
    paths = []
    for k, axis in enumerate("xy"):
        u = np.zeros((2, 2000))
        u[k] = 10 * np.sin(2 * np.pi * 50 * time_s)
        response = plant.respond(u, [k])
        frame = pd.DataFrame(
            {
                "time": time_s,
                "u_x": u[0],
                "u_y": u[1],
                "x": response.reading_um[0],
                "y": response.reading_um[1],
            }
        )
        paths.append(folder / f"{axis}.csv")
        frame.to_csv(paths[-1], index=False)
    return paths


COLUMNS = ("--inputs", "u_x,u_y", "--outputs", "x,y")


def test_loops_prints_and_draws(records, tmp_path, capsys):
    assert _call("loops", records[0], *COLUMNS, "--rate", 20000, "--out", tmp_path, "--json") == 0
    loops = json.loads(capsys.readouterr().out)["loops"]
    direct = [loop for loop in loops if (loop["input"], loop["output"]) == ("u_x", "x") and loop["settled"]]
    assert direct[-1]["height_um"] == pytest.approx(116.8, rel=0.02)
    assert (tmp_path / "x" / "loops.png").stat().st_size > 5_000
    assert _call("loops", records[0], *COLUMNS, "--time", "time", "--no-figures") == 0
    assert "u_x" in capsys.readouterr().out


def test_a_record_in_which_all_inputs_move_is_drawn_and_called_so(tmp_path, capsys):
    time_s = 1e-3 * np.arange(1000)
    u = np.array([np.sin(2 * np.pi * f * time_s) for f in (3.0, 4.0)])
    table = {"t": time_s, "ux [V]": 5.0 * u[0], "uy [V]": 5.0 * u[1], "x": 9.0 * u[0], "y": 9.0 * u[1]}
    path = tmp_path / "circle.csv"
    pd.DataFrame(table).to_csv(path, index=False)
    named = ("--inputs", "ux,uy", "--outputs", "x,y", "--time", "t", "--out", tmp_path)
    assert _call("loops", path, *named) == 0
    told = capsys.readouterr()
    assert "ux and uy move together" in told.err
    assert "height_um" not in told.out
    assert (tmp_path / "circle" / "loops.png").stat().st_size > 5_000


def test_identify_writes_a_model_that_scenarios_can_run(records, tmp_path, capsys):
    out = tmp_path / "stage.json"
    known = ("--rate", 20000, "--sensor-bandwidth", 2000, "--dynamics", "none")
    assert _call("identify", *records, *COLUMNS, *known, "--out", out) == 0
    told = capsys.readouterr().out.strip().splitlines()
    said = told[next(i for i, line in enumerate(told) if line.startswith("Usable")) :]
    assert len(said) <= 3  # and one table before them
    assert said[0].startswith("Usable for simulation and compensation; untested on other records. Rms error ")
    assert said[-1].startswith(f"Model in {out}, report in {tmp_path / 'stage_fit' / 'report.html'}. Next: ")
    assert sum("───" in line for line in told) == 1
    model = HammersteinModel.load(out)
    truth = HammersteinModel.load("duo_bimorph_static").hysteresis.amplitude(10.0)
    np.testing.assert_allclose(model.hysteresis.amplitude(10.0), truth, atol=0.4)
    folder = tmp_path / "stage_fit"
    assert "improves the model" in (folder / "report.md").read_text()
    assert {"report.md", "fit.json", "loops.svg"} <= {p.name for p in folder.iterdir()}
    (tmp_path / "circle.toml").write_text(
        'question = "?"\nactuator = "stage.json"\n'
        '[reference]\nkind = "circle"\nradius_um = 20\nfrequency_hz = 20\n'
        '[[compensators]]\nlabel = "exact"\nlaw = "exact_inverse"\nmodel = "stage.json"\n'
    )
    assert _call("run", tmp_path / "circle.toml", "--out", tmp_path / "reports", "--no-figures") == 0


def test_thresholds_can_be_given(records, tmp_path, capsys):
    out = tmp_path / "m.json"
    plain = ("--rate", 20000, "--no-figures", "--dynamics", "none", "--out", out)
    arguments = ("identify", *records, *COLUMNS, *plain)
    assert _call(*arguments, "--thresholds", "0,0.5,3") == 0
    assert HammersteinModel.load(str(out)).hysteresis.pairs[0][0].thresholds_v.tolist() == [0.0, 0.5, 3.0]
    capsys.readouterr()
    assert _call(*arguments, "--thresholds", "0;1") == 2
    assert "not a list of voltages with commas between them" in capsys.readouterr().err


def test_json_holds_fit_and_validation(records, tmp_path, capsys):
    pd.read_csv(records[0]).to_csv(tmp_path / "held.csv", index=False)
    options = ("--validate", tmp_path / "held.csv", "--no-figures", "--json", "--operators", 4)
    options += ("--dynamics", "none")
    assert _call("identify", *records, *COLUMNS, "--rate", 20000, "--out", tmp_path / "m.json", *options) == 0
    content = json.loads(capsys.readouterr().out)
    held = content["validation"]
    for part in (content["fit"], held):
        for score in part.values():
            assert len(score["nrmse_percent"]) == len(score["rms_um"]) == 2
    assert held["static_hysteresis"]["nrmse_percent"][0] < held["linear"]["nrmse_percent"][0]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (
            ("--rate", 20000, "--operators", "many"),
            2,
            "or 'auto', not 'many'",
        ),
        (("--rate", 20000, "--solver", "best"), 2, "best"),
        (("--rate", 20000, "--time", "time"), 2, "rate"),
        ((), 2, "rate"),
    ],
)
def test_wrong_options_write_nothing(records, tmp_path, capsys, arguments, code, message):
    out = tmp_path / "m.json"
    assert _call("identify", *records, *COLUMNS, "--out", out, *arguments) == code
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_a_rate_that_the_time_column_contradicts_is_refused(records, tmp_path, capsys):
    arguments = ("identify", *records, *COLUMNS, "--no-figures", "--out", tmp_path / "m.json", "--rate")
    assert _call(*arguments, 5000) == 2
    assert (
        "the column time has steps of 5e-05, which is 20000 Hz; give --time time" in capsys.readouterr().err
    )
    assert not list(tmp_path.iterdir())
    frame = pd.read_csv(records[0])
    for k, factor in enumerate((1e3, 1e6, 20000.0)):  # ms, us, samples
        other = tmp_path / f"{k}.csv"
        frame.assign(time=frame.time * factor).to_csv(other, index=False)
        assert _call("loops", other, *COLUMNS, "--no-figures", "--rate", 20000) == 0


@pytest.mark.parametrize(
    ("command", "option"),
    [("identify", "--out"), ("identify", "--report"), ("loops", "--out"), ("compensate", "--out")],
)
def test_a_place_that_cannot_be_written_is_told_before_the_work(records, tmp_path, capsys, command, option):
    (tmp_path / "file").write_text("")
    place = (option, tmp_path / "file" / "below")
    if command == "compensate":
        code = _call(command, "no_such_model", records[0], *place)
    else:
        code = _call(command, "no_such_record.csv", *COLUMNS, "--rate", 20000, *place)
    assert code == 2
    assert f"{option}: {tmp_path / 'file'} is a file, not a folder" in capsys.readouterr().err


def test_a_bad_record_is_named_with_its_row(records, tmp_path, capsys):
    frame = pd.read_csv(records[0])
    frame.loc[41, "x"] = np.nan
    frame.to_csv(tmp_path / "hole.csv", index=False)
    out = tmp_path / "m.json"
    assert _call("identify", tmp_path / "hole.csv", *COLUMNS, "--rate", 20000, "--out", out) == 2
    error = capsys.readouterr().err
    assert "hole.csv" in error
    assert "43" in error
    assert not out.exists()


def test_an_input_that_never_moves_cannot_be_identified(records, tmp_path, capsys):
    out = tmp_path / "m.json"
    assert _call("identify", records[0], *COLUMNS, "--rate", 20000, "--out", out) in (2, 4)
    assert "u_y" in capsys.readouterr().err
    assert not out.exists()


def test_a_record_is_not_fitted_and_held_back_at_once(records, tmp_path, capsys):
    options = ("--rate", 20000, "--out", tmp_path / "m.json", "--validate", records[0])
    assert _call("identify", *records, *COLUMNS, *options) == 2
    assert "use another record for validation" in capsys.readouterr().err


def test_a_record_without_a_loop_says_so(records, tmp_path, capsys):
    pd.read_csv(records[0]).head(150).to_csv(tmp_path / "short.csv", index=False)
    assert _call("loops", tmp_path / "short.csv", *COLUMNS, "--rate", 20000, "--no-figures") == 2
    assert "no loop found" in capsys.readouterr().err


def _loops_of(record, path, travel):
    """Command on a copy of a record whose largest displacement is a number without a unit."""
    frame = pd.read_csv(record)
    outputs = COLUMNS[COLUMNS.index("--outputs") + 1].split(",")
    frame[outputs] *= travel / np.ptp(frame[outputs].to_numpy())
    frame.to_csv(path, index=False)
    return "loops", path, *COLUMNS, "--rate", 20000, "--no-figures"


def test_displacements_in_nm_without_a_unit_are_asked_for_it(records, tmp_path, capsys):
    """Ten um/V written in nm would be 10,000 um/V; a name with its unit is not asked, --units answers."""
    call = _loops_of(records[0], tmp_path / "nm.csv", 90.0 * 1000.0)
    assert _call(*call) == 2
    error = capsys.readouterr().err
    assert "in um it would travel 90 mm" in error
    assert "--units nm" in error
    assert _call(*call, "--units", "nm", "--json") == 0
    heights = [loop["height_um"] for loop in json.loads(capsys.readouterr().out)["loops"]]
    assert max(heights) == pytest.approx(90.0, rel=0.1)
    assert _call(*call, "--units", "ell") == 2
    assert "is not one of" in capsys.readouterr().err
    assert _call(*call, "--units", "nm", "--output-scale", "0.001") == 2
    assert "repeats --output-scale" in capsys.readouterr().err


def test_displacements_in_mm_without_a_unit_are_asked_for_it(records, tmp_path, capsys):
    """Less than 0.001 um/V is no actuator in um either; the smaller cross-couplings are not asked about."""
    call = _loops_of(records[0], tmp_path / "mm.csv", 5.0 / 1000.0)
    assert _call(*call) == 2
    error = capsys.readouterr().err
    assert "in um it would travel 0.005 um" in error
    assert "--units nm, um or mm" in error
    assert _call(*call, "--units", "mm") == 0


def test_a_gain_that_no_actuator_has_is_refused_until_it_is_accepted(records, tmp_path, capsys):
    call = ("loops", records[0], *COLUMNS, "--rate", 20000, "--no-figures", "--output-scale", 200)
    assert _call(*call) == 2
    error = capsys.readouterr().err
    assert "outside 0.001 to 1000 um/V" in error
    assert "--accept-gain" in error
    assert _call(*call, "--accept-gain") == 0
    text = capsys.readouterr().out
    assert "gain_um_per_v" in text
    assert "span_v" in text


def test_a_person_is_asked_about_a_gain(records, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr("typer.confirm", lambda text, err: asked.append(text) or True)
    call = ("loops", records[0], *COLUMNS, "--rate", 20000, "--no-figures", "--output-scale", 200)
    assert _call(*call) == 0
    assert asked == [asked[0]]
    assert asked[0].endswith("outside 0.001 to 1000 um/V. Is this right?")


@pytest.mark.full
def test_records_have_folders_of_their_own(records, tmp_path):
    call = ("loops", *records, *COLUMNS, "--rate", 20000, "--out", tmp_path)
    assert _call(*call) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["x_y"]
    assert _call("loops", records[1], *COLUMNS, "--rate", 20000, "--out", tmp_path) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"x_y", "y"}


def test_a_record_without_a_loop_does_not_stop_the_others(records, tmp_path, capsys):
    pd.read_csv(records[0]).head(150).to_csv(tmp_path / "short.csv", index=False)
    call = ("loops", records[0], tmp_path / "short.csv", *COLUMNS, "--rate", 20000, "--no-figures")
    assert _call(*call) == 0
    said = capsys.readouterr()
    assert "short.csv: no loop found" in said.err
    assert "u_x" in said.out


@pytest.mark.parametrize("command", ["identify", "loops"])
@pytest.mark.parametrize(
    ("time", "name", "said"),
    [
        (1_700_000_000_000_000_000 + 50_000 * np.arange(1600), "x", "a rate of 2e-05 Hz; it must be 1e-4"),
        (50e-6 * np.arange(1600), "x" * 150, "has 150 characters; a name has at most 100"),
    ],
)
def test_a_clock_of_nanoseconds_and_a_long_name_are_told_before_the_work(
    tmp_path, capsys, monkeypatch, command, time, name, said
):
    """Both ended in an internal error, the name after the whole fit."""
    monkeypatch.chdir(tmp_path)
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1600) / 400)
    pd.DataFrame({"time": time, "u": u, name: 5.0 * play(u, [2.0])[0]}).to_csv("record.csv", index=False)
    assert _call(command, "record.csv", "--inputs", "u", "--outputs", name, "--time", "time") == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["record.csv"]


@pytest.mark.parametrize(("lag_deg", "said"), [(305.0, True), (60.0, False), (170.0, False)])
def test_a_loop_that_turns_backwards_is_no_hysteresis(tmp_path, capsys, monkeypatch, lag_deg, said):
    """A lag of 305 degrees looks like a lead of 55: its width of -82 % (its sine) was a plain number."""
    monkeypatch.chdir(tmp_path)
    turned = 2.0 * np.pi * np.arange(1600) / 400
    late = np.sin(turned - np.radians(lag_deg))
    pd.DataFrame({"u": np.sin(turned), "x": late}).to_csv("record.csv", index=False)
    call = ("loops", "record.csv", "--inputs", "u", "--outputs", "x", "--rate", "20000", "--no-figures")
    assert _call(*call, "--accept-gain") == 0
    assert ("runs backwards (width -82 %)" in capsys.readouterr().err) is said


@pytest.mark.full
@pytest.mark.parametrize("case", ["swapped", "noise", "copy"])
def test_loops_ask_the_doubts_of_identify(tmp_path, capsys, monkeypatch, case):
    """A width of -12 %, a gain of 0.002, a copy of the voltage: each was a table with exit 0."""
    monkeypatch.chdir(tmp_path)
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1600) / 400)
    x = 5.0 * play(u, [2.0])[0]
    noise = np.random.default_rng(3).normal(size=u.size)
    u, x = {"swapped": (x, u), "noise": (u, noise), "copy": (u, u)}[case]
    pd.DataFrame({"u": u, "x": x}).to_csv("record.csv", index=False)
    call = ("loops", "record.csv", "--inputs", "u", "--outputs", "x", "--rate", "20000", "--no-figures")
    said = {
        "swapped": "leads u by 1",
        "noise": "record.csv: no output responds",
        "copy": "equals the column",
    }
    assert _call(*call) == 2
    assert said[case] in capsys.readouterr().err
    assert _call(*call, "--accept-order", "--accept-gain") == 0
    capsys.readouterr()
    assert _call("identify", *call[1:]) == 2
    assert said[case] in capsys.readouterr().err

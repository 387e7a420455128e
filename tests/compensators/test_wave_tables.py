"""One settled period of a periodic path, and the tables of devices: what is stated is what is played."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from export_cases import stage

from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.commands.cli import main
from hammerstein.compensators import cycle
from hammerstein.compensators.cycle import cycle_of, rms
from hammerstein.compensators.drive_file import Terms
from hammerstein.compensators.wave_table import wave_table
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant

T = 50e-6


def _path(folder, samples, radius=20.0, ratio=(3, 2)):
    """A Lissajous figure whose common period is the whole file."""
    turn = 2.0 * np.pi * np.arange(samples) / samples
    columns = {
        "time_s": np.arange(samples) * T,
        "x": radius * np.sin(ratio[0] * turn),
        "y": radius * np.sin(ratio[1] * turn),
    }
    pd.DataFrame(columns).to_csv(folder / "path.csv", index=False)
    return folder / "path.csv"


def _replayed(drive_v, periods=12):
    """Position (p, N) in the last of some periods, by the plant itself, without noise and rounding."""
    model = HammersteinModel.load("duo_bimorph")
    plant = Plant(model, Instruments.ideal(T))
    return plant.respond(np.tile(drive_v, (1, periods)), [0]).position_um[:, -drive_v.shape[1] :]


def _table_of(path, separator):
    rows = [line for line in path.read_text().splitlines() if line[0] in "-0123456789"]
    return np.array([[float(cell) for cell in row.split(separator)] for row in rows]).T


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


def _compensate(folder, capsys, *options):
    out = folder / "table.txt"
    code = _call("compensate", "duo_bimorph", folder / "path.csv", "--out", out, "--json", *options)
    said = capsys.readouterr()
    assert code == 0, said.err
    return out, json.loads(said.out)


def test_a_settled_period_repeats_itself(tmp_path):
    """The fixed point of the loop: ten periods from the start end where the law believes them to."""
    found = cycle_of("duo_bimorph", _path(tmp_path, 800), "hammerstein_inverse", {})
    assert found.closure_um < 1e-9
    played = _replayed(found.drive_v)
    assert np.abs(played - found.played_um).max() < 1e-9
    assert rms(played - found.reference_um) < 0.01  # steps of the converter, 0.3 mV
    written = pd.read_csv(io.StringIO(found.to_csv()), comment="#")
    assert written["time_s"].to_numpy() == pytest.approx(T * np.arange(800), abs=1e-9)


@pytest.mark.parametrize("size", [0.0, 5.0])
def test_the_middle_of_every_axis_is_that_of_its_path(tmp_path, size):
    """Also where the other axis stands still, at its own position."""
    turn = 2.0 * np.pi * np.arange(400) / 400
    columns = {
        "time_s": np.arange(400) * T,
        "x": 20.0 + 15.0 * np.cos(turn),
        "y": 2.0 + size * np.sin(2.0 * turn),
    }
    pd.DataFrame(columns).to_csv(tmp_path / "path.csv", index=False)
    found = cycle_of("duo_bimorph", tmp_path / "path.csv", "hammerstein_inverse", {})
    assert np.abs(found.error_um.mean(axis=1)).max() < 1e-3  # steps of the converter


def test_the_first_period_is_another_one(tmp_path):
    found = cycle_of("duo_bimorph", _path(tmp_path, 800), "hammerstein_inverse", {})
    model = HammersteinModel.load("duo_bimorph")
    first = Plant(model, Instruments.ideal(T)).respond(found.drive_v, [0]).position_um
    assert np.abs(first - found.played_um).max() > 1.0


def test_a_run_up_leads_to_the_settled_period(tmp_path, capsys):
    """From rest at the start: steps no larger than the path's own, and no first period of its own."""
    path = _path(tmp_path, 800)
    out = tmp_path / "cycle.csv"
    assert _call("compensate", "duo_bimorph", path, "--cycle", "--out", out) == 0
    said = capsys.readouterr().out
    names = ["drive_x_v", "drive_y_v"]
    way, period = (
        pd.read_csv(file, comment="#")[names].to_numpy().T for file in (tmp_path / "cycle.run_up.csv", out)
    )
    own_step = np.abs(np.diff(period, axis=1)).max()
    sent = np.hstack([np.zeros((2, 1)), way, period, period[:, :1]])
    assert np.abs(np.diff(sent, axis=1)).max() == pytest.approx(own_step, rel=0.05)
    plant = Plant(HammersteinModel.load("duo_bimorph"), Instruments.ideal(T))
    first = plant.respond(sent[:, 1:-1], [0]).position_um[:, -800:]
    assert np.abs(first - _replayed(period)).max() < 0.02
    assert "Largest step" in said
    assert "first period after the run-up" in said


def test_what_does_not_settle_without_creep_is_not_blamed_on_creep(monkeypatch):
    model = HammersteinModel.load("duo_bimorph")
    law = cycle.sensorless_law(
        cycle.compensator_of("hammerstein_inverse", {}), model, Terms().allowed_range(model), T
    )
    monkeypatch.setattr(cycle, "SETTLED", -1.0)
    with pytest.raises(SimulationError) as caught:
        cycle.settled(law, model, np.zeros((2, 400)))
    assert "creep" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "separator", "scale"),
    [
        (("--table", "nv200", "--table-scale", "5,50"), ",", (5.0, 50.0)),
        (("--table", "pi", "--table-scale", "1"), "\t", (1.0, 0.0)),
        (("--table", "csv", "--table-points", "250"), ",", (1.0, 0.0)),
    ],
)
def test_a_replay_reproduces_the_stated_error(tmp_path, capsys, options, separator, scale):
    """Read the file back, hold each point, play it: the rms error is the stated one within 1 %."""
    _path(tmp_path, 4000)
    out, said = _compensate(tmp_path, capsys, *options)
    table = (_table_of(out, separator) - scale[1]) / scale[0]
    hold = 4000 // table.shape[1]
    path = pd.read_csv(tmp_path / "path.csv")[["x", "y"]].to_numpy().T
    played = _replayed(np.repeat(table, hold, axis=1))
    assert rms(played - path) == pytest.approx(said["rms_um"][-1], rel=0.01)
    assert said["rms_um"][0] <= said["rms_um"][1] * 1.001
    if "nv200" in options:
        assert table.shape[1] == 1000  # of 1024; 800 us would be too few a point
    text = out.read_text()
    assert "not tested on hardware" in text
    assert (f"Table rate {hold} at a servo update time of 50 us" in text) == ("pi" in options)
    limits = (
        f"points {table.shape[1]}, rate {1.0 / (hold * T):g} Hz, low {table.min():g}, high {table.max():g}"
    )
    assert (limits in text) == ("csv" in options)
    if "csv" in options:  # its header is the first line, as genfromtxt wants it
        read = np.genfromtxt(out, delimiter=",", names=True)
        assert read.dtype.names == ("drive_x_v", "drive_y_v")
        assert text.splitlines()[len(read)].count("#") == 0  # its notes are below, for spreadsheets
        assert text.splitlines()[-1].startswith("# points")
    way = pd.read_csv(out.with_name(f"{out.stem}.run_up.csv"), comment="#")
    first, last = table[:, 0] * scale[0] + scale[1], way.to_numpy()[-1, 1:]
    assert np.abs(first - last).max() < 0.02 * scale[0] * np.ptp(table)  # both in the numbers of the table


def test_a_period_that_does_not_close_is_named(tmp_path, capsys):
    """Three quarters of a circle as a period: what is out of reach is its jump."""
    turn = 1.5 * np.pi * np.arange(3000) / 3000
    rows = np.stack([T * np.arange(3000), 50.0 * np.cos(turn), 50.0 * np.sin(turn)], axis=1)
    pd.DataFrame(rows, columns=["time_s", "x", "y"]).to_csv(tmp_path / "open.csv", index=False)
    asked = ("compensate", "duo_bimorph", tmp_path / "open.csv", "--cycle", "--out", tmp_path / "drive.csv")
    assert _call(*asked) == 3
    assert re.search(
        r"the period does not close, [xy] jumps by (49|50).* um: give one whole", capsys.readouterr().err
    )


def test_points_are_placed_for_the_least_played_error(tmp_path):
    """Better than holding every fourth voltage, or the mean of four; no small change improves it."""
    cycle = cycle_of("duo_bimorph", _path(tmp_path, 4000), "hammerstein_inverse", {})
    table = wave_table(cycle, "nv200", (1.0, 0.0))
    held = cycle.drive_v.reshape(2, 1000, 4)
    others = [
        rms(_replayed(np.repeat(t, 4, axis=1)) - cycle.reference_um)
        for t in (held[:, :, 0], held.mean(axis=2))
    ]
    assert table.errors_um[1] < 0.8 * min(others)
    rng = np.random.default_rng(0)
    for _ in range(5):
        near = table.volts + 1e-3 * rng.standard_normal((2, 1000))
        assert rms(_replayed(np.repeat(near, 4, axis=1)) - cycle.reference_um) > table.errors_um[1]


def test_fewer_points_are_worse(tmp_path):
    cycle = cycle_of("duo_bimorph", _path(tmp_path, 4000), "hammerstein_inverse", {})
    errors = [wave_table(cycle, "csv", None, points).errors_um[1] for points in (1000, 500, 250)]
    assert errors[0] < errors[1] < errors[2]


def test_what_no_table_holds_is_refused(tmp_path):
    cycle = cycle_of("duo_bimorph", _path(tmp_path, 2063), "hammerstein_inverse", {})
    assert wave_table(cycle, "csv").hold == 1
    with pytest.raises(InputError, match="table-scale"):
        wave_table(cycle, "pi")
    with pytest.raises(InputError, match="not a whole number of points, at most 500"):
        wave_table(cycle, "nv200", (1.0, 0.0), 500)
    with pytest.raises(InputError, match="not one of pi, nv200, csv"):
        wave_table(cycle, "wav")


def test_a_path_out_of_reach_is_refused(tmp_path):
    path = _path(tmp_path, 800, radius=90.0)
    with pytest.raises(SimulationError, match="out of reach"):
        cycle_of("duo_bimorph", path, "hammerstein_inverse", {})
    cycle_of("duo_bimorph", path, "exact_inverse", {}, Terms(clip=True))


def _one_sided(folder, resonance_hz=None):
    """A stage of one axis from 0 to 100 V: back at 0 V after 100 V, its play of 5 V keeps 1 um."""
    dynamics = AxesDynamics(axes=(Axis(resonance_hz=180.0, damping_ratio=0.02),))
    model = HammersteinModel(
        "stage",
        PrandtlIshlinskii([[Pair([0.0, 5.0], [0.8, 0.2])]]),
        dynamics if resonance_hz else StaticDynamics(n_outputs=1),
        50.0,
        ("u",),
        ("x",),
        instruments=Instruments.ideal(T),
        voltages=Voltages.of([0.0], [0.0], [100.0]),
    )
    model.save(folder / "stage.json")
    return folder / "stage.json"


def test_a_period_that_the_range_cuts_is_refused_with_what_mends_it(tmp_path):
    """Centring moved the cut off the limit: a drive that missed by 0.5 um was written without a word."""
    model, path = _one_sided(tmp_path), tmp_path / "low.csv"
    turn = 2.0 * np.pi * np.arange(500) / 500
    pd.DataFrame({"time_s": np.arange(500) * T, "x": 20.3 - 20.0 * np.cos(turn)}).to_csv(path, index=False)
    with pytest.raises(SimulationError, match=r"low.csv: out of reach: the range limits") as found:
        cycle_of(str(model), path, "exact_inverse", {})
    offset, left = re.search(r"error: --offset=([0-9.]+) \(([0-9.]+) um\), --clip", str(found.value)).groups()
    mended = cycle_of(str(model), path, "exact_inverse", {}, Terms(offset_um=(float(offset),)))
    assert np.abs(mended.error_um).max() == pytest.approx(float(left), abs=1e-6)
    clipped = cycle_of(str(model), path, "exact_inverse", {}, Terms(clip=True))
    assert np.abs(clipped.error_um).max() > 0.3
    assert "The range limits the drive in" in " ".join(clipped.statements())


def test_a_filter_that_helps_a_period_is_named_with_its_error(tmp_path):
    """A triangle of 20 Hz on a stage of 180 Hz: its corners need far more than 100 V."""
    model, path = _one_sided(tmp_path, 180.0), tmp_path / "scan.csv"
    lines = np.abs((np.arange(1000) / 1000 + 0.75) % 1.0 - 0.5) - 0.25
    pd.DataFrame({"time_s": np.arange(1000) * T, "x": 50.0 + 160.0 * lines}).to_csv(path, index=False)
    with pytest.raises(SimulationError, match=r"Remedies, with the remaining error: --filter-hz") as found:
        cycle_of(str(model), path, "hammerstein_inverse", {})
    hertz, left = re.search(r"--filter-hz ([0-9]+) \(([0-9.]+) um\)", str(found.value)).groups()
    mended = cycle_of(str(model), path, "hammerstein_inverse", {"filter_hz": float(hertz)})
    assert np.abs(mended.error_um).max() == pytest.approx(float(left), rel=0.06)
    clipped = cycle_of(str(model), path, "hammerstein_inverse", {}, Terms(clip=True))
    assert np.abs(mended.error_um).max() < 0.5 * np.abs(clipped.error_um).max()


def test_creep_that_never_settles_is_said(tmp_path):
    model = stage()
    model.save(tmp_path / "stage.json")
    turn = 2.0 * np.pi * np.arange(200) / 200
    pd.DataFrame({"time_s": np.arange(200) * T, "x": 10.0 + 8.0 * np.sin(turn)}).to_csv(
        tmp_path / "p.csv", index=False
    )
    with pytest.raises(SimulationError, match="Creep in the model causes this"):
        cycle_of(str(tmp_path / "stage.json"), tmp_path / "p.csv", "hammerstein_inverse", {})


def test_a_table_is_written_again_over_itself_and_over_nothing_else(tmp_path, capsys):
    path, out = _path(tmp_path, 800), tmp_path / "table.txt"
    asked = ("compensate", "duo_bimorph", path, "--table", "pi", "--table-scale", "1", "--out", out)
    assert _call(*asked) == 0
    first = out.read_text()
    assert first.startswith("# Wave table of Physik Instrumente: 800 points")
    assert "resampled" not in first  # each sample is a point
    assert _call(*asked) == 0
    assert out.read_text() == first
    assert _call("compensate", "duo_bimorph", path, "--cycle", "--out", out) == 2
    assert "table.txt is a file that this command did not write" in capsys.readouterr().err
    drive = tmp_path / "drive.csv"
    assert _call("compensate", "duo_bimorph", path, "--cycle", "--out", drive) == 0
    assert _call(*asked[:-1], drive) == 2
    assert "drive.csv is a file that this command did not write" in capsys.readouterr().err


def test_the_command_refuses_half_a_request(tmp_path, capsys):
    path = _path(tmp_path, 800)
    out = tmp_path / "drive.csv"
    assert _call("compensate", "duo_bimorph", path, "--table-scale", "1", "--out", out) == 2
    assert _call("compensate", "duo_bimorph", path, "--table", "wav", "--out", out) == 2
    for scale in ("0", "nan", "1,2,3"):
        asked = ("--table", "pi", "--table-scale", scale, "--out", out)
        assert _call("compensate", "duo_bimorph", path, *asked) == 2
    assert not out.exists()
    assert _call("compensate", "duo_bimorph", path, "--cycle", "--out", out) == 0
    assert re.search("One settled period of 0.04 s", capsys.readouterr().out)
    assert len(pd.read_csv(out, comment="#")) == 800


def test_the_settled_error_of_a_short_period_does_not_ring(tmp_path):
    """A resonance of 180 Hz with damping 0.02 rings for 0.3 s to 1 %: longer than ten periods of 25 ms."""
    packaged = HammersteinModel.load("duo_bimorph")
    axes = tuple(
        axis.model_copy(update={"resonance_hz": 180.0, "damping_ratio": 0.02})
        for axis in packaged.dynamics.axes
    )
    model = replace(packaged, dynamics=packaged.dynamics.model_copy(update={"axes": axes}))
    model.save(tmp_path / "ringing.json")
    turn = 2.0 * np.pi * np.arange(500) / 500
    columns = {"time_s": np.arange(500) * T, "x": 20.0 + 15.0 * np.cos(turn), "y": 20.0 + 15.0 * np.sin(turn)}
    pd.DataFrame(columns).to_csv(tmp_path / "path.csv", index=False)
    found = cycle_of(str(tmp_path / "ringing.json"), tmp_path / "path.csv", "hammerstein_inverse", {})
    sent = np.concatenate([found.run_up_v, np.tile(found.drive_v, (1, 80))], axis=1)
    long = Plant(model, Instruments.ideal(T)).respond(sent, [0]).position_um[:, -500:]  # 2 s: all is settled
    assert np.abs(found.played_um - long).max() < 2e-3
    assert np.abs(found.error_um).max() < 5e-3

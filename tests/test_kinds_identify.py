"""Other kinds of hysteresis in identify, on the command line and in a scenario."""

import json
from pathlib import Path

import numpy as np
import pytest
import theory
from typer.testing import CliRunner

import hammerstein
from hammerstein.commands.cli import app
from hammerstein.errors import InputError
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

SEED = 16
R = np.array([0.0, 3.0, 8.0, 20.0, 35.0])
W = [0.5, 0.1, 0.15, 0.1, 0.12]
Q = np.array([25.0, 50.0, 75.0])
B = [-0.15, 0.25, 0.2]


def record_of(turns, seed, noise=0.01):
    """A stack from 0 to 100 V, from rest at 10 V."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, 6000)
    swing = np.linspace(1.0, 0.4, 6000) * (1.0 - np.exp(-angle))
    sent = 10.0 + 45.0 * (1.0 - np.cos(angle)) * swing / 1.0
    v = theory.asymmetric([sent], [[R]], [[W]], [[Q]], [[B]], [10.0])
    y = v + noise * np.random.default_rng(seed).standard_normal(v.shape) + 3.0
    return Record([sent], y, 1e-3, ("u",), ("x",), f"{turns}.csv")


def test_identify_finds_the_stack_and_says_what_the_dead_zones_gain():
    kept = {"thresholds_v": R, "delay_samples": 0, "error_curve": False}
    settings = Settings(hysteresis="asymmetric", **kept)
    model, fit = identify([record_of(9, 1)], settings, validation=[record_of(5, 2)])
    assert isinstance(model.hysteresis, Asymmetric)
    ours, plays = (fit.validation[kind].nrmse_percent[0] for kind in ("static_hysteresis", "classical"))
    assert ours < 0.3 * plays
    assert fit.invertible
    assert "Hysteresis beyond plays improves the model" in fit.verdict
    assert any("dead-zones an input stand beside the plays" in note for note in fit.notes)


def test_the_model_counts_from_where_the_actuator_stood_and_is_compensated(tmp_path):
    model, _ = identify(
        [record_of(9, 1)],
        Settings(thresholds_v=R, delay_samples=0, error_curve=False, hysteresis="asymmetric"),
    )
    assert model.recorded.working_point_v == pytest.approx([10.0], abs=0.01)
    path = tmp_path / "stack.json"
    model.save(path)
    again = hammerstein.HammersteinModel.load(path)
    assert again.digest() == model.digest()
    law = hammerstein.ExactInverse().design(again, (0.0, 100.0), 1e-3)
    goal = 20.0 * (1.0 - np.cos(np.linspace(0.0, 12.0, 400)))[None, :]
    np.testing.assert_allclose(again.static_response(law.respond(goal)[0])[0], goal, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"hysteresis": "preisach"}, "is not known"),
        ({"hysteresis": "asymmetric", "dynamics": "state_space", "order": 4}, "state_space cannot be had"),
        ({"hysteresis": "asymmetric", "method": "closed_form"}, "closed_form cannot be had"),
        ({"dead_zones": 3}, "belong to hysteresis asymmetric"),
        ({"hysteresis": "asymmetric", "dead_zones": 99}, "must be 0 to 50"),
    ],
)
def test_what_does_not_go_together_is_refused(options, says):
    with pytest.raises(InputError, match=says):
        Settings(**options)


def test_the_command_writes_a_model_and_its_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    record = record_of(6, 1)
    table = np.column_stack([np.arange(record.samples) * 1e-3, record.u_v[0], record.y_um[0]])
    Path("a.csv").write_text("t,u,x\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in table[::4]))
    words = ["identify", "a.csv", "--inputs", "u", "--outputs", "x", "--time", "t", "--no-figures"]
    done = CliRunner().invoke(
        app, [*words, "--hysteresis", "asymmetric", "--dead-zones", "3", "--out", "m.json"]
    )
    assert done.exit_code == 0, done.output
    content = json.loads(Path("m.json").read_text())
    assert content["hysteresis"]["kind"] == "asymmetric"
    assert len(content["hysteresis"]["dead_zones"][0][0]["breakpoints_v"]) == 3
    assert "dead-zones" in Path("m_fit/report.md").read_text()


def test_a_scenario_identifies_it_through_drive_and_sensor(tmp_path):
    plays = PrandtlIshlinskii([[Pair([0.0, 0.9, 2.2, 4.1], [3.0, 0.5, 0.6, 0.9])]])
    block = Asymmetric(plays, [[DeadZones([-2.0, 3.0], [0.8, -0.9])]])
    axes = hammerstein.AxesDynamics(axes=(hammerstein.Axis(resonance_hz=430.0, damping_ratio=0.2),))
    hammerstein.HammersteinModel("bent", block, axes, 8.0, ("u",), ("x",)).save(tmp_path / "bent.json")
    found = {"method": "hammerstein", "frequencies_hz": [20.0, 50.0]}
    kinds = [{"label": kind, "law": "hammerstein_inverse", "identification": {**found, "hysteresis": kind}}
             for kind in ("prandtl_ishlinskii", "asymmetric")]  # fmt: skip
    report = hammerstein.run(
        {
            "question": "What do dead-zones gain?",
            "actuator": str(tmp_path / "bent.json"),
            "reference": {"kind": "sine", "amplitude_um": 15.0, "frequency_hz": 20.0, "axis": 1},
            "measure": {"settle_cycles": 2, "measured_cycles": 2},
            "compensators": kinds,
        }
    )
    rms = {row.compensator: row.rms_true_um for row in report.rows}
    assert rms["asymmetric"] < 0.4 * rms["prandtl_ishlinskii"]

"""Other kinds of hysteresis in identify, on the command line and in a scenario."""

import json
from pathlib import Path

import numpy as np
import pytest
import theory
from block_fits import task_of
from scipy.signal import lfilter
from typer.testing import CliRunner

import hammerstein
from hammerstein.commands.cli import app
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii
from hammerstein.identification import kinds
from hammerstein.identification.fit import Task
from hammerstein.identification.identify import identify
from hammerstein.identification.kinds import FittedBlock, HammersteinFit, trials_of
from hammerstein.identification.output_dynamics import OutputDynamics
from hammerstein.identification.score import Candidate
from hammerstein.identification.search import MOST_DELAY, alike_clocks
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import judged_starts
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
    assert any("dead-zones for each input beside the plays: " in note for note in fit.notes)


def test_a_block_without_dead_zones_is_plays_and_nothing_is_said_to_lie_beyond_them():
    """A page said that hysteresis beyond plays improves a model that had none."""
    given = {"thresholds_v": R, "delay_samples": 0, "error_curve": False, "dead_zones": 0}
    _, fit = identify([record_of(9, 1)], Settings(hysteresis="asymmetric", **given))
    assert "this model with plays alone" in fit.verdict
    assert "beyond plays" not in fit.verdict
    assert "no dead-zones: this hysteresis is of plays alone" in fit.notes


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
        ({"hysteresis": "preisac"}, "is not known"),
        ({"hysteresis": "asymmetric", "dynamics": "state_space", "order": 4}, "state_space cannot be used"),
        ({"hysteresis": "asymmetric", "solver": "closed_form"}, "closed_form cannot be used"),
        ({"dead_zones": 3}, "belongs to hysteresis asymmetric"),
        ({"hysteresis": "asymmetric", "dead_zones": 99}, "must be 0 to 50"),
    ],
)
def test_what_does_not_go_together_is_refused(options, says):
    with pytest.raises(InputError, match=says):
        Settings(**options)


@pytest.mark.parametrize("kind", ["asymmetric", "rate_dependent"])
@pytest.mark.parametrize("known", [None, 0])
@pytest.mark.parametrize("times_s", [(1e-3, 1e-3), (1e-3, 2e-3)])
@pytest.mark.parametrize("turns", [2.0, 2.3])
def test_a_delay_is_searched_only_where_nothing_else_looks_like_one(kind, known, times_s, turns):
    """Not thresholds that grow with the rate, single loops, or records of several sample times."""
    u = 5.0 * np.cos(2.0 * np.pi * turns * np.linspace(0.0, 1.0, 401))[None]
    task, _ = task_of(kind, [Record(u, 2.0 * u, time_s) for time_s in times_s], delay_samples=known)
    free = kind == "asymmetric" and known is None and times_s[0] == times_s[1] and turns != 2.0
    assert kinds._free_delay(task) == free


WRONG = (
    {"partition": "spline"}, {"hysteresis": "none"}, {"solver": "newton"}, {"dynamics": "third_order"},
    {"operators": "many"}, {"operators": 0}, {"operators": [3, 4], "partition": "fitted"}, {"ridge": -1.0},
    {"dynamics": "state_space", "sensor_delay_s": 1e-3}, {"dynamics": "lag", "order": 2}, {"order": 0},
    {"dynamics": "none", "creep_modes": 1}, {"creep_modes": 99}, {"solver": "closed_form", "dynamics": "lag"},
    {"solver": "closed_form", "ridge": 1e-3}, {"dead_zones": 3},
    {"hysteresis": "asymmetric", "dead_zones": 99},
    {"hysteresis": "preisach", "dynamics": "state_space"},
    {"hysteresis": "bouc_wen", "solver": "nonnegative"},
    {"partition": "fitted", "thresholds_v": [0.0, 1.0]},
    {"partition": "fitted", "dynamics": "state_space"},
    {"partition": "fitted", "solver": "closed_form"}, {"delay_samples": -1},
    {"thresholds_v": [1.0, 0.0]},
    {"sensor_bandwidth_hz": 0.0}, {"sensor_delay_s": -1.0},
)  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_a_mistake_of_settings_names_the_option_that_is_wrong(wrong):
    with pytest.raises(InputError) as caught:
        Settings(**wrong)
    named = {mistake.where for mistake in caught.value.mistakes}
    assert {name.partition("[")[0].removesuffix("_v") for name in named} <= {
        name.removesuffix("_v") for name in wrong
    }
    assert all(" " in mistake.what for mistake in caught.value.mistakes)


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


@pytest.mark.full
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


@pytest.mark.full
def test_a_scenario_identifies_a_plane_of_relays_through_drive_and_sensor(tmp_path):
    """Relays in a lobe aside of the diagonal, which no plays have; voltages of the actuator's whole range."""
    on, off = np.meshgrid(*2 * [(np.arange(20) + 0.5) / 20], indexing="ij")
    lobe = np.tril(1.0 * np.exp(-((on - 0.6) ** 2 + (off - 0.35) ** 2) / 0.05))
    block = hammerstein.Preisach([-8.0], [8.0], [[lobe + 2.0 * np.eye(20)]])
    axes = hammerstein.AxesDynamics(axes=(hammerstein.Axis(resonance_hz=430.0, damping_ratio=0.2),))
    hammerstein.HammersteinModel("lobed", block, axes, 8.0, ("u",), ("x",)).save(tmp_path / "lobed.json")
    file = tmp_path / "lobed.toml"
    file.write_text(
        """
question = "What does a plane of relays gain over plays?"
actuator = "lobed.json"
measure = { settle_cycles = 2, measured_cycles = 2 }

[reference]
kind = "sine"
amplitude_um = 15
frequency_hz = 20
axis = 1
"""
        + "".join(
            f"""
[[compensators]]
label = "{kind}"
law = "hammerstein_inverse"
identification = {{ method = "hammerstein", frequencies_hz = [20, 50], hysteresis = "{kind}" }}
"""
            for kind in ("prandtl_ishlinskii", "preisach")
        )
    )
    rms = {row.compensator: row.rms_true_um for row in hammerstein.run(file).rows}
    assert rms["preisach"] < 0.3 * rms["prandtl_ishlinskii"]


# ---- which of several models is kept ----


def tried_on(records, *blocks):
    """Models without dynamics, each with the starts that it explains, and the task that they are tried in."""
    settings = Settings(hysteresis="asymmetric", dynamics="none", delay_samples=0)
    found = []
    for block in blocks:
        candidate = Candidate(block, StaticDynamics(n_outputs=1))
        starts = judged_starts(records, candidate.predict, 0.0)
        found.append(HammersteinFit(candidate, OutputDynamics((), 0.0), FittedBlock(block), starts))
    return Task(tuple(records), found[0].starts, [[R]], 0.0, settings, lambda _: None), found


def test_models_are_judged_on_the_same_samples():
    """A play of 6 V that moves in the first rise alone: who lacks it is not spared that rise."""
    t = np.arange(2000) / 400
    u = 5.0 - 5.0 * np.cos(2.0 * np.pi * t) * np.linspace(1.0, 0.5, 2000)
    right, late = (
        PrandtlIshlinskii([[Pair(r, w)]])
        for r, w in (([0.0, 2.0, 6.0], [3.0, 1.0, 0.5]), ([0.0, 2.0], [3.0, 1.0]))
    )
    record = Record([u], right.respond([u])[0], 1e-3)
    task, tried = tried_on([record], late, right)
    assert tried[0].starts[0].first > 0
    without, whole = trials_of(task, tried)
    assert without.squares[0] > 1e-5  # of the rise, in a part of the fold
    assert whole.percent < 1e-5
    [alone] = trials_of(task, tried[:1])
    assert alone.percent < 0.1 * without.percent


def test_a_model_that_stands_still_after_a_reversal_is_told_to_have_no_inverse():
    u = 5.0 - 5.0 * np.cos(np.linspace(0.0, 30.0, 2000))
    stuck, free = (PrandtlIshlinskii([[Pair([0.0, 2.0], w)]]) for w in ([0.0, 3.0], [1.0, 2.0]))
    record = Record([u], free.respond([u])[0], 1e-3)
    assert [trial.usable for trial in trials_of(*tried_on([record], stuck, free))] == [False, True]


@pytest.mark.parametrize("kind", ["prandtl_ishlinskii", pytest.param("asymmetric", marks=pytest.mark.full)])
def test_nothing_is_chosen_by_a_record_that_is_held_back(kind):
    """One that is late by three samples and bent: it says how far the model is off, and changes nothing."""
    stack, other = record_of(9, 1), record_of(5, 2)
    y = np.roll(other.y_um, 3, axis=1) * 1.2
    y[:, :3] = y[:, 3:4]
    far_off = Record(other.u_v, y, other.sample_time_s, ("u",), ("x",), "off.csv")
    settings = Settings(hysteresis=kind, dynamics="none", error_curve=False)
    alone, first = identify([stack], settings)
    judged, fit = identify([stack], settings, validation=[far_off])
    assert judged.hysteresis.file() == alone.hysteresis.file()
    assert judged.dynamics == alone.dynamics
    assert [trial.percent for trial in fit.trials] == [trial.percent for trial in first.trials]
    assert fit.validation[fit.kind].mean_percent > 2.0 * first.fit[first.kind].mean_percent


@pytest.mark.full
def test_a_linear_gain_has_the_delay_that_suits_it_beside_every_kind():
    """Of all delays its own, for one of another model is no rival; and so one figure, whatever the kind."""
    late = 3
    stack = record_of(20, 1)
    y = np.concatenate([np.repeat(stack.y_um[:, :1], late, axis=1), stack.y_um[:, :-late]], axis=1)
    whole = Record(stack.u_v, y, stack.sample_time_s)
    records, held = [whole.part(0, whole.samples // 2)], [whole.part(whole.samples // 2, whole.samples)]
    u, read = records[0].u_v[0], records[0].y_um[0]
    left = []
    for d in range(MOST_DELAY + 1):
        columns = np.stack([np.concatenate([np.full(d, u[0]), u[: len(u) - d]]), np.ones_like(u)])
        weights, *_ = np.linalg.lstsq(columns.T, read, rcond=None)
        left.append(100.0 * np.std(read - weights @ columns) / np.ptp(read))
    figures = []
    for kind in ("prandtl_ishlinskii", "bouc_wen", "asymmetric"):
        _, fit = identify(records, Settings(hysteresis=kind, dynamics="none"), validation=held)
        figures.append(fit.fit["linear"].nrmse_percent[0])
    assert fit.delay_samples == late  # of the bent block
    assert figures == pytest.approx([min(left)] * 3, rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize("kind", ["bouc_wen", "generalised"])
@pytest.mark.parametrize("seed", [0, 2])
def test_a_resonance_without_dynamics_has_a_model_with_errors_of_its_numbers(kind, seed):
    """A block that misses most of a record leaves its numbers open, but within what they can be."""
    generator = np.random.default_rng(seed)
    t = np.arange(2000)
    tones = np.arange(1, 200)[:, None]
    u = 0.1 * np.cos(2.0 * np.pi * tones * t / 2000 + generator.uniform(0.0, 6.28, tones.shape)).sum(axis=0)
    y = lfilter([1.0], [1.0, -2.0 * np.exp(-0.02) * np.cos(0.35), np.exp(-0.04)], u)
    settings = Settings(hysteresis=kind, dynamics="none", creep_modes=0, delay_samples=0, operators=3)
    model, fit = identify([Record([u], [y], 1e-3)], settings)
    assert fit.judged[fit.kind].nrmse_percent[0] > 5.0
    assert np.isfinite(model.covariance.errors).all()
    for _ in range(20):
        model.drawn(generator)


def test_a_delay_is_not_taken_from_plays_without_dynamics_where_clocks_differ_a_little():
    """Three samples late without axes: that stayed with axes, with sixty times the error."""
    lag_s, records = 3e-3, []
    for seed, (turns, clock) in enumerate(((9, 1.0), (31, 1.00002), (83, 0.99997))):
        one = record_of(turns, seed)
        y = lfilter([0.0, 1e-3 / lag_s], [1.0, 1e-3 / lag_s - 1.0], one.y_um - one.y_um[:, :1])
        records.append(Record(one.u_v, y, clock * 1e-3, one.inputs, one.outputs, one.source))
    settings = Settings(hysteresis="asymmetric", thresholds_v=R, dead_zones=3, error_curve=False)
    _, fit = identify(records, settings)
    assert fit.delay_samples <= 1.0
    assert fit.kind == "hammerstein"
    assert fit.axes[0].axis.lag_s == pytest.approx(lag_s, rel=0.2)


def test_sample_times_are_one_within_a_percent():
    def alike(*times_s):
        u = np.sin(np.arange(40.0))
        return alike_clocks([Record([u], [u], time) for time in times_s])

    assert alike(1e-3)
    assert alike(1e-3, 1.009e-3)
    assert not alike(1e-3, 1.011e-3)

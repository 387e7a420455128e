"""Bouc-Wen models from records: the numbers are found again, through noise, dynamics and bounds."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
import theory
from block_fits import fit_kind
from typer.testing import CliRunner

import hammerstein
from hammerstein.commands.cli import app
from hammerstein.dynamics import AxesDynamics, Axis, discretise
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import BoucWen, BoucWenPair
from hammerstein.hysteresis.bouc_wen_kernels import FEW, LONGEST, lagging
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

T = 50e-6
D = np.array([[14.0, 0.6], [-0.5, 12.0]])
A = np.array([[4.0, -0.3], [0.2, 3.0]])
BETA = np.array([[0.25, 0.2], [0.3, 0.1]])
GAMMA = np.array([[0.1, -0.05], [-0.1, 0.15]])


def voltages(samples, swing=10.0, hz=50.0):
    """Cycles whose size goes down to a third, first of one input, then of the other, then of both."""
    t = T * np.arange(samples)
    size = np.interp(t, [0.0, t[-1]], [1.0, 0.3]) * swing
    both = np.stack([size * np.sin(2.0 * np.pi * hz * t), size * np.sin(2.0 * np.pi * 0.73 * hz * t)])
    return [both * [[1.0], [0.0]], both * [[0.0], [1.0]], both]


def records_of(samples, noise_um=0.0, through=None):
    generator, found = np.random.default_rng(1), []
    for u in voltages(samples):
        v = theory.bouc_wen(u, D, A, BETA, GAMMA)
        y = v if through is None else through.respond(v)[0]
        found.append(Record(u, y + noise_um * generator.standard_normal(y.shape) + 3.0, T))
    return found


def numbers(block):
    names = ("direct_um_per_v", "hysteretic_um_per_v", "beta_per_v", "gamma_per_v")
    return [np.array([[getattr(pair, name) for pair in row] for row in block.pairs]) for name in names]


def test_all_numbers_of_two_axes_are_found_again():
    fit = fit_kind("bouc_wen", records_of(2000))
    for ours, true, near in zip(
        numbers(fit.hysteresis), (D, A, BETA, GAMMA), (1e-3, 5e-3, 3e-3, 5e-3), strict=True
    ):
        np.testing.assert_allclose(ours, true, atol=near)
    assert fit.rms_um.max() < 1e-3
    assert fit.held == ()


def test_noise_moves_the_slopes_by_what_their_standard_errors_say():
    fit = fit_kind("bouc_wen", records_of(2000, 0.04))
    assert fit.rms_um == pytest.approx([0.04, 0.04], rel=0.03)
    d, a, *_ = numbers(fit.hysteresis)
    assert np.abs(d - D).max() < 0.05
    assert np.abs(a - A).max() < 0.1
    errors = fit.hysteresis.weight_errors
    assert all(1e-5 < value < 0.05 for row in errors for value in row)


def test_through_a_resonance_and_a_delay_the_same_numbers():
    axes = AxesDynamics(axes=(Axis(resonance_hz=700.0, damping_ratio=0.1),) * 2)
    path = discretise(axes, T)
    late = [
        Record(r.u_v, np.hstack([r.y_um[:, :1]] * 3 + [r.y_um[:, :-3]]), T)
        for r in records_of(2000, through=path)
    ]
    fit = fit_kind("bouc_wen", late, delay_samples=3, axes=axes.axes)
    np.testing.assert_allclose(numbers(fit.hysteresis)[1], A, atol=0.02)


def test_a_repeated_record_needs_no_rest():
    from hammerstein.identification.static.regressors import InitialState

    cycle = np.sin(2.0 * np.pi * np.arange(3 * 400) / 400)
    u = 10.0 * np.stack([cycle])
    y = theory.bouc_wen(u, [[14.0]], [[4.0]], [[0.25]], [[0.1]])[:, 800:]
    record = Record(u[:, 800:], y, T)
    fit = fit_kind("bouc_wen", [record], starts=[InitialState("repeated")])
    assert fit.rms_um[0] < 5e-3


def test_slopes_of_a_direct_pair_are_held_where_there_were_no_inverse():
    u = voltages(3000)[0][:1]
    y = theory.bouc_wen(u, [[5.0]], [[4.0]], [[0.25]], [[0.1]])  # falls right after a turn
    free, bound = (fit_kind("bouc_wen", [Record(u, y, T)], invertible=which) for which in (False, True))
    low, held = (min(fit.hysteresis.pairs[0][0].slopes_um_per_v) for fit in (free, bound))
    assert low < 0.0 < held
    assert bound.held == ((0, 0),)
    assert bound.rms_um[0] > free.rms_um[0]


@pytest.mark.full
def test_of_two_axes_the_slopes_of_one_are_held_and_the_other_is_as_it_was():
    steep = np.array([[9.0, -0.3], [0.2, 3.0]])
    d = np.array([[5.0, 0.6], [-0.5, 12.0]])
    records = [Record(u, theory.bouc_wen(u, d, steep, BETA, GAMMA), T) for u in voltages(1000)]
    free, bound = (fit_kind("bouc_wen", records, invertible=which) for which in (False, True))
    assert bound.held == ((0, 0),)
    low, held = (min(fit.hysteresis.pairs[0][0].slopes_um_per_v) for fit in (free, bound))
    assert low < 0.0 < held
    np.testing.assert_allclose(numbers(bound.hysteresis)[0][1], d[1], atol=1e-3)


@pytest.mark.parametrize(
    ("load", "share", "told"),
    [(0.3, 0.5, ()), (1e-9, 0.5, (0,)), (1e9, 0.5, (0,)), (0.3, 1e-9, (1,)), (0.3, 1e9, (1,))],
)
def test_a_number_at_either_of_its_limits_is_told(load, share, told):
    """Numbers beyond what records can show are put to the nearer limit, where they say nothing."""
    u = voltages(500)[0][:1]
    record = Record(u, theory.bouc_wen(u, [[14.0]], [[4.0]], [[0.25]], [[0.1]]), T)
    begin = BoucWen([[BoucWenPair(14.0, 4.0, share * load, (1.0 - share) * load)]])
    assert fit_kind("bouc_wen", [record], like=begin, refined=False).at_limit == told


def test_an_input_that_never_moves_is_refused():
    u = voltages(500)[0]
    with pytest.raises(IdentificationError, match="never moves"):
        fit_kind("bouc_wen", [Record(u, u, T)])


def test_identify_finds_it_and_shows_plays_beside_it():
    u = voltages(3000)[0][:1]
    y = theory.bouc_wen(u, [[14.0]], [[4.0]], [[0.25]], [[0.1]])
    kept = {"delay_samples": 0, "error_curve": False}
    model, fit = identify([Record(u, y, T)], Settings(hysteresis="bouc_wen", **kept))
    assert isinstance(model.hysteresis, BoucWen)
    assert fit.invertible
    assert fit.fit["static_hysteresis"].mean_percent < 0.1 * fit.fit["classical"].mean_percent
    assert any("beta 0.25, gamma 0.1" in note for note in fit.notes)


def test_the_command_writes_a_model_and_its_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    u = voltages(1500)[0][:1]
    y = theory.bouc_wen(u, [[14.0]], [[4.0]], [[0.25]], [[0.1]])
    rows = "\n".join(f"{T * k:.9g},{u[0, k]:.9g},{y[0, k]:.9g}" for k in range(1500))
    Path("a.csv").write_text(f"t,u,x\n{rows}\n")
    words = ["identify", "a.csv", "--inputs", "u", "--outputs", "x", "--time", "t", "--no-figures"]
    done = CliRunner().invoke(app, [*words, "--hysteresis", "bouc_wen", "--out", "m.json"])
    assert done.exit_code == 0, done.output
    content = json.loads(Path("m.json").read_text())
    assert content["hysteresis"]["kind"] == "bouc_wen"
    assert content["hysteresis"]["pairs"][0][0]["beta_per_v"] == pytest.approx(0.25, rel=0.02)
    assert "beta 0.25" in Path("m_fit/report.md").read_text()


@pytest.mark.full
def test_a_scenario_identifies_it_through_drive_and_sensor(tmp_path):
    block = BoucWen([[hammerstein.BoucWenPair(14.0, 4.0, 0.25, 0.1)]])
    axes = AxesDynamics(axes=(Axis(resonance_hz=900.0, damping_ratio=0.3),))
    hammerstein.HammersteinModel("wen", block, axes, 8.0, ("u",), ("x",)).save(tmp_path / "wen.json")
    found = {"method": "hammerstein", "hysteresis": "bouc_wen"}
    report = hammerstein.run(
        {
            "question": "What does the Bouc-Wen compensator leave?",
            "actuator": str(tmp_path / "wen.json"),
            "reference": {"kind": "sine", "amplitude_um": 40.0, "frequency_hz": 10.0, "axis": 1},
            "measure": {"settle_cycles": 1, "measured_cycles": 1},
            "compensators": [
                {"label": "nothing", "law": "none", "identification": found},
                {
                    "label": "bouc_wen",
                    "law": "inverse_multiplicative",
                    "iterations": 8,
                    "identification": found,
                },
            ],
        }
    )
    rms = {row.compensator: row.rms_true_um for row in report.rows}
    assert rms["bouc_wen"] < 0.25 * rms["nothing"]


@pytest.mark.long
def test_100_000_samples_of_two_axes_take_less_than_a_minute():
    records = records_of(33_334, 0.04)
    fit_kind("bouc_wen", records_of(500))  # compiled
    begun = time.perf_counter()
    fit_kind("bouc_wen", records)
    assert time.perf_counter() - begun < 60.0


@pytest.mark.parametrize(
    ("beta", "gamma"), [(40.0, 10.0), (2.0, 8.0), (0.5, 5.0), (500.0, -400.0), (3.0, 3.0)]
)
def test_shapes_that_bend_within_a_sample_are_told_at_once(beta, gamma):
    """Long movements go in closed form; the steps of the model would take seconds and come to the same."""
    u = np.cumsum(np.random.default_rng(4).normal(0.0, 3.0, 2000))
    z = np.empty_like(u)
    lagging(u, beta + gamma, beta - gamma, 0.0, 0.0, z)
    exact = -theory.bouc_wen([u], [[0.0]], [[1.0]], [[beta]], [[gamma]])[0]
    np.testing.assert_allclose(z, exact, atol=2e-4 / (beta + gamma))
    far = np.abs(np.diff(u, prepend=0.0)) > FEW * LONGEST / max(beta + gamma, abs(beta - gamma))
    assert far.mean() > 0.9

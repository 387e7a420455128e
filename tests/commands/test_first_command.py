"""What a new user types first: the defaults on hard made-up records, and what is said where they fail."""

from __future__ import annotations

import made_up
import numpy as np
import pytest
from made_up_cases import record, stage_records, try_actuator
from record_cases import plain

from hammerstein.dynamics import AxesDynamics, Axis, discretise
from hammerstein.identification.identify import identify
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask
from hammerstein.identification.model_selection import Trial, chosen, fold_squares
from hammerstein.identification.score import Candidate, SensorModel
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record
from hammerstein.reporting.figures.identified import identified_figures
from hammerstein.reporting.fit_page import fit_page


@pytest.fixture(scope="module")
def stage():
    made = made_up.stage(0, noise_um=0.01, plays=12, rate_hz=5e3)
    return made, *stage_records(made, np.random.default_rng(1), cycles=4, hz=5.0)


@pytest.fixture(scope="module")
def stage_fit(stage):
    _, fitted, held = stage
    return identify(fitted, Settings(), validation=[held])


@pytest.mark.full
def test_the_defaults_find_the_stage(stage, stage_fit):
    made, _, held = stage
    model, fit = stage_fit
    for o, axis in enumerate(model.dynamics.axes):
        assert axis.resonance_hz == pytest.approx(made.resonances_hz[o], rel=0.02)
        assert axis.damping_ratio == pytest.approx(made.damping[o], rel=0.05)
        allowed = 3.0 * made.noise_um + 0.0005 * np.ptp(held.y_um[o])
        assert fit.validation["hammerstein"].rms_um[o] < allowed
    assert not any(start.first for start in (*fit.starts, *fit.held_starts))
    assert not fit.verdict.startswith("The prediction error")


@pytest.mark.full
def test_all_models_that_were_tried_stand_in_the_report(stage_fit):
    _, fit = stage_fit
    assert sum(trial.kept for trial in fit.trials) == 1
    kept = next(trial for trial in fit.trials if trial.kept)
    assert kept.name == "Hammerstein"
    assert kept.percent < min(t.percent for t in fit.trials if not t.kept)
    assert fit.as_dict()["trials"][0].keys() == {"name", "parameters", "percent", "kept"}


def test_falling_amplitudes_on_one_axis_at_a_time_are_told_apart(stage):
    _, fitted, _ = stage
    _, fit = identify(fitted[:2], plain(operators=10, partition="voltage"))
    assert fit.fit["static_hysteresis"].mean_percent < 1.0


def test_far_more_than_noise_is_said_first(stage):
    _, fitted, held = stage
    _, fit = identify(fitted, plain(operators=3), validation=[held])
    assert fit.verdict.startswith("The prediction error of y1")
    assert "times the noise" in fit.verdict
    assert "Not tried: --dynamics auto; or --operators auto --partition auto" in fit.verdict


@pytest.mark.full
def test_ringing_and_creep_under_a_held_voltage_are_used():
    r, w = np.linspace(0.0, 20.0, 12), np.full(12, 0.03)
    w[0] = 0.6
    creep = ((0.08, 0.4),)
    made = made_up.MadeUp(r[None], w[None, None], 0.0, 60.0, 1e4, (734.0,), (0.016,), creep=creep)
    tops = [np.interp(np.arange(5000), [0, 2500, 5000], [0.0, top, 0.0]) for top in (20.0, 40.0, 60.0)]
    u = np.concatenate([[0.0], np.full(15000, 40.0), np.linspace(40.0, 0.0, 2500), *tops])[None]
    y = made.position_um(u)[:, 1:]
    y = y + 2e-4 * np.ptp(y) * np.random.default_rng(3).standard_normal(y.shape)
    model, fit = identify([Record(u[:, 1:], y, 1e-4)], Settings())
    axis = model.dynamics.axes[0]
    assert axis.resonance_hz == pytest.approx(734.0, rel=0.01)
    assert axis.damping_ratio == pytest.approx(0.016, rel=0.2)
    assert axis.creep[0].gain == pytest.approx(0.08, rel=0.2)
    assert axis.creep[0].time_constant_s == pytest.approx(0.4, rel=0.2)
    assert not any("resonance" in text for text in fit.not_identifiable)


@pytest.mark.parametrize(
    ("before_v", "kind"), [pytest.param((), "turned", marks=pytest.mark.full), ((70.0,), "turned")]
)
def test_what_the_plays_remember_is_found(before_v, kind):
    made = made_up.stage(3, low_v=0.0, plays=8, resonances_hz=None, noise_um=1e-3)
    u = np.full((2, 4000), 30.0)
    u[0] = np.interp(np.arange(4000), [0, 800, 2200, 4000], [30.0, 60.0, 10.0, 80.0])
    v = u[::-1]
    past = [before_v, before_v]
    generator = np.random.default_rng(0)
    records = [record(made, x, generator, name, past) for name, x in (("x", u), ("y", v))]
    wide = made_up.triangles(made, 0) + made_up.triangles(made, 1)[:, ::-1]
    _, fit = identify(
        [*records, record(made, wide, generator, "wide")], plain(operators=25, partition="voltage")
    )
    assert [start.kind for start in fit.starts[:2]] == [kind] * 2
    assert fit.fit["static_hysteresis"].mean_percent < 0.1


@pytest.mark.full
def test_a_low_pass_is_found_and_kept_out_of_the_resonance():
    made = made_up.stage(5, plays=10, resonances_hz=None, lag_s=2e-3, noise_um=0.005, rate_hz=2e3)
    fitted, held = stage_records(made, np.random.default_rng(2))
    model, fit = identify(fitted, Settings(), validation=[held])
    for axis in model.dynamics.axes:
        assert axis.lag_s == pytest.approx(2e-3, rel=0.02)
        assert axis.resonance_hz is None
    assert fit.validation[fit.kind].rms_um[0] < 3.0 * made.noise_um + 0.0005 * np.ptp(held.y_um[0])


def test_an_axis_with_a_low_pass_has_the_response_of_theory():
    axis = Axis(resonance_hz=300.0, damping_ratio=0.1, lag_s=1e-3)
    block = discretise(AxesDynamics(axes=(axis,)), 1e-5)
    s = 2j * np.pi * np.array([0.0, 50.0, 300.0, 900.0])
    w = 2.0 * np.pi * 300.0
    theory = w**2 / (s**2 + 0.2 * w * s + w**2) / (1.0 + 1e-3 * s) * np.exp(-s * 0.5e-5)
    assert np.abs(block.response(s.imag / (2.0 * np.pi))[:, 0, 0] - theory).max() < 2e-3
    quick = AxisTask((), (), (np.zeros(1),), 0, AxisShape(lag=True), 0, SensorModel())
    x = np.log([300.0, 0.1, 1e-3])
    hz = [0.0, 50.0, 900.0]
    assert np.abs(quick.path(x, 1e-5).response(hz) - block.response(hz)).max() < 1e-9


def test_an_unstable_model_never_wins():
    generator = np.random.default_rng(0)
    u = 5.0 * np.sin(np.linspace(0.0, 20.0, 2000))[None]
    one = Record(u, 2.0 * u + 0.01 * generator.standard_normal(u.shape), 1e-3)
    model, _ = identify([one], plain(operators=1))
    from hammerstein.dynamics import StateSpaceDynamics

    grows = StateSpaceDynamics(A=((1.1,),), B=((1.0,),), C=((0.0,),), D=((1.0,),), sample_time_s=1e-3)
    squares = fold_squares(Candidate(model.hysteresis, grows), [one], [InitialState("rest")])
    assert np.isinf(squares).all()
    fine = fold_squares(Candidate(model.hysteresis, model.dynamics), [one], [InitialState("rest")])
    assert chosen([Trial("fine", 5, fine), Trial("grows", 2, squares)]) == 0


@pytest.mark.parametrize(("gain", "kept"), [(0.0007, 0), (0.015, 0), (0.025, 1)])
def test_a_sure_gain_is_worth_its_parameters_from_two_percent_on(gain, kept):
    """A gain that is the same on every part is infinitely many standard errors; its size decides."""
    squares = np.array([1.0, 1.3, 0.8, 0.9])
    few, many = Trial("few", 11, squares), Trial("many", 31, (1.0 - gain) ** 2 * squares)
    assert chosen([few, many]) == kept


@pytest.mark.full
def test_the_model_that_is_kept_obeys_the_rule_on_its_page(stage_fit):
    model, fit = stage_fit
    assert (
        "within 2 % of the lowest, or within 5 % and one standard error of it"
        in fit_page(model, fit).markdown()
    )
    told = [trial for trial in fit.trials if trial.told]
    enough = [trial for trial in told if 0.98 * trial.percent <= min(t.percent for t in told)]
    kept = next(trial for trial in fit.trials if trial.kept)
    assert kept.parameters <= min(trial.parameters for trial in enough)


@pytest.mark.full
def test_linear_dynamics_that_are_kept_alone_stand_on_the_page():
    made = made_up.stage(4, loop=0.0, plays=2, resonances_hz=(150.0, 190.0), noise_um=0.02, rate_hz=5e3)
    fitted, held = stage_records(made, np.random.default_rng(3), cycles=4, hz=5.0)
    model, fit = identify(fitted, Settings(), validation=[held])
    assert fit.kind == "linear_dynamics"
    row = next(line for line in fit_page(model, fit).markdown().splitlines() if line.startswith("| y1 | 1"))
    assert float(row.split("|")[2].split("±")[0]) == pytest.approx(150.0, rel=0.01)
    assert "response" in identified_figures(fit)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
@pytest.mark.full
def test_a_model_is_hardly_worse_than_a_simpler_one(seed):
    """As in the long harness, where one in twenty may be worse by more than this, none by twice."""
    assert try_actuator(seed).ratio <= 1.05

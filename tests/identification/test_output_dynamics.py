"""Lag, resonance, creep and delay found together with hysteresis of any kind."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import theory
from block_fits import fit_kind
from record_cases import plain
from stack_cases import CREEP, DAMPING, LAG_S, RATE_HZ, RESONANCE_HZ, record_um
from test_measured import loops, micromanipulator, needs_dbo, needs_ja  # noqa: F401

from hammerstein import run
from hammerstein.dynamics import AxesDynamics, Axis, CreepMode, discretise
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    BoucWenPair,
    DeadZones,
    Pair,
    PrandtlIshlinskii,
    RateDependent,
    RatePlays,
)
from hammerstein.identification.excitation import rates_of_input
from hammerstein.identification.fit_report import axis_statements
from hammerstein.identification.identify import identify
from hammerstein.identification.kinds import several_rates
from hammerstein.identification.linear.axis_fit import AxisFit, fit_axis
from hammerstein.identification.linear.axis_task import AxisShape, AxisTask
from hammerstein.identification.output_dynamics import sure_axis
from hammerstein.identification.score import Candidate, SensorModel
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

T = 1e-4
BOTH = ((5.0, 0.6), (60.0, 0.3))
R, W = np.array([0.0, 1.0, 3.0, 6.0]), np.array([3.0, 0.4, 0.5, 0.6])


def sines(hz, seconds, swing=10.0):
    t = T * np.arange(round(seconds / T))
    size = swing * np.interp(t, [0.0, 0.6 * seconds, seconds], [1.0, 0.3, 0.8])
    return (size * np.sin(2.0 * np.pi * hz * t))[None]


def static_um(kind, u):
    if kind == "bouc_wen":
        return theory.bouc_wen(u, [[14.0]], [[4.0]], [[0.25]], [[0.1]])
    if kind == "asymmetric":
        return theory.asymmetric(u, [[R]], [[W]], [[[-3.0, 3.0]]], [[[0.4, -0.6]]], [0.0])
    return theory.rate_dependent(u, T, [R], [np.array([0.0, 4e-4, 4e-4, 4e-4])], [200.0], [0.0], [[W]])


def record_of(kind, path, hz, seconds, seed):
    u = sines(hz, seconds)
    y = path.respond(static_um(kind, u))[0]
    return Record(u, y + 0.005 * np.random.default_rng(seed).standard_normal(y.shape), T)


@pytest.mark.parametrize("kind", ["asymmetric", pytest.param("bouc_wen", marks=pytest.mark.full)])
def test_lag_and_creep_behind_each_kind_are_found_again(kind):
    axis = Axis(lag_s=1e-3, creep=(CreepMode(gain=0.06, time_constant_s=0.15),))
    path = discretise(AxesDynamics(axes=(axis,)), T)
    records = [record_of(kind, path, 10.0, 1.0, 1), record_of(kind, path, 60.0, 0.5, 2)]
    kept = {"thresholds_v": R, "dynamics": "lag", "error_curve": False, "start": "rest"}
    kept |= {"dead_zones": 5} if kind == "asymmetric" else {}
    model, fit = identify(records, Settings(hysteresis=kind, **kept))
    [found] = model.dynamics.axes
    assert found.lag_s == pytest.approx(1e-3, rel=0.02)
    assert [mode.gain for mode in found.creep] == pytest.approx([0.06], rel=0.05)
    assert [mode.time_constant_s for mode in found.creep] == pytest.approx([0.15], rel=0.1)
    assert model.dynamics.input_delay_s == 0.0
    assert fit.kind == "hammerstein"
    assert fit.fit["hammerstein"].nrmse_percent[0] < 0.5 * fit.fit["classical"].nrmse_percent[0]


def test_the_rate_keeps_what_is_its_own_and_the_lag_what_is_not():
    """Fitted in turn they do not come there: a lag explains much of what growing thresholds do."""
    path = discretise(AxesDynamics(axes=(Axis(lag_s=1e-3),)), T)
    records = [record_of("rate_dependent", path, *both, seed) for seed, both in enumerate(BOTH)]
    kept = {"thresholds_v": R, "dynamics": "lag", "creep_modes": 0, "error_curve": False, "start": "rest"}
    model, fit = identify(records, Settings(hysteresis="rate_dependent", **kept))
    [plays] = model.hysteresis.inputs
    assert model.dynamics.axes[0].lag_s == pytest.approx(1e-3, rel=1e-3)
    assert plays.growth_s[-1] == pytest.approx(4e-4, rel=1e-3)
    assert plays.bandwidth_hz == pytest.approx(200.0, rel=2e-3)
    np.testing.assert_allclose(model.hysteresis.weights[0], W, atol=1e-3)
    assert fit.fit["hammerstein"].rms_um[0] == pytest.approx(0.005, rel=0.02)  # its noise


def test_plays_before_the_same_axes_are_what_a_kind_is_compared_with():
    """Of plays behind a lag dead-zones explain nothing: static plays are no comparison."""
    path = discretise(AxesDynamics(axes=(Axis(lag_s=1e-3),)), T)
    records = []
    for seed, (hz, seconds) in enumerate(BOTH):
        u = sines(hz, seconds)
        y = path.respond(theory.asymmetric(u, [[R]], [[W]], [[[3.0]]], [[[0.0]]], [0.0]))[0]
        records.append(Record(u, y + 0.005 * np.random.default_rng(seed).standard_normal(y.shape), T))
    kept = {"thresholds_v": R, "dynamics": "lag", "creep_modes": 0, "error_curve": False, "start": "rest"}
    _, fit = identify(records, Settings(hysteresis="asymmetric", dead_zones=2, **kept))
    assert fit.fit["static_hysteresis"].mean_percent > 10.0 * fit.fit["hammerstein"].mean_percent
    assert fit.fit["classical"].mean_percent < 1.1 * fit.fit["hammerstein"].mean_percent
    assert "Hysteresis beyond plays does not improve the model" in fit.verdict
    assert "The linear dynamics improve the model" in fit.verdict


@pytest.mark.full
def test_an_envelope_that_bent_to_a_resonance_is_found_straight_once_there_is_one():
    """Plays behind a resonance, driven by a slow sine and a multisine: the envelope has nothing to do."""
    path = discretise(AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),)), 0.5 * T)
    time_s, rng = 0.5 * T * np.arange(3000), np.random.default_rng(1)
    lines_hz = np.arange(20.0, 400.0, 20.0 / 3.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, lines_hz.size)
    multisine = np.sin(2.0 * np.pi * np.outer(lines_hz, time_s) + phases[:, None]).sum(axis=0)
    multisine *= 10.0 / np.abs(multisine).max() * np.minimum(1.0, time_s / 0.01)
    u = np.concatenate([np.zeros(20), 10.0 * np.sin(2.0 * np.pi * 20.0 * time_s), multisine])[None]
    y = path.respond(theory.asymmetric(u, [[R]], [[W]], [[[3.0]]], [[[0.0]]], [0.0]))[0]
    record = Record(u, y + 0.04 * rng.standard_normal(y.shape), 0.5 * T)
    kept = {"dynamics": "second_order", "creep_modes": 0, "error_curve": False}
    model, fit = identify([record], Settings(hysteresis="generalised", **kept))
    voltages = np.linspace(-9.9, 9.9, 400)
    np.testing.assert_allclose(np.ptp(model.hysteresis.envelopes[0].of(voltages) - voltages), 0.0, atol=0.1)
    assert model.dynamics.axes[0].resonance_hz == pytest.approx(280.0, rel=1e-3)
    assert fit.fit["hammerstein"].rms_um[0] == pytest.approx(0.04, rel=0.02)


def test_a_delay_of_parts_of_a_sample_is_found_beside_lag_and_dead_zones():
    axis = Axis(lag_s=1e-3)
    late = AxesDynamics(axes=(axis,), input_delay_s=1.4 * T)
    path = discretise(late, T)
    records = [record_of("asymmetric", path, *both, seed) for seed, both in enumerate(BOTH)]
    kept = {"thresholds_v": R, "dynamics": "lag", "creep_modes": 0, "error_curve": False, "start": "rest"}
    model, _ = identify(records, Settings(hysteresis="asymmetric", dead_zones=5, **kept))
    assert model.dynamics.input_delay_s == pytest.approx(1.4 * T, abs=0.05 * T)
    assert model.dynamics.axes[0].lag_s == pytest.approx(1e-3, rel=0.01)


@pytest.mark.full
def test_growth_suits_the_weights_that_it_will_have():
    """A falling weight, which is held at zero: growth and lag are where bounded weights leave least."""
    path = discretise(AxesDynamics(axes=(Axis(lag_s=1e-3),)), T)
    bent = np.array([3.0, 0.4, -0.1, 0.6])
    u = [sines(*both) for both in BOTH]
    v = [theory.rate_dependent(x, T, [R], [np.append(0.0, [2e-4] * 3)], [200.0], [0.0], [[bent]]) for x in u]
    noise = np.random.default_rng(5)
    y = [path.respond(one)[0] + 0.005 * noise.standard_normal(one.shape) for one in v]
    records = [Record(x, one, T) for x, one in zip(u, y, strict=True)]
    kept = {"thresholds_v": R, "dynamics": "lag", "creep_modes": 0, "error_curve": False, "start": "rest"}
    model, _ = identify(records, Settings(hysteresis="rate_dependent", **kept))
    block, [axis] = model.hysteresis, model.dynamics.axes
    assert block.weights[0][2] == 0.0

    def left(growth=1.0, bandwidth=1.0, lag=1.0):
        plays = block.inputs[0]
        near = RatePlays(R, growth * plays.growth_s, bandwidth * plays.bandwidth_hz)
        behind = (Axis(lag_s=lag * axis.lag_s),)
        like = RateDependent((near,), block.weights_um_per_v)
        known = {"grids": [R], "axes": behind, "like": like, "refined": False}
        return fit_kind("rate_dependent", records, **known).rms_um[0]

    least = left()
    for name in ("growth", "bandwidth", "lag"):
        assert min(left(**{name: part}) for part in (0.8, 0.95, 1.05, 1.25)) > (1.0 - 1e-5) * least


def test_a_single_rate_tells_no_lag_unless_it_is_asked_for():
    path = discretise(AxesDynamics(axes=(Axis(lag_s=1e-3),)), T)
    record = record_of("asymmetric", path, 20.0, 0.5, 1)
    kept = {"thresholds_v": R, "delay_samples": 0, "error_curve": False, "start": "rest", "dead_zones": 3}
    assert identify([record], Settings(hysteresis="asymmetric", **kept))[0].dynamics.kind == "static"
    asked = Settings(hysteresis="asymmetric", dynamics="lag", creep_modes=0, **kept)
    assert identify([record], asked)[0].dynamics.axes[0].lag_s == pytest.approx(1e-3, rel=0.1)


# ---- what went before a record, for every kind ----


def blocks():
    plays = PrandtlIshlinskii([[Pair(R, W)]])
    return [
        plays,
        Asymmetric(plays, [[DeadZones([-3.0, 3.0], [0.4, -0.6])]]),
        RateDependent((RatePlays(R, [0.0, 4e-5, 4e-5, 4e-5], 200.0),), ((W,),)),
        BoucWen([[BoucWenPair(14.0, 4.0, 0.25, 0.1)]]),
    ]


@pytest.mark.parametrize("block", blocks(), ids=lambda block: block.kind)
def test_a_record_that_begins_after_a_turn_is_predicted_as_the_end_of_a_longer_one(block):
    """Driven from 0 to 9 V and back to 2 V so slowly that no rate is left, then on."""
    before = np.concatenate([np.linspace(0.0, 9.0, 9000), np.linspace(9.0, 2.0, 9000), np.full(4000, 2.0)])
    after = 2.0 + 3.0 * np.sin(np.arange(600) / 40.0)
    axis = AxesDynamics(axes=(Axis(lag_s=2e-3),))
    longer = Record([np.append(before, after)], [np.append(before, after)], T)
    whole = Candidate(block, axis).predict(longer, InitialState("rest"))
    part = Record([after], [after], T)
    said = Candidate(block, axis).predict(part, InitialState("turned", 0, ((0.0, 9.0),)))
    np.testing.assert_allclose(said, whole[:, len(before) :], atol=1e-3)


# ---- the whole actuator ----


@cache
def stack_records():
    def record(hz, seconds, seed):
        u, y = record_um(hz, seconds, seed)
        return Record(u, y, 1.0 / RATE_HZ, ("u",), ("x",), f"{hz:g}.csv")

    return [record(20.0, 3.0, 1), record(100.0, 1.0, 2)], record(40.0, 1.5, 3)


@pytest.mark.long
def test_a_whole_stack_is_found_and_followed_at_a_frequency_between():
    """Plays, dead-zones, lag, resonance, two slow modes, saturated start; classical beside: 0.9 %."""
    records, held = stack_records()
    model, fit = identify(records, Settings(hysteresis="asymmetric"), validation=[held])
    [axis] = model.dynamics.axes
    assert fit.validation["hammerstein"].nrmse_percent[0] <= 0.05  # 0.15 was wanted
    assert fit.validation["classical"].nrmse_percent[0] > 0.6
    assert axis.lag_s == pytest.approx(LAG_S, rel=0.02)
    assert axis.resonance_hz == pytest.approx(RESONANCE_HZ, rel=0.02)
    assert axis.damping_ratio == pytest.approx(DAMPING, rel=0.05)
    assert sorted(mode.gain for mode in axis.creep) == pytest.approx([gain for gain, _ in CREEP], rel=0.02)
    times = sorted(mode.time_constant_s for mode in axis.creep)
    assert times == pytest.approx([time_s for _, time_s in CREEP], rel=0.02)
    assert {start.kind for start in fit.starts} == {"turned"}  # of both it is told that they stood saturated


@needs_ja
@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("11_TwoStepSolver_{}_MnZn_HP_ferrite.mat", 3),
        ("12_Automation2018_{}_MnZn_ferrite.mat", 2),
        pytest.param("1_isotropic_{}_MnZn_ferrite.mat", 2, marks=pytest.mark.full),
        pytest.param("1_isotropic_{}_MnZn_ferrite.mat", 3, marks=pytest.mark.full),
        pytest.param("2_anisotropic_{}_amorf.mat", 0, marks=pytest.mark.full),
    ],
)
def test_dead_zones_follow_saturation_where_plays_are_flagged(name, number):
    """With nothing asked for but the kind; four times less than 15 plays, three were wanted."""
    record = loops(name)[number]
    _, fit = identify([record], Settings(hysteresis="asymmetric"))
    ours, plays = (fit.fit[kind].nrmse_percent[0] for kind in ("static_hysteresis", "classical"))
    assert 4.0 * ours <= plays
    assert fit.flags == ()
    assert fit.invertible
    assert identify([record], plain())[1].flags != ()


@needs_dbo
def test_the_delay_of_the_micromanipulator_is_chosen_from_its_records(micromanipulator):  # noqa: F811
    """On the fitted record alone; chosen by the one held back itself, it left 0.65 % of that one."""
    (record,), (other,) = micromanipulator
    records, held = [record.part(400, record.samples)], [other.part(400, other.samples)]
    _, fit = identify(records, Settings(hysteresis="asymmetric"), validation=held)
    assert fit.fit["static_hysteresis"].nrmse_percent[0] <= 0.50
    assert fit.validation["static_hysteresis"].nrmse_percent[0] <= 0.70
    assert fit.delay_samples in (3, 4)  # folds of the fitted record alone say so
    assert fit.invertible


def slow_then_fast(parts):
    """Sines one after the other: amplitude [V], frequency [Hz], cycles."""
    return np.concatenate(
        [a * np.sin(2.0 * np.pi * f * T * np.arange(round(n / f / T))) for a, f, n in parts]
    )


@pytest.mark.parametrize(
    ("u", "several"),
    [
        (slow_then_fast([(10.0, 5.0, 5)]), False),
        (slow_then_fast([(10.0, 5.0, 3), (5.0, 5.0, 3), (2.0, 5.0, 3)]), False),
        (slow_then_fast([(10.0, 5.0, 3), (2.0, 200.0, 20)]), True),
        (slow_then_fast([(10.0, 5.0, 3), (0.2, 200.0, 20)]), False),  # too small to be told by
        (
            np.interp(
                np.arange(900),
                [0, 100, 300, 500, 700, 750, 800, 850, 900],
                np.array([0, 1, -1, 1, -1, -0.5, -1, -0.5, -1]),
            ),
            False,
        ),  # of one speed
    ],
)
def test_rates_are_several_in_one_record_too(u, several):
    assert several_rates([Record([u], [u], T)]) == several


@cache
def hardly_creeping(creep_modes):
    """A record whose slow sine and fast one tell a low-pass, and creep of 0.2 % not quite."""
    t = 1e-3 * np.arange(12_000)
    u = np.where(t < 10.0, 8.0 - 8.0 * np.cos(np.pi * t), 3.2 * np.sin(80.0 * np.pi * t))[None]
    axis = Axis(lag_s=2e-3, creep=(CreepMode(gain=0.002, time_constant_s=3.0),))
    y = discretise(AxesDynamics(axes=(axis,)), 1e-3).respond(static_um("bouc_wen", u))[0]
    record = Record(u, y + 0.005 * np.random.default_rng(1).standard_normal(y.shape), 1e-3)
    kept = {"thresholds_v": R, "dynamics": "lag", "error_curve": False, "start": "rest", "dead_zones": 3}
    return identify([record], Settings(hysteresis="asymmetric", creep_modes=creep_modes, **kept))


@pytest.mark.full
def test_creep_that_is_asked_for_stays_and_is_said_to_be_unsure():
    """With plays it always did; behind other kinds it was left out without a word."""
    [free], [asked] = (hardly_creeping(modes)[0].dynamics.axes for modes in ("auto", 1))
    assert free.creep == ()
    assert len(asked.creep) == 1
    assert any("creep of y1 with a time constant" in text for text in hardly_creeping(1)[1].not_identifiable)


def test_creep_that_is_left_out_although_it_explains_much_is_told():
    axis = Axis(lag_s=1e-3)
    slow = axis.model_copy(update={"creep": (CreepMode(gain=0.07, time_constant_s=1.8),)})
    larger = AxisFit(slow, None, None, (0.05,), rms_um=0.03, static_rms_um=1.0, lag_error_percent=1.0)
    fit = AxisFit(axis, None, None, (), rms_um=0.07, static_rms_um=1.0, lag_error_percent=1.0, unsure=larger)
    [text] = [text for text in axis_statements(["x"], [fit]) if "creep" in text]
    assert "a slow mode with a time constant of 1.8 s would lower the error from 0.07 to 0.03 um" in text
    assert "(0.07 ± 0.05)" in text
    assert text.endswith("--creep-modes 1")
    hardly = replace(fit, unsure=replace(larger, rms_um=0.068))
    assert not any("creep" in text for text in axis_statements(["x"], [hardly]))


def test_a_resonance_that_is_left_out_says_nothing_of_creep():
    """The slow mode that is kept beside it was told once as left out."""
    slow = CreepMode(gain=0.05, time_constant_s=0.15)
    t = T * np.arange(10_000)
    u = 8.0 * np.sin(2.0 * np.pi * 10.0 * t)[None]
    y = discretise(AxesDynamics(axes=(Axis(creep=(slow,)),)), T).respond(static_um("asymmetric", u))[0]
    record = Record(u, y + 0.005 * np.random.default_rng(1).standard_normal(y.shape), T)
    task = AxisTask((record,), (InitialState("rest"),), (R,), 0, AxisShape(creep_modes=1), 0.0, SensorModel())
    x = np.array([np.log(2.0 * np.pi * 3000.0), np.log(0.5), 0.05, np.log(0.15)])
    fit = sure_axis(task, fit_axis(task, x), asked=False)
    assert fit.axis.resonance_hz is None
    assert fit.unsure is None


def test_of_a_resonance_and_a_low_pass_that_is_not_told_the_resonance_stays():
    """The resonance left, and a lag of 16 us stayed, with two and a half times the error."""
    t = T * np.arange(10_000)
    u = 8.0 * np.sin(2.0 * np.pi * (5.0 + 300.0 * t) * t)[None]
    true = Axis(resonance_hz=500.0, damping_ratio=0.03)
    y = discretise(AxesDynamics(axes=(true,)), T).respond(static_um("asymmetric", u))[0]
    record = Record(u, y + 0.05 * np.random.default_rng(1).standard_normal(y.shape), T)
    shape = AxisShape(resonance=True, lag=True)
    task = AxisTask((record,), (InitialState("rest"),), (R,), 0, shape, 0.0, SensorModel())
    whole = fit_axis(task, np.log([500.0, 0.03, 1e-5]))
    assert not whole.identified
    fit = sure_axis(task, whole, asked=False)
    assert fit.axis.lag_s is None
    assert fit.axis.resonance_hz == pytest.approx(500.0, rel=1e-3)


@pytest.mark.parametrize("seconds", [2.0, 2.25, 3.0, 3.1])
def test_one_rate_is_one_rate_however_long_the_record(seconds):
    """Records of 2 s passed and those of 3 s were refused: parts of a record cut its cycles anywhere."""
    t = T * np.arange(round(seconds / T))
    record = Record([10.0 * np.sin(2.0 * np.pi * 1.0 * t)], [t], T)
    assert rates_of_input([record]) == (False,)


def test_creep_goes_on_the_way_of_the_displacement():
    """Behind plays a mode of -0.156 explained what a record's unknown past had left."""
    t = T * np.arange(10_000)
    u = np.where(t < 0.5, 5.0, 5.0 * np.cos(20.0 * np.pi * (t - 0.5)))[None]
    y = static_um("asymmetric", u) + 8.0 * np.exp(-t / 0.1)
    task = AxisTask(
        (Record(u, y, T),), (InitialState("rest"),), (R,), 0, AxisShape(False, True, 1), 0.0, SensorModel()
    )
    fit = fit_axis(task, np.array([np.log(1e-3), 0.02, np.log(0.1)]))
    assert 0.0 <= fit.axis.creep[0].gain <= 1.0


def test_creep_goes_no_farther_than_the_fast_displacement():
    """What creeps by 1.6 times as much is none of a piezo: the mode stays at its limit."""
    t = T * np.arange(10_000)
    u = np.where(t < 0.5, 5.0, 5.0 * np.cos(20.0 * np.pi * (t - 0.5)))[None]
    far = AxesDynamics(axes=(Axis(creep=(CreepMode(gain=1.6, time_constant_s=0.1),)),))
    y = discretise(far, T).respond(static_um("asymmetric", u))[0]
    task = AxisTask(
        (Record(u, y, T),), (InitialState("rest"),), (R,), 0, AxisShape(False, False, 1), 0.0, SensorModel()
    )
    fit = fit_axis(task, np.array([0.5, np.log(0.1)]))
    assert fit.axis.creep[0].gain == 1.0


@pytest.mark.parametrize("seed", [4, 5])
def test_a_resonance_is_found_that_the_static_response_hides(seed):
    """Behind the response that is best without axes, errors fall past both, to the highest frequency."""
    scenario = {
        "question": "Are the resonances found?",
        "actuator": "duo_bimorph",
        "seed": seed,
        "reference": {"kind": "sine", "axis": 1, "amplitude_um": 20.0, "frequency_hz": 100.0},
        "compensators": [
            {"label": "a", "law": "hammerstein_inverse", "identification": {"method": "hammerstein"}}
        ],
    }
    rows = [row for row in run(scenario).rows if row.measured_axis == "x"]
    assert rows
    assert max(row.figures["rms_true_um"] for row in rows) < 0.05  # 1.97 um without the resonances

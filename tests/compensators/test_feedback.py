import json
from dataclasses import replace
from types import SimpleNamespace

import control
import numpy as np
import pytest

from hammerstein.blocks.instruments import Drive, Instruments, Sensor
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.feedback.loop import Gains
from hammerstein.compensators.feedback.pid import FeedbackController, closed_loop
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.set_up import set_up
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import WIRES, Plant
from hammerstein.scenario import Scenario

T = 50e-6
SENSOR = Sensor()
QUIET = Sensor(noise_um=0.0, resolution_um=0.0)


def _model(damping=0.12, resonances=(280.0, 306.0), linear=False):
    direct, cross = Pair([0.05, 0.4, 2.0, 5.0], [4.0, 0.5, 1.0, 1.5]), Pair([0.05, 1.0], [0.3, -0.1])
    if linear:
        direct, cross = Pair.linear(5.0), Pair.absent()
    p = len(resonances)
    rows = tuple(tuple(direct if o == k else cross for k in range(p)) for o in range(p))
    dynamics = AxesDynamics(axes=tuple(Axis(resonance_hz=f, damping_ratio=damping) for f in resonances))
    return HammersteinModel("test", PrandtlIshlinskii(rows), dynamics, 10.0, ("u", "v")[:p], ("x", "y")[:p])


@pytest.fixture(scope="module")
def model():
    return _model()


@pytest.fixture(scope="module")
def law(model):
    return FeedbackController(model, 10.0, T, 2000.0)


def _plant(model, sensor=SENSOR, drive=None):
    return Plant(model, Instruments(drive=drive or Drive(), sensor=sensor))


def _run(law, model, path, sensor=SENSOR, drive=None, seed=3):
    return closed_loop(law, _plant(model, sensor, drive), path, [seed])


def _path(samples=1200, frequency_hz=20.0, radius=20.0):
    angle = 2.0 * np.pi * frequency_hz * T * np.arange(samples)
    return radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)])


def test_every_wire_is_what_the_blocks_one_by_one_give(law, model):
    path = _path()
    run = _run(law, model, path)
    drive, saturated = Drive().apply(run.requested_v)
    assert (run.drive_v == drive).all()
    assert (run.saturated == saturated).all()
    v, _ = model.hysteresis.respond(run.drive_v)
    assert (run.hysteresis_um == v).all()
    block = discretise(model.dynamics, T, SENSOR.bandwidth_hz)
    position, filtered = np.split(block.respond(run.hysteresis_um)[0], 2)
    assert (run.position_um == position).all()
    assert (run.reading_um == SENSOR.read(filtered, np.random.default_rng(3))).all()


@pytest.mark.parametrize("forward", [False, True])
def test_one_step_is_the_loop_to_the_last_bit_and_its_state_can_be_saved(model, forward):
    feedforward = ExactInverseLaw(model, 10.0) if forward else None
    law = FeedbackController(model, 10.0, T, 2000.0, feedforward=feedforward)
    path = _path(600, radius=40.0)  # reaches the range
    run = _run(law, model, path)
    ahead = feedforward.drive_for(path) if forward else np.zeros((2, 600))
    state = law.rest()
    for k in range(599):
        asked, state = law.request(law.correct(path[:, k], run.reading_um[:, k], state), ahead[:, k + 1])
        assert (asked == run.requested_v[:, k + 1]).all()
        if k % 100 == 50:
            state = law.restore(json.loads(json.dumps(state.as_dict())))


def test_integral_action_leaves_no_error_at_rest(law, model):
    path = np.tile([[15.0], [-20.0]], (1, 6000))
    run = _run(law, model, path, QUIET, Drive(resolution_v=0.0))
    np.testing.assert_allclose(run.position_um[:, -1], path[:, -1], atol=1e-3)


def test_leaves_the_range_as_soon_as_the_reference_does(law, model):
    """A wish far beyond reach for 0.2 s winds nothing up."""
    path = np.zeros((2, 10000))
    path[0, 1000:5000] = 500.0
    run = _run(law, model, path, QUIET)
    at_range = np.abs(run.requested_v[0]) >= 10.0
    assert at_range[4500:5000].all()
    assert not at_range[5020:].any()
    assert np.abs(run.position_um[0, 7000:]).max() < 1.0


def test_integral_gain_of_a_lone_resonance_is_twice_damping_times_frequency_over_the_margin():
    """With an ideal sensor on a fine grid |1 + L| is smallest at w_n, where L = -k / (2 z w_n)."""
    model = _model(damping=0.02, resonances=(280.0,), linear=True)
    gains = FeedbackController(model, 10.0, 1e-6).gains
    limit = 2.0 * 0.02 * 2.0 * np.pi * 280.0
    assert gains.integral_per_s[0] == pytest.approx((1.0 - 1.0 / 1.6) * limit, rel=0.12)
    assert gains.derivative_s[0] == 0.0


def test_the_greatest_slope_of_the_hysteresis_limits_the_gains():
    """Its slopes are 4 to 7 um/V: the loop is fastest, and its sensitivity largest, at 7."""
    model = _model(resonances=(280.0,))
    gains = FeedbackController(model, 10.0, T, 2000.0).gains
    kp, ki = gains.proportional[0], gains.integral_per_s[0]
    r, w_um_per_v = np.array([0.05, 0.4, 2.0, 5.0]), np.array([4.0, 0.5, 1.0, 1.5])
    gain = w_um_per_v @ (10.0 - r) / 10.0
    w, lag = 2.0 * np.pi * 280.0, 2.0 * np.pi * 2000.0
    s, z = control.tf("s"), control.tf([1, 0], [1], T)
    plant = control.c2d(w**2 / (s**2 + 0.24 * w * s + w**2) * lag / (s + lag), T, "zoh")
    on_circle = np.exp(2j * np.pi * np.geomspace(0.1, 9999.0, 4000) * T)
    peaks = []
    for slope in np.cumsum(w_um_per_v):
        loop = (ki * T * z / (z - 1) + kp) * plant / z * slope / gain
        sensitivity = control.feedback(1, control.minreal(loop, verbose=False))
        assert np.abs(sensitivity.poles()).max() < 1.0
        peaks.append(np.abs(sensitivity(on_circle)).max())
    assert peaks[0] < peaks[-1]
    assert 1.4 < peaks[-1] < 1.6 * 1.01


def test_saturated_is_where_more_is_asked_than_the_drive_gives(law, model):
    run = _run(law, model, _path(radius=62.0, frequency_hz=50.0), QUIET)
    np.testing.assert_array_equal(run.saturated, np.abs(run.requested_v) > 10.0)
    assert run.saturated.any()
    assert np.abs(run.requested_v).max() < 20.0


@pytest.mark.parametrize("asked_v", [-10.0, 10.0])
def test_the_end_of_the_range_itself_is_not_saturated(model, asked_v):
    nothing = Gains(np.zeros(2), np.zeros(2), np.zeros(2))
    forward = SimpleNamespace(
        drive_for=lambda reference_um: np.full(reference_um.shape, asked_v), delay_samples=0
    )
    law = FeedbackController(model, 10.0, T, 2000.0, gains=nothing, feedforward=forward)
    run = _run(law, model, _path(radius=10.0, frequency_hz=50.0), QUIET)
    assert (run.requested_v == asked_v).all()
    assert not run.saturated.any()


@pytest.mark.parametrize("derivative", [False, True])
def test_computed_gains_keep_the_sensitivity(derivative):
    """Sensitivity and poles of the closed loop, from python-control alone."""
    model = _model(resonances=(280.0,), linear=True)
    gains = FeedbackController(model, 10.0, T, 2000.0, derivative=derivative).gains
    kp, ki, kd = gains.proportional[0], gains.integral_per_s[0], gains.derivative_s[0]
    w, lag = 2.0 * np.pi * 280.0, 2.0 * np.pi * 2000.0
    s, z = control.tf("s"), control.tf([1, 0], [1], T)
    plant = control.c2d(w**2 / (s**2 + 0.24 * w * s + w**2) * lag / (s + lag), T, "zoh")
    controller = ki * T * z / (z - 1) + kp + kd / T * (z - 1) / z
    sensitivity = control.feedback(1, control.minreal(controller * plant / z, verbose=False))
    assert np.abs(sensitivity.poles()).max() < 1.0
    peak = np.abs(sensitivity(np.exp(2j * np.pi * np.geomspace(0.1, 9999.0, 4000) * T))).max()
    assert 1.4 < peak < 1.6 * 1.01


@pytest.mark.parametrize("sample_time_s", [T, 0.5 * T])
def test_the_controller_is_pid_in_time(model, sample_time_s):
    """Proportional to the error, to its integral and to its derivative; gains do not know the sample time."""
    kp, ki, kd = np.array([0.3, 0.1]), np.array([40.0, 70.0]), np.array([2e-4, 1e-4])
    law = FeedbackController(model, 10.0, sample_time_s, gains=Gains(kp, ki, kd))
    error = 0.5 * np.random.default_rng(0).normal(size=(20, 2))
    integral = sample_time_s * error.cumsum(axis=0)
    derivative = np.diff(error, axis=0, prepend=0.0) / sample_time_s
    expected = (kp * error + ki * integral + kd * derivative) @ law.inverse_gain_v_per_um.T
    state, found = law.rest(), []
    for wanted in error:
        asked, state = law.request(law.correct(wanted, np.zeros(2), state))
        found.append(asked)
    assert np.abs(expected).max() < 10.0  # nothing is cut off
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("damping", [0.12, 1e-3, 1e-6])
def test_the_loop_gain_is_1_at_the_frequency_that_is_stated(damping):
    """Loop gain from python-control alone; loops of hardly damped stages were said to cross at 0 Hz."""
    model = _model(damping=damping, resonances=(280.0,), linear=True)
    gains = FeedbackController(model, 10.0, T, 2000.0).gains
    w, lag = 2.0 * np.pi * 280.0, 2.0 * np.pi * 2000.0
    s = control.tf("s")
    plant = control.c2d(w**2 / (s**2 + 2.0 * damping * w * s + w**2) * lag / (s + lag), T, "zoh")
    z = np.exp(2j * np.pi * gains.crossover_hz[0] * T)
    controller = gains.integral_per_s[0] * T / (1.0 - 1.0 / z) + gains.proportional[0]
    assert abs(controller * plant(z) / z) == pytest.approx(1.0, rel=1e-4)


def test_derivative_action_follows_faster(model):
    plain, damped = (FeedbackController(model, 10.0, T, 2000.0, derivative=d).gains for d in (False, True))
    assert (damped.integral_per_s > 5.0 * plain.integral_per_s).all()
    assert (damped.crossover_hz > plain.crossover_hz).all()
    assert "s derivative, loop gain 1 at" in damped.statement()


def test_feedback_takes_out_what_a_wrong_feedforward_leaves(model):
    wrong = HammersteinInverseLaw(_model(resonances=(260.0, 330.0)), 10.0, T)
    stiffer = tuple(
        tuple(Pair(q.thresholds_v, 1.1 * q.weights_um_per_v) for q in row) for row in model.hysteresis.pairs
    )
    plant = HammersteinModel(
        "stiffer", PrandtlIshlinskii(stiffer), model.dynamics, 10.0, ("u", "v"), ("x", "y")
    )
    path = _path(6000, frequency_hz=2.0)

    def error(law):
        return np.abs(_run(law, plant, path).position_um - path)[:, 1000:].max()

    none = Gains(*np.zeros((3, 2)))
    alone = error(FeedbackController(model, 10.0, T, 2000.0))
    forward = error(FeedbackController(model, 10.0, T, 2000.0, none, feedforward=wrong))
    both = error(FeedbackController(model, 10.0, T, 2000.0, feedforward=wrong))
    assert both < 0.3 * min(alone, forward)


def test_a_delayed_feedforward_is_met_with_the_delayed_reference(model):
    late = HammersteinInverseLaw(model, 10.0, T, preview_s=0.0, filter_hz=1500.0)
    path = _path(3000)
    run = _run(FeedbackController(model, 10.0, T, 2000.0, feedforward=late), model, path, QUIET)
    delay = late.delay_samples
    assert np.abs(run.position_um[:, delay:] - path[:, :-delay])[:, 1000:].max() < 0.1


def test_a_model_without_dynamics_gives_no_gains(model):
    static = HammersteinModel(
        "static", model.hysteresis, StaticDynamics(n_outputs=2), 10.0, model.inputs, model.outputs
    )
    with pytest.raises(InputError, match="no dynamics"):
        FeedbackController(static, 10.0, T)
    FeedbackController(static, 10.0, T, gains=Gains(np.zeros(2), np.full(2, 10.0), np.zeros(2)))


def test_gains_of_the_wrong_number_are_refused(model):
    with pytest.raises(InputError, match="give 2 finite values"):
        FeedbackController(model, 10.0, T, gains=Gains(np.zeros(1), np.ones(1), np.zeros(1)))


def test_axes_that_do_not_fit_are_refused(law):
    with pytest.raises(InputError, match="same axes"):
        closed_loop(law, _plant(_model(resonances=(280.0,))), _path(), [0])


def test_a_loop_that_diverges_says_so():
    model = _model(linear=True)
    ideal = Instruments.ideal()
    law = FeedbackController(model, np.inf, T, gains=Gains(np.full(2, 50.0), np.full(2, 1e5), np.zeros(2)))
    with pytest.raises(SimulationError, match="diverges"):
        _run(law, model, _path(8000), ideal.sensor, ideal.drive)


def test_the_sensors_own_lag_is_no_error(model):
    """Readings of a first-order sensor on a ramp: a (t - tau (1 - exp(-t / tau)))."""
    law = FeedbackController(model, 10.0, T, 300.0)
    time, tau = T * np.arange(1, 400), 1.0 / (2.0 * np.pi * 300.0)
    path = np.outer([2000.0, -1000.0], time)
    reading = np.outer([2000.0, -1000.0], time - tau * (1.0 - np.exp(-time / tau)))
    state = law.rest()
    for k in range(len(time)):
        asked, state = law.request(law.correct(path[:, k], reading[:, k], state))
        assert np.abs(asked).max() < 1e-10


def test_a_law_from_a_model_file_works_on_the_scenarios_sensor(tmp_path):
    """A slow sensor must not pass as an error, wherever the model comes from."""
    slow = Sensor(bandwidth_hz=200.0)
    actuator = HammersteinModel.load("duo_bimorph")
    told = replace(actuator, instruments=actuator.instruments.model_copy(update={"sensor": slow}))
    told.save(tmp_path / "told.json")

    def set_up_with(model):
        return set_up(
            Scenario.model_validate(
                {
                    "question": "?",
                    "instruments": {"sensor": {"bandwidth_hz": 200.0}},
                    "reference": {"kind": "sine", "amplitude_um": 20, "frequency_hz": 20, "axis": 1},
                    "compensators": [{"label": "pi", "law": "feedback", "model": model}],
                }
            )
        )

    own, other = set_up_with("duo_bimorph"), set_up_with(str(tmp_path / "told.json"))
    np.testing.assert_allclose(own.laws["pi"]._settings[:, 0], np.exp(-2.0 * np.pi * 200.0 * T), rtol=1e-12)
    np.testing.assert_array_equal(own.laws["pi"]._settings, other.laws["pi"]._settings)
    (case,) = own.cases()
    assert np.array_equal(own.simulate(case).position_um, other.simulate(case).position_um)


@pytest.mark.parametrize(
    "options",
    [{}, {"derivative": True}, {"feedforward": "exact_inverse"}, {"feedforward": "hammerstein_inverse"}],
)
def test_the_compiled_loop_is_the_block_diagram_to_the_last_bit(options):
    """Controller, drive, hysteresis, dynamics and noisy sensor sample by sample, drive cut at times."""
    feedback = {"label": "pi", "law": "feedback", "model": "duo_bimorph", **options}
    scenario = {
        "question": "Is it the same?",
        "reference": {"kind": "circle", "radius_um": 44.0, "frequency_hz": 120.0},
        "compensators": [feedback],
        "measure": {"settle_cycles": 0, "measured_cycles": 1},
        "instruments": {"drive": {"range_v": 9.0}},
    }
    setup = set_up(Scenario.model_validate(scenario))
    (case,) = setup.cases()
    fast = setup.simulate(case)
    plain = setup.plant.closed_loop(setup.laws["pi"], fast.reference_um, case.seed(setup.scenario.seed))
    for wire in WIRES:
        np.testing.assert_array_equal(getattr(fast, wire), getattr(plain, wire), err_msg=wire)
    assert fast.saturated.any() or not options  # the plain controller is too slow to reach the range

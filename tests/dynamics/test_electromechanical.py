"""Piezo stacks from data-sheet numbers, against the printed equations of Goldfarb and Celanovic."""

import control
import numpy as np
import pytest
from scipy.optimize import brentq

import hammerstein
from hammerstein import HammersteinModel
from hammerstein.commands.cli import main
from hammerstein.commands.contents import contents_of
from hammerstein.dynamics import ElastoSlip, ElectromechanicalDynamics, StackAxis, StackMode, on_grid
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.reporting.folder import Writer

STOPS = ((3.0, 0.3), (2.0, 1.0), (1.0, 4.0))


def axis(stops=STOPS):
    """A stack of 400 Hz: 0.5 kg on 3.16 N/um, 2 uF, 1.2 N/V."""
    slips = tuple(ElastoSlip(stiffness_v_per_uc=k, threshold_uc=r) for k, r in stops)
    numbers = {"mass_kg": 0.5, "stiffness_n_per_um": 3.16, "damping_ns_per_m": 60.0}
    return StackAxis(**numbers, capacitance_uf=2.0, force_n_per_v=1.2, stops=slips)


def stop_voltage(q, plays, stops):
    """V_h(q) and the plays after it, from those before."""
    after = [max(q - r, min(q + r, p)) for (_, r), p in zip(stops, plays, strict=True)]
    return sum(k * (q - p) for (k, _), p in zip(stops, after, strict=True)), after


def test_charge_solves_the_voltage_balance_at_every_sample():
    """q + C V_h(q) = C u + T x, by the stops themselves and a root."""
    s = np.random.default_rng(1).normal(size=400).cumsum()
    found, _ = PrandtlIshlinskii([[axis().charge()]]).respond(s[None])
    plays, expected = [0.0] * 3, []
    for value in s:
        q = brentq(lambda q: q + 2.0 * stop_voltage(q, plays, STOPS)[0] - value, -1e3, 1e3, xtol=1e-13)  # noqa: B023
        plays = stop_voltage(q, plays, STOPS)[1]
        expected.append(q)
    np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-10)


def test_without_stops_it_is_a_linear_oscillator():
    """V_z = u: M x'' + D x' + K x = T u, in m and N."""
    time_s = np.arange(400) * 1e-4
    u = np.random.default_rng(2).normal(size=(1, 400))
    found, _ = on_grid(ElectromechanicalDynamics(axes=(axis(()),)), 1e-4).respond(u)
    system = control.c2d(control.tf([1.2], [0.5, 60.0, 3.16e6]), 1e-4)
    expected = 1e6 * control.forced_response(system, time_s, u[0]).outputs
    np.testing.assert_allclose(found[0], expected, atol=1e-7 * np.abs(expected).max())


def march(u, time_s, fine, one=None, force=None):
    """Positions [um] of the printed equations in short steps of Runge and Kutta's method, u and f held."""
    one, force = one or axis(), np.zeros(len(u)) if force is None else force
    r, weights, plays = one.charge().thresholds_v, one.charge().weights_um_per_v, np.zeros(4)
    kg, stiff, damping, ratio = np.array(
        [(m.mass_kg, m.stiffness_n_per_um, 1e-6 * m.damping_ns_per_m, m.output_ratio) for m in one.modes]
    ).T
    x, y, step = np.zeros((2, len(kg))), [], time_s / fine

    def moved(x, value, pushed, plays):
        s = 2.0 * value + 1.2 * x[0].sum()  # C u + T x [uC]
        after = np.maximum(s - r, np.minimum(s + r, plays))
        pull = 1.2 * (weights @ after - 1.2 * x[0].sum()) / 2.0 + pushed  # T V_z + f [N]
        return np.array([x[1], 1e6 * (pull - stiff * x[0] - damping * x[1]) / kg]), after

    for value, pushed in zip(u, force, strict=True):
        y.append(ratio @ x[0])
        for _ in range(fine):
            one, plays = moved(x, value, pushed, plays)
            two = moved(x + 0.5 * step * one, value, pushed, plays)[0]
            three = moved(x + 0.5 * step * two, value, pushed, plays)[0]
            four = moved(x + step * three, value, pushed, plays)[0]
            x = x + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return np.array(y)


def test_stops_on_a_coarse_grid_are_those_of_a_fine_one():
    """At 25 samples in a period of the resonance, the error falls with the square of the sample time."""
    errors = []
    for time_s in (1e-4, 0.5e-4):
        u = 30.0 * np.repeat(np.random.default_rng(5).normal(size=150), round(4e-4 / time_s))
        expected = march(u, time_s, round(time_s / 1e-6))
        found, _ = on_grid(ElectromechanicalDynamics(axes=(axis(),)), time_s).respond(u[None])
        errors.append(float(np.std(found[0] - expected) / np.std(expected)))
    assert errors[0] < 0.006
    assert errors[1] < errors[0] / 3.0


def modes(*ratios, stops=STOPS):
    """The stack with a second mode of 710 Hz and, where there is a third ratio, one of 1.2 kHz."""
    own = axis(stops).model_copy(update={"output_ratio": ratios[0]})
    numbers = ({"mass_kg": 0.4, "stiffness_n_per_um": 8.0}, {"mass_kg": 0.3, "stiffness_n_per_um": 17.0})
    further = [
        StackMode(**each, damping_ns_per_m=50.0, output_ratio=ratio)
        for each, ratio in zip(numbers, ratios[1:], strict=False)
    ]
    return own.model_copy(update={"further_modes": tuple(further)})


@pytest.mark.parametrize("ratios", [(1.0, 1.0), (0.8, -0.5, 0.3)])
def test_every_mode_moves_the_charge_and_is_pushed_by_it(ratios):
    """Of two or three modes, of which the output sees one against the others."""
    u = 30.0 * np.repeat(np.random.default_rng(7).normal(size=150), 20)
    stack = modes(*ratios)
    expected = march(u, 2e-5, 20, stack)
    found, _ = on_grid(ElectromechanicalDynamics(axes=(stack,)), 2e-5).respond(u[None])
    assert np.std(found[0] - expected) < 0.006 * np.std(expected)
    alone, _ = on_grid(ElectromechanicalDynamics(axes=(axis(),)), 2e-5).respond(u[None])
    assert np.std(found[0] - alone[0]) > 0.05 * np.std(expected)  # they count


def test_modes_without_stops_are_those_of_python_control():
    """x = (g_1 + ... + g_n)(T u), y the same with the ratio of each mode."""
    u, time_s = np.random.default_rng(8).normal(size=(1, 400)), np.arange(400) * 1e-4
    found, _ = on_grid(ElectromechanicalDynamics(axes=(modes(0.8, -0.5, stops=()),)), 1e-4).respond(u)
    one = control.tf([0.8 * 1.2], [0.5, 60.0, 3.16e6])
    two = control.tf([-0.5 * 1.2], [0.4, 50.0, 8e6])
    system = control.c2d(control.ss(control.parallel(one, two)), 1e-4)
    expected = 1e6 * control.forced_response(system, time_s, u[0]).outputs
    np.testing.assert_allclose(found[0], expected, atol=1e-7 * np.abs(expected).max())


def test_axes_of_several_modes_do_not_hear_each_other():
    u = 30.0 * np.repeat(np.random.default_rng(9).normal(size=(2, 100)), 20, axis=1)
    both, _ = on_grid(ElectromechanicalDynamics(axes=(modes(0.8, -0.5), axis())), 2e-5).respond(u)
    for k, own in enumerate((modes(0.8, -0.5), axis())):
        alone, _ = on_grid(ElectromechanicalDynamics(axes=(own,)), 2e-5).respond(u[k : k + 1])
        np.testing.assert_allclose(both[k], alone[0], atol=1e-12 * np.abs(alone).max())


def test_a_force_is_a_further_input():
    """Of a stack with its voltage moving, and of one that is shorted."""
    rng = np.random.default_rng(10)
    u, force = (size * np.repeat(rng.normal(size=150), 20) for size in (20.0, 30.0))
    dynamics = ElectromechanicalDynamics(axes=(modes(1.0, 0.4),))
    for volts in (u, np.zeros_like(u)):
        expected = march(volts, 2e-5, 20, dynamics.axes[0], force)
        found, _ = dynamics.block(forces=True).held(2e-5).respond(np.stack([volts, force]))
        assert np.std(found[0] - expected) < 0.006 * np.std(expected)


def test_slow_voltage_moves_it_as_the_static_balance_says():
    """x = T V_z / K, q = C V_z + T x, so that u = V_h(q) + q / (C + T^2 / K)."""
    u = np.interp(np.arange(60_000), [0, 20_000, 40_000, 60_000], [0.0, 30.0, -20.0, 25.0])
    found, _ = on_grid(ElectromechanicalDynamics(axes=(axis(),)), 1e-4).respond(u[None])
    plays, expected = [0.0] * 3, []
    stiff, t, c = 3.16, 1.2, 2.0
    for value in u[::50]:
        q = brentq(
            lambda q: stop_voltage(q, plays, STOPS)[0] + q / (c + t * t / stiff) - value,  # noqa: B023
            -1e4,
            1e4,
        )
        plays = stop_voltage(q, plays, STOPS)[1]
        expected.append(t / stiff * q / (c + t * t / stiff))
    np.testing.assert_allclose(found[0, ::50], expected, atol=2e-3 * np.ptp(expected))


def test_resonance_falls_with_the_amplitude():
    """Stops slip at large charge: the stack between full stiffness and a shorted one gets softer."""
    rng = np.random.default_rng(3)
    block, fs, peaks = on_grid(ElectromechanicalDynamics(axes=(axis(),)), 2e-5), 5e4, []
    u = rng.normal(size=200_000)
    for amplitude in (0.05, 200.0):
        y, _ = block.respond(amplitude * u[None])
        spectrum = np.abs(np.fft.rfft(y[0].reshape(20, -1) * np.hanning(10_000))) ** 2
        hertz = np.fft.rfftfreq(10_000, 1 / fs)
        band = (hertz > 250) & (hertz < 700)
        peaks.append(hertz[band][np.argmax(spectrum.mean(axis=0)[band])])
    assert peaks[0] > peaks[1] + 5.0


def test_a_model_file_keeps_its_numbers(tmp_path):
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    model.save(tmp_path / "stack.json")
    again, u = HammersteinModel.load(tmp_path / "stack.json"), np.random.default_rng(4).normal(size=(1, 200))
    assert np.array_equal(again.simulate(u, 1e-4).position_um, model.simulate(u, 1e-4).position_um)


def test_export_of_the_inverse_says_what_serves_instead(tmp_path, capsys):
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    model.save(tmp_path / "stack.json")
    words = ["--law", "hammerstein_inverse", "--sample-time", "1e-4", "--out", str(tmp_path / "c")]
    with pytest.raises(SystemExit) as caught:
        main(["export", str(tmp_path / "stack.json"), *words])
    assert caught.value.code == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "compensate MODEL PATH --table" in said
    assert "--law model" in said
    assert not (tmp_path / "c").exists()


def test_two_stops_at_one_threshold_are_refused():
    with pytest.raises(InputError, match="add their stiffnesses"):
        axis(((1.0, 0.5), (2.0, 0.5)))


def scenario(tmp_path, law):
    """Sine on a stack with its hysteresis in the loop."""
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    model.save(tmp_path / "stack.json")
    stack = str(tmp_path / "stack.json")
    return {
        "question": "How far does it move?",
        "actuator": stack,
        "reference": {"kind": "sine", "amplitude_um": 1.0, "frequency_hz": 50.0},
        "compensators": [{"label": law, "law": law, "model": stack}],
    }


def test_a_scenario_runs_on_it(tmp_path):
    report = hammerstein.run(scenario(tmp_path, "none"))
    Writer(tmp_path, figures=False)(report)
    assert (
        "electromechanical stacks: 400.1 Hz with 3 stops" in (tmp_path / "scenario" / "report.md").read_text()
    )


def slow_end(volts):
    """Position at the end of a slow loop, from the static balance and the virgin curve of twice the size."""

    def left(q):  # of the settled loop, whose tips are at half of what the virgin curve does for twice q
        voltage = sum(k * min(abs(q), r) * np.sign(q) for k, r in STOPS)
        return voltage + q / (2.0 + 1.2 * 1.2 / 3.16) - volts

    return 1.2 / 3.16 * brentq(left, -1e4, 1e4) / (2.0 + 1.2 * 1.2 / 3.16)


def test_gain_is_that_of_slow_settled_loops(tmp_path):
    """By the balance of the stops at both ends of a loop, and by a slow run of the model itself."""
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    expected = slow_end(50.0) / 50.0
    assert model.gain(50.0)[0, 0] == pytest.approx(expected, rel=1e-9)
    u = 50.0 * np.interp(np.arange(250_001) / 50_000, range(6), [0.0, 1.0, -1.0, 1.0, -1.0, -1.0])
    x = model.simulate(u[None], 1e-5).position_um[0, 50_000:]
    assert 0.5 * np.ptp(x) / 50.0 == pytest.approx(expected, rel=2e-3)
    model.save(tmp_path / "stack.json")
    shown = dict(contents_of(tmp_path / "stack.json")[1])
    assert shown["gain of x [um/V]"] == f"{expected:.4g} from u"
    assert shown["hysteresis"].endswith("gains without hysteresis")


def test_positive_voltages_alone_reach_from_zero_to_the_slow_end():
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    low, high = model.extremes(np.array([0.0]), np.array([50.0]))
    assert low[0] == 0.0
    assert high[0] == pytest.approx(slow_end(50.0), rel=1e-9)


def test_without_a_compensator_the_drive_has_the_right_size():
    """50 V for the end of the slow loop of 50 V; the block in front of the loop has 1 V/um alone."""
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    model = HammersteinModel("stack", one, ElectromechanicalDynamics(axes=(axis(),)), 50.0, ("u",), ("x",))
    law = hammerstein.NoCompensation().design(model, 100.0, 1e-4)
    assert law.drive_for([[0.0, slow_end(50.0)]])[0, 1] == pytest.approx(50.0, rel=1e-9)


def test_a_path_beyond_the_slow_loops_is_out_of_reach(tmp_path):
    """10 V go as far as the balance of the stops says, and not to 10 um as the block in front does."""
    asked = scenario(tmp_path, "none")
    asked["reference"]["amplitude_um"] = 1.1 * slow_end(10.0)
    with pytest.raises(SimulationError, match=f"reaches {-slow_end(10.0):.4g} to {slow_end(10.0):.4g} um"):
        hammerstein.run(asked)


STATIC_LAWS = ("exact_inverse", "inverse_multiplicative", "decoupled_inverse")


@pytest.mark.parametrize("law", ["feedback", *STATIC_LAWS])
def test_laws_of_linear_dynamics_refuse_it_in_a_scenario(law, tmp_path):
    with pytest.raises(InputError, match="electromechanical is not linear"):
        hammerstein.run(scenario(tmp_path, law))

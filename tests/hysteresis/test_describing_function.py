"""Describing functions of plays behind a drive, and the limit cycles they predict."""

import control
import numpy as np
import pytest
import theory
from scipy.optimize import brentq

from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.blocks.limit_cycles import limit_cycles
from hammerstein.dynamics import AxesDynamics, Axis, discretise
from hammerstein.errors import InputError
from hammerstein.hysteresis import Envelope, Generalised, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.kind import describing_function
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant, PlantState

R, W = [0.05, 0.5, 2.0, 5.0], [4.0, 0.5, -1.0, 1.5]
T = 1e-4
RANGE_V = 10.0
AMPLITUDES = [0.03, 0.06, 0.7, 2.0, 4.9, 9.0, 11.0, 30.0, 400.0]


def _first_harmonic(r, w, amplitude, range_v, points=20000):
    """Fourier integral over the second cycle of equation 4 for the cut sine."""
    angle = 2.0 * np.pi * np.arange(2 * points) / points
    cut = np.clip(amplitude * np.sin(angle), -range_v, range_v)
    v = theory.prandtl_ishlinskii([cut], [[r]], [[w]])[0, points:]
    return 2j * np.mean(v * np.exp(-1j * angle[points:])) / amplitude


@pytest.mark.parametrize("range_v", [np.inf, 10.0, 3.0])
def test_it_is_the_first_harmonic(range_v):
    found = describing_function(Pair(R, W), AMPLITUDES, range_v)
    expected = [_first_harmonic(R, W, a, range_v) for a in AMPLITUDES]
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-7 * sum(np.abs(W)))


@pytest.mark.parametrize("range_v", [np.inf, 10.0])
def test_that_of_an_envelope_is_the_first_harmonic_of_its_loop(range_v):
    """By theory: plays of the values of the lines, from the working point."""
    u, g, rest, amplitude = [0.0, 12.0, 25.0, 60.0], [0.0, 6.0, 30.0, 50.0], 20.0, 15.0
    block = Generalised((Envelope(u, g),), PrandtlIshlinskii([[Pair(R, W)]])).counted_from([rest])
    points = 40000
    angle = 2.0 * np.pi * np.arange(2 * points) / points
    cut = np.clip(amplitude * np.sin(angle), -range_v, range_v)
    seen = np.interp(rest + cut, u, g) - np.interp(rest, u, g)
    v = theory.prandtl_ishlinskii([seen], [[R]], [[W]])[0, points:]
    expected = 2j * np.mean(v * np.exp(-1j * angle[points:])) / amplitude
    found = block.to_describing_function(range_v)
    assert found.describing_function(amplitude) == pytest.approx(expected, rel=1e-6)
    assert found(5.0) == block.respond([[5.0]])[0][0, 0]


def test_without_a_range_it_is_python_controls_backlash():
    """One backlash object of width 2 r an operator."""
    for a in AMPLITUDES:
        parts = [
            w * control.friction_backlash_nonlinearity(2.0 * r).describing_function(a)
            for r, w in zip(R, W, strict=True)
        ]
        assert describing_function(Pair(R, W), a) == pytest.approx(sum(parts), abs=1e-13)


def test_without_hysteresis_it_is_python_controls_saturation():
    for a in AMPLITUDES:
        expected = 2.5 * control.saturation_nonlinearity(3.0).describing_function(a)
        assert describing_function(Pair.linear(2.5), a, 3.0) == pytest.approx(expected, abs=1e-14)


def test_cut_and_plays_do_not_multiply():
    """Behind the range the loop stays as wide as at the range, however large the sine."""
    a, r, w = 20.0, 2.0, 3.0
    cut = control.saturation_nonlinearity(RANGE_V).describing_function(a)
    product = cut * w * control.friction_backlash_nonlinearity(2.0 * r).describing_function(cut * a)
    right = describing_function(Pair([r], [w]), a, RANGE_V)
    assert right == pytest.approx(_first_harmonic([r], [w], a, RANGE_V), abs=1e-6)
    assert abs(right - product) > 0.1
    assert right.imag == pytest.approx(-theory.loop_area([r], [w], RANGE_V) / (np.pi * a * a))


def test_python_control_integrates_the_same_from_the_object():
    """Its numerical integral calls the object sample by sample, one amplitude at a time: it must settle."""
    object_ = PrandtlIshlinskii([[Pair(R, W)]]).to_describing_function(RANGE_V)
    for a in (0.7, 9.0, 30.0):
        found = control.describing_function(object_, [a], num_points=4000, try_method=False)
        np.testing.assert_allclose(found, control.describing_function(object_, [a]), atol=2e-6)
    assert object_.describing_function(0.0) == 0.0


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: describing_function(Pair(R, W), [1.0, 0.0]), "must be above 0"),
        (lambda: describing_function(Pair(R, W), 1.0, range_v=-1.0), "range_v: is -1"),
        (
            lambda: HammersteinModel.load("duo_bimorph").hysteresis.to_describing_function(),
            "give one pair of it",
        ),
        (
            lambda: PrandtlIshlinskii([[Pair(R, W)]]).to_describing_function(0.05),
            "nothing moves below 0.05 V",
        ),
    ],
)
def test_what_has_none_is_refused(build, message):
    with pytest.raises(InputError, match=message):
        build()


# ---- limit cycles ----


def _saturation(gain=1.0):
    return PrandtlIshlinskii([[Pair.linear(gain)]]).to_describing_function(1.0)


@pytest.mark.parametrize("dt", [None, 1e-3])
def test_a_saturation_in_a_third_order_loop(dt):
    """H = k / (s (s+1) (s+2)) has phase -180 degrees at w = sqrt 2 and |H| = k / 6 there; f(1/A) = 6 / k."""
    k = 12.0
    s = control.tf("s")
    system = k / (s * (s + 1) * (s + 2))
    if dt:
        system = control.c2d(control.ss(system), dt)
    (cycle,) = limit_cycles(_saturation(), system)

    def f(x):
        return 2.0 / np.pi * (np.arcsin(x) + x * np.sqrt(1.0 - x * x))

    expected = 1.0 / brentq(lambda x: f(x) - 6.0 / k, 1e-6, 1.0)
    tolerance = 2e-3 if dt else 1e-9
    assert cycle.amplitude_v == pytest.approx(expected, rel=tolerance)
    assert 2.0 * np.pi * cycle.frequency_hz == pytest.approx(np.sqrt(2.0), rel=tolerance)
    assert cycle.stable
    # d ln H / dw = -sqrt 2 - 2j / 3 there, and -1/N runs along the real axis
    assert cycle.angle_deg == pytest.approx(np.degrees(np.arctan(np.sqrt(2.0) / 3.0)), rel=10 * tolerance)


def test_a_loop_that_is_stable_between_two_gains_has_an_unstable_limit_cycle():
    """H = k (s+1)^2 / s^3 is stable for gains above 1/2: a large amplitude, cut, loses it and grows.

    Phase -180 degrees at w = 1, where |H| = 2 k; f(1/A) = 1 / (2 k).
    """
    s = control.tf("s")
    (cycle,) = limit_cycles(
        _saturation(), 1.0 * (s + 1) ** 2 / s**3, frequency_hz=np.geomspace(0.01, 10.0, 900)
    )
    assert 2.0 * np.pi * cycle.frequency_hz == pytest.approx(1.0, rel=1e-9)
    assert not cycle.stable


def test_a_crossing_beside_another_unstable_root_is_not_stable():
    """The loop of the first test behind an unstable mode of its own, far above, that no gain here moves."""
    s = control.tf("s")
    plain = control.ss(12.0 / (s * (s + 1) * (s + 2)))
    mode = control.ss([[0.01, 50.0], [-50.0, 0.01]], [[0.0], [1e-9]], [[1.0, 0.0]], [[0.0]])
    frequencies = np.geomspace(0.05, 2.0, 500)
    (alone,) = limit_cycles(_saturation(), plain, frequency_hz=frequencies)
    (beside,) = limit_cycles(_saturation(), plain + mode, frequency_hz=frequencies)
    assert alone.stable
    assert not beside.stable
    assert beside.amplitude_v == pytest.approx(alone.amplitude_v, rel=1e-6)


def test_a_limit_cycle_beyond_the_amplitudes_is_not_found():
    """Few frequencies find that of the first test too small at first; it is left out if it is too large."""
    s, k = control.tf("s"), 12.0
    few = np.array([0.7, 1.2, 2.5]) / (2.0 * np.pi)
    system = k / (s * (s + 1) * (s + 2))
    (cycle,) = limit_cycles(_saturation(), system)
    for share, expected in ((0.95, 0), (0.99, 0), (1.01, 1)):
        amplitudes = np.geomspace(1.01, share * cycle.amplitude_v, 50)
        assert len(limit_cycles(_saturation(), system, amplitudes, few)) == expected


def test_what_cannot_be_searched_is_refused():
    system = control.ss(control.tf([1.0], [1.0, 1.0]))
    for arguments, message in [
        ((control.append(system, system),), "has 2 inputs and 2 outputs"),
        ((control.frd([1.0, 0.5], [1.0, 10.0]),), "frequency response"),
        ((system, [2.0, 1.0]), "amplitudes_v: must be two or more rising"),
        ((system, None, [0.0, 1.0]), "frequency_hz: must be two or more rising"),
        ((control.tf([2.0], [1.0]),), "has no corner"),
    ]:
        with pytest.raises(InputError, match=message):
            limit_cycles(_saturation(), *arguments)
    hysteresis = PrandtlIshlinskii([[Pair(R, W)]]).to_describing_function(RANGE_V)
    with pytest.raises(InputError, match=r"use amplitudes above 0\.05 V"):
        limit_cycles(hysteresis, system, [0.01, 1.0])


# ---- an integral controller around an actuator with resonance, hysteresis and a limited drive ----

GAIN_PER_S = 45.0


@pytest.fixture(scope="module")
def model():
    hysteresis = PrandtlIshlinskii([[Pair([0.05, 0.5, 2.0, 5.0], [4.0, 0.5, 1.0, 1.5])]])
    dynamics = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.05),))
    return HammersteinModel("one axis", hysteresis, dynamics, RANGE_V, ("u",), ("y",))


@pytest.fixture(scope="module")
def plant(model):
    ideal = Instruments.ideal(T)
    drive = Drive(range_v=RANGE_V, resolution_v=0.0, sample_time_s=T)
    return Plant(model, ideal.model_copy(update={"drive": drive}))


@pytest.fixture(scope="module")
def controller():
    """c[k+1] = c[k] + ki T y[k], whose negative is the voltage."""
    return control.ss([[1.0]], [[GAIN_PER_S * T]], [[1.0]], [[0.0]], T, name="controller")


@pytest.fixture(scope="module")
def cycles(model, controller):
    block = discretise(model.dynamics, T)
    system = controller * control.ss(block.A, block.B, block.C, block.D, T)
    return limit_cycles(model.hysteresis.to_describing_function(RANGE_V), system)


def _run(plant, controller, cycle, share, samples):
    """Voltage of the closed loop that starts on the sine of the limit cycle times a share."""
    actuator = plant.to_iosys()
    integral = control.ss(controller, inputs=["position_um[0]"], outputs=["c"], name="integral")
    sign = control.ss([], [], [], [[-1.0]], T, inputs=["c"], outputs=["requested_v[0]"], name="sign")
    loop = control.interconnect([integral, sign, actuator], inputs=[], outputs=["requested_v[0]"])
    start = _on_the_sine(plant, cycle, share)
    return control.input_output_response(loop, T * np.arange(samples), 0.0, start).y.ravel()


def _on_the_sine(plant, cycle, share):
    """State of integral and actuator when the loop is driven by that sine for ever, by phasors."""
    amplitude, z = share * cycle.amplitude_v, np.exp(2j * np.pi * cycle.frequency_hz * T)
    block, hysteresis = plant.block, plant.model.hysteresis
    past = np.arange(-round(5.0 / cycle.frequency_hz / T), 0)
    u = amplitude * np.imag(z**past)
    _, plays = hysteresis.respond(np.clip(u, -RANGE_V, RANGE_V)[None])
    v = amplitude * describing_function(hysteresis.pairs[0][0], amplitude, RANGE_V)
    x = np.linalg.solve(z * np.eye(len(block.A)) - block.A, block.B[:, 0] * v)
    y = (block.C @ x + block.D[:, 0] * v)[0]
    state = PlantState(plays, np.imag(x), plant.rest([0]).noise)
    integral = np.imag(GAIN_PER_S * T * y / (z - 1.0))
    return np.concatenate([[integral], plant.to_iosys().state_vector(state)])


def _frequency_hz(signal):
    up = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    crossings = up - signal[up] / (signal[up + 1] - signal[up])
    return 1.0 / (T * np.diff(crossings).mean())


def test_a_small_motion_decays_and_a_large_one_is_caught(cycles):
    """More operators move as the amplitude grows, until the range clips it."""
    small, large = cycles
    assert (small.stable, large.stable) == (False, True)
    assert small.amplitude_v < 1.0 < RANGE_V < large.amplitude_v
    assert min(small.angle_deg, large.angle_deg) > 20.0


@pytest.mark.full
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_simulation_comes_to_the_stable_limit_cycle(plant, controller, cycles, share):
    last = _run(plant, controller, cycles[1], share, 1500)[-500:]
    assert np.abs(last).max() == pytest.approx(cycles[1].amplitude_v, rel=0.05)
    assert _frequency_hz(last) == pytest.approx(cycles[1].frequency_hz, rel=0.05)


@pytest.mark.full
def test_starts_on_both_sides_bracket_the_unstable_limit_cycle(plant, controller, cycles):
    below, above = (np.abs(_run(plant, controller, cycles[0], share, 2500)) for share in (0.9, 1.1))
    assert below[-300:].max() < 0.5 * cycles[0].amplitude_v
    assert above[-300:].max() > 1.5 * cycles[0].amplitude_v


def test_python_control_alone_finds_them_in_continuous_time(model):
    """``control.describing_function_response`` with the object, against our crossings."""
    object_ = model.hysteresis.to_describing_function(RANGE_V)
    system = control.ss(model.dynamics.system()) * control.tf([60.0], [1.0, 0.0])
    amplitudes, omega = np.geomspace(0.06, 100.0, 40), 2.0 * np.pi * np.geomspace(150.0, 400.0, 60)
    theirs = control.describing_function_response(system, object_, amplitudes, omega=omega, refine=False)
    ours = limit_cycles(object_, system)
    assert len(ours) == len(theirs.intersections) == 2
    for cycle, (amplitude, w) in zip(ours, sorted(theirs.intersections), strict=True):
        assert amplitude == pytest.approx(cycle.amplitude_v, rel=0.05)
        assert w == pytest.approx(2.0 * np.pi * cycle.frequency_hz, rel=0.01)

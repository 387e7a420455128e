import control
import numpy as np
import pytest
import theory_linear as theory

from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    CreepMode,
    StateSpaceDynamics,
    StaticDynamics,
    cantilever,
    discretise,
)
from hammerstein.dynamics.linear_block import LinearBlock
from hammerstein.errors import InputError

T = 50e-6


@pytest.mark.parametrize("damping", [0.02, 0.12, 0.7, 1.5])
@pytest.mark.parametrize("bandwidth_hz", [40.0, 430.0])
def test_bandwidth_is_what_was_asked(bandwidth_hz, damping):
    block = cantilever(bandwidth_hz, damping)
    assert control.bandwidth(block) / (2 * np.pi) == pytest.approx(bandwidth_hz, rel=1e-6)


def test_cantilever_has_one_axis_an_entry():
    block = cantilever([430.0, 470.0], 0.12)
    for axis, wanted in enumerate((430.0, 470.0)):
        assert control.bandwidth(block[axis, axis]) / (2 * np.pi) == pytest.approx(wanted, rel=1e-6)
    assert np.abs(block(2j * np.pi * 100.0)[0, 1]) == 0.0


def test_resonance_and_damping_give_the_textbook_response():
    f = np.array([1.0, 100.0, 280.0, 2000.0])
    block = cantilever(resonance_hz=280.0, damping_ratio=0.12)
    ours = np.array([block(2j * np.pi * x) for x in f]).ravel()
    np.testing.assert_allclose(ours, theory.second_order(f, 280.0, 0.12), rtol=1e-10)


def test_creep_adds_its_slow_modes():
    modes = (CreepMode(gain=0.02, time_constant_s=3.0), CreepMode(gain=0.03, time_constant_s=100.0))
    block = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12, creep=modes),)).system()
    f = np.array([1e-4, 1e-2, 1.0, 50.0])
    ours = np.array([block(2j * np.pi * x) for x in f]).ravel()
    expected = theory.second_order(f, 280.0, 0.12) * theory.creep(f, (0.02, 0.03), (3.0, 100.0))
    np.testing.assert_allclose(ours, expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "either"),
        ({"bandwidth_hz": 1.0, "resonance_hz": 2.0}, "either"),
        ({"bandwidth_hz": -1.0}, "positive"),
        ({"bandwidth_hz": 1.0, "damping_ratio": 0.0}, "positive"),
        ({"bandwidth_hz": np.nan}, "finite"),
    ],
)
def test_cantilever_refuses(arguments, message):
    with pytest.raises(InputError, match=message):
        cantilever(**arguments)


def _axes(*creep):
    return AxesDynamics(
        axes=(
            Axis(resonance_hz=280.0, damping_ratio=0.12, creep=creep),
            Axis(resonance_hz=306.0, damping_ratio=0.2),
        )
    )


def test_held_step_is_exact_on_the_grid():
    t = np.arange(400) * T
    y, _ = discretise(_axes(), T).respond(np.ones((2, 400)))
    np.testing.assert_allclose(y[0], theory.second_order_step(t, 280.0, 0.12), atol=1e-12)


def test_cascade_equals_forced_response_of_python_control():
    dynamics = _axes(CreepMode(gain=0.05, time_constant_s=0.3))
    u = np.random.default_rng(0).normal(size=(2, 500))
    held = control.c2d(dynamics.system(), T, "zoh")
    expected = control.forced_response(held, np.arange(500) * T, u).outputs
    y, _ = discretise(dynamics, T).respond(u)
    assert np.abs(y - expected).max() < 1e-9


def test_the_response_of_a_series_is_the_product_of_the_responses():
    rng = np.random.default_rng(3)

    def block(outputs, states, inputs):
        sizes = (states, states), (states, inputs), (outputs, states), (outputs, inputs)
        return LinearBlock(*(rng.standard_normal(size) for size in sizes), None)

    def at(s, own):
        return own.C @ np.linalg.solve(s * np.eye(len(own.A)) - own.A, own.B) + own.D

    first, last = block(3, 4, 2), block(2, 5, 3)
    for s in (0.7j, 11j, 2.0 + 3j):
        np.testing.assert_allclose(at(s, last.behind(first)), at(s, last) @ at(s, first), rtol=1e-10)


def test_sensor_is_behind_the_position_and_sees_it_continuously():
    # A fine grid converges to the product of the continuous responses.
    f, dynamics = 150.0, _axes()
    block = discretise(dynamics, 1e-6, sensor_bandwidth_hz=2000.0)
    response = block.response(f)[0]
    assert response.shape == (4, 2)
    position = theory.second_order(f, 280.0, 0.12)
    assert response[0, 0] == pytest.approx(position, rel=1e-3)
    assert response[2, 0] == pytest.approx(position * theory.first_order(f, 2000.0), rel=1e-3)


@pytest.mark.parametrize("inputs", [1, 3])
def test_a_delay_is_refused_from_where_it_says(inputs, monkeypatch):
    monkeypatch.setattr("hammerstein.dynamics.linear_block.MOST_DELAY_STATES", 20)
    most = 20 // inputs
    gain = LinearBlock(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((1, 0)), np.ones((1, inputs)), T)
    assert len(gain.delayed(most).A) == most * inputs
    with pytest.raises(InputError, match=f"at most {most} are possible"):
        gain.delayed(most + 1)


@pytest.mark.parametrize("delay_samples", [0, 1, 2.4, 3])
def test_steps_equal_the_batch_to_the_last_bit(delay_samples):
    dynamics = _axes(CreepMode(gain=0.05, time_constant_s=0.3))
    block = discretise(dynamics.model_copy(update={"input_delay_s": delay_samples * T}), T, 2000.0)
    u = np.random.default_rng(1).normal(size=(2, 200))
    y, final = block.respond(u)
    state = block.rest()
    for k in range(200):
        sample, state = block.step(u[:, k], state)
        assert (sample == y[:, k]).all()
    assert (state == final).all()


def test_delay_shifts_the_response():
    plain, _ = discretise(_axes(), T).respond(np.eye(2, 50))
    late, _ = discretise(_axes().model_copy(update={"input_delay_s": 3 * T}), T).respond(np.eye(2, 50))
    np.testing.assert_allclose(late[:, 3:], plain[:, :-3], atol=1e-15)
    assert (late[:, :3] == 0.0).all()


@pytest.mark.parametrize("delay_samples", [0.3, 2.75])
def test_a_fraction_of_a_sample_delays_the_step_response_by_just_that(delay_samples):
    late = _axes().model_copy(update={"input_delay_s": delay_samples * T})
    y, _ = discretise(late, T).respond(np.ones((2, 400)))
    time_s = np.arange(400) * T - delay_samples * T
    expected = theory.second_order_step(np.maximum(time_s, 0.0), 280.0, 0.12)
    np.testing.assert_allclose(y[0], expected, atol=1e-12)


def test_a_fraction_of_a_sample_is_a_whole_delay_on_a_finer_grid():
    dynamics = _axes(CreepMode(gain=0.05, time_constant_s=0.3)).model_copy(update={"input_delay_s": 1.25 * T})
    u = np.random.default_rng(5).normal(size=(2, 300))
    fine, _ = discretise(dynamics, T / 8, 2000.0).respond(np.repeat(u, 8, axis=1))
    y, _ = discretise(dynamics, T, 2000.0).respond(u)
    np.testing.assert_allclose(y, fine[:, ::8], atol=1e-12)
    settled = discretise(dynamics, T, 2000.0)
    held, _ = settled.respond(np.full((2, 3), 7.0), settled.settled([7.0, 7.0]))
    np.testing.assert_allclose(held[:, -1], 7.0 * np.array([1.05, 1.0, 1.05, 1.0]), rtol=1e-9)


def test_refuses_another_sample_time_and_a_broken_delay():
    block = discretise(_axes(), T)
    with pytest.raises(InputError, match="sample time"):
        block.respond(np.zeros((2, 5)), sample_time_s=1e-3)
    rounded = discretise(_axes().model_copy(update={"input_delay_s": (2.0 + 1e-9) * T}), T)
    assert len(rounded.A) == len(block.A) + 4  # two whole samples of two inputs
    discrete = StateSpaceDynamics(A=((0.5,),), B=((1.0,),), C=((1.0,),), D=((0.0,),), sample_time_s=1e-3)
    with pytest.raises(InputError, match="identified at"):
        discretise(discrete, T)
    with pytest.raises(InputError, match="not a whole number of samples"):
        discretise(discrete.model_copy(update={"input_delay_s": 1.5e-3}), 1e-3)


def test_state_space_of_the_users_own_is_kept():
    system = control.rss(4, 2, 2, strictly_proper=True)
    dynamics = StateSpaceDynamics.of(system)
    for name in "ABCD":
        np.testing.assert_array_equal(np.asarray(getattr(dynamics, name)), getattr(system, name))
    again = StateSpaceDynamics.model_validate_json(dynamics.model_dump_json())
    assert again == dynamics


@pytest.mark.parametrize(("pole", "sample_time_s"), [(0.0, None), (1.0, 1e-3), (-1.0, 1e-3)])
def test_a_pole_on_the_border_of_stability_is_not_stable(pole, sample_time_s):
    """An integrator, a sum, and a sum of alternating sign: each grows without bound."""
    rows = {"A": ((pole,),), "B": ((1.0,),), "C": ((1.0,),), "D": ((0.0,),)}
    assert "is not stable" in StateSpaceDynamics(**rows, sample_time_s=sample_time_s).instability()
    inside = rows | {"A": ((0.99 * pole if sample_time_s else -1e-9,),)}
    assert not StateSpaceDynamics(**inside, sample_time_s=sample_time_s).instability()


def test_no_dynamics_passes_its_input():
    u = np.random.default_rng(2).normal(size=(2, 20))
    y, _ = discretise(StaticDynamics(n_outputs=2), T).respond(u)
    np.testing.assert_array_equal(y, u)


@pytest.mark.parametrize("sensor_hz", [None, 2000.0, np.inf])
@pytest.mark.parametrize(
    "dynamics",
    [
        StaticDynamics(n_outputs=2),
        _axes(),
        _axes(CreepMode(gain=0.05, time_constant_s=0.3)),
        StateSpaceDynamics(A=(), B=(), C=((),), D=((2.0,),)),
        StateSpaceDynamics(A=(), B=(), C=((),), D=((2.0,),), sample_time_s=T),
    ],
)
def test_no_system_without_states_stands_in_the_way_to_the_grid(dynamics, sensor_hz, monkeypatch):
    """python-control up to 0.10.2 makes them in a way that NumPy 2.5 warns of."""
    states = []

    class Watched(control.StateSpace):
        def __init__(self, *arguments, **named):
            super().__init__(*arguments, **named)
            states.append(self.nstates)

    monkeypatch.setattr("control.statesp.StateSpace", Watched)
    discretise(dynamics, T, sensor_hz)
    assert 0 not in states


def test_a_system_without_states_is_exported():
    system = StaticDynamics(n_outputs=2).system()
    np.testing.assert_array_equal(system.D, np.eye(2))
    assert system.nstates == 0
    assert system.dt is None  # fits a continuous and a discrete system


@pytest.mark.parametrize("frequency_hz", [3.0, 40.0, 250.0, 900.0])
def test_how_far_sines_come_out_from_slow_ones(frequency_hz):
    """A resonance leaves |1 / (1 - r^2 + 2j zeta r) - 1| of a sine at r times its frequency, the hold of a
    sample of T half a sample of delay more; of two axes the worse one counts."""
    sample_time_s, zeta, resonances = 2e-6, 0.12, (280.0, 300.0)
    axes = tuple(Axis(resonance_hz=f, damping_ratio=zeta) for f in resonances)
    found = discretise(AxesDynamics(axes=axes), sample_time_s).lag([frequency_hz])[0]
    late = np.exp(-1j * np.pi * frequency_hz * sample_time_s)
    ratios = [frequency_hz / f for f in resonances]
    wanted = max(abs(late / (1.0 - r**2 + 2j * zeta * r) - 1.0) for r in ratios)
    assert found == pytest.approx(wanted, rel=2e-4)


def test_how_far_sines_come_out_is_what_python_control_says():
    slow = CreepMode(gain=0.1, time_constant_s=0.5)
    block = discretise(
        AxesDynamics(axes=[Axis(resonance_hz=300.0, damping_ratio=0.1, creep=[slow])] * 2), 50e-6
    )
    hertz = np.array([0.1, 1.0, 100.0, 2000.0])
    gain = control.frequency_response(block.system(), 2.0 * np.pi * np.append(1e-9, hertz)).complex
    wanted = np.abs(gain[0, 0] / gain[0, 0, 0] - 1.0)[1:]
    assert block.lag(hertz) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("axis", [{"resonance_hz": 80.0, "damping_ratio": 0.02}, {"lag_s": 0.03}])
def test_the_slowest_axis_has_rung_down_to_a_thousandth_when_it_is_said_to_have(axis):
    """The envelope of the step response, exp(-z w t) or exp(-t / T), of two axes; creep does not count."""
    creeping = Axis(**axis, creep=(CreepMode(gain=0.1, time_constant_s=50.0),))
    both = AxesDynamics(axes=(Axis(resonance_hz=500.0, damping_ratio=0.3), creeping))
    t = np.linspace(0.0, both.settle_s, 20001)
    left = np.abs(control.step_response(Axis(**axis).system(), t).outputs - 1.0)
    assert left[-200:].max() == pytest.approx(1e-3, rel=0.1)

"""Plays and dead-zones side by side, against their equation, closed forms and the classical block."""

import json

import control
import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Asymmetric, AsymmetricState, DeadZones, Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

SEED = 16


def random_model(generator, m, p, smallest=0.0):
    """Ragged plays and dead-zones; pairs without the one, the other, or both; a working point of its own."""
    rows, zones = [], []
    for _ in range(p):
        plays, bends = [], []
        for _ in range(m):
            r = np.unique(
                np.concatenate([[smallest], generator.uniform(smallest, 6.0, generator.integers(5))])
            )
            q = np.unique(generator.uniform(-8.0, 8.0, generator.integers(5)))
            plays.append(
                Pair(r, generator.normal(size=len(r))) if generator.random() < 0.8 else Pair.absent()
            )
            bends.append(DeadZones(q, generator.normal(size=len(q))))
        rows.append(plays)
        zones.append(bends)
    rows[0][0] = Pair([smallest, smallest + 1.0], [2.0, 0.5])
    return Asymmetric(PrandtlIshlinskii(rows), zones, generator.uniform(-3.0, 3.0, m))


def by_theory(model, u):
    """u counted from the working point, as ``respond`` wants it."""
    plays = [
        [[getattr(pair, name) for pair in row] for row in model.plays.pairs]
        for name in ("thresholds_v", "weights_um_per_v")
    ]
    bends = [
        [[getattr(zone, name) for zone in row] for row in model.zones]
        for name in ("breakpoints_v", "weights_um_per_v")
    ]
    rest = model.working_point_v
    return theory.asymmetric(u + rest[:, None], *plays, *bends, rest)


def one_axis(r, w, q, b, rest=0.0):
    return Asymmetric(PrandtlIshlinskii([[Pair(r, w)]]), [[DeadZones(q, b)]], [rest])


@pytest.mark.parametrize("smallest", [0.0, 0.4])
@pytest.mark.parametrize(("m", "p"), [(1, 1), (2, 2), (3, 2), (1, 3)])
def test_response_is_the_equation_for_every_shape(m, p, smallest):
    generator = np.random.default_rng([SEED, m, p])
    for _ in range(20):
        model = random_model(generator, m, p, smallest)
        u = np.cumsum(generator.normal(0.0, 2.0, (m, 200)), axis=1)
        expected = by_theory(model, u)
        np.testing.assert_allclose(model.respond(u)[0], expected, atol=1e-12 * (1 + np.abs(expected).max()))


def test_without_dead_zones_it_is_the_classical_block_to_the_last_bit():
    plays = PrandtlIshlinskii.from_arrays(theory.R_V, theory.W_UM_PER_V)
    model = Asymmetric(plays, [[DeadZones.absent()] * 2] * 2)
    u = np.random.default_rng(SEED).uniform(-10.0, 10.0, (2, 3000))
    np.testing.assert_array_equal(model.respond(u)[0], plays.respond(u)[0])


def test_at_rest_the_output_is_zero_wherever_the_working_point_is():
    for rest in (-50.0, 0.0, 33.0):
        model = one_axis([0.0], [1.0], [-20.0, 0.0, 20.0], [0.3, 0.2, -0.1], rest)
        np.testing.assert_array_equal(model.respond([[0.0]])[0], [[0.0]])


def test_breakpoints_are_voltages_as_they_are_sent():
    """The same record counted from two working points: what is sent is the same, so is the change."""
    sent = 60.0 + 40.0 * np.sin(np.linspace(0.0, 20.0, 800))
    about = one_axis([0.0, 5.0], [1.0, 0.4], [50.0, 80.0], [0.3, -0.2], sent[0])
    v = about.respond([sent - sent[0]])[0]
    moved = about.counted_from([0.0])
    before = moved.respond([[sent[0]]])[1]  # plays at sent[0] - r, not at rest: only the dead-zones compare
    zones = v - about.plays.respond([sent - sent[0]])[0]
    again = moved.respond([sent], before)[0] - moved.plays.respond([sent], before.plays)[0]
    np.testing.assert_allclose(zones, again - again[0, 0], atol=1e-12)


def test_settled_loop_about_any_middle_has_its_closed_form():
    r, w = np.array([0.0, 0.8, 2.0, 3.5]), np.array([3.0, 0.7, 0.5, 1.2])
    q, b = np.array([-3.0, 1.0, 6.0]), np.array([0.9, -1.1, 0.6])
    low, high, rest = -4.0, 9.0, 1.5
    ramp = np.linspace(low, high, 2001)
    sent = np.concatenate([ramp, ramp[::-1], ramp, ramp[::-1]])
    v = one_axis(r, w, q, b, rest).respond([sent - rest])[0][0]
    rising, falling = theory.asymmetric_branches(r, w, q, b, low, high, ramp)
    ours = v[2 * len(ramp) :]
    expected = np.concatenate([rising, falling[::-1]])
    np.testing.assert_allclose(ours - ours[0], expected - expected[0], atol=1e-11)
    # dead-zones enclose no area of their own
    area = theory.polygon_area(np.concatenate([ramp, ramp[::-1]]), ours)
    assert area == pytest.approx(theory.loop_area(r, w, 0.5 * (high - low)), rel=1e-5)


@pytest.mark.parametrize("smallest", [0.0, 0.6])
def test_amplitude_is_that_of_the_simulated_loop(smallest):
    generator = np.random.default_rng(SEED)
    model = random_model(generator, 2, 2, smallest)
    tips = 7.0 * np.concatenate([np.linspace(0, 1, 400), np.linspace(1, -1, 8001), np.linspace(-1, 1, 8001)])
    for k in range(2):
        u = np.zeros((2, len(tips)))
        u[k] = tips
        loop = model.respond(u)[0][:, -16002:]
        np.testing.assert_allclose(model.amplitude(7.0)[:, k], 0.5 * (loop[:, -1] - loop[:, 8000]), atol=1e-9)


def test_a_larger_swing_wipes_out_what_it_covers():
    generator = np.random.default_rng(SEED)
    model = random_model(generator, 1, 1)
    ends = [model.respond([np.concatenate([past, [-9.0, 9.0], [2.0, 4.0]])])[0][0, -4:]
            for past in generator.uniform(-8.0, 8.0, (2, 30))]  # fmt: skip
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


def test_minor_loops_between_the_same_voltages_are_congruent_and_elsewhere_are_not():
    model = one_axis([0.0, 1.0, 2.0], [2.0, 0.5, 0.5], [0.0, 3.0], [0.7, -0.4])
    inner = np.concatenate([np.linspace(-1, 2, 50), np.linspace(2, -1, 50)])
    loops = []
    for past, middle in (([-9.0, 9.0, -1.0], 0.0), ([5.0, -7.0, -1.0], 0.0), ([-9.0, 9.0, 3.0], 4.0)):
        v = model.respond([np.concatenate([past, inner + middle, inner + middle])])[0][0, -100:]
        loops.append(v - v[0])
    np.testing.assert_allclose(loops[0], loops[1], atol=1e-12)
    assert np.abs(loops[0] - loops[2]).max() > 0.1  # plays alone would give the same loop there
    plays = [model.plays.respond([np.concatenate([[-9.0, 9.0, -1.0 + c], inner + c])])[0][0, -100:]
             for c in (0.0, 4.0)]  # fmt: skip
    np.testing.assert_allclose(plays[0] - plays[0][0], plays[1] - plays[1][0], atol=1e-12)


def test_an_inverted_signal_is_not_answered_inverted():
    u = np.sin(np.linspace(0.0, 12.0, 300)) * 5.0
    model = one_axis([0.0, 1.0], [2.0, 0.5], [1.0], [0.7])
    assert np.abs(model.respond([u])[0] + model.respond([-u])[0]).max() > 1.0


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.3]))
def test_step_equals_respond_to_the_last_bit_and_states_pass_json(seed, smallest):
    generator = np.random.default_rng(seed)
    model = random_model(generator, 2, 2, smallest)
    # steps of a tenth meet breakpoints and thresholds exactly
    u = np.round(np.cumsum(generator.normal(0.0, 2.0, (2, 60)), axis=1), 1)
    whole, end = model.respond(u)
    state, steps = model.rest(), []
    for k in range(u.shape[1]):
        v, state = model.step(u[:, k], state)
        state = model.restore(json.loads(json.dumps(state.as_dict())))
        steps.append(v)
    np.testing.assert_array_equal(np.stack(steps, axis=1), whole)
    assert isinstance(state, AsymmetricState)
    np.testing.assert_array_equal(model.respond(u, state)[0], model.respond(u, end)[0])


@pytest.mark.parametrize(
    ("q", "b", "says"),
    [
        ([1.0, 1.0], [1.0, 2.0], "not strictly increasing"),
        ([1.0, np.nan], [1.0, 2.0], "not finite"),
        ([1.0], [1.0, 2.0], "they must be equally many"),
        ([1.0], [np.inf], "not finite"),
    ],
)
def test_dead_zones_refuse(q, b, says):
    with pytest.raises(InputError, match=says):
        DeadZones(q, b)


def test_a_model_refuses_other_pairs_and_voltages_that_are_not_finite():
    plays = PrandtlIshlinskii([[Pair.linear(1.0)]])
    with pytest.raises(InputError, match="one for each pair"):
        Asymmetric(plays, [[DeadZones.absent()] * 2])
    with pytest.raises(InputError, match="working_point_v"):
        Asymmetric(plays, [[DeadZones.absent()]], [0.0, 1.0])
    with pytest.raises(SimulationError, match="sample 1"):
        Asymmetric(plays, [[DeadZones([0.0], [1.0])]]).respond([[0.0, np.nan]])


def test_a_model_file_keeps_it_to_the_last_bit(tmp_path):
    hysteresis = random_model(np.random.default_rng(SEED), 2, 2)
    voltages = Voltages.of([1.5, -2.0], [-8.0, -8.0], [8.0, 8.0])
    dynamics = StaticDynamics(n_outputs=2)
    model = HammersteinModel("m", hysteresis, dynamics, 8.0, ("a", "b"), ("x", "y"), voltages=voltages)
    model.save(tmp_path / "m.json")
    again = HammersteinModel.load(tmp_path / "m.json")
    assert again.digest() == model.digest()
    sent = np.random.default_rng(1).uniform(-8.0, 8.0, (2, 500))
    np.testing.assert_array_equal(again.static_response(sent)[0], model.static_response(sent)[0])
    # counted from the working point of the file, wherever the block was counted from before
    expected = by_theory(again.hysteresis, sent - np.array([[1.5], [-2.0]]))
    np.testing.assert_allclose(again.static_response(sent)[0], expected, atol=1e-11)


def test_breakpoints_out_of_order_in_a_file_are_named(tmp_path):
    model = HammersteinModel(
        "m", one_axis([0.0], [1.0], [1.0, 2.0], [0.5, 0.5]), StaticDynamics(n_outputs=1), 8.0, ("a",), ("x",)
    )
    text = model.to_json().replace("[1.0, 2.0]", "[2.0, 1.0]")
    with pytest.raises(InputError, match="breakpoints_v is not strictly increasing"):
        HammersteinModel.from_json(text)


def test_weights_are_given_pair_by_pair_and_take_the_place_of_others():
    model = random_model(np.random.default_rng(SEED), 2, 2)
    twice = model.with_weights([2.0 * w for w in model.weights])
    u = np.random.default_rng(1).uniform(-8.0, 8.0, (2, 200))
    np.testing.assert_allclose(twice.respond(u)[0], 2.0 * model.respond(u)[0], atol=1e-12)
    assert [len(w) for w in model.weights] == [sum(row) for row in model.operators]


def test_python_control_gives_the_same_numbers():
    model = random_model(np.random.default_rng(SEED), 2, 2, 0.3)
    u = np.random.default_rng(1).uniform(-8.0, 8.0, (2, 60))
    system = model.to_iosys(1e-3)
    response = control.input_output_response(system, 1e-3 * np.arange(60), u)
    np.testing.assert_allclose(response.outputs, model.respond(u)[0], atol=1e-12)


@pytest.mark.parametrize("zones", [([], []), ([-1.0, 2.0], [0.2, -0.1])])
@pytest.mark.parametrize("smallest", [0.0, 0.7])
def test_the_smallest_play_is_where_the_voltages_led_it_with_and_without_dead_zones(smallest, zones):
    plays = PrandtlIshlinskii([[Pair([smallest, 2.0], [1.0, 0.5])]])
    u = np.cumsum(np.random.default_rng(4).normal(0.0, 0.5, (1, 300)), axis=1)
    _, state = Asymmetric(plays, [[DeadZones(*zones)]]).respond(u)
    assert state.smallest_v[0] == theory.play(u[0], smallest)[-1]

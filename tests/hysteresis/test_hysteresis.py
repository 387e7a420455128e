"""The Prandtl-Ishlinskii block against equation 4, closed forms and python-control."""

import json
import re

import control
import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, play
from hammerstein.hysteresis.identifiable import Identifiable

RNG_SEED = 7


def published():
    return PrandtlIshlinskii.from_arrays(theory.R_V, theory.W_UM_PER_V)


def settled_sine(amplitude, samples=400):
    """Two periods of a sine whose extremes are samples; the second one is settled."""
    return amplitude * np.sin(2 * np.pi * np.arange(2 * samples + 1) / samples)


voltages = st.floats(-12.0, 12.0, allow_nan=False)
# Steps of a tenth make plateaus, repeated extremes and inputs that meet a threshold exactly.
coarse = st.integers(-100, 100).map(lambda i: i / 10)
signals = st.lists(st.one_of(voltages, coarse), min_size=1, max_size=60).map(np.array)


@st.composite
def pairs(draw, most=6):
    r = draw(st.lists(st.one_of(st.floats(0, 8), st.integers(0, 16).map(lambda i: i / 2)), max_size=most))
    r = sorted(set(r))
    w = draw(st.lists(st.floats(-5, 5), min_size=len(r), max_size=len(r)))
    return Pair(np.array(r), np.array(w))


@st.composite
def models(draw, n_inputs=None, n_outputs=None):
    m = n_inputs or draw(st.integers(1, 3))
    p = n_outputs or draw(st.integers(1, 3))
    rows = [[draw(pairs()) for _ in range(m)] for _ in range(p)]
    rows[0][0] = Pair.linear(1.0) if not len(rows[0][0].thresholds_v) else rows[0][0]
    return PrandtlIshlinskii(rows)


@st.composite
def models_and_inputs(draw):
    model, length = draw(models()), draw(st.integers(1, 40))
    cell = st.one_of(voltages, coarse)
    u = draw(st.lists(cell, min_size=model.n_inputs * length, max_size=model.n_inputs * length))
    return model, np.array(u).reshape(model.n_inputs, length)


def by_theory(model, u):
    thresholds = [[pair.thresholds_v for pair in row] for row in model.pairs]
    weights = [[pair.weights_um_per_v for pair in row] for row in model.pairs]
    return theory.prandtl_ishlinskii(u, thresholds, weights)


def size(model):
    """Largest output that 12 V can make, for tolerances."""
    return 1.0 + sum(12 * np.abs(pair.weights_um_per_v).sum() for row in model.pairs for pair in row)


# ---- equation 4 ----


def test_play_is_equation_1():
    u = np.random.default_rng(RNG_SEED).uniform(-5, 5, 300)
    r = np.array([0.0, 0.3, 2.0, 7.0])
    expected = [theory.play(u, ri, si) for ri, si in zip(r, [0.0, 0.2, -1.0, 3.0], strict=True)]
    np.testing.assert_array_equal(play(u, r, [0.0, 0.2, -1.0, 3.0]), expected)


@pytest.mark.parametrize("r", [0.0, 0.07, 1.3, 20.0])
def test_play_is_the_backlash_of_python_control(r):
    backlash = control.friction_backlash_nonlinearity(2 * r)
    u = np.random.default_rng(RNG_SEED).normal(0, 4, 500)
    np.testing.assert_array_equal(play(u, [r])[0], [backlash(v) for v in u])


@settings(max_examples=60)
@given(models_and_inputs())
def test_response_is_equation_4_for_every_shape(case):
    model, u = case
    v, _ = model.respond(u)
    np.testing.assert_allclose(v, by_theory(model, u), rtol=0, atol=1e-12 * size(model))


def test_published_model_is_equation_4():
    model = published()
    u = np.random.default_rng(RNG_SEED).uniform(-10, 10, (2, 400))
    np.testing.assert_allclose(model.respond(u)[0], by_theory(model, u), rtol=0, atol=1e-12 * 150)


def test_linear_gain_and_absent_pair():
    model = PrandtlIshlinskii([[Pair.linear(2.5), Pair.absent()], [Pair.absent(), Pair([1.0], [3.0])]])
    u = np.array([[1.0, -2.0, 0.5], [4.0, 1.5, 0.0]])
    np.testing.assert_array_equal(model.respond(u)[0], [[2.5, -5.0, 1.25], [9.0, 7.5, 3.0]])


def test_an_input_that_no_output_responds_to_adds_nothing():
    model = PrandtlIshlinskii([[Pair.absent(), Pair([0.5], [2.0])]])
    np.testing.assert_array_equal(model.respond([[7.0, -7.0], [1.0, 1.0]])[0], [[1.0, 1.0]])


# ---- closed forms ----


def test_published_loops_have_the_printed_size():
    model = published()
    np.testing.assert_allclose(model.amplitude(10.0), [[58.40, 1.41], [2.08, 50.57]], atol=0.006)
    r, w = theory.R_V, theory.W_UM_PER_V
    assert theory.loop_area(r, w[0, 0], 10.0) == pytest.approx(281.90, abs=0.006)
    for o, k in np.ndindex(2, 2):
        assert model.amplitude(10.0)[o, k] == pytest.approx(theory.loop_amplitude(r, w[o, k], 10), abs=1e-9)


def test_simulated_settled_loop_has_the_closed_forms():
    model, u = published(), settled_sine(10.0)
    for k in range(2):
        v, _ = model.respond(np.stack([u if k == 0 else 0 * u, u if k == 1 else 0 * u]))
        for o in range(2):
            r, w = theory.R_V, theory.W_UM_PER_V[o, k]
            loop = v[o, 400:800]
            assert u[700] == -10.0
            assert v[o, 500] == pytest.approx(theory.loop_amplitude(r, w, 10.0), abs=1e-9)
            assert v[o, 700] == pytest.approx(-theory.loop_amplitude(r, w, 10.0), abs=1e-9)
            rise = v[o, 300:501] - v[o, 300]
            np.testing.assert_allclose(rise, theory.rising_branch(r, w, 10.0, u[300:501]), atol=1e-9)
            # The polygon through the samples misses the kinks, by an amount that falls with their distance.
            assert theory.polygon_area(u[400:800], loop) == pytest.approx(
                abs(theory.loop_area(r, w, 10.0)), rel=2e-3
            )


def test_simulated_loop_through_every_kink_has_the_closed_area():
    r, w = theory.R_V, theory.W_UM_PER_V[0, 0]
    up = np.sort(np.concatenate([2 * r - 10.0, [-10.0, 10.0]]))
    loop = np.concatenate([up, -up[1:]])
    u = np.concatenate([loop, loop[1:]])
    v, _ = PrandtlIshlinskii([[Pair(r, w)]]).respond([u])
    start = len(loop) - 1
    area = theory.polygon_area(u[start:-1], v[0, start:-1])
    assert area == pytest.approx(theory.loop_area(r, w, 10.0), abs=1e-9)


def test_published_loops_have_the_printed_widths():
    """Width at mid height over height: 16.7 % (xx) and 15.2 % (yy)."""
    for o, percent in ((0, 16.7), (1, 15.2)):
        pair = published().pairs[o][o]
        height = 2 * pair.amplitude(10.0)
        rise_um = theory.rising_branch(pair.thresholds_v, pair.weights_um_per_v, 10.0, 0.0)
        width_um = height - 2 * rise_um
        assert 100 * width_um / height == pytest.approx(percent, abs=0.05)


def test_slopes_and_amplitude_of_a_pair():
    pair = Pair([0.5, 1.0, 3.0], [2.0, -1.0, 0.5])
    np.testing.assert_array_equal(pair.slopes, [2.0, 1.0, 1.5])
    assert pair.amplitude(2.0) == pytest.approx(2.0 * 1.5 - 1.0, abs=1e-12)


# ---- state ----


def test_the_smallest_step_of_a_voltage_engages_an_operator():
    """A segment of no operator stood in the stack; what was then read beside the thresholds never ended."""
    tiny, r, w = 5e-324, np.array([0.0, 1.0]), np.array([1.0, 2.0])
    model, path = PrandtlIshlinskii([[Pair(r, w)]]), np.array([3.0, 0.0, tiny])
    _, end = model.respond([path])
    assert (end.end[0, : end.count[0]] > 0).all()
    whole = np.concatenate([path, [-2.0, 2.0, 0.0, tiny, 4.0]])
    v, _ = model.respond([whole])
    np.testing.assert_allclose(v[0], theory.prandtl_ishlinskii([whole], [[r]], [[w]])[0], atol=1e-12)


@settings(max_examples=60)
@given(models_and_inputs())
def test_step_equals_respond_to_the_last_bit(case):
    model, u = case
    v, end = model.respond(u)
    state, steps = model.rest(), []
    for sample in u.T:
        out, state = model.step(sample, state)
        steps.append(out)
    np.testing.assert_array_equal(np.array(steps).T, v)
    for a, b in zip(model.plays_of(state), model.plays_of(end), strict=True):
        np.testing.assert_array_equal(a, b)


@settings(max_examples=60)
@given(models_and_inputs(), st.data())
def test_a_signal_cut_in_two_gives_the_same_bits_through_json(case, data):
    model, u = case
    cut = data.draw(st.integers(0, u.shape[1]))
    whole, _ = model.respond(u)
    first, state = model.respond(u[:, :cut])
    restored = model.restore(json.loads(json.dumps(state.as_dict())))
    second, _ = model.respond(u[:, cut:], restored)
    np.testing.assert_array_equal(np.concatenate([first, second], axis=1), whole)


@settings(max_examples=200)
@given(st.data())
def test_step_equals_respond_where_rounding_decides(data):
    """Voltages a few last bits apart: whether the input turned must not depend on how it is asked."""
    near = st.builds(
        lambda v, i, unit: v + i * unit,
        st.sampled_from([-3.3, 0.1, 2.7, 5.1]),
        st.integers(-6, 6),
        st.sampled_from([1e-16, 4.4e-16, 1e-15]),
    )
    corners = data.draw(st.lists(near, min_size=2, max_size=6))
    steps = data.draw(st.lists(st.integers(-3, 3), min_size=5 * len(corners), max_size=5 * len(corners)))
    u = np.repeat(corners, 5) + 2.2e-16 * np.array(steps)
    smallest = data.draw(st.sampled_from([0.0, 1e-16, 0.1]))
    model = PrandtlIshlinskii([[Pair([smallest, 1.0, 2.0], [2.0, -0.7, 0.3])], [Pair([1.0], [1.1])]])
    whole, state = model.respond([u])[0], model.rest()
    for t, sample in enumerate(u):
        v, state = model.step([sample], state)
        np.testing.assert_array_equal(v, whole[:, t])


def test_blocks_of_any_length_give_the_bits_of_one_piece():
    model = published()
    rng = np.random.default_rng(RNG_SEED)
    u = np.cumsum(rng.normal(0, 0.4, (2, 20000)), axis=1)
    u = 10 * np.sin(u / 5)
    whole, _ = model.respond(u)
    state, pieces = model.rest(), []
    for block in np.split(u, [1, 2, 2048, 2049, 4500, 12288, 19999], axis=1):
        v, state = model.respond(block, state)
        pieces.append(v)
    np.testing.assert_array_equal(np.concatenate(pieces, axis=1), whole)


def test_the_start_state_is_not_written_to():
    model = published()
    _, state = model.respond([[1.0, 5.0, 2.0], [0.0, -3.0, 4.0]])
    before = json.dumps(state.as_dict())
    model.respond([[9.0, -9.0], [9.0, -9.0]], state)
    assert json.dumps(state.as_dict()) == before


@settings(max_examples=60)
@given(models_and_inputs(), signals)
def test_a_state_is_its_plays(case, more):
    """The plays of a state are those of equation 1, and a state made of them goes on alike."""
    model, u = case
    _, state = model.respond(u)
    plays = model.plays_of(state)
    for k, n in enumerate(model.bank.n):
        expected = [theory.play(u[k], r)[-1] for r in model.bank.r[k, :n]]
        np.testing.assert_allclose(plays[k], expected, rtol=0, atol=1e-12 * 20)
    again = model.state_of(plays)
    for a, b in zip(model.plays_of(again), plays, strict=True):
        np.testing.assert_array_equal(a, b)
    on = np.tile(more, (model.n_inputs, 1))
    v, _ = model.respond(on, state)
    np.testing.assert_allclose(model.respond(on, again)[0], v, rtol=0, atol=1e-12 * size(model))


def test_rest_is_all_plays_at_zero():
    model = published()
    for plays in model.plays_of(model.rest()):
        np.testing.assert_array_equal(plays, np.zeros(15))


# ---- what makes a Prandtl-Ishlinskii model ----


@settings(max_examples=60)
@given(models(n_inputs=1), signals, signals, st.floats(6.0, 12.0))
def test_a_larger_swing_wipes_out_what_it_covers(model, past, other_past, peak):
    """After -M and +M beyond every earlier extreme, nothing of the past is left."""
    peak = max(peak, np.abs(past).max(), np.abs(other_past).max())
    swing = np.array([-3 * peak, 3 * peak, 0.0, 1.0])
    a, _ = model.respond([np.concatenate([past, swing])])
    b, _ = model.respond([np.concatenate([other_past, swing])])
    np.testing.assert_allclose(a[:, -3:], b[:, -3:], rtol=0, atol=1e-12 * 3 * size(model))


@settings(max_examples=60)
@given(models(n_inputs=1), signals, signals, coarse, coarse)
def test_minor_loops_between_the_same_voltages_are_congruent(model, past, other_past, low, high):
    low, high = min(low, high), max(low, high)
    loop = np.concatenate([np.linspace(low, high, 9), np.linspace(high, low, 9)[1:]])
    shapes = []
    for before in (past, other_past):
        v, _ = model.respond([np.concatenate([before, [low, high, low], loop])])
        shapes.append(v[:, -len(loop) :] - v[:, [-len(loop)]])
    np.testing.assert_allclose(shapes[0], shapes[1], rtol=0, atol=1e-12 * 2 * size(model))


@settings(max_examples=60)
@given(models(n_inputs=1), signals, st.integers(1, 7))
def test_the_output_does_not_depend_on_the_rate(model, corners, finer):
    """More samples on the way between the same corners change nothing at the corners."""
    path = np.concatenate([[0.0], corners])
    fine = np.concatenate([np.linspace(a, b, finer + 1)[1:] for a, b in zip(path, corners, strict=False)])
    fine[finer - 1 :: finer] = corners
    v, _ = model.respond([corners])
    np.testing.assert_allclose(
        model.respond([fine])[0][:, finer - 1 :: finer], v, rtol=0, atol=1e-12 * size(model)
    )


@settings(max_examples=60)
@given(models(n_inputs=1), signals)
def test_an_odd_law_answers_an_inverted_signal_inverted(model, u):
    np.testing.assert_allclose(
        model.respond([-u])[0], -model.respond([u])[0], rtol=0, atol=1e-12 * size(model)
    )


# ---- python-control ----


def test_the_exported_system_gives_the_same_numbers_in_interconnect():
    rectangular = PrandtlIshlinskii(
        [
            [Pair([0.2, 1.0], [3.0, -1.0]), Pair.linear(0.5), Pair.absent()],
            [Pair([0.5], [1.5]), Pair.absent(), Pair([0.1, 0.4, 2.0], [1.0, 0.3, 0.7])],
        ]
    )
    for model in (published(), rectangular):
        m, p = model.n_inputs, model.n_outputs
        dt = 5e-5
        block = model.to_iosys(dt, name="gamma")
        gain = control.nlsys(None, lambda t, x, u, params: 2.0 * u, dt=dt, name="gain", inputs=p, outputs=p)
        loop = control.interconnect(
            [block, gain],
            connections=[[f"gain.u[{o}]", f"gamma.hysteresis_um[{o}]"] for o in range(p)],
            inplist=[f"gamma.drive_v[{k}]" for k in range(m)],
            outlist=[f"gain.y[{o}]" for o in range(p)],
        )
        time = np.arange(120) * dt
        u = np.random.default_rng(RNG_SEED).uniform(-10, 10, (m, 120))
        response = control.input_output_response(loop, time, u)
        expected = 2.0 * model.respond(u)[0]
        np.testing.assert_allclose(response.outputs.reshape(p, -1), expected, rtol=0, atol=1e-12 * 150)


# ---- refusals ----


@pytest.mark.parametrize(
    ("r", "w", "says"),
    [
        ([0.0, np.nan], [1.0, 1.0], "not finite"),
        ([0.0, np.inf], [1.0, 1.0], "not finite"),
        ([-0.5, 1.0], [1.0, 1.0], "negative value, -0.5 V"),
        ([1.0, 0.5], [1.0, 1.0], "not strictly increasing"),
        ([0.5, 0.5], [1.0, 1.0], "not strictly increasing"),
        ([0.5], [np.nan], "not finite"),
        ([0.5, 1.0], [1.0], "shape (1,)"),
        ([[0.5]], [[1.0]], "shape (1, 1)"),
    ],
)
def test_a_pair_refuses(r, w, says):
    with pytest.raises(InputError, match=re.escape(says)):
        Pair(r, w)


def test_a_pair_refuses_errors_of_another_length_and_names_all_mistakes():
    with pytest.raises(InputError) as caught:
        Pair([2.0, 1.0], [np.inf, 1.0], [0.1])
    assert [mistake.where for mistake in caught.value.mistakes] == [
        "weight_errors_um_per_v",
        "thresholds_v",
        "weights_um_per_v",
    ]


def test_a_model_from_arrays_names_the_pair():
    weights = theory.W_UM_PER_V.copy()
    weights[1, 0, 3] = np.nan
    with pytest.raises(InputError, match="pair of output 2 and input 1"):
        PrandtlIshlinskii.from_arrays(theory.R_V, weights)
    with pytest.raises(InputError, match=re.escape("weights have shape (2, 15)")):
        PrandtlIshlinskii.from_arrays(theory.R_V, weights[0])
    with pytest.raises(InputError, match="pair of output 1 and input 1"):
        PrandtlIshlinskii.from_arrays(theory.R_V[:3], weights)


def test_a_model_refuses_ragged_rows_and_no_operator():
    with pytest.raises(InputError, match="one pair for each input"):
        PrandtlIshlinskii([[Pair.linear(1.0)], [Pair.linear(1.0), Pair.linear(1.0)]])
    with pytest.raises(InputError, match="one pair for each input"):
        PrandtlIshlinskii([])
    with pytest.raises(InputError, match="all pairs are absent"):
        PrandtlIshlinskii([[Pair.absent()]])


def test_a_response_refuses_the_wrong_shape_and_names_what_is_not_finite():
    model = published()
    with pytest.raises(InputError, match=re.escape("has shape (3, 4)")):
        model.respond(np.zeros((3, 4)))
    u = np.zeros((2, 5000))
    u[1, 4321] = np.nan
    with pytest.raises(SimulationError, match="input 2 is not finite at sample 4321"):
        model.respond(u)
    u[0, 4322] = -np.inf
    u[1, 4321] = 0.0
    with pytest.raises(SimulationError, match="input 1 is not finite at sample 4322"):
        model.respond(u)


def test_a_state_refuses_plays_that_no_voltage_leads_to():
    model = PrandtlIshlinskii([[Pair([0.5, 1.0], [1.0, 1.0])]])
    with pytest.raises(InputError, match="differ by more than their thresholds"):
        model.state_of([[0.0, 0.6]])
    with pytest.raises(InputError, match="2 finite plays for input 1"):
        model.state_of([[0.0]])
    with pytest.raises(InputError, match="2 finite plays for input 1"):
        model.state_of([[0.0, np.nan]])


@pytest.mark.parametrize(
    ("u", "r", "start", "said"),
    [
        (np.zeros((2, 3)), [1.0], None, r"u has shape \(2, 3\).*respond"),
        (1.0, [1.0], None, r"u has shape \(\)"),
        (np.zeros(3), [[1.0]], None, r"r has shape \(1, 1\)"),
        (np.zeros(3), [1.0], [1.0, 2.0], "start has 2 outputs, r 1"),
        (["a"], [1.0], None, "u contains a value that is not a number"),
        ([0.0, np.nan], [1.0], None, "u is not finite at index 1"),
    ],
)
def test_what_play_cannot_play_is_one_message(u, r, start, said):
    with pytest.raises(InputError, match=said):
        play(u, r, start)


def test_a_pair_says_what_it_is():
    assert repr(Pair.absent()) == "Pair(absent)"
    told = "Pair(2 operators, thresholds 0.5 to 1.25 V, summed weight 3.5 um/V)"
    assert repr(Pair([0.5, 1.25], [3.0, 0.5])) == told


def test_plays_of_negative_thresholds_are_refused():
    with pytest.raises(InputError, match="r holds -1 V, but thresholds are 0 or more"):
        play([0.0, 1.0], [0.5, -1.0])


@pytest.mark.parametrize("passes", [1, 2])
def test_derivatives_by_thresholds_are_differences_of_the_outputs(passes):
    rows = [[Pair([0.0, 1.0, 2.5], [1.0, 2.0, -0.3]), Pair([0.4, 3.0], [0.3, 0.2])]]
    rows += [[Pair([0.5, 2.5], [0.1, 0.2]), Pair([0.4], [1.0])]]  # thresholds that some pairs lack
    block, generator = PrandtlIshlinskii(rows), np.random.default_rng(3)
    driven = generator.uniform(-8.0, 8.0, (2, 200)), generator.uniform(-8.0, 8.0, (2, 3)), passes
    for one, other in zip(block.bends(*driven), Identifiable.bends(block, *driven), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_thresholds_that_meet_stay_apart():
    block = PrandtlIshlinskii([[Pair([0.0, 1.0, 2.5, 4.0], [1.0, 2.0, 3.0, 4.0])]])
    moved = block.at(np.array([0.0, 2.5, 2.5, 2.5])).pairs[0][0].thresholds_v
    assert np.diff(moved).min() > 0.9e-3 * 2.5
    assert moved[-1] == 2.5
    np.testing.assert_array_equal(block.at(block.free).free, block.free)

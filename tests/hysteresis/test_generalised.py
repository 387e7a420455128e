"""Plays of an envelope of each voltage: the generalised Prandtl-Ishlinskii model."""

from dataclasses import replace

import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

import hammerstein
from hammerstein.blocks.voltages import Voltages
from hammerstein.compensators.exact.inverse import exact_inverse_of
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.errors import InputError
from hammerstein.hysteresis import Envelope, Generalised, Pair, PrandtlIshlinskii, identifiable
from hammerstein.hysteresis.generalised import EnvelopeFile
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.hysteresis.shape_kernels import tanh_by_doubling
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

SEED = 29
R, W = [0.0, 5.0, 12.0, 22.0, 40.0], [0.5, 0.12, 0.1, 0.15, 0.1]
KNOTS, BENDS, FIRST = [25.0, 50.0, 70.0], [0.4, -0.5, 0.6], 0.7
"""Dead-zones in front of the plays: where the slope of the envelope changes, and by how much."""


def random_model(seed, m=2, p=2, tangent=False):
    generator = np.random.default_rng(seed)
    envelopes = []
    for _ in range(m):
        u = np.sort(generator.uniform(-10.0, 10.0, 5)) + 0.1 * np.arange(5)
        g = np.cumsum(np.diff(u, prepend=u[0] - 1.0) * generator.uniform(0.4, 2.0, 5)) - 8.0
        bent = (generator.uniform(0.5, 3.0), generator.uniform(0.05, 0.6), generator.uniform(-3.0, 3.0))
        envelopes.append(Envelope(u, g, *bent) if tangent else Envelope(u, g))
    r = np.array([0.0, 0.7, 2.0, 5.0])
    pairs = [
        [Pair(r, generator.uniform(0.3, 1.0, 4) * (1.0 if o == k else 0.05)) for k in range(m)]
        for o in range(p)
    ]
    hysteresis = Generalised(tuple(envelopes), PrandtlIshlinskii(pairs))
    rest = generator.uniform(-2.0, 2.0, m)
    names = tuple(f"u{k}" for k in range(m)), tuple(f"y{o}" for o in range(p))
    voltages = Voltages.of(rest.tolist(), rest - 9.0, rest + 9.0)
    return HammersteinModel("test", hysteresis, StaticDynamics(n_outputs=p), 9.0, *names, voltages=voltages)


def by_definition(model, u_v):
    """The plays of theory, of the envelopes of the voltages, from the working point."""
    rest, block = np.array(model.recorded.working_point_v), model.hysteresis
    seen = []
    for own, u, at_rest in zip(block.envelopes, u_v, rest, strict=True):

        def g(v, one=own):
            inside = np.interp(v, one.voltages_v, one.values_v)
            first, last = (np.diff(one.values_v) / np.diff(one.voltages_v))[[0, -1]]
            below, above = np.minimum(v - one.voltages_v[0], 0.0), np.maximum(v - one.voltages_v[-1], 0.0)
            return (
                inside
                + first * below
                + last * above
                + one.saturating_v * np.tanh(one.steepness_per_v * (v - one.centre_v))
            )

        seen.append(g(u) - g(at_rest))
    pairs = block.plays.pairs
    thresholds = [[pair.thresholds_v for pair in row] for row in pairs]
    return theory.prandtl_ishlinskii(
        np.array(seen), thresholds, [[pair.weights_um_per_v for pair in row] for row in pairs]
    )


def walk(seed, m, n=300):
    return 8.0 * np.sin(np.cumsum(np.random.default_rng(seed).normal(0.0, 0.4, (m, n)), axis=1))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_it_is_the_plays_of_the_envelope(seed, tangent):
    model = random_model(seed, tangent=tangent)
    u = walk(seed, 2)
    here = model.hysteresis
    rest = np.array(model.recorded.working_point_v)[:, None]
    np.testing.assert_allclose(here.respond(u - rest)[0], by_definition(model, u), atol=1e-11)


def test_the_tangent_is_that_of_numpy_within_rounding():
    x = np.concatenate([np.linspace(-25.0, 25.0, 200_001), np.logspace(-300, 0, 1000), [0.0, -0.0, 1e300]])
    np.testing.assert_allclose(tanh_by_doubling(x), np.tanh(x), rtol=4e-15, atol=0.0)
    assert (np.diff(tanh_by_doubling(np.linspace(-3.0, 3.0, 10_001))) > 0.0).all()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans(), st.integers(1, 299))
def test_parts_and_steps_give_the_same_bits(seed, tangent, cut):
    block, u = random_model(seed, tangent=tangent).hysteresis, walk(seed, 2)
    whole, end = block.respond(u)
    first, state = block.respond(u[:, :cut])
    second, _ = block.respond(u[:, cut:], block.restore(state.as_dict()))
    np.testing.assert_array_equal(np.hstack([first, second]), whole)
    state, each = block.rest(), []
    for sample in u.T:
        y, state = block.step(sample, state)
        each.append(y)
    np.testing.assert_array_equal(np.stack(each, axis=1), whole)
    assert state.as_dict() == end.as_dict()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_the_inverse_puts_coupled_axes_on_any_path(seed, tangent):
    model = random_model(seed, tangent=tangent)
    goal = model.static_response(walk(seed, 2) * 0.7)[0]
    goal = goal - goal[:, :1]
    law = hammerstein.ExactInverse().design(model, 40.0, 1e-3)
    drive = law.respond(goal)[0]
    np.testing.assert_allclose(model.static_response(drive)[0], goal, atol=1e-9)
    state, each = law.rest(), []
    for sample in goal.T:
        v, state = law.step(sample, state)
        each.append(v)
    np.testing.assert_array_equal(np.stack(each, axis=1), drive)


def test_at_the_end_of_the_range_the_drive_stands_there_and_comes_back():
    model = random_model(3, 1, 1, tangent=True)
    low, high = -4.0, 5.0
    law = hammerstein.ExactInverse().design(model, (low, high), 1e-3)
    drive = law.respond([[0.0, 1e3, 1e3, 0.0, -1e3, 0.0]])[0][0]
    assert drive[1] == drive[2] == high
    assert drive[4] == low
    reached = model.static_response(drive[None])[0][0]
    np.testing.assert_allclose(reached[[3, 5]], 0.0, atol=1e-9)


def test_the_inverse_of_dynamics_builds_on_it():
    static = random_model(5)
    axes = AxesDynamics(axes=(Axis(resonance_hz=90.0, damping_ratio=0.2),) * 2)
    model = replace(static, dynamics=axes)
    t = np.arange(4000) * 1e-4
    goal = np.stack([2.0 * np.sin(20.0 * t) ** 2, np.sin(31.0 * t) ** 2])
    law = hammerstein.HammersteinInverse().design(model, 40.0, 1e-4)
    moved = discretise(axes, 1e-4).respond(model.static_response(law.drive_for(goal))[0])[0]
    np.testing.assert_allclose(moved[:, 200:-200], goal[:, 200:-200], atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_slopes_and_extremes_hold_for_any_path(seed, tangent):
    """No chord of a path is steeper or flatter than what the block says of its slopes."""
    block = random_model(seed, 1, 1, tangent=tangent).hysteresis
    u = walk(seed, 1)
    v = block.respond(u)[0]
    moved = np.abs(np.diff(u[0])) > 1e-6
    chords = (np.diff(v[0]) / np.where(moved, np.diff(u[0]), 1.0))[moved]
    columns = block.slope_columns(0)
    assert columns.min() - 1e-9 <= chords.min()
    assert chords.max() <= columns.max() + 1e-9
    assert invertibility(block, 9.0).invertible


def test_the_height_of_a_loop_has_the_sign_of_its_slope():
    """Of a straight envelope it is that of plays, sum of w (A - r); a cross-coupling may be negative."""
    weights = np.array([[W, [-0.1 * w for w in W]], [[0.2 * w for w in W], W]])
    plays = PrandtlIshlinskii([[Pair(R, w) for w in row] for row in weights])
    block = Generalised((Envelope([-1.0, 1.0], [-1.0, 1.0]),) * 2, plays)
    expected = np.array([[w @ np.maximum(30.0 - np.array(R), 0.0) for w in row] for row in weights])
    np.testing.assert_allclose(block.amplitude(30.0), expected, atol=1e-9)


def test_wiping_out_and_no_congruency():
    """A way that turns and comes back leaves no trace; loops of one swing differ where the envelope bends."""
    block = Generalised((Envelope([-10.0, 0.0, 10.0], [-5.0, 0.0, 10.0]),), PrandtlIshlinskii([[Pair(R, W)]]))
    v = block.respond([[0.0, 8.0, 2.0, 6.0, 2.0, 8.0, -3.0]])[0][0]
    plain = block.respond([[0.0, 8.0, -3.0]])[0][0]
    assert v[[1, 5, 6]].tolist() == plain[[1, 1, 2]].tolist()
    above = np.ptp(block.respond([[0.0, 10.0, 0.0]])[0][0][1:])
    below = np.ptp(block.respond([[0.0, -10.0, 0.0]])[0][0][1:])
    assert above > 1.5 * below


def test_it_is_saved_and_loaded(tmp_path):
    model = random_model(11, tangent=True)
    model.save(tmp_path / "m.json")
    again = HammersteinModel.load(tmp_path / "m.json")
    assert again.hysteresis == model.hysteresis
    assert again.digest() == model.digest()


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        (([0.0, 1.0], [0.0, 0.0]), "strictly increasing"),
        (([0.0], [0.0]), "two points"),
        (([0.0, 1.0], [0.0, np.nan]), "finite"),
        (([0.0, 1.0], [0.0, 1.0], -1.0), "0 or more"),
    ],
)
def test_an_envelope_without_an_inverse_is_refused(numbers, says):
    with pytest.raises(InputError, match=says):
        Envelope(*numbers)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_free_numbers_give_the_block_back(seed, tangent):
    block = random_model(seed, tangent=tangent).hysteresis
    once = block.at(block.free)
    u = walk(seed, 2)
    again = once.at(once.free)
    np.testing.assert_allclose(again.respond(u)[0], once.respond(u)[0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_thresholds_stay_so_far_apart_that_readings_tell_two_from_one(seed):
    """At a distance of 1e-9, weights grew to 4.5e8 um/V, and their sums gave a tenth of the true error."""
    block, generator = random_model(seed).hysteresis, np.random.default_rng(seed)
    free = block.free.copy()
    crowded = generator.choice([1e-3, 0.5, 0.999], size=3) + 1e-6 * generator.standard_normal(3)
    free[:3] = crowded
    half = 0.5 * np.ptp(block.envelopes[0].voltages_v)
    r = block.at(free).plays.pairs[0][0].thresholds_v / half
    assert np.diff(r).min() > 0.99e-3
    assert r[-1] < 1.0
    np.testing.assert_allclose(r[1:], np.sort(crowded), atol=2.6e-3)


@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("tangent", [False, True])
def test_derivatives_are_differences_of_the_outputs(tangent, passes, monkeypatch):
    """In closed form, those of the plays hold the change of their input from when they last moved."""
    monkeypatch.setattr(identifiable, "STEP", 1e-7)
    block, generator = random_model(3, tangent=tangent).hysteresis, np.random.default_rng(3)
    block = block.at(block.free).counted_from([0.7, -0.4])
    driven = generator.uniform(-8.0, 8.0, (2, 200)), generator.uniform(-8.0, 8.0, (2, 3)), passes
    for one, other in zip(block.bends(*driven), Identifiable.bends(block, *driven), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


def measured(turns, end, seed=0, noise=0.0, samples=2500):
    """A stack from 0 to 100 V whose plays stand behind dead-zones, from rest at 10 V."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, samples)
    sent = 10.0 + 45.0 * (1.0 - np.cos(angle)) * np.linspace(1.0, end, samples)
    seen = FIRST * sent + sum(b * theory.dead_zone(sent, q) for q, b in zip(KNOTS, BENDS, strict=True))
    v = theory.prandtl_ishlinskii([seen - seen[0]], [[R]], [[W]])
    y = v + noise * np.random.default_rng(seed).standard_normal(v.shape)
    return Record([sent], y, 1e-3, ("u",), ("x",), f"{turns}-{end}.csv")


def test_identified_from_a_clean_record_it_is_the_truth():
    """0.003 % of the range held back; dead-zones beside the plays cannot write it (0.2 % and more stay)."""
    fitted, held = [measured(3, 0.3), measured(4, 0.6)], [measured(5, 0.45)]
    asked = Settings(hysteresis="generalised", dynamics="none", delay_samples=0, thresholds_v=R)
    model, fit = identify(fitted, asked, validation=held)
    assert fit.validation["static_hysteresis"].nrmse_percent[0] < 0.003
    assert fit.invertible
    np.testing.assert_allclose(model.hysteresis.envelopes[0].voltages_v[1:-1], KNOTS, atol=0.2)
    law = exact_inverse_of(model.hysteresis, model, (0.0, 100.0))
    goal = 20.0 * np.sin(np.linspace(0.0, 6.0, 300))[None] ** 2
    np.testing.assert_allclose(model.static_response(law.respond(goal)[0])[0], goal, atol=1e-9)


@pytest.mark.full
@pytest.mark.parametrize("given", [{"thresholds_v": R, "delay_samples": 0, "dynamics": "none"}, {}])
def test_five_experiments_leave_a_thousandth_of_a_percent_of_one_held_back(given):
    """With thresholds to begin with, or nothing given; dead-zones beside the plays leave 0.2 % and more."""
    fitted = [measured(n, end, samples=5000) for n, end in ((3, 0.3), (4, 0.6), (2, 0.8), (5, 0.2), (3, 1.0))]
    asked = Settings(hysteresis="generalised", error_curve=False, **given)
    held = [measured(5, 0.45, samples=5000)]
    _, fit = identify(fitted, asked, validation=held)
    assert fit.validation["static_hysteresis"].nrmse_percent[0] < 0.001


def test_what_a_file_leaves_out_of_an_envelope_is_what_a_value_leaves_out():
    told = {"voltages_v": (0.0, 10.0), "values_v": (0.0, 4.0), "saturating_v": 2.0, "steepness_per_v": 0.5}
    assert EnvelopeFile.model_validate(told).value() == Envelope(**told)


def test_the_gain_of_a_one_sided_actuator_is_that_of_its_own_loop():
    """Heights of settled loops over the recorded range, by definition; a loop about 0 V is another one."""
    model = random_model(SEED)
    model = replace(model, voltages=Voltages.of([0.0, 0.0], [0.0, -1.0], [9.0, 7.0]))
    up = np.linspace(0.0, 1.0, 400)
    for k, (low, high) in enumerate([(0.0, 9.0), (-1.0, 7.0)]):
        u = np.zeros((2, 2000))
        u[k] = low + (high - low) * np.concatenate([up, up[::-1], up, up[::-1], up])
        heights = np.ptp(by_definition(model, u)[:, 1000:], axis=1)
        sizes = np.array([4.5, 4.0])
        np.testing.assert_allclose(2.0 * model.amplitude(sizes)[:, k], heights, rtol=1e-3)
        assert np.abs(2.0 * model.hysteresis.amplitude(sizes)[:, k] / heights - 1.0).max() > 0.02

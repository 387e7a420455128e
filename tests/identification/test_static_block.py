"""Least squares for the static block: exact recovery, bounds, standard errors, filters, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st
from scipy.signal import lfilter

from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError
from hammerstein.identification.identify import identify
from hammerstein.identification.model_selection import CurvePoint, enough_operators, error_curve
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.normal_equations import (
    Bounds,
    coefficients,
    moments_of,
    pooled,
    solve,
    squares_left,
)
from hammerstein.identification.static.regressors import (
    InitialState,
    PlayColumns,
    Regressors,
    SideBySide,
    channel,
)
from hammerstein.identification.static.static_block import direct_pairs, fit_static, input_grids
from hammerstein.records.record import Record

SHAPES = [(1, 1), (1, 2), (2, 1), (2, 2), (2, 3), (3, 2), (3, 3)]


def random_walk(generator, inputs, samples=3000, amplitude=10.0):
    """Inputs that wander over the whole range and turn often."""
    walk = np.cumsum(generator.standard_normal((inputs, samples)), axis=1)
    low, high = walk.min(axis=1, keepdims=True), walk.max(axis=1, keepdims=True)
    return amplitude * (2.0 * (walk - low) / (high - low) - 1.0)


def random_model(generator, inputs, outputs):
    """Ragged thresholds, well below half the range, and weights of either sign."""
    thresholds = [
        [
            np.sort(generator.choice(np.arange(40), generator.integers(1, 8), replace=False)) * 0.2
            for _ in range(inputs)
        ]
        for _ in range(outputs)
    ]
    weights = [[generator.standard_normal(len(r)) for r in row] for row in thresholds]
    return thresholds, weights


def record_of(u, thresholds, weights, offset=0.0, noise=0.0, generator=None):
    y = theory.prandtl_ishlinskii(u, thresholds, weights) + offset
    if noise:
        y = y + noise * generator.standard_normal(y.shape)
    return Record(u, y, 1e-3, verified=True)


def worst(hysteresis, weights):
    return max(
        float(np.abs(pair.weights_um_per_v - w).max())
        for row, wanted in zip(hysteresis.pairs, weights, strict=True)
        for pair, w in zip(row, wanted, strict=True)
    )


@pytest.mark.parametrize(("inputs", "outputs"), SHAPES)
@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1))
def test_noise_free_records_return_their_weights(inputs, outputs, seed):
    generator = np.random.default_rng(seed)
    thresholds, weights = random_model(generator, inputs, outputs)
    offset = 100.0 * generator.standard_normal((outputs, 1))
    record = record_of(random_walk(generator, inputs), thresholds, weights, offset)
    fit = fit_static([record], thresholds, solver="least_squares")
    assert worst(fit.hysteresis, weights) < 1e-8
    assert np.abs(fit.offsets_um - offset.T).max() < 1e-7
    assert fit.open == ()


def test_an_output_without_a_direct_input_has_no_bounds():
    generator = np.random.default_rng(5)
    thresholds, weights = [[np.zeros(1)], [np.zeros(1)]], [[np.array([4.0])], [np.array([0.3])]]
    record = record_of(random_walk(generator, 1), thresholds, weights, noise=0.1, generator=generator)
    fit = fit_static([record], thresholds, solver="invertible")
    assert worst(fit.hysteresis, weights) < 0.01


def test_a_weight_that_no_sign_suits_is_zero_and_has_no_error():
    generator = np.random.default_rng(6)
    thresholds = [[np.zeros(1)]]
    record = record_of(random_walk(generator, 1), thresholds, [[np.array([4.0])]])
    moments = moments_of([(record.u_v, record.y_um)], 1, 1)
    bounds = Bounds(np.eye(1), np.array([-1.0]), np.zeros(1))
    found = solve(moments.gram, moments.cross[:, 0], float(moments.power[0]), moments.freedom, bounds=bounds)
    assert found.coefficients.tolist() == [0.0]
    assert found.at_bound.all()
    assert not found.spread.any()


def test_several_records_with_their_own_offsets_are_one_problem():
    generator = np.random.default_rng(1)
    thresholds, weights = random_model(generator, 2, 2)
    alone = []
    for k, offset in enumerate((-30.0, 12.0)):
        u = np.zeros((2, 2000))
        u[k] = random_walk(generator, 1, 2000)[0]
        alone.append(record_of(u, thresholds, weights, offset))
    fit = fit_static(alone, thresholds, solver="least_squares")
    assert worst(fit.hysteresis, weights) < 1e-8
    assert np.abs(fit.offsets_um - [[-30.0, -30.0], [12.0, 12.0]]).max() < 1e-7
    assert fit.samples == 4000


def test_a_record_in_blocks_gives_the_same_as_in_one(monkeypatch):
    generator = np.random.default_rng(2)
    thresholds, weights = random_model(generator, 2, 1)
    record = record_of(random_walk(generator, 2), thresholds, weights, 0.0, 0.1, generator)
    whole = fit_static([record], thresholds)
    monkeypatch.setattr("hammerstein.identification.static.regressors.BLOCK", 37)
    pieces = fit_static([record], thresholds)
    found = [pair.weights_um_per_v for pair in whole.hysteresis.pairs[0]]
    assert worst(pieces.hysteresis, [found]) < 1e-10


def test_standard_errors_cover_the_truth():
    generator = np.random.default_rng(3)
    r, w = [[theory.R_V]], [[np.array(theory.W_XX)]]
    u = np.tile(10.0 * np.sin(2.0 * np.pi * np.arange(400) / 400), 5)[None]
    clean = theory.prandtl_ishlinskii(u, r, w)
    scores = []
    for _ in range(40):
        record = Record(u, clean + 0.04 * generator.standard_normal(clean.shape), 5e-5)
        pair = fit_static([record], r, solver="least_squares").hysteresis.pairs[0][0]
        scores.append((pair.weights_um_per_v - w[0][0]) / pair.weight_errors_um_per_v)
    assert np.std(scores) == pytest.approx(1.0, abs=0.1)  # 600 normal scores: 0.03 each way
    assert abs(np.mean(scores)) < 0.2


def lagging_record():
    """A loop whose lag asks for a negative first slope (theory: none of ours is involved)."""
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(2000) / 400)[None]
    v = theory.prandtl_ishlinskii(u, [[theory.R_V]], [[theory.W_XX]])
    return Record(u, lfilter([0.05], [1.0, -0.95], v), 5e-5)


def test_invertible_keeps_every_slope_of_the_direct_pair_positive():
    record = lagging_record()
    free = fit_static([record], [[theory.R_V]], solver="least_squares").hysteresis.pairs[0][0]
    fit = fit_static([record], [[theory.R_V]])
    pair = fit.hysteresis.pairs[0][0]
    assert free.slopes.min() < 0.0
    gain = free.amplitude(10.0) / 10.0
    assert pair.slopes.min() == pytest.approx(0.05 * gain, rel=1e-6)
    assert (0, 0, 0) in fit.bounded
    assert fit.rms_um[0] > fit_static([record], [[theory.R_V]], solver="least_squares").rms_um[0]


def test_invertible_leaves_negative_weights_alone_where_slopes_are_positive():
    r, w = [[theory.R_V]], [[np.array(theory.W_XX)]]
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)[None]
    fit = fit_static([record_of(u, r, w)], r)
    assert min(w[0][0]) < 0.0
    assert worst(fit.hysteresis, w) < 1e-8
    assert fit.bounded == ()


def test_nonnegative_gives_every_weight_the_sign_of_the_gain():
    generator = np.random.default_rng(4)
    thresholds = [[np.array([0.0, 1.0, 2.0, 4.0])] * 2] * 2
    weights = [[np.array([3.0, -1.0, 1.0, 0.5]), np.array([-2.0, 0.5, -0.5, 0.1])]] * 2
    fit = fit_static(
        [record_of(random_walk(generator, 2), thresholds, weights)], thresholds, solver="nonnegative"
    )
    for row in fit.hysteresis.pairs:
        assert (row[0].weights_um_per_v >= 0.0).all()
        assert (row[1].weights_um_per_v <= 0.0).all()
        assert row[1].weights_um_per_v.sum() < -1.0


@pytest.mark.parametrize("solver", ["least_squares", "nonnegative", "invertible"])
def test_the_model_has_the_weights_of_the_solver_that_is_asked_for(solver):
    """Lag asks for a negative slope: free weights have one, and leave least."""
    record = lagging_record()
    asked = {"thresholds_v": theory.R_V, "dynamics": "none", "delay_samples": 0, "start": "rest"}
    [[pair]] = identify([record], Settings(solver=solver, error_curve=False, **asked))[0].hysteresis.pairs
    own = fit_static([record], [[theory.R_V]], solver=solver).hysteresis.pairs[0][0]
    assert pair.weights_um_per_v == pytest.approx(own.weights_um_per_v, rel=1e-9, abs=1e-12)
    assert (pair.slopes.min() < 0.0) == (solver == "least_squares")
    assert (pair.weights_um_per_v.min() < 0.0) == (solver != "nonnegative")


def test_direct_pairs_follow_the_largest_gains():
    assert direct_pairs(np.array([[1.0, 5.0], [4.0, 1.0]])) == [(0, 1), (1, 0)]
    assert direct_pairs(np.array([[1.0, -5.0, 2.0]])) == [(0, 1)]


def test_ridge_makes_up_for_thresholds_that_the_record_cannot_tell_apart():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(200) / 40)[None]  # 40 samples a cycle, 60 thresholds
    r = [[10.0 * np.arange(60) / 60]]
    record = record_of(u, [[[0.0, 3.0]]], [[[2.0, 1.0]]], 0.0, 0.05, np.random.default_rng(5))
    bare = fit_static([record], r, solver="least_squares")
    calm = fit_static([record], r, solver="least_squares", ridge=1e-3)
    assert bare.open == ((0, 0),)
    assert np.abs(calm.hysteresis.pairs[0][0].weights_um_per_v[1:]).max() < 1.0
    assert calm.rms_um[0] < 0.3


def one_pole(pole):
    return LinearBlock(
        np.array([[pole]]), np.array([[1.0 - pole]]), np.array([[pole]]), np.array([[1.0 - pole]]), 1e-3
    )


def test_weights_behind_a_linear_block_come_back():
    generator = np.random.default_rng(6)
    thresholds, weights = random_model(generator, 2, 1)
    u = random_walk(generator, 2)
    v = theory.prandtl_ishlinskii(u, thresholds, weights)
    lagging = Record(u, lfilter([0.1], [1.0, -0.9], v), 1e-3, verified=True)
    fit = fit_static([lagging], thresholds, solver="least_squares", through=[one_pole(0.9)])
    assert worst(fit.hysteresis, weights) < 1e-8
    assert fit_static([lagging], thresholds, solver="least_squares").rms_um[0] > 0.1


def test_the_path_of_one_axis_keeps_only_the_states_it_needs():
    plant = LinearBlock(np.diag([0.5, 0.7]), np.eye(2), np.eye(2), np.zeros((2, 2)), 1e-3)
    both = plant.observed_by(plant)
    path = channel(both, 3, 1)
    assert path.A.shape == (2, 2)
    assert channel(both, 2, 1) is None
    u = np.random.default_rng(7).standard_normal((1, 50))
    wanted = lfilter([0.0, 1.0], [1.0, -0.7], lfilter([0.0, 1.0], [1.0, -0.7], u))
    copies = SideBySide(path)
    first, state = copies.respond(u[:, :20], copies.settled(np.zeros(1)))
    second, _ = copies.respond(u[:, 20:], state)
    assert np.abs(np.hstack([first, second]) - wanted).max() < 1e-12


def test_a_block_that_couples_the_outputs_is_refused():
    coupled = LinearBlock(np.array([[0.5]]), np.ones((1, 2)), np.ones((2, 1)), np.zeros((2, 2)), 1e-3)
    record = record_of(random_walk(np.random.default_rng(8), 2), [[[0.0]] * 2] * 2, [[[1.0]] * 2] * 2)
    with pytest.raises(IdentificationError, match="couples the outputs"):
        fit_static([record], [[np.zeros(1)] * 2] * 2, through=[coupled])


def test_what_the_records_cannot_tell_is_refused_by_name():
    u = random_walk(np.random.default_rng(9), 1)
    grid = np.array([0.0, 1.0])
    same = record_of(np.vstack([u, u]), [[grid] * 2], [[[1.0, 1.0]] * 2])
    with pytest.raises(IdentificationError, match="cannot separate inputs u1 and u2"):
        fit_static([same], [[grid] * 2])
    still = record_of(np.vstack([u, 0.0 * u]), [[grid] * 2], [[[1.0, 1.0]] * 2])
    with pytest.raises(IdentificationError, match="input u2 is never driven"):
        fit_static([still], [[grid] * 2])
    with pytest.raises(IdentificationError, match="threshold 12 V of input u1 is never engaged"):
        fit_static([same], [[np.array([0.0, 12.0]), grid]])


def test_an_absent_pair_stays_absent():
    generator = np.random.default_rng(10)
    thresholds = [[np.array([0.0, 1.0]), np.empty(0)], [np.empty(0), np.array([0.5])]]
    weights = [[np.array([2.0, 1.0]), np.empty(0)], [np.empty(0), np.array([3.0])]]
    fit = fit_static([record_of(random_walk(generator, 2), thresholds, weights)], thresholds)
    assert [len(pair.thresholds_v) for row in fit.hysteresis.pairs for pair in row] == [2, 0, 0, 1]
    assert fit.hysteresis.pairs[1][1].weights_um_per_v == pytest.approx([3.0], abs=1e-9)


@pytest.mark.full
def test_delay_is_found_with_hysteresis_in_the_way():
    u = random_walk(np.random.default_rng(11), 1)
    record = record_of(u, [[theory.R_V[:8]]], [[theory.W_XX[:8]]])
    late = Record(u[:, 3:], record.y_um[:, :-3], 1e-3)
    known = {"dynamics": "none", "thresholds_v": theory.R_V[:8], "start": "rest", "error_curve": False}
    assert identify([late], Settings(**known))[1].delay_samples == 3


def test_a_repeated_start_takes_the_record_for_its_own_past():
    u = np.tile(10.0 * np.sin(2.0 * np.pi * np.arange(400) / 400), 2)[None]
    y = theory.prandtl_ishlinskii(u, [[theory.R_V]], [[theory.W_XX]])[:, 400:]
    record = Record(u[:, 400:], y, 5e-5)
    fit = fit_static([record], [[theory.R_V]], solver="least_squares", starts=[InitialState("repeated")])
    assert worst(fit.hysteresis, [[theory.W_XX]]) < 1e-8
    assert fit_static([record], [[theory.R_V]], solver="least_squares").rms_um[0] > 0.1


def test_error_curve_levels_off_at_the_true_number_of_operators():
    generator = np.random.default_rng(12)
    r = input_grids(
        [Record(10.0 * np.sin(np.arange(3000) / 50.0)[None], np.arange(3000.0)[None], 1e-3)], 8, "voltage"
    )
    u = random_walk(generator, 1, 6000)
    record = record_of(u, [[r[0]]], [[np.linspace(3.0, 0.5, 8)]], 0.0, 0.01, generator)
    curve = error_curve([record], [InitialState("rest")], partition="voltage")
    errors = {point.operators: point.mean_percent for point in curve}
    assert errors[1] > 10.0 * errors[8]
    assert errors[8] == pytest.approx(100.0 * 0.01 / np.ptp(record.y_um), rel=0.1)
    assert enough_operators(curve) == 8


def test_error_curve_is_of_parts_that_were_not_fitted():
    generator = np.random.default_rng(14)
    u = random_walk(generator, 1, 400)
    noise = Record(u, generator.standard_normal((1, 400)), 1e-3)  # nothing to be learnt: more is worse
    few, *_, many = error_curve([noise], [InitialState("rest")])
    assert many.mean_percent > 1.02 * few.mean_percent


def test_enough_operators_takes_the_smallest_within_two_percent():
    curve = [CurvePoint(1, (7.0,)), CurvePoint(8, (0.815,)), CurvePoint(15, (0.8,))]
    assert enough_operators(curve) == 8


def test_moments_do_not_lose_digits_to_large_offsets():
    x = np.random.default_rng(13).standard_normal((2, 500))
    y = np.array([[2.0, -1.0]]) @ x + 1e7
    m = pooled([moments_of([(x[:, :200], y[:, :200]), (x[:, 200:], y[:, 200:])], 2, 1)])
    found = solve(m.gram, m.cross[:, 0], float(m.power[0]), m.freedom)
    assert found.coefficients == pytest.approx([2.0, -1.0], abs=1e-8)
    with pytest.raises(IdentificationError, match="no usable sample"):
        moments_of([], 2, 1)


def decays(k):
    """A decaying sine on one of two inputs, the other at rest."""
    t = np.arange(4000) * 1e-3
    u = np.zeros((2, 4000))
    u[k] = 10.0 * np.exp(-t / 1.5) * np.sin(2.0 * np.pi * 2.0 * t)
    return u


@pytest.mark.parametrize("solver", ["least_squares", "nonnegative", "invertible"])
def test_decaying_sines_one_axis_at_a_time_are_no_inseparable_inputs(solver):
    """Thresholds that the late swings do not engage depend on each other; their sums are told."""
    grid = np.linspace(0.0, 8.0, 20)
    rows, weights = [[grid, grid]] * 2, [[np.ones(20), 0.1 * np.ones(20)], [0.2 * np.ones(20), np.ones(20)]]
    records = [Record(decays(k), theory.prandtl_ishlinskii(decays(k), rows, weights), 1e-3) for k in (0, 1)]
    starts = [InitialState("repeated", 1200)] * 2
    fit = fit_static(records, rows, solver=solver, starts=starts)
    assert (fit.rms_um < 0.15).all()
    assert fit.open


def test_bounds_hold_beside_plays_that_never_move():
    """A voltage of two levels tells one number of each input; bounded or not, the fit is the same."""
    rng = np.random.default_rng(3)
    u = 10.0 * np.repeat(2.0 * rng.integers(0, 2, (2, 300)) - 1.0, 7, axis=1)
    grid = np.linspace(0.0, 9.0, 10)
    rows, weights = [[grid, grid]] * 2, [[np.ones(10), 0.1 * np.ones(10)], [0.2 * np.ones(10), np.ones(10)]]
    y = theory.prandtl_ishlinskii(u, rows, weights) + 0.05 * rng.standard_normal((2, u.shape[1]))
    start = [InitialState("repeated", 300)]
    free, bound = (
        fit_static([Record(u, y, 1e-3)], rows, solver=solver, starts=start)
        for solver in ("least_squares", "invertible")
    )
    np.testing.assert_allclose(free.rms_um, 0.05, rtol=0.05)
    np.testing.assert_allclose(bound.rms_um, free.rms_um, rtol=1e-6)


def test_inputs_that_move_together_are_told_by_name():
    u = decays(0)
    u[1] = 0.5 * u[0]
    grids = [[np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.5, 1.5])]] * 2
    with pytest.raises(IdentificationError, match="inputs u1 and u2: they never move independently"):
        fit_static([Record(u, u, 1e-3)], grids)


def test_copies_at_rest_stay_there_beside_others():
    path = LinearBlock(np.array([[0.9]]), np.array([[0.1]]), np.ones((1, 1)), np.zeros((1, 1)), 1e-3)
    columns, start = np.zeros((13, 50)), np.zeros((13, 1))
    columns[[4, 12]], start[9] = 1.0, 1.0
    y, after = SideBySide(path).respond(columns, start)
    decay = 0.9 ** np.arange(51)
    wanted = np.zeros((13, 51))
    wanted[[4, 12]], wanted[9] = 1.0 - decay, decay
    assert np.abs(y - wanted[:, :-1]).max() < 1e-14
    assert np.abs(after[:, 0] - wanted[:, -1]).max() < 1e-14


def test_columns_that_are_zero_need_not_be_summed():
    generator = np.random.default_rng(5)
    x, y = generator.standard_normal((3, 400)), generator.standard_normal((2, 400))
    x[1] = 0.0
    blocks = [(x[::2, :300], y[:, :300]), (x[::2, 300:], y[:, 300:])]
    found = moments_of(blocks, 3, 2, np.array([0, 2]))
    wanted = 400 * np.cov(np.vstack([x, y]), bias=True)
    assert np.abs(found.gram - wanted[:3, :3]).max() < 1e-10
    assert np.abs(found.cross - wanted[:3, 3:]).max() < 1e-10
    assert np.abs(found.power - np.diag(wanted)[3:]).max() < 1e-10
    assert np.abs(found.means[0] - np.vstack([x, y]).mean(axis=1)).max() < 1e-14


@pytest.mark.parametrize("middle", [0.0, 2.5, 9.0])
def test_plays_of_an_input_that_rests_stay_where_its_voltage_put_them(middle):
    r = np.array([0.0, 1.0, 3.0])
    start = InitialState("stepped", 0, ((middle, middle),))
    [(_, x)] = PlayColumns.of(np.full((1, 5), 2.0), start, [r]).counted
    plays = np.clip(middle, 2.0 - r, 2.0 + r)
    assert np.array_equal(x, np.repeat(np.append(-np.diff(plays), plays[-1])[:, None], 5, axis=1))


@pytest.mark.parametrize("kind", ["rest", "repeated"])
def test_plays_that_are_kept_can_be_gone_through_again(kind):
    u, r = random_walk(np.random.default_rng(2), 1, 9000), 3.0
    before = u[0] if kind == "repeated" else u[0, :0]
    wanted = theory.play(np.concatenate([before, u[0]]), r)[len(before) :]

    def columns():
        return PlayColumns.of(np.vstack([0.0 * u, u]), InitialState(kind), [np.array([0.5]), np.array([r])])

    own, moving = columns().moving()
    assert own.tolist() == [1]
    for kept, all_of_them in ((columns().kept(), [0.0 * wanted, wanted]), (moving, [wanted])):
        for _ in range(2):
            assert np.array_equal(np.hstack([x for _, x in kept.counted]), all_of_them)
            assert sum(x.shape[1] for x in kept.before) == len(before)


@pytest.mark.parametrize("with_derivatives", [False, True])
def test_a_step_that_was_held_before_the_record_is_a_longer_record(with_derivatives):
    """Cut after some samples at one voltage, which the actuator had stepped to, it begins where it was."""
    u, grids, held = random_walk(np.random.default_rng(3), 2, 60), [np.array([0.0, 0.5, 3.0])] * 2, 4
    whole = np.hstack([np.repeat(u[:, :1], held, axis=1), u])
    turns = ((4.0, 4.0), (-1.0, -1.0))
    cut = PlayColumns.of(u, InitialState("stepped", 0, turns, held), grids, with_derivatives)
    plain = PlayColumns.of(whole, InitialState("stepped", 0, turns), grids, with_derivatives)
    found = [*cut.before, *(x for _, x in cut.counted)]
    np.testing.assert_array_equal(np.hstack(found), np.hstack([x for _, x in plain.counted]))


def test_a_column_of_rounding_errors_takes_no_part():
    """Its own product can come out below zero: no number is lost for that (it was NaN)."""
    gram, cross = np.array([[4.0, 0.0], [0.0, -1e-17]]), np.array([2.0, 0.0])
    np.testing.assert_array_equal(coefficients(gram, cross), [0.5, 0.0])


@pytest.mark.parametrize("delay", [0, 1, 7])
def test_a_period_that_repeats_comes_as_late_as_the_delay_from_its_end(delay):
    """No sample of it knows what was before the record: the period was."""
    columns = np.random.default_rng(0).normal(size=(3, 40))
    [(first, rows)] = Regressors(columns, np.full(3, 9.0)).blocks(InitialState("repeated"), delay, [])
    assert first == 0
    np.testing.assert_array_equal(rows, np.roll(columns, delay, axis=1))


@pytest.mark.parametrize("seed", range(100))
def test_large_coefficients_that_nearly_cancel_are_no_perfect_fit(seed):
    """The squares of the residual itself, summed, are the truth; 47 of 100 were below it, many at zero."""
    noise = np.random.default_rng(seed)
    x, n, error = noise.standard_normal((3, 50))
    columns, found = np.stack([x, x + 1e-6 * n]), np.array([-1e7, 1e7])
    y = 10.0 * n + 1e-4 * error
    true = np.sum((found @ columns - y) ** 2)
    assert squares_left(columns @ columns.T, columns @ y, float(y @ y), found) >= true

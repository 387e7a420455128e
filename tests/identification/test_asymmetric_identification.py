"""Plays and dead-zones from records, against the block that made them and plain least squares."""

from pathlib import Path

import numpy as np
import pytest
import theory
from block_fits import columns_for, fit_kind, task_of

from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii, identifiable
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.identification.excitation import counted
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import fit_static
from hammerstein.records.record import Record

SEED = 16
R = np.array([0.0, 0.6, 1.4, 2.5])
Q = np.array([-2.0, 0.5, 2.0])


def fit_asymmetric(records, rows, points, solver="invertible", ridge=0.0, **known):
    """Weights of plays with thresholds (output, input) and dead-zones with breakpoints (input,)."""
    plays = PrandtlIshlinskii([[Pair(r, np.ones(len(r))) for r in row] for row in rows])
    zones = [[DeadZones(q, np.zeros(len(q))) for q in points] for _ in rows]
    like = Asymmetric(plays, zones, records[0].rest_v)
    known = {"invertible": solver == "invertible", "ridge": ridge, "refined": False} | known
    return fit_kind("asymmetric", records, grids=rows[-1], like=like, **known)


def places_of(block):
    """Thresholds (output, input) and breakpoints (input,)."""
    rows = [[pair.thresholds_v for pair in row] for row in block.plays.pairs]
    return rows, [zone.breakpoints_v for zone in block.zones[0]]


def wave(samples=4000, turns=9.0, decay=0.7, phase=0.0):
    time = np.linspace(0.0, 2.0 * np.pi * turns, samples)
    return 5.0 * np.sin(time + phase) * np.linspace(1.0, 1.0 - decay, samples) - 5.0 * np.sin(phase)


def truth(rest=(0.0, 0.0)):
    plays = [[Pair(R, [3.0, 0.5, 0.6, 0.7]), Pair(R, [0.2, -0.1, 0.05, 0.02])],
             [Pair(R, [0.1, 0.1, -0.2, 0.1]), Pair(R, [2.5, 0.3, 0.8, 0.2])]]  # fmt: skip
    zones = [[DeadZones(Q, [0.6, -0.9, 0.5]), DeadZones(Q, [0.1, -0.1, 0.1])],
             [DeadZones(Q, [0.05, 0.1, -0.1]), DeadZones(Q, [-0.5, 0.7, 0.4])]]  # fmt: skip
    return Asymmetric(PrandtlIshlinskii(plays), zones, np.array(rest))


def records_of(block, noise=0.0):
    """Two records, each begun at another voltage, at rest there."""
    generator, found = np.random.default_rng(SEED), []
    for first, phase in ((0.0, 0.0), (-1.0, 0.4)):
        u = np.stack([wave(phase=phase), wave(turns=7.3, decay=0.5, phase=phase)])
        u = u - u[:, :1] + first
        y = block.counted_from(u[:, 0]).respond(u - u[:, :1])[0] + np.array([[11.0], [-7.0]])
        found.append(counted(Record(u, y + noise * generator.standard_normal(y.shape), 1e-3)))
    return found


@pytest.mark.parametrize("solver", ["least_squares", "invertible"])
def test_weights_of_both_are_found_again_from_records_with_working_points_of_their_own(solver):
    block = truth()
    fit = fit_asymmetric(records_of(block), [[R, R]] * 2, [Q, Q], solver=solver)
    for ours, theirs in zip(fit.hysteresis.weights, block.weights, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-8)
    assert fit.held == ()


def test_it_is_plain_least_squares_on_plays_and_dead_zones():
    record = records_of(truth(), 0.05)[0]
    fit = fit_asymmetric([record], [[R, R]] * 2, [Q, Q], solver="least_squares")
    sent = record.u_v + record.rest_v[:, None]
    columns = [theory.play(record.u_v[k], r) for k in range(2) for r in R]
    columns += [theory.dead_zone(sent[k], q) for k in range(2) for q in Q]
    matrix = np.column_stack([*columns, np.ones(record.samples)])
    for o in range(2):
        w = np.linalg.lstsq(matrix, record.y_um[o], rcond=None)[0]
        expected = np.concatenate([w[:4], w[8:11], w[4:8], w[11:14]])
        np.testing.assert_allclose(fit.hysteresis.weights[o], expected, atol=1e-9)
        left = record.y_um[o] - matrix @ w
        assert fit.rms_um[o] == pytest.approx(np.sqrt(np.sum(left**2) / (record.samples - 1)), rel=1e-9)


def test_standard_errors_are_those_of_repeated_records():
    found, told = [], None
    for seed in range(60):
        u = wave()
        y = np.asarray(
            theory.asymmetric([u], [[R]], [[[3.0, 0.5, 0.6, 0.7]]], [[Q]], [[[0.6, -0.9, 0.5]]], [0.0])
        )
        y = y + 0.05 * np.random.default_rng(seed).standard_normal(y.shape)
        fit = fit_asymmetric([Record([u], y, 1e-3)], [[R]], [Q], solver="least_squares")
        found.append(fit.hysteresis.weights[0])
        told = fit.hysteresis.weight_covariance[0].covariance
    np.testing.assert_allclose(np.std(found, axis=0), np.sqrt(np.diag(told)), rtol=0.35)


def test_the_invertible_fit_is_the_best_of_all_that_are_within_the_inequalities():
    """Against a fine scan of t, each t with plain bounds: a convex problem has one least value."""
    from scipy.optimize import lsq_linear

    block = Asymmetric(
        PrandtlIshlinskii([[Pair(R, [3.0, -2.0, 1.5, 1.0])]]), [[DeadZones(Q, [-1.5, 1.0, -0.4])]], [0.0]
    )
    u = wave()
    record = Record([u], block.respond([u])[0], 1e-3)
    assert not invertibility(block, 5.0).invertible
    fit = fit_asymmetric([record], [[R]], [Q])
    assert fit.held == ((0, 0),)
    assert invertibility(fit.hysteresis, 5.0).invertible
    plays = np.stack([theory.play(u, r) for r in R])
    plays[:-1] -= plays[1:].copy()
    zones = np.stack([theory.dead_zone(u, q) for q in Q])
    zones[:-1] -= zones[1:].copy()
    matrix = np.vstack([plays, zones]).T
    matrix, y = matrix - matrix.mean(axis=0), record.y_um[0] - record.y_um[0].mean()
    slopes = np.concatenate([np.cumsum(fit.hysteresis.plays.pairs[0][0].weights_um_per_v),
                             fit.hysteresis.zones[0][0].slopes])  # fmt: skip
    least = min(s + z for s in slopes[:4] for z in (0.0, *slopes[4:]))
    best = np.inf
    for t in np.linspace(least, 3.0, 120):
        low = np.concatenate([np.full(4, t), np.full(3, least - t)])
        best = min(best, 2.0 * lsq_linear(matrix, y, (low, np.full(7, np.inf)), tol=1e-13).cost)
    ours = np.sum((matrix @ slopes - y) ** 2)
    assert least > 0.0
    assert ours <= best * (1.0 + 1e-9)
    assert ours == pytest.approx(best, rel=1e-3)


def test_without_dead_zones_bounds_of_ragged_pairs_are_those_of_plays_alone():
    rows = [[np.array([0.0, 0.6]), R], [R, R]]
    plays = [[Pair(rows[0][0], [3.0, -3.4]), Pair(R, [0.2, -0.1, 0.05, 0.02])],
             [Pair(R, [0.1, 0.1, -0.2, 0.1]), Pair(R, [2.5, 0.3, 0.8, 0.2])]]  # fmt: skip
    records = records_of(PrandtlIshlinskii(plays))[:1]  # mean slopes are those over the range of all records
    fit = fit_asymmetric(records, rows, [np.empty(0)] * 2)
    alone = fit_static(records, rows)
    assert fit.held == ((0, 0),)
    for ours, theirs in zip(fit.hysteresis.plays.pairs, alone.hysteresis.pairs, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(one.weights_um_per_v, other.weights_um_per_v, rtol=1e-6, atol=1e-9)


def test_through_a_linear_block_the_weights_are_found_all_the_same():
    block = truth()
    axes = (Axis(resonance_hz=60.0, damping_ratio=0.2), Axis(resonance_hz=75.0, damping_ratio=0.3))
    dynamics = AxesDynamics(axes=axes)
    u = np.stack([wave(), wave(turns=7.3, decay=0.5)])
    path = discretise(dynamics, 1e-3)
    y = path.respond(block.respond(u)[0])[0][:2]
    fit = fit_asymmetric([Record(u, y, 1e-3)], [[R, R]] * 2, [Q, Q], solver="least_squares", axes=axes)
    for ours, theirs in zip(fit.hysteresis.weights, block.weights, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7)


def test_the_number_of_dead_zones_is_what_the_records_call_for():
    u = wave(samples=8000, turns=23.0)
    made = {0: [0.0] * 3, 3: [0.6, -0.9, 0.5]}
    for count, bends in made.items():
        q = u.min() + np.ptp(u) * np.arange(1, 4) / 4.0
        v = theory.asymmetric([u], [[R]], [[[3.0, 0.5, 0.6, 0.7]]], [[q]], [[bends]], [0.0])
        y = v + 0.02 * np.random.default_rng(SEED).standard_normal(v.shape)
        block, _ = columns_for("asymmetric", [Record([u], y, 1e-3)], grids=[R])
        assert len(block.zones[0][0].breakpoints_v) == count


def test_the_smallest_threshold_is_zero_and_every_breakpoint_is_passed():
    """After a reversal a model without play(0) would stand still, and its dead-zones with it."""
    record = records_of(truth())[0]
    block, _ = columns_for("asymmetric", [record], grids=[R + 0.1, R + 0.1], dead_zones=3)
    for row, bends in zip(block.plays.pairs, block.zones, strict=True):
        for k, (pair, zones) in enumerate(zip(row, bends, strict=True)):
            sent = record.u_v[k] + record.rest_v[k]
            assert pair.thresholds_v[0] == 0.0
            assert sent.min() < zones.breakpoints_v[0] < zones.breakpoints_v[-1] < sent.max()


def single_amplitude(samples, amplitude_v, seed):
    """Ten cycles of one amplitude of a block with thresholds and breakpoints unlike those tried."""
    r, w = np.array([0.0, 0.7, 1.6, 2.9, 4.2]), [3.0, 0.3, 0.5, 0.4, 0.6]
    u = amplitude_v * np.sin(np.linspace(0.0, 20.0 * np.pi, samples))
    y = theory.asymmetric([u], [[r]], [[w]], [[[-2.1, 1.3]]], [[[0.3, -0.5]]], [0.0])
    return Record([u], y + 0.05 * np.random.default_rng(seed).standard_normal(y.shape), 1e-3)


@pytest.mark.parametrize("dead_zones", [3, 5, 11])
def test_loops_of_one_amplitude_leave_weights_that_hold_for_others(dead_zones):
    """Slopes that are alike on both sides of the middle can go from plays to dead-zones unseen: see there.

    With thresholds and breakpoints on one grid nothing but the noise would tell how much, and smaller loops
    would go wrong by that.
    """
    record, other = single_amplitude(4000, 5.0, 1), single_amplitude(4000, 3.0, 2)
    block, chosen = columns_for(
        "asymmetric", [record], grids=[5.0 * np.arange(24) / 24], dead_zones=dead_zones
    )
    assert chosen >= 1e-6
    error = {}
    for ridge in (1e-9, chosen):
        fit = fit_asymmetric(
            [record],
            *places_of(block),
            ridge=ridge,
            starts=[InitialState("repeated")],
            solver="least_squares",
        )
        left = other.y_um - fit.hysteresis.respond(other.u_v)[0]
        error[ridge] = 100.0 * float(np.std(left[0, 1000:])) / np.ptp(other.y_um[0, 1000:])
    assert error[chosen] < 2.0 < 0.2 * error[1e-9]


def test_the_error_left_out_is_that_of_plain_least_squares_on_coarser_grids():
    """Part by part with plain columns, while the choice sums those of its finest grid."""
    from hammerstein.hysteresis.asymmetric import DEAD_ZONES, PLAYS
    from hammerstein.identification.columns import PARTS, _errors_left_out
    from hammerstein.identification.static.normal_equations import FOLDS

    u = wave(samples=3000, turns=23.0)
    y = theory.asymmetric([u], [[R]], [[[3.0, 0.5, 0.6, 0.7]]], [[Q]], [[[0.6, -0.9, 0.5]]], [0.0])[0]
    y = y + 0.05 * np.random.default_rng(3).standard_normal(len(y))
    task, driven = task_of("asymmetric", [Record([u], [y], 1e-3)])
    [finest] = Asymmetric.first_guesses(driven)
    error = _errors_left_out(task, finest, StaticDynamics(n_outputs=1))
    n, zones = PLAYS[1], DEAD_ZONES[2]
    low, high = u.min(), u.max()
    columns = [theory.play(u, 0.5 * (high - low) * i / n) for i in range(n)]
    columns += [theory.dead_zone(u, low + (high - low) * k / (zones + 1)) for k in range(1, zones + 1)]
    rows = np.column_stack([*columns, y])
    fold = np.arange(len(u)) * PARTS // len(u) % FOLDS
    parts = [rows[fold == f] - rows[fold == f].mean(axis=0) for f in range(FOLDS)]
    squares = 0.0
    for f, part in enumerate(parts):
        rest = np.vstack([other for i, other in enumerate(parts) if i != f])
        w = np.linalg.lstsq(rest[:, :-1], rest[:, -1], rcond=1e-12)[0]
        squares += np.sum((part[:, -1] - part[:, :-1] @ w) ** 2)
    expected = np.sqrt(squares / len(u)) / np.ptp(y)
    plays, bends = finest.column_choices(driven)
    assert error(plays.masks[1] & bends.masks[2], 0.0) == pytest.approx(expected, rel=1e-6)


def test_derivatives_by_places_are_differences_of_the_outputs(monkeypatch):
    """Each place is moved alone there, and all at once here."""
    monkeypatch.setattr(identifiable, "STEP", 1e-7)
    records = records_of(truth())
    block = truth(records[0].rest_v).released(task_of("asymmetric", records, grids=[R, R])[1])
    assert len(block.free) == 2 * (len(R) - 1 + len(Q))
    assert all((a == b).all() for a, b in zip(block.at(block.free).places, block.places, strict=True))
    u, before = records[0].u_v[:, ::10], records[0].u_v[:, :1]
    for one, other in zip(block.bends(u, before), Identifiable.bends(block, u, before), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.full
def test_few_places_are_found_where_the_actuator_has_them():
    """Thresholds and breakpoints of two inputs, which no grid holds, within their standard errors."""
    noise_um = 0.02
    records = records_of(truth(), noise_um)
    settings = Settings(
        hysteresis="asymmetric", dynamics="none", delay_samples=0, creep_modes=0, error_curve=False
    )
    model, fit = identify(records, settings)
    found, known = model.hysteresis, model.covariance
    assert fit.fit[fit.kind].rms_um == pytest.approx(np.full(2, noise_um), rel=0.05)
    errors = np.split(known.errors, np.cumsum([len(place) for place in found.places]))[:-1]
    for places, own, true in zip(found.places, errors, [R, R, Q, Q, Q, Q], strict=True):
        distant = np.abs(places[:, None] - true)
        near, at = distant.argmin(axis=0), np.arange(len(true))
        assert (distant[near, at] <= np.maximum(4.0 * own[near], 1e-9)).all()
        assert len(places) <= len(true) + 2


def test_records_without_noise_bear_hardly_any_penalty():
    block, ridge = columns_for("asymmetric", records_of(truth()), grids=[R, R])
    fit = fit_asymmetric(records_of(truth()), *places_of(block), ridge=ridge)
    assert fit.rms_um.max() < 2e-3 * 20.0


DBO = Path(__file__).parents[3] / "shared" / "data" / "dbo_piezo_micromanipulator"


@pytest.mark.skipif(not DBO.is_dir(), reason="the records of the micromanipulator are not here")
@pytest.mark.parametrize(("delay", "fitted", "held_back"), [(1, 0.56, 0.95), (3, 0.50, 0.65)])
@pytest.mark.parametrize("plays", [None, 12, 15, 20, 40])
def test_micromanipulator(delay, fitted, held_back, plays):
    """Means removed, all rows after the first two seconds; the figures that were asked for.

    They hold for the number of plays that is found and for others: nothing hangs on one.
    """
    from hammerstein.identification.static.regressors import delayed
    from hammerstein.identification.static.static_block import input_grids

    def read(name):
        table = np.loadtxt(DBO / name)
        return counted(Record([table[:, 0]], [table[:, 4]], 5e-3))

    record, held = read("Model_Vi_Do.dat"), read("Test_Vi_Do_Di.dat")
    start = InitialState("rest", 400)
    grids = None if plays is None else input_grids([record], plays, "voltage")
    known = {"starts": [start], "delay_samples": delay}
    block, ridge = columns_for("asymmetric", [record], grids=grids, **known)
    fit = fit_asymmetric([record], *places_of(block), ridge=ridge, **known)
    slack = 0.03 if plays in (12, 15) else 0.0
    assert 100.0 * fit.rms_um[0] / np.ptp(record.y_um[0, 400:]) <= fitted + slack
    block = fit.hysteresis.counted_from(held.rest_v)
    error = (held.y_um - block.respond(delayed(held, start, delay))[0])[0, 400:]
    assert 100.0 * error.std() / np.ptp(held.y_um[0, 400:]) <= held_back + slack

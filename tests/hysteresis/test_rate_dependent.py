"""Plays whose thresholds grow with the rate: their equation, closed forms, stability and exact inverse."""

import json

import control
import numpy as np
import pytest
import theory

from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators.exact.inverse import ExactInverse, ExactInverseLaw, exact_inverse_of
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, Parallel, PrandtlIshlinskii, RateDependent, RatePlays
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.hysteresis.rate_dependent_kernels import log_of_one_and
from hammerstein.model import HammersteinModel

SEED = 16
T = 50e-6
R = np.linspace(0.0, 9.0, 10)
W = np.array([4.0, 0.3, 0.4, 0.3, 0.3, 0.4, 0.3, 0.3, 0.4, 0.5])
B = np.append(0.0, np.full(9, 3e-4))


def block(growth=B, bandwidth_hz=500.0, lam=0.0, sample_time_s=T):
    plays = RatePlays(R, growth, bandwidth_hz, lam)
    return RateDependent((plays, plays), ((W, 0.05 * W), (-0.04 * W, 0.9 * W))).on_grid(sample_time_s)


def model_of(hysteresis, dynamics=None):
    linear = dynamics or StaticDynamics(n_outputs=2)
    return HammersteinModel("rate", hysteresis, linear, 10.0, ("a", "b"), ("x", "y"))


def by_theory(hysteresis, u):
    of = [[getattr(plays, name) for plays in hysteresis.inputs]
          for name in ("thresholds_v", "growth_s", "bandwidth_hz", "lambda_s_per_v")]  # fmt: skip
    return theory.rate_dependent(u, hysteresis.sample_time_s, *of, hysteresis.weights_um_per_v)


@pytest.mark.parametrize("lam", [0.0, 2e-3])
def test_response_is_the_equation(lam):
    hysteresis = block(lam=lam)
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 0.3, (2, 800)), axis=1)
    np.testing.assert_allclose(hysteresis.respond(u)[0], by_theory(hysteresis, u), atol=1e-10)


def test_the_logarithm_of_flattening_growth_is_that_of_the_library():
    x = np.concatenate([[0.0, 1e-300], np.logspace(-20.0, 20.0, 2001), np.linspace(0.3, 0.6, 301)])
    ours = np.array([log_of_one_and(value) for value in x])
    np.testing.assert_allclose(ours, np.log1p(x), rtol=1e-15)


def test_without_growth_it_is_the_classical_block():
    hysteresis = block(growth=np.zeros(10))
    classical = PrandtlIshlinskii([[Pair(R, w) for w in row] for row in hysteresis.weights_um_per_v])
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 1.0, (2, 500)), axis=1)
    np.testing.assert_allclose(hysteresis.respond(u)[0], classical.respond(u)[0], atol=1e-10)


@pytest.mark.parametrize("lam", [0.0, 2e-3])
def test_branch_at_a_constant_rate_has_its_closed_form(lam):
    """Once all plays move and the filter has settled, each lags by r + b g(s)."""
    rate, half = 4000.0, 200
    way = np.arange(-half, half + 1) * rate * T
    hysteresis = block(lam=lam)
    v = hysteresis.respond(np.stack([np.concatenate([np.linspace(0.0, way[0], 4000), way]), np.zeros(4401)]))[
        0
    ]
    lag = R + B * (np.log1p(lam * rate) / lam if lam else rate)
    late = way > -way[-1] + 2.0 * lag[-1] + 5.0
    assert late.sum() > 20
    np.testing.assert_allclose(v[0, -len(way) :][late], [np.dot(W, u - lag) for u in way[late]], atol=1e-8)


def test_the_output_depends_on_the_rate_and_slow_loops_do_not_grow():
    def width(hz):
        u = 10.0 * np.sin(2.0 * np.pi * hz * T * np.arange(round(3 / hz / T)))
        v = block().respond(np.stack([u, 0 * u]))[0][0]
        cycle = slice(-round(1 / hz / T), None)
        return theory.polygon_area(u[cycle], v[cycle])

    slow = theory.loop_area(R, W, 10.0)
    assert width(1.0) == pytest.approx(slow, rel=0.05)
    assert width(200.0) > 1.25 * slow


def at_rate(*turns, samples=400):
    """From turn to turn in as many samples each, on both inputs."""
    ends = np.arange(len(turns)) * samples
    return np.stack([np.interp(np.arange(ends[-1] + 1), ends, turns)] * 2)


def test_a_larger_swing_at_the_same_rate_wipes_out_what_it_covers():
    last = (-9.0, 9.0, 2.0, 4.0)
    ends = [block().respond(at_rate(0.0, *past, *last))[0][:, -800:] for past in ((3.0, -7.0), (-2.0, 8.0))]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-10)


def test_minor_loops_are_congruent_at_one_rate_and_differ_at_another():
    def loop(middle, samples):
        inner = [middle - 1.5, middle + 1.5] * 3
        u = np.hstack([at_rate(0.0, 9.5, inner[0]), at_rate(*inner, samples=samples)])
        v = block().respond(u)[0][:, -2 * samples :]
        return v - v[:, :1]

    np.testing.assert_allclose(loop(0.0, 400), loop(4.0, 400), atol=1e-10)
    slow, fast = np.ptp(loop(0.0, 400), axis=1), np.ptp(loop(0.0, 15), axis=1)
    assert (np.abs(fast - slow) > 0.02 * slow).all()


def test_wiping_out_fails_where_the_rate_differs():
    """Two histories end with the same swings at other rates: a classical block would not tell them apart."""
    slow, fast = (np.interp(np.arange(n), [0, n // 2, n - 1], [0.0, 9.0, -9.0]) for n in (8000, 200))
    last = np.linspace(-9.0, 0.0, 40)
    ends = [block().respond(np.stack([np.append(u, last)] * 2))[0][0, -1] for u in (slow, fast)]
    assert abs(ends[0] - ends[1]) > 0.1


@pytest.mark.parametrize("lam", [0.0, 2e-3])
def test_step_equals_respond_to_the_last_bit_through_json(lam):
    hysteresis = block(lam=lam)
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 0.3, (2, 80)), axis=1)
    whole, state, steps = hysteresis.respond(u)[0], hysteresis.rest(), []
    for k in range(80):
        v, state = hysteresis.step(u[:, k], state)
        state = hysteresis.restore(json.loads(json.dumps(state.as_dict())))
        steps.append(v)
    np.testing.assert_array_equal(np.stack(steps, axis=1), whole)


def test_python_control_and_the_model_file_give_the_same_numbers(tmp_path):
    hysteresis = block()
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 0.3, (2, 60)), axis=1)
    system = hysteresis.to_iosys(T)
    response = control.input_output_response(system, T * np.arange(60), u)
    np.testing.assert_allclose(response.outputs, hysteresis.respond(u)[0], atol=1e-12)
    model_of(hysteresis).save(tmp_path / "m.json")
    again = HammersteinModel.load(tmp_path / "m.json")
    np.testing.assert_array_equal(again.on_grid(T).hysteresis.respond(u)[0], hysteresis.respond(u)[0])
    with pytest.raises(InputError, match="needs a sample time"):
        again.hysteresis.respond(u)


# ---- the exact inverse ----


@pytest.mark.parametrize("hz", [1.0, 50.0, 200.0])
def test_the_inverse_is_exact_without_false_reversals(hz):
    hysteresis = block()
    law = ExactInverse().design(model_of(hysteresis), 10.0, T)
    phase = 2.0 * np.pi * hz * T * np.arange(round(2 / hz / T))
    path = np.stack([40.0 * np.sin(phase), 15.0 * np.sin(phase + 1.0) - 15.0 * np.sin(1.0)])
    drive, _ = law.respond(path)
    np.testing.assert_allclose(by_theory(hysteresis, drive), path, atol=1e-10)
    assert all(np.sum(np.diff(np.sign(np.diff(u))) != 0) == 4 for u in drive)


def test_random_paths_are_followed_and_steps_give_the_same_bits():
    hysteresis = block(lam=1e-3)
    law = ExactInverse().design(model_of(hysteresis), 1e4, T)
    path = np.cumsum(np.random.default_rng(SEED).normal(0.0, 1.0, (2, 300)), axis=1)
    drive, _ = law.respond(path)
    np.testing.assert_allclose(by_theory(hysteresis, drive), path, atol=1e-9)
    state, steps = law.rest(), []
    for k in range(300):
        u, state = law.step(path[:, k], state)
        state = law.restore(json.loads(json.dumps(state.as_dict())))
        steps.append(u)
    np.testing.assert_array_equal(np.stack(steps, axis=1), drive)


def test_without_growth_it_is_the_classical_inverse():
    hysteresis = block(growth=np.zeros(10))
    classical = PrandtlIshlinskii([[Pair(R, w) for w in row] for row in hysteresis.weights_um_per_v])
    path = np.cumsum(np.random.default_rng(SEED).normal(0.0, 1.0, (2, 300)), axis=1)
    ours = ExactInverse().design(model_of(hysteresis), 1e3, T).respond(path)[0]
    np.testing.assert_allclose(ours, ExactInverseLaw(model_of(classical), 1e3).respond(path)[0], atol=1e-9)


@pytest.mark.parametrize(("growth_s", "stable"), [(3.0e-4, True), (3.9e-4, False)])
def test_the_inverse_is_stable_exactly_where_its_loop_gain_is_below_one(growth_s, stable):
    """One play that grows, none that does not but by a hair: its branch rings as the poles say."""
    plays = RatePlays([0.0, 1.0], [0.0, growth_s], 500.0)
    hysteresis = RateDependent((plays,), (([1e-3, 1.0],),)).on_grid(T)
    a = np.exp(-2.0 * np.pi * 500.0 * T)
    beta = growth_s / 1.001 * (1.0 - a) / T
    radius = np.abs(np.roots([1.0, -(a + beta), beta])).max()
    assert (radius < 1.0) == stable
    assert (hysteresis.loop_gain()[0] < 1.0) == stable
    model = HammersteinModel("one", hysteresis, StaticDynamics(n_outputs=1), 10.0, ("u",), ("x",))
    if not stable:
        with pytest.raises(SimulationError, match="is unstable"):
            ExactInverse().design(model, 1e6, T)
    law = ExactInverse(run_anyway=True).design(model, 1e6, T)
    ramp = np.concatenate([np.linspace(0.0, 100.0, 400), 100.0 + 0.25 * np.arange(1.0, 2000.0)])[None, :]
    drive = law.respond(ramp)[0][0]
    late = np.abs(np.diff(drive[-400:]) - 0.25 / 1.001).max()
    assert (late < 1e-3) == stable


@pytest.mark.parametrize("build", ["exact", "passes", "parallel"])
def test_a_start_is_where_slow_voltages_led_not_jumps(build):
    """Conditioned before the start: the position from which a law counts is that of a slow drive there."""
    model = model_of(block() if build != "parallel" else Parallel((block(), block())))
    limits = DriveRange.of((-9.0, 10.0), model, start_v=[3.0, -2.0], conditioned=True)
    ends = limits.history()
    ways = zip(ends.T[:-1], ends.T[1:], strict=True)
    slow = np.concatenate([np.linspace(begin, end, 40_000) for begin, end in ways]).T
    wanted = model.hysteresis.on_grid(T).respond(slow)[0][:, -1]
    if build == "exact":
        law = exact_inverse_of(model.hysteresis, model, limits)
    else:
        law = InverseMultiplicativeLaw(model, limits, T, iterations=8)
    np.testing.assert_allclose(law.origin_um, wanted, atol=0.05)
    np.testing.assert_allclose(law.respond(np.zeros((2, 50)))[0][:, -1], [3.0, -2.0], atol=0.05)


def test_the_range_is_kept_and_left_again():
    law = ExactInverse().design(model_of(block()), 5.0, T)
    phase = 2.0 * np.pi * 50.0 * T * np.arange(800)
    path = np.stack([40.0 * np.sin(phase), 5.0 * np.sin(phase)])
    drive, _ = law.respond(path)
    assert drive.max() == 5.0
    assert drive.min() == -5.0
    assert np.abs(by_theory(block(), drive) - path)[1].max() < 1e-9


def test_weights_that_leave_no_inverse_are_refused():
    plays = RatePlays([0.0, 1.0], [0.0, 1e-4])
    one = RateDependent((plays,), (([1.0, -1.5],),))
    with pytest.raises(
        SimulationError,
        match=r"is not proven that the model has an inverse: .* keeps -2 of its own mean slope",
    ):
        ExactInverse().design(
            HammersteinModel("m", one, StaticDynamics(n_outputs=1), 5.0, ("u",), ("x",)), 5.0, T
        )


def test_behind_dynamics_the_preview_law_takes_it():
    from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverse
    from hammerstein.model.simulation import Plant

    axes = AxesDynamics(axes=(Axis(resonance_hz=600.0, damping_ratio=0.2),) * 2)
    model = model_of(block(), axes)
    law = HammersteinInverse().design(model, 10.0, T)
    phase = 2.0 * np.pi * 40.0 * T * np.arange(1500)
    path = np.stack([20.0 * (1.0 - np.cos(phase)), 10.0 * (1.0 - np.cos(phase))])
    plant = Plant(model.on_grid(T), model.instruments)
    drive = law.drive_for(path)
    v, _ = model.on_grid(T).static_response(drive)
    moved = plant.block.respond(v)[0][:2]
    assert np.abs(moved - path)[:, 100:-100].max() < 0.01


@pytest.mark.parametrize(
    ("r", "b", "says"),
    [
        ([0.0, 1.0], [0.0], "they must be equally many"),
        ([1.0, 0.5], [0.0, 0.0], "increasing"),
        ([0.0, 1.0], [1.0, 0.0], "not decrease"),
        ([0.0, np.inf], [0.0, 0.0], "thresholds_v:? +and growth_s must be finite"),
        ([0.0, 1.0], [0.0, np.nan], "thresholds_v:? +and growth_s must be finite"),
    ],
)
def test_plays_refuse(r, b, says):
    with pytest.raises(InputError, match=says):
        RatePlays(r, b)


def test_what_is_not_proven_is_not_called_singular():
    """The first play of input 1 moves the other output more than its own share allows."""
    plays = RatePlays([0.0, 1.0], [0.0, 1e-3])
    weights = (([1.0, 1.0], [0.0, 0.0]), ([2.0, -5.0], [1.0, 1.0]))
    found = invertibility(RateDependent((plays, plays), weights))
    assert not found.invertible
    assert found.singular == 0
    assert "singular" not in found.statement()
    assert "the plays of input 1 move in any combination" in found.statement()

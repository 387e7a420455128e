"""The Bouc-Wen model: its equation, closed forms, what it has not, and its compensator."""

import itertools
import json
import time

import control
import numpy as np
import pytest
import theory
from scipy.integrate import solve_ivp

from hammerstein.compensators.exact.inverse import ExactInverse
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import BoucWen, BoucWenPair
from hammerstein.hysteresis.bouc_wen_kernels import moved, moved_far
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.hysteresis.kind import Hysteresis
from hammerstein.model import HammersteinModel

SEED = 16
T = 50e-6
D = np.array([[14.0, 0.6], [-0.5, 12.0]])
A = np.array([[4.0, -0.3], [0.2, 3.0]])
BETA = np.array([[0.25, 0.2], [0.3, 0.1]])
GAMMA = np.array([[0.1, -0.05], [-0.1, 0.15]])
STATED = 2e-4


def block(d=D, a=A, beta=BETA, gamma=GAMMA):
    numbers = zip(*(np.ravel(part).tolist() for part in (d, a, beta, gamma)), strict=True)
    pairs = [BoucWenPair(*each) for each in numbers]
    m = np.shape(d)[1]
    return BoucWen([pairs[k : k + m] for k in range(0, len(pairs), m)])


def one(d=14.0, a=4.0, beta=0.25, gamma=0.1):
    return BoucWen([[BoucWenPair(d, a, beta, gamma)]])


def model_of(hysteresis):
    names = ("a", "b")[: hysteresis.n_inputs], ("x", "y")[: hysteresis.n_outputs]
    return HammersteinModel("wen", hysteresis, StaticDynamics(n_outputs=len(names[1])), 10.0, *names)


def stated_error(a, beta, gamma):
    """Of the output: so much of the limit of each hysteretic part."""
    return STATED * np.sum(np.abs(a) / (np.asarray(beta) + gamma), axis=-1)


@pytest.mark.parametrize("step_v", [0.01, 0.3, 5.0, 100.0])
def test_the_rational_step_stays_within_its_stated_error_of_the_exponential(step_v):
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, step_v, (2, 800)), axis=1)
    exact = theory.bouc_wen(u, D, A, BETA, GAMMA)
    error = np.abs(block().respond(u)[0] - exact).max(axis=1)
    assert (error <= stated_error(A, BETA, GAMMA)).all()
    assert error.max() > 0.0  # it is rational, not the exponential


@pytest.mark.parametrize(("hz", "um"), [(50.0, 4e-4), (200.0, 4e-4)])
def test_at_50_us_the_error_is_far_below_a_nanometre_of_a_sensor(hz, um):
    """Amplitude-modulated 10 V at 20 kHz."""
    t = T * np.arange(4000)
    u = 10.0 * np.sin(2.0 * np.pi * 7.0 * t) * np.sin(2.0 * np.pi * hz * t)
    exact = theory.bouc_wen([u], [[14.0]], [[4.0]], [[0.25]], [[0.1]])
    assert np.abs(one().respond([u])[0] - exact).max() < um


@pytest.mark.parametrize(("beta", "gamma"), [(0.25, 0.1), (0.2, -0.15), (0.1, 0.3), (0.3, 0.0), (0.2, 0.2)])
def test_response_is_the_differential_equation(beta, gamma):
    """SciPy integrates it branch by branch; nothing of ours takes part."""
    turns = np.array([0.0, 9.0, -6.0, 4.0, 1.0, 8.0, -10.0])
    z, steps, said = 0.0, [], []
    for begin, end in itertools.pairwise(turns):
        way = np.linspace(begin, end, 60)
        rate = np.sign(end - begin)
        found = solve_ivp(
            lambda u, z, rate=rate: 1.0 - beta * rate * z - gamma * np.abs(z),
            (begin, end), [z], t_eval=way, rtol=1e-10, atol=1e-12, max_step=0.05,
        )  # fmt: skip
        z = found.y[0, -1]
        steps.append(way)
        said.append(14.0 * way - 4.0 * found.y[0])
    u, expected = np.concatenate(steps), np.concatenate(said)
    ours = one(beta=beta, gamma=gamma).respond([u])[0][0]
    np.testing.assert_allclose(ours, expected, atol=4.0 * STATED / (beta + gamma))


TURNS = np.array([0.0, 9.0, -6.0, 4.0, 1.0, 8.0, -10.0])
OPENSEES = {
    (0.25, 0.1): [2.734708, -2.823707, 2.660456, -0.668305, 2.549023, -2.845975],
    (0.2, -0.15): [7.247437, -8.684374, 5.191828, -0.040752, 5.877694, -10.461133],
    (0.1, 0.3): [2.431691, -2.476514, 2.320237, 0.117154, 2.355099, -2.493330],
}
"""z at the turns by OpenSeesPy 3.7.1 (implicit steps), extrapolated from 10 000 and 20 000 steps a branch."""


def branches(steps):
    return np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in itertools.pairwise(TURNS)])


@pytest.mark.parametrize(("beta", "gamma"), list(OPENSEES))
def test_opensees_says_the_same(beta, gamma):
    u = branches(1000)
    z = u - one(1.0, 1.0, beta, gamma).respond([u])[0][0]
    np.testing.assert_allclose(z[999::1000], OPENSEES[beta, gamma], atol=STATED / (beta + gamma))


@pytest.mark.parametrize(("beta", "gamma"), list(OPENSEES))
def test_opensees_comes_nearer_the_finer_its_steps_are(beta, gamma):
    """Along whole branches; its steps are implicit ones of first order."""
    try:
        import openseespy.opensees as opensees
    except (ImportError, RuntimeError) as error:  # the latter where a library of it is missing
        pytest.skip(f"OpenSeesPy is not here: {error}")
    left = []
    for steps in (300, 3000):
        u = branches(steps)
        opensees.wipe()
        opensees.uniaxialMaterial("BoucWen", 1, 0.0, 1.0, 1.0, gamma, beta, 1.0, 0.0, 0.0, 0.0, 1e-12, 100)
        opensees.testUniaxialMaterial(1)
        said = []
        for v in u.tolist():
            opensees.setStrain(v)
            said.append(opensees.getStress())
        z = u - one(1.0, 1.0, beta, gamma).respond([u])[0][0]
        left.append(np.abs(z - said).max())
    assert left[1] < 0.12 * left[0]
    assert left[1] < 0.005


@pytest.mark.parametrize(("beta", "gamma"), [(0.25, 0.1), (0.2, -0.15), (0.1, 0.3), (0.3, 0.0), (0.2, 0.2)])
def test_settled_loop_has_its_closed_form(beta, gamma):
    hysteresis = one(beta=beta, gamma=gamma)
    for part in (0.2, 0.6, 0.95):
        tip = part / (beta + gamma)
        size = theory.bouc_wen_amplitude(tip, beta, gamma)
        assert hysteresis.amplitude(size)[0, 0] == pytest.approx(14.0 * size - 4.0 * tip, abs=1e-9)
        u = size * np.sin(np.pi * np.arange(8001) / 200)
        settled = hysteresis.respond([u])[0][0, -400:]
        tips = settled[np.argmax(u[-400:])] - settled[np.argmin(u[-400:])]
        assert 0.5 * tips == pytest.approx(14.0 * size - 4.0 * tip, abs=4e-3)


def test_without_gamma_the_tip_is_a_hyperbolic_tangent():
    assert one(beta=0.3, gamma=0.0).amplitude(5.0)[0, 0] == pytest.approx(70.0 - 4.0 * np.tanh(1.5) / 0.3)


def test_without_a_hysteretic_part_it_is_a_gain_matrix():
    u = np.random.default_rng(SEED).normal(0.0, 5.0, (2, 300))
    np.testing.assert_allclose(block(a=0.0 * A).respond(u)[0], D @ u, atol=1e-12)


def test_what_forgets_nothing_is_a_gain():
    u = np.random.default_rng(SEED).normal(0.0, 5.0, (1, 300))
    straight = BoucWen([[BoucWenPair(2.0, hysteretic_um_per_v=0.5)]])
    np.testing.assert_allclose(straight.respond(u)[0], 1.5 * u, atol=1e-9)


def test_the_output_does_not_depend_on_the_rate():
    """Ten times as many samples on the same way give the same, but for the rounding of the rational step."""
    turns = np.array([0.0, 9.0, -6.0, 4.0, -2.0])
    few, many = (np.interp(np.linspace(0, 4, 4 * n + 1), np.arange(5), turns) for n in (40, 400))
    slow, fast = (one().respond([u])[0][0] for u in (few, many))
    np.testing.assert_allclose(fast[::10], slow, atol=4.0 * STATED / 0.35)


def test_wiping_out_fails_minor_loops_do_not_close():
    """After a minor loop a classical block comes back to where it left the branch; this one does not."""
    way = np.interp(np.arange(0, 401), [0, 100, 200, 300, 400], [0.0, 8.0, 2.0, 6.0, 2.0])
    v = one().respond([way])[0][0]
    back = one().respond([np.append(way, np.linspace(2.0, 6.0, 100))])[0][0]
    assert abs(back[-1] - v[300]) > 1e-2
    plays = theory.prandtl_ishlinskii(
        [np.append(way, np.linspace(2.0, 6.0, 100))], [[[0.0, 1.0]]], [[[2.0, 1.0]]]
    )
    assert abs(plays[0, -1] - plays[0, 300]) < 1e-9


def test_congruency_fails_minor_loops_depend_on_where_they_lie():
    """The first way from 2 to 4 V after turns at 2 V that were reached from far and from near."""
    heights = []
    for top in (10.0, 4.5):
        way = np.interp(np.arange(0, 301), [0, 100, 200, 300], [0.0, top, 2.0, 4.0])
        v = one().respond([way])[0][0]
        heights.append(v[300] - v[200])
    assert abs(heights[0] - heights[1]) > 0.1


def test_step_equals_respond_to_the_last_bit_through_json():
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 0.8, (2, 80)), axis=1)
    whole, state, steps = block().respond(u)[0], block().rest(), []
    for k in range(80):
        v, state = block().step(u[:, k], state)
        state = block().restore(json.loads(json.dumps(state.as_dict())))
        steps.append(v)
    np.testing.assert_array_equal(np.stack(steps, axis=1), whole)


def test_a_response_leaves_the_state_that_it_was_given():
    state = block().rest()
    block().respond(np.ones((2, 5)), state)
    assert not state.z_v.any()
    assert not state.last_v.any()


def test_python_control_and_the_model_file_give_the_same_numbers(tmp_path):
    u = np.cumsum(np.random.default_rng(SEED).normal(0.0, 0.8, (2, 60)), axis=1)
    response = control.input_output_response(block().to_iosys(T), T * np.arange(60), u)
    np.testing.assert_allclose(response.outputs, block().respond(u)[0], atol=1e-12)
    model_of(block()).save(tmp_path / "m.json")
    again = HammersteinModel.load(tmp_path / "m.json")
    np.testing.assert_array_equal(again.hysteresis.respond(u)[0], block().respond(u)[0])
    assert again.digest() == model_of(block()).digest()


def test_where_a_kind_says_no_more_memory_after_a_path_is_that_of_a_jump_to_it():
    path, onward = np.array([[3.0, 6.0, -4.0], [1.0, -7.0, 3.0]]), np.array([[-2.0, 5.0], [0.0, -1.0]])
    whole = block().respond(np.hstack([path, onward]))[0]
    memory = Hysteresis.after(block(), path)
    np.testing.assert_array_equal(block().respond(onward, memory)[0], whole[:, 3:])


def test_slopes_lie_between_the_ends_and_reach_them():
    u = 30.0 * np.sin(np.arange(6000) / 300.0)
    v = one().respond([u])[0][0]
    moving = np.abs(np.diff(u)) > 1e-3
    slopes = (np.diff(v) / np.diff(u))[moving]
    low, high = np.sort(one().slope_columns(0)[:, 0])
    assert low - 1e-6 <= slopes.min() <= low + 0.15
    assert high - 0.01 <= slopes.max() <= high + 1e-6


def test_invertibility_is_told_by_the_ends_of_the_slopes():
    assert invertibility(block()).invertible
    found = invertibility(one(d=5.0, a=4.0, beta=0.25, gamma=0.1))  # falls by 4 * 0.5 / 0.35 > 5
    assert not found.invertible
    assert "no inverse" in found.statement()


# ---- the inverse-multiplicative compensator ----


def path(samples=1600, hz=50.0):
    phase = 2.0 * np.pi * hz * T * np.arange(samples)
    return np.stack([40.0 * np.sin(phase), 20.0 * (1.0 - np.cos(phase))])


def test_one_pass_is_the_published_law_which_lags_by_a_sample():
    """u[k] = (y_r[k] + h[k-1]) / d (reference 8 of the paper)."""
    law = InverseMultiplicative().design(model_of(one()), 10.0, T)
    wanted = path()[0]
    drive = law.respond([wanted])[0][0]
    z, last, expected = 0.0, 0.0, []
    for y in wanted:
        now = (y + 4.0 * z) / 14.0
        z = theory.bouc_wen_line(z, now - last, 0.25, 0.1)
        last = now
        expected.append(now)
    np.testing.assert_allclose(drive, expected, atol=4.0 * STATED / 0.35 / 14.0)


def test_more_passes_leave_less_and_many_leave_nothing():
    left = []
    for passes in (1, 4, 30):
        law = InverseMultiplicative(iterations=passes).design(model_of(block()), 10.0, T)
        drive, _ = law.respond(path(800))
        left.append(np.abs(block().respond(drive)[0] - path(800)).max())
    assert left[0] > 20.0 * left[1]
    assert left[2] < 1e-9


def test_the_exact_inverse_is_refused_by_its_name():
    with pytest.raises(InputError, match="'bouc_wen' has no exact inverse; use inverse_multiplicative"):
        ExactInverse().design(model_of(block()), 10.0, T)


def test_a_gain_at_which_it_cannot_converge_is_refused():
    with pytest.raises(SimulationError, match="does not converge"):
        InverseMultiplicative(gain="identity").design(model_of(block()), 10.0, T)


@pytest.mark.parametrize(
    ("numbers", "says"),
    [
        ((1.0, 1.0, -0.1, 0.0), "0 or more"),
        ((1.0, 1.0, 0.1, -0.2), "without limit"),
        ((np.nan, 1.0, 0.1, 0.0), "finite"),
    ],
)
def test_pairs_refuse(numbers, says):
    with pytest.raises(InputError, match=says):
        BoucWenPair(*numbers)


def test_a_far_movement_takes_few_steps_however_fast_it_forgets():
    """Rates that differ a million times, over many volts: the steps go with logarithms, not with volts."""
    hysteresis = one(beta=1e3, gamma=-1e3 + 1e-3)
    u = np.tile([0.0, 500.0, -500.0], 2000)
    begun = time.perf_counter()
    ours = hysteresis.respond([u])[0]
    assert time.perf_counter() - begun < 10.0
    exact = theory.bouc_wen([u], [[14.0]], [[4.0]], [[1e3]], [[-1e3 + 1e-3]])
    np.testing.assert_allclose(ours, exact, atol=4.0 * STATED / 1e-3)


def test_a_movement_has_a_bound_where_nothing_is_forgotten():
    """With beta = 0 and z at its limit the way back changes nothing, however far it is."""
    v = one(d=1.0, a=1.0, beta=0.0, gamma=5.0).respond([[0.0, 100.0, -1e9]])[0]
    assert v[0, 1:] == pytest.approx([100.0 - 0.2, -1e9 - 0.2], rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_far_movement_is_where_many_short_ones_go(seed):
    """Both ways from either side of zero, to a turn of z and beyond it."""
    rng = np.random.default_rng(seed)
    load, unload = 10.0 ** rng.uniform(-1.5, 0.0, 2)
    for z in np.array([-0.9, -0.3, 0.0, 0.3, 0.9]) / load:
        for du in (-8.0, -1.0, 1.0, 8.0):
            at = z
            for _ in range(2000):
                at = moved(at, du / 2000, load, unload)
            assert moved_far(z, du, load, unload) == pytest.approx(at, abs=1e-3 / load)

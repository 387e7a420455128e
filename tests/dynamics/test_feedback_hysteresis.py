"""Hysteresis inside the loop: theory of the block, and what simulates, saves and refuses it."""

from dataclasses import replace

import control
import numpy as np
import pytest
import theory
from scipy import signal
from scipy.linalg import expm

from hammerstein import HammersteinModel
from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import FeedbackHysteresisDynamics, discretise, on_grid
from hammerstein.errors import InputError
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    BoucWenPair,
    DeadZones,
    Envelope,
    Generalised,
    Pair,
    Parallel,
    PrandtlIshlinskii,
    Preisach,
    RateDependent,
    RatePlays,
)

RNG = np.random.default_rng(30)
TIME_S = 1e-4


def matrices(n=6, m=2, h=2, q=2, seed=1, moves=1):
    """Random stable matrices A to G of a discrete block with two outputs, and H for two moves in a sample."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n))
    a *= 0.9 / np.abs(np.linalg.eigvals(a)).max()
    shapes = {"B": (n, m), "C": (2, n), "D": (2, m)}
    shapes |= {"E": (n, moves * q), "F": (moves * h, n), "G": (moves * h, m)}
    if moves == 2:
        shapes["H"] = h, q
    return {"A": a} | {name: 0.3 * rng.normal(size=shape) for name, shape in shapes.items()}


def plays(weights=0.02, thresholds=(0.0, 0.5, 1.5)):
    """Bank of plays from two inputs to two outputs."""
    w = weights * np.array([1.0, 0.5, 0.25])
    return PrandtlIshlinskii([[Pair(thresholds, s * w) for s in row] for row in ((1.0, 0.3), (-0.2, 0.8))])


def block(hysteresis, **changes):
    """Block of these matrices on its own grid."""
    given = matrices() | changes
    return FeedbackHysteresisDynamics.of(hysteresis, sample_time_s=TIME_S, **given).block()


def written_out(m, gamma, u):
    """Outputs by the equations as they are written, Gamma a function of the whole past of z."""
    x, z_past, y = np.zeros(len(m["A"])), [], []
    for k in range(u.shape[1]):
        z = m["F"] @ x + m["G"] @ u[:, k]
        z_past.append(z[:2])
        w = gamma(np.array(z_past).T)
        if "H" in m:
            z_past.append(z[2:] + m["H"] @ w)
            w = np.concatenate([w, gamma(np.array(z_past).T)])
        y.append(m["C"] @ x + m["D"] @ u[:, k])
        x = m["A"] @ x + m["B"] @ u[:, k] + m["E"] @ w
    return np.array(y).T


@pytest.mark.parametrize("moves", [1, 2])
def test_follows_its_equations(moves):
    u = RNG.normal(size=(2, 60)).cumsum(axis=1)
    weights, thresholds = 0.02 * np.array([1.0, 0.5, 0.25]), np.array([0.0, 0.5, 1.5])
    mix = np.array([[1.0, 0.3], [-0.2, 0.8]])

    def gamma(z):
        each = [weights @ [theory.play(row, r)[-1] for r in thresholds] for row in z]
        return mix @ each

    expected = written_out(matrices(moves=moves), gamma, u)
    found, _ = block(plays(), **matrices(moves=moves)).respond(u)
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("steady", [None, 7.0], ids=["static", "never turned"])
def test_without_loops_it_is_the_linear_model(steady):
    """A static Gamma is a matrix; plays that move one way are a matrix too, less what their gaps take."""
    m, gain = matrices(), np.array([[0.05, 0.01], [-0.02, 0.04]])
    gamma = PrandtlIshlinskii([[Pair([0.0], [g]) for g in row] for row in gain])
    a, b = m["A"] + m["E"] @ gain @ m["F"], m["B"] + m["E"] @ gain @ m["G"]
    u = RNG.normal(size=(2, 400))
    if steady is not None:  # z rises for ever: the play follows r behind, which is a constant input
        one_way = {"F": np.zeros((2, 6)), "G": np.eye(2)}
        u = np.cumsum(np.abs(u) + 0.1, axis=1) + steady
        m = m | one_way
        a, b = m["A"], m["B"] + m["E"] @ gain
        gamma = PrandtlIshlinskii([[Pair([steady], [g]) for g in row] for row in gain])
    found, _ = block(gamma, **m).respond(u)
    driven = np.vstack([u, np.ones(u.shape[1])])
    shift = m["E"] @ gain @ np.full((2, 1), -(steady or 0.0))
    system = (a, np.hstack([b, shift]), m["C"], np.hstack([m["D"], np.zeros((2, 1))]), TIME_S)
    _, expected, _ = signal.dlsim(system, driven.T)
    np.testing.assert_allclose(found, expected.T, rtol=1e-10, atol=1e-12 * np.abs(expected).max())
    answer = control.forced_response(control.ss(*system), inputs=driven)
    np.testing.assert_allclose(found, answer.outputs, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("wide", [0.0, 1e6])
def test_a_continuous_loop_in_which_nothing_turns_is_linear(wide):
    """Oscillator with a static spring in its loop and a play that never moves, against its exponential."""
    w, spring = 2 * np.pi * 300.0, 0.4
    a = np.array([[0.0, w], [-w, -0.02 * w]])
    of = {"A": a, "B": [[0.0], [w]], "C": [[1.0, 0.0]], "D": [[0.0]]}
    loop = {"E": [[0.0], [w]], "F": [[1.0, 0.0]], "G": [[0.0]]}
    pair = Pair([0.0, wide], [-spring, 0.7]) if wide else Pair([0.0], [-spring])
    dynamics = FeedbackHysteresisDynamics.of(PrandtlIshlinskii([[pair]]), **of, **loop)
    u = RNG.normal(size=(1, 50))
    found, _ = on_grid(dynamics, TIME_S).respond(u)
    softer = np.array([[0.0, w], [-w - w * spring, -0.02 * w]])
    step = expm(TIME_S * np.block([[softer, np.array([[0.0], [w]])], [np.zeros((1, 3))]]))
    x, y = np.zeros(2), []
    for value in u[0]:
        y.append(x[0])
        x = step[:2, :2] @ x + step[:2, 2] * value
    np.testing.assert_allclose(found[0], y, rtol=1e-10, atol=1e-13)


def every_kind():
    """A block of each kind, from two inputs to two outputs, and all of them side by side."""
    zones = [[DeadZones([-1.0, 2.0], [0.01, -0.005]), DeadZones.absent()] for _ in range(2)]
    bent, straight = (
        Envelope([-4.0, 1.0, 5.0], [-4.0, 1.0, 3.0], 0.5, 0.7, 1.5),
        Envelope([0.0, 1.0], [0.0, 0.9]),
    )
    cells = np.tril(RNG.uniform(0.0, 0.01, (6, 6)))
    rates = RatePlays([0.0, 0.5, 1.5], [0.0, 1e-5, 3e-5], bandwidth_hz=900.0, lambda_s_per_v=1e-4)
    found = {
        "plays": plays(),
        "asymmetric": Asymmetric(plays(), zones, np.zeros(2)),
        "asymmetric behind plays": Asymmetric(plays(thresholds=(0.3, 0.5, 1.5)), zones, np.zeros(2)),
        "generalised": Generalised((bent, straight), plays()),
        "preisach": Preisach([-3.0, -4.0], [3.0, 4.0], [[cells, 0.2 * cells], [0.1 * cells, cells]]),
        "rate_dependent": RateDependent((rates, rates), [[[0.02, 0.01, 0.005]] * 2] * 2),
        "bouc_wen": BoucWen([[BoucWenPair(0.02, 0.01, 0.5, 0.2) for _ in range(2)] for _ in range(2)]),
    }
    return found | {"parallel": Parallel(tuple(found.values()))}


KINDS = every_kind()
RATED = ("rate_dependent", "parallel")
IN_LOOPS = [(kind, moves) for kind in KINDS for moves in (1, 2) if moves == 1 or kind not in RATED]


def test_a_gain_for_two_moves_is_the_block_of_a_static_gamma():
    """Closed over both moves; and beside a gain, what is added to w at each."""
    m, gain = matrices(moves=2), np.array([[0.05, 0.01], [-0.02, 0.04]])
    here, u = (
        block(PrandtlIshlinskii([[Pair([0.0], [g]) for g in row] for row in gain]), **m),
        RNG.normal(size=(2, 200)),
    )
    found, _ = here.respond(u)
    np.testing.assert_allclose(here.with_gain(gain).respond(u)[0], found, rtol=1e-10, atol=1e-12)
    other = 0.5 * gain
    both = here.beside(other)
    x, y, d = np.zeros(6), [], np.zeros(4)
    for sample in u.T:
        first = m["F"][:2] @ x + m["G"][:2] @ sample
        second = m["F"][2:] @ x + m["G"][2:] @ sample + m["H"] @ gain @ first
        d = np.concatenate([(gain - other) @ z for z in (first, second)])
        y.append(both.C @ x + both.D @ np.concatenate([sample, d]))
        np.testing.assert_allclose(y[-1][2:], np.concatenate([first, second]), rtol=1e-9, atol=1e-12)
        x = both.A @ x + both.B @ np.concatenate([sample, d])
    np.testing.assert_allclose(np.array(y).T[:2], found, rtol=1e-9, atol=1e-12)


def test_two_moves_follow_an_oscillator_that_one_misses():
    """At ten samples per period: plays of a fine march, less by a twentieth of what a held w leaves."""
    w, share, fine = 2 * np.pi * 0.1 / TIME_S, 0.3, 200
    a = np.array([[0.0, w], [-w, -0.05 * w]])
    held = np.block([[a, np.array([[0.0, 0.0], [w, w]]), np.zeros((2, 1))], [np.zeros((3, 5))]])
    held[3, 4] = 1.0 / TIME_S  # w rises by the last input in a sample
    step, short = expm(TIME_S * held), expm(TIME_S / fine * held)
    of = {"A": step[:2, :2], "B": step[:2, 2:3], "C": [[1.0, 0.0]], "D": [[0.0]]}
    f = np.array([[1.0, 0.0]])
    one = {"E": step[:2, 3:4], "F": f, "G": [[0.0]]}
    rows = {"F": np.vstack([f, f @ step[:2, :2]]), "G": [[0.0], [step[0, 2]]], "H": f @ step[:2, 3:4]}
    two = {"E": np.hstack([step[:2, 3:4] - step[:2, 4:5], step[:2, 4:5]])} | rows
    r, u = 0.5, RNG.normal(size=(1, 400))
    x, p, y = np.zeros(2), 0.0, []
    for value in u[0]:
        y.append(x[0])
        for _ in range(fine):
            p = max(x[0] - r, min(x[0] + r, p))
            x = short[:2, :2] @ x + short[:2, 2] * value - short[:2, 3] * share * p
    gamma = PrandtlIshlinskii([[Pair([r], [-share])]])
    errors = [
        (
            FeedbackHysteresisDynamics.of(gamma, sample_time_s=TIME_S, **of, **more).block().respond(u)[0][0]
            - y
        ).std()
        for more in (one, two)
    ]
    assert errors[1] < 0.05 * errors[0]


@pytest.mark.parametrize(("kind", "moves"), IN_LOOPS)
def test_every_kind_moves_in_compiled_loops_as_by_itself(kind, moves):
    """Its own ``step`` for the z of the written equations, one sample after the other."""
    m, u = matrices(moves=moves), 2.0 * RNG.normal(size=(2, 200)).cumsum(axis=1)
    gamma = KINDS[kind].on_grid(TIME_S)
    expected = written_out(m, lambda z: gamma.respond(z)[0][:, -1], u)
    found, _ = block(KINDS[kind], **m).respond(u)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_a_kind_of_a_plug_in_is_stepped_in_python(monkeypatch):
    here, u = block(KINDS["bouc_wen"]), RNG.normal(size=(2, 80)).cumsum(axis=1)
    expected, after = here.respond(u)
    monkeypatch.setattr(BoucWen, "in_loop", lambda self, memory: None)
    found, state = here.respond(u)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state, after, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_that_leaves_all_numbers_ends_in_none(kind):
    """Grown beyond every number, the outputs are no numbers, and nothing is read outside a table."""
    found, _ = replace(block(KINDS[kind]), A=1e30 * np.eye(6)).respond(np.ones((2, 40)))
    assert np.isfinite(found[:, :5]).all()
    assert not np.isfinite(found[:, -1]).any()


@pytest.mark.parametrize("kind", ["asymmetric", "generalised", "preisach", "parallel"])
def test_a_working_point_in_the_loop_is_refused_and_not_lost(kind):
    moved = KINDS[kind].counted_from(np.array([1.5, -0.5]))
    with pytest.raises(InputError, match=r"use its counted_from\(0\)"):
        block(moved)
    assert block(moved.counted_from(np.zeros(2))).hysteresis == KINDS[kind].on_grid(TIME_S)


def test_a_loop_without_states_is_its_direct_gain():
    none = {"A": np.zeros((0, 0)), "B": np.zeros((0, 2)), "C": np.zeros((2, 0)), "E": np.zeros((0, 2))}
    u = RNG.normal(size=(2, 20))
    found, _ = block(plays(), **none, F=np.zeros((2, 0))).respond(u)
    np.testing.assert_allclose(found, matrices()["D"] @ u, rtol=1e-12, atol=1e-14)


def test_a_rate_does_not_move_twice_in_a_sample():
    with pytest.raises(InputError, match="would double its rate: omit H"):
        block(KINDS["rate_dependent"], **matrices(moves=2))


def test_the_end_of_a_sample_needs_a_sample_time():
    with pytest.raises(InputError, match="give the sample_time_s"):
        FeedbackHysteresisDynamics.of(plays(), **matrices(moves=2))


@pytest.mark.parametrize(("kind", "moves"), IN_LOOPS)
def test_batch_is_step_to_the_last_bit(kind, moves):
    here, u = block(KINDS[kind], **matrices(moves=moves)), RNG.normal(size=(2, 50)).cumsum(axis=1)
    whole, after = here.respond(u)
    state, steps = here.rest(), []
    for sample in u.T:
        y, state = here.step(sample, state)
        steps.append(y)
    assert np.array_equal(np.array(steps).T, whole)
    assert np.array_equal(state, after)


def model(dynamics, working_point_v=None):
    """Actuator whose only hysteresis is in the loop."""
    one = PrandtlIshlinskii([[Pair([0.0], [float(i == k)]) for k in range(2)] for i in range(2)])
    given = None
    if working_point_v:
        low, high = ([v + 5.0 * way for v in working_point_v] for way in (-1.0, 1.0))
        given = Voltages.of(working_point_v, low, high)
    return HammersteinModel("loop", one, dynamics, 5.0, ("a", "b"), ("x", "y"), voltages=given)


def discrete(**changes):
    return FeedbackHysteresisDynamics.of(plays(), sample_time_s=TIME_S, **(matrices() | changes))


@pytest.mark.parametrize(("kind", "moves"), IN_LOOPS)
def test_model_file_keeps_every_bit(kind, moves, tmp_path):
    dynamics = FeedbackHysteresisDynamics.of(KINDS[kind], sample_time_s=TIME_S, **matrices(moves=moves))
    first = model(dynamics)
    first.save(tmp_path / "model.json")
    again = HammersteinModel.load(tmp_path / "model.json")
    u = RNG.normal(size=(2, 300))
    found, expected = (m.simulate(u, TIME_S).position_um for m in (again, first))
    assert np.array_equal(found, expected)
    assert again.digest() == first.digest()


def test_absolute_volts_count_from_the_working_point():
    at_zero, raised = model(discrete()), model(discrete(), (40.0, -3.0))
    u = RNG.normal(size=(2, 100))
    found = raised.simulate(u + np.array([[40.0], [-3.0]]), TIME_S).position_um
    expected = at_zero.simulate(u, TIME_S).position_um
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_python_control_plays_the_same_numbers():
    here, u = model(discrete()), RNG.normal(size=(2, 40))
    system = here.to_iosys(TIME_S)
    answer = control.input_output_response(system, np.arange(40) * TIME_S, u)
    expected = here.simulate(u, TIME_S).position_um
    np.testing.assert_allclose(answer.outputs, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("moves", [1, 2])
def test_sensor_and_delay_stand_around_the_loop(moves):
    """A delay of the input shifts the outputs; a fractional one is a step between two samples."""
    dynamics, u = discrete(**matrices(moves=moves)), RNG.normal(size=(2, 80))
    late = dynamics.model_copy(update={"input_delay_s": 3 * TIME_S})
    plain, shifted = (on_grid(d, TIME_S).respond(u)[0] for d in (dynamics, late))
    np.testing.assert_allclose(shifted[:, 3:], plain[:, :-3], rtol=1e-10, atol=1e-13)
    assert not shifted[:, :3].any()
    with_sensor, _ = on_grid(dynamics, TIME_S, 500.0).respond(u)
    np.testing.assert_allclose(with_sensor[:2], plain, rtol=1e-10, atol=1e-13)
    pole = np.exp(-2 * np.pi * 500.0 * TIME_S)
    filtered = signal.lfilter([0.0, 1.0 - pole], [1.0, -pole], plain, axis=1)
    np.testing.assert_allclose(with_sensor[2:], filtered, rtol=1e-10, atol=1e-13)


def test_a_delay_within_a_sample_is_the_input_of_a_finer_grid():
    """Continuous loop of a linear spring: late by half a sample is the linear model late by as much."""
    w = 2 * np.pi * 200.0
    a = np.array([[0.0, w], [-w, -0.1 * w]])
    of = {"A": a, "B": [[0.0], [w]], "C": [[1.0, 0.0]], "D": [[0.0]]}
    unused = {"E": [[0.0], [0.0]], "F": [[1.0, 0.0]], "G": [[0.0]]}
    dynamics = FeedbackHysteresisDynamics.of(PrandtlIshlinskii([[Pair([0.5], [1.0])]]), **of, **unused)
    late = dynamics.model_copy(update={"input_delay_s": 1.5 * TIME_S})
    u = RNG.normal(size=(1, 100))
    fine, _ = on_grid(dynamics, TIME_S / 2).respond(np.repeat(u, 2, axis=1))
    found, _ = on_grid(late, TIME_S).respond(u)
    expected = np.concatenate([np.zeros(3), fine[0]])[: 2 * u.shape[1] : 2]
    np.testing.assert_allclose(found[0], expected, rtol=1e-9, atol=1e-12)


def test_laws_that_need_linear_dynamics_refuse_it_by_name():
    with pytest.raises(InputError, match="feedback_hysteresis is not linear"):
        discretise(discrete(), TIME_S)


def test_an_unstable_loop_is_refused_unless_it_is_meant():
    """Small amplitudes are stable, large ones are not: all plays move there."""
    wild = {"E": 5000.0 * matrices()["E"]}
    with pytest.raises(InputError, match="large amplitudes"):
        model(discrete(**wild))
    allowed = discrete(**wild).model_copy(update={"allow_unstable": True})
    assert model(allowed).dynamics.instability() == ""


@pytest.mark.parametrize("radius", [0.999, 1.001, 1.5])
def test_poles_of_a_discrete_loop_belong_inside_the_unit_circle(radius):
    """Where nothing comes back from the hysteresis they are those of A."""
    rows = matrices()
    alone = {"A": rows["A"] * radius / np.abs(np.linalg.eigvals(rows["A"])).max(), "E": 0.0 * rows["E"]}
    told = discrete(**alone).instability()
    assert (f"a pole is {radius - 1.0:.3g} beyond" in told) if radius > 1.0 else told == ""


def test_resonance_follows_the_amplitude():
    """An oscillator with a play as a spring: its resonance is that of the describing function.

    m x'' + d x' + k x = u - k_h p(x), p the play of x: at amplitude X the spring is k + k_h N(X).
    """
    hz, damping, share, r, fs = 300.0, 0.02, 0.2, 1.0, 160e3
    w = 2 * np.pi * hz
    of = {"A": [[0.0, w], [-w, -2 * damping * w]], "B": [[0.0], [w]], "C": [[1.0, 0.0]], "D": [[0.0]]}
    loop = {"E": [[0.0], [share * w]], "F": [[1.0, 0.0]], "G": [[0.0]]}
    here = on_grid(
        FeedbackHysteresisDynamics.of(PrandtlIshlinskii([[Pair([r], [1.0])]]), **of, **loop), 1 / fs
    )
    angles = 2 * np.pi * np.array([[280.0], [310.0], [340.0]]) / fs * np.arange(int(fs))
    for ratio, angle in zip(angles[:, 1] * fs / w, angles, strict=True):
        for force in (0.6, 1.5, 5.0):
            y, _ = here.respond(force * np.sin(angle)[None])
            last = slice(-int(fs / 10), None)
            amplitude = 2 * abs(np.mean(y[0, last] * np.exp(-1j * angle[last])))
            gain, ahead = theory.play_describing_function(amplitude, r) if amplitude > r else (0.0, 0.0)
            stiffness = 1.0 - share * (gain + 1j * ahead) - ratio**2 + 2j * damping * ratio
            assert amplitude * abs(stiffness) == pytest.approx(force, rel=0.03)


def test_ideal_instruments_change_nothing():
    here, u = model(discrete()), RNG.normal(size=(2, 30))
    found = here.simulate(u, TIME_S, instruments=Instruments.ideal()).position_um
    assert np.array_equal(found, block(plays()).respond(u)[0])


@pytest.mark.parametrize("size", [0.4, 8.0])
def test_ends_of_slow_loops_are_those_that_it_reaches(size):
    here, ends = block(plays()), size * np.array([[1.0, 0.0, 1.0], [0.0, 1.0, -0.5]])
    falls = np.linspace(1.0, -1.0, 4001)
    turns = np.concatenate([np.linspace(0.0, 1.0, 2000), falls, -falls, falls])
    for end, found in zip(ends.T, here.slow_ends(ends).T, strict=True):
        y, _ = here.respond(end[:, None] * turns)
        np.testing.assert_allclose(found, 0.5 * (y[:, -4001] - y[:, -1]), rtol=0.01)


@pytest.mark.parametrize("pole", [-0.3, 0.3])
def test_poles_of_a_continuous_loop_belong_left_of_the_axis(pole):
    """The worst of them decides, whatever the others are, where nothing comes back from the hysteresis."""
    rows = matrices(n=2)
    alone = rows | {"A": np.diag([-5.0, pole]), "E": 0.0 * rows["E"]}
    told = FeedbackHysteresisDynamics.of(plays(), **alone).instability()
    assert ("a pole is 0.3 beyond" in told) if pole > 0.0 else told == ""

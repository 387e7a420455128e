import itertools
from dataclasses import replace

import numpy as np
import pytest
import theory

from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw, convergence
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import BoucWen, BoucWenPair, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.invertibility import slope_matrices
from hammerstein.model import HammersteinModel

T = 50e-6


@pytest.fixture(scope="module")
def table():
    return HammersteinModel.load("duo_bimorph_static")


def _circle(cycles=4):
    angle = 2 * np.pi * 50.0 * T * np.arange(400 * cycles)
    return 50.0 * np.stack([np.cos(angle), np.sin(angle)])


def _rms_of_last_cycles(table, **options):
    reference = _circle()
    drive, _ = InverseMultiplicativeLaw(table, np.inf, T, **options).respond(reference)
    position, _ = table.hysteresis.respond(drive)
    return np.sqrt(np.mean((position - reference)[:, 800:] ** 2, axis=1))


def _summed_inverse(table):
    return np.linalg.inv(table.hysteresis.bank.slope[:, -1, :].T)


# RMS of a 50 um circle at 50 Hz, static model, x and y [um], from a script that shares nothing with ours.
@pytest.mark.parametrize(
    ("gain", "expected"),
    [
        (lambda _: 0.1 * np.eye(2), (0.45, 0.55)),
        (lambda _: 0.2 * np.eye(2), (0.11, 0.07)),
        (_summed_inverse, (0.44, 0.29)),
        (lambda table: 1.8 * _summed_inverse(table), (0.09, 0.14)),
    ],
)
def test_error_on_a_circle(table, gain, expected):
    np.testing.assert_allclose(_rms_of_last_cycles(table, gain=gain(table)), expected, atol=0.0051)


def test_iterations_in_each_sample_remove_the_error(table):
    gain = 0.5 * np.diag(np.diag(_summed_inverse(table)))
    assert (_rms_of_last_cycles(table, gain=gain, iterations=30) < 0.01).all()


def test_the_law_as_printed_is_refused_and_diverges(table):
    with pytest.raises(
        SimulationError, match=r"does not converge: slopes 3.* to 9\.[89].* spectral radius 8"
    ):
        InverseMultiplicativeLaw(table, np.inf, T, gain="identity")
    law = InverseMultiplicativeLaw(table, np.inf, T, gain="identity", run_anyway=True)
    drive, _ = law.respond(_circle()[:, :6])
    assert np.abs(drive[:, 5]).max() > 250e3


def test_one_linear_input_follows_the_recursion():
    # Gamma = g u: U[k] = y + (1 - g) U[k-1], a geometric sum.
    g, n = 0.4, 30
    model = HammersteinModel.load("duo_bimorph_static")
    linear = PrandtlIshlinskii(((Pair.linear(g), Pair.absent()), (Pair.absent(), Pair.linear(2 * g))))
    law = InverseMultiplicativeLaw(_with(model, linear), np.inf, T, gain="identity")
    drive, _ = law.respond(np.ones((2, n)))
    k = np.arange(1, n + 1)
    np.testing.assert_allclose(drive[0], (1 - (1 - g) ** k) / g, rtol=1e-12)
    np.testing.assert_allclose(drive[1], (1 - (1 - 2 * g) ** k) / (2 * g), rtol=1e-12)


def _with(model, hysteresis):
    from dataclasses import replace

    return replace(model, hysteresis=hysteresis)


def test_filter_converges_where_the_delay_does_not(table):
    slope_max = table.hysteresis.slope_columns(0)[:, 0].max()
    slow, fast = 1.05 * T * slope_max / 2, 0.9 * T * slope_max / 2
    pole = lambda tau: np.exp(-T / tau)  # noqa: E731
    assert convergence(slope_matrices(table.hysteresis, 10.0), np.eye(2), pole(1.2 * slow)).converges
    assert not convergence(slope_matrices(table.hysteresis, 10.0), np.eye(2), pole(0.8 * fast)).converges
    law = InverseMultiplicativeLaw(table, np.inf, T, gain="identity", filter_s=2 * slow)
    drive, _ = law.respond(np.full((2, 400), 30.0))
    position, _ = table.hysteresis.respond(drive)
    np.testing.assert_allclose(position[:, -1], 30.0, atol=1e-9)


def _auto_gain():
    """The inverse of the summed weights, made so small that K J nowhere passes 1."""
    inverse = np.linalg.inv(theory.W_UM_PER_V.sum(axis=2))
    sums = np.concatenate([np.zeros((2, 2, 1)), np.cumsum(theory.W_UM_PER_V, axis=2)], axis=2)
    pairs = itertools.product(range(1, 16), repeat=2)
    slopes = [np.stack([sums[:, 0, i], sums[:, 1, j]], axis=1) for i, j in pairs]
    return inverse / max(np.linalg.eigvals(inverse @ j).real.max() for j in slopes)


def _plain_filter_law(reference, gain, tau_s, passes, step_s=T):
    """U = K Y_r + f,  tau f' = U - K Gamma(U) - f, solved for what stands still from pass to pass."""
    rest, f = np.zeros((2, 2, 15)), np.zeros(2)
    a = np.exp(-step_s / (passes * tau_s))
    drive = np.empty_like(reference)
    for k in range(reference.shape[1]):
        for _ in range(passes):
            u = gain @ reference[:, k] + f
            voltage = u[None, :, None]
            rest = np.maximum(voltage - theory.R_V, np.minimum(voltage + theory.R_V, rest))
            f = a * f + (1 - a) * (u - gain @ (theory.W_UM_PER_V * rest).sum(axis=(1, 2)))
        drive[:, k] = u
    return drive


@pytest.mark.parametrize("passes", [1, 4])
@pytest.mark.parametrize("filter_s", [20e-6, 200e-6, 1e-3])
def test_filter_law_is_the_plain_loop(table, filter_s, passes):
    reference = _circle(1)
    law = InverseMultiplicativeLaw(table, np.inf, T, filter_s=filter_s, iterations=passes)
    expected = _plain_filter_law(reference, _auto_gain(), filter_s, passes)
    np.testing.assert_allclose(law.respond(reference)[0], expected, rtol=0, atol=1e-9)


def test_filter_law_follows_a_ramp_by_its_closed_form():
    # Gamma = g u: v[k+1] - v[k] = g K c + (1 - a) g K e, so that the error of a ramp is constant.
    g, k, tau, rate = 4.0, 0.1, 300e-6, 0.02
    linear = PrandtlIshlinskii(((Pair.linear(g), Pair.absent()), (Pair.absent(), Pair.linear(g))))
    model = _with(HammersteinModel.load("duo_bimorph_static"), linear)
    law = InverseMultiplicativeLaw(model, np.inf, T, gain=k * np.eye(2), filter_s=tau)
    ramp = rate * np.arange(2000) * np.ones((2, 1))
    error = ramp[:, -1] - g * law.respond(ramp)[0][:, -1]
    pole = np.exp(-T / tau)
    np.testing.assert_allclose(error, rate * (1 - g * k) / ((1 - pole) * g * k), rtol=1e-9)


def test_a_faster_filter_follows_better_and_the_fastest_is_the_delay(table):
    times = (1e-3, 300e-6, 100e-6, 30e-6, 1e-9)
    errors = [_rms_of_last_cycles(table, filter_s=tau).max() for tau in times]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(_rms_of_last_cycles(table).max(), rel=1e-9)
    assert errors[0] < 10.0  # of a circle of 50 um; a feed-through that is too large misses by more


def test_more_passes_with_a_filter_neither_chatter_nor_shorten_its_time(table):
    """The drive of a circle turns twice a cycle and axis, however many passes there are."""
    drives = {}
    for passes in (1, 8):
        law = InverseMultiplicativeLaw(table, np.inf, T, filter_s=300e-6, iterations=passes)
        drives[passes] = law.respond(_circle())[0][:, 800:]
        turns = np.diff(np.sign(np.diff(drives[passes], axis=1)), axis=1) != 0
        assert (turns.sum(axis=1) <= 4).all()  # two cycles
    assert np.abs(drives[1] - drives[8]).max() < 0.02 * np.abs(drives[1]).max()


def test_the_statement_holds_the_filter(table):
    filter_s, passes = 300e-6, 2
    law = InverseMultiplicativeLaw(table, np.inf, T, filter_s=filter_s, iterations=passes)
    share = 1 - np.exp(-T / (passes * filter_s))
    sums = np.cumsum(theory.W_UM_PER_V, axis=2)
    least = min(
        np.linalg.eigvals(_auto_gain() @ np.stack([sums[:, 0, i], sums[:, 1, j]], axis=1)).real.min()
        for i, j in itertools.product(range(15), repeat=2)
    )
    radius = 1 - share * least
    assert law.convergence.spectral_radius == pytest.approx(radius, rel=1e-9)
    time_s = -T / passes / np.log(radius)
    assert f"an error decays with a time constant of {1e3 * time_s:.3g} ms" in law.statement()
    assert not law.convergence.overshoot


def test_a_gain_that_passes_too_much_overshoots_behind_any_filter(table):
    law = InverseMultiplicativeLaw(table, np.inf, T, gain="identity", filter_s=5e-3)
    assert law.convergence.converges
    assert law.convergence.overshoot
    with pytest.raises(SimulationError, match="a slower filter converges too, but overshoots"):
        InverseMultiplicativeLaw(table, np.inf, T, gain="identity", filter_s=20e-6)


def test_automatic_gain_converges_without_overshoot(table):
    law = InverseMultiplicativeLaw(table, 10.0, T)
    assert law.convergence.converges
    assert not law.convergence.overshoot
    doubled = InverseMultiplicativeLaw(table, 10.0, T, gain=1.2 * law.gain_v_per_um)
    assert doubled.convergence.overshoot


def test_drive_stays_in_range_and_recovers(table):
    reference = np.hstack([np.full((2, 200), 70.0), np.zeros((2, 400))])
    drive, _ = InverseMultiplicativeLaw(table, 10.0, T).respond(reference)
    assert np.abs(drive).max() == 10.0
    position, _ = table.hysteresis.respond(drive)
    assert np.abs(position[:, -1]).max() < 0.3


def test_around_another_kind_of_hysteresis_it_goes_on_from_its_state():
    pair = BoucWenPair(direct_um_per_v=5.0, hysteretic_um_per_v=1.0, beta_per_v=0.3, gamma_per_v=0.1)
    model = HammersteinModel("m", BoucWen([[pair]]), StaticDynamics(n_outputs=1), 10.0, ("u",), ("x",))
    law, path = InverseMultiplicativeLaw(model, np.inf, T, iterations=2), 0.4 * _circle(1)[:1]
    whole, _ = law.respond(path)
    before, state = law.respond(path[:, :150])
    after, _ = law.respond(path[:, 150:], state)
    assert (np.hstack([before, after]) == whole).all()


def test_refuses_what_is_not_square():
    model = HammersteinModel.load("duo_bimorph_static")
    from dataclasses import replace

    wide = replace(
        model,
        hysteresis=PrandtlIshlinskii(tuple((*row, Pair.linear(1.0)) for row in model.hysteresis.pairs)),
        inputs=("x", "y", "z"),
    )
    with pytest.raises(InputError, match="as many inputs as outputs"):
        InverseMultiplicativeLaw(wide, 10.0, T)


def test_refuses_a_gain_of_the_wrong_shape(table):
    with pytest.raises(InputError, match="matrix in V/um"):
        InverseMultiplicativeLaw(table, 10.0, T, gain=np.eye(3))


@pytest.mark.parametrize("scale", [1e-7, 1e7])
def test_the_automatic_gain_does_not_depend_on_units(table, scale):
    """Weights that are so many times larger want a gain that is so many times smaller."""
    own = PrandtlIshlinskii.from_arrays(theory.R_V, theory.W_UM_PER_V)
    large = PrandtlIshlinskii.from_arrays(theory.R_V, scale * np.array(theory.W_UM_PER_V))
    plain, other = (
        InverseMultiplicativeLaw(replace(table, hysteresis=h), 10.0, T).gain_v_per_um for h in (own, large)
    )
    np.testing.assert_allclose(scale * other, plain, rtol=1e-9)
    flat = PrandtlIshlinskii.from_arrays(np.zeros(1), scale * np.array([[[1.0], [2.0]], [[2.0], [4.0]]]))
    with pytest.raises(SimulationError, match="singular"):
        InverseMultiplicativeLaw(replace(table, hysteresis=flat), 10.0, T)

import numpy as np
import pytest

from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative, convergence
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
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
    drive, _ = InverseMultiplicative(table, np.inf, T, **options).respond(reference)
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
        InverseMultiplicative(table, np.inf, T, gain="identity")
    law = InverseMultiplicative(table, np.inf, T, gain="identity", run_anyway=True)
    drive, _ = law.respond(_circle()[:, :6])
    assert np.abs(drive[:, 5]).max() > 250e3


def test_one_linear_input_follows_the_recursion():
    # Gamma = g u: U[k] = y + (1 - g) U[k-1], a geometric sum.
    g, n = 0.4, 30
    model = HammersteinModel.load("duo_bimorph_static")
    linear = PrandtlIshlinskii(((Pair.linear(g), Pair.absent()), (Pair.absent(), Pair.linear(2 * g))))
    law = InverseMultiplicative(_with(model, linear), np.inf, T, gain="identity")
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
    assert convergence(table.hysteresis, np.eye(2), pole(1.2 * slow)).converges
    assert not convergence(table.hysteresis, np.eye(2), pole(0.8 * fast)).converges
    law = InverseMultiplicative(table, np.inf, T, gain="identity", filter_s=2 * slow)
    drive, _ = law.respond(np.full((2, 400), 30.0))
    position, _ = table.hysteresis.respond(drive)
    np.testing.assert_allclose(position[:, -1], 30.0, atol=1e-9)


def test_automatic_gain_converges_without_overshoot(table):
    law = InverseMultiplicative(table, 10.0, T)
    assert law.convergence.converges
    assert not law.convergence.overshoot
    doubled = InverseMultiplicative(table, 10.0, T, gain=1.2 * law.gain_v_per_um)
    assert doubled.convergence.overshoot


def test_drive_stays_in_range_and_recovers(table):
    reference = np.hstack([np.full((2, 200), 70.0), np.zeros((2, 400))])
    drive, _ = InverseMultiplicative(table, 10.0, T).respond(reference)
    assert np.abs(drive).max() == 10.0
    position, _ = table.hysteresis.respond(drive)
    assert np.abs(position[:, -1]).max() < 0.3


def test_refuses_what_is_not_square():
    model = HammersteinModel.load("duo_bimorph_static")
    from dataclasses import replace

    wide = replace(
        model,
        hysteresis=PrandtlIshlinskii(tuple((*row, Pair.linear(1.0)) for row in model.hysteresis.pairs)),
        inputs=("x", "y", "z"),
    )
    with pytest.raises(InputError, match="as many inputs as outputs"):
        InverseMultiplicative(wide, 10.0, T)


def test_refuses_a_gain_of_the_wrong_shape(table):
    with pytest.raises(InputError, match="matrix in V/um"):
        InverseMultiplicative(table, 10.0, T, gain=np.eye(3))

import numpy as np
import pytest

from hammerstein import metrics

f, T = 50.0, 50e-6
t = np.arange(4000) * T
u = 10 * np.sin(2 * np.pi * f * t)


def test_lagging_sine_is_an_ellipse():
    y = 3 * np.sin(2 * np.pi * f * t - 0.3)
    (figures,) = metrics.loop_figures(u, y, f, T, 2, 40)
    assert figures.height_um == pytest.approx(6.0, rel=1e-3)
    assert figures.width_um == pytest.approx(6.0 * np.sin(0.3), rel=1e-3)
    assert figures.width_percent == pytest.approx(100 * np.sin(0.3), rel=1e-3)
    assert figures.gain == pytest.approx(0.3, rel=1e-9)
    assert figures.phase_deg == pytest.approx(np.degrees(-0.3), rel=1e-9)


@pytest.mark.parametrize("f", [150.0, 175.0, 420.0])
def test_period_need_not_be_a_whole_number_of_samples(f):
    y = 3 * np.sin(2 * np.pi * f * t - 0.3)
    (figures,) = metrics.loop_figures(10 * np.sin(2 * np.pi * f * t), y, f, T, 2, 4)
    assert figures.gain == pytest.approx(0.3, rel=2e-2)
    assert figures.height_um == pytest.approx(6.0, rel=2e-2)
    assert figures.phase_deg == pytest.approx(np.degrees(-0.3), abs=0.5)


def test_noise_above_the_sensors_bandwidth_does_not_widen_a_loop():
    noise = 0.04 * np.random.default_rng(0).normal(size=t.size)
    (figures,) = metrics.loop_figures(u, 1.4 * np.sin(2 * np.pi * f * t) + noise, f, T, 2, 40)
    assert figures.height_um == pytest.approx(2.8, rel=0.02)


def test_errors_of_a_shifted_circle():
    reference = 50 * np.stack([np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)])
    error = np.array([[0.3], [0.4]])
    assert metrics.euclidean(np.broadcast_to(error, reference.shape)).max() == pytest.approx(0.5)
    assert metrics.worst(metrics.radial(reference, reference + error)) == pytest.approx(0.5, rel=1e-3)
    assert metrics.rms(np.broadcast_to(error, reference.shape)[1]) == pytest.approx(0.4)


def test_epsilon_is_the_printed_formula():
    reference, position = np.array([[30.0], [40.0]]), np.array([[30.1], [40.0]])
    theta = 70.0**2 - 70.1**2
    assert metrics.epsilon(reference, position)[0] == pytest.approx(-np.sqrt(-theta))

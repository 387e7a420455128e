from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy import signal

from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.linear import frequency_response as module
from hammerstein.identification.linear.frequency_response import FrequencyResponse

Array = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "cubespec_fsm"
T = 5e-5


def frequency_response(u, y, *given, settle: int = 0, period_samples=None) -> FrequencyResponse:
    """Of one experiment or several, whose first periods are left out."""
    u, y = ([x] if isinstance(x, np.ndarray) else x for x in (u, y))
    first = settle * (period_samples or 0)
    cut = ([x[:, first:] for x in both] for both in (u, y))
    return module.frequency_response(*cut, *given, period_samples=period_samples)


def fir(u: Array, taps: Array) -> Array:
    """Outputs of finite impulse responses (p, m, tap), starting from rest."""
    return np.array([sum(signal.lfilter(t, [1.0], x) for t, x in zip(row, u, strict=True)) for row in taps])


def fir_response(taps: Array, frequency_hz: Array) -> NDArray[np.complex128]:
    powers = np.exp(-2j * np.pi * frequency_hz * T * np.arange(taps.shape[2])[:, None])
    return np.asarray(taps @ powers)


def periodic(rng: np.random.Generator, m: int, period: int, count: int) -> Array:
    return np.tile(rng.standard_normal((m, period)), count)


def orthogonal(rng: np.random.Generator, m: int, period: int, experiments: int) -> list[Array]:
    """Random-phase multisines, three periods: inputs orthogonal over the experiments at every line."""
    lines = (period + 1) // 2
    turn = np.exp(2j * np.pi * np.arange(experiments)[:, None] * np.arange(m) / experiments)
    spectra = turn[:, :, None] * np.exp(2j * np.pi * rng.uniform(size=(m, lines)))
    return [np.tile(np.fft.irfft(spectrum, period), 3) for spectrum in spectra]


@settings(max_examples=25)
@given(m=st.integers(1, 4), p=st.integers(1, 4), spare=st.integers(0, 2), seed=st.integers(0, 999))
def test_steady_periods_give_the_response_exactly(m: int, p: int, spare: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    taps = rng.standard_normal((p, m, 7))
    u = orthogonal(rng, m, 50, m + spare)
    g = frequency_response(u, [fir(x, taps) for x in u], T, period_samples=50, settle=1)
    assert g.response.shape == (p, m, 24)
    assert np.allclose(g.frequency_hz, np.arange(1, 25) / (50 * T))
    assert np.allclose(g.response, fir_response(taps, g.frequency_hz), atol=1e-9)
    assert np.allclose(g.coherence, 1.0)
    assert np.all(g.residual_power < 1e-25)


def test_the_transient_in_front_is_left_out() -> None:
    rng = np.random.default_rng(1)
    taps = rng.standard_normal((1, 1, 30))
    u = periodic(rng, 1, 64, 3)[:, 20:]  # starts within a period, so that it ends in a whole one
    g = frequency_response(u, fir(u, taps), T, period_samples=64, settle=1)
    assert np.allclose(g.response, fir_response(taps, g.frequency_hz), atol=1e-10)


def test_one_input_driven_at_a_time() -> None:
    rng = np.random.default_rng(2)
    taps = rng.standard_normal((3, 2, 5))
    u = [periodic(rng, 2, 40, 2) * np.array(only)[:, None] for only in ([1, 0], [0, 5])]
    g = frequency_response(u, [fir(x, taps) for x in u], T, period_samples=40, settle=1)
    assert np.allclose(g.response, fir_response(taps, g.frequency_hz), atol=1e-10)


def test_only_excited_lines_are_told() -> None:
    t = np.arange(400)
    odd = np.sum([np.cos(2 * np.pi * k * t / 200 + k * k) for k in range(1, 60, 2)], axis=0)
    g = frequency_response(odd[None], 3.0 * odd[None], T, period_samples=200)
    assert np.allclose(g.frequency_hz * 200 * T, np.arange(1, 60, 2))
    assert np.allclose(g.response, 3.0)


def test_the_residual_power_is_that_of_the_noise() -> None:
    rng = np.random.default_rng(3)
    taps, mix = rng.standard_normal((2, 2, 4)), np.array([[1.0, 0.0], [0.6, 2.0]])
    u = [mix @ periodic(rng, 2, 1000, 3) for _ in range(6)]
    y = [fir(x, taps) + np.array([[0.1], [0.5]]) * rng.standard_normal(x.shape) for x in u]
    g = frequency_response(u, y, T, period_samples=1000, settle=1)
    # white noise of variance s^2, spectra divided by the period, two periods averaged
    assert np.mean(g.residual_power, axis=1) == pytest.approx(np.array([0.1, 0.5]) ** 2 / 2000, rel=0.1)


def test_with_as_many_experiments_as_inputs_the_periods_tell_the_noise() -> None:
    rng = np.random.default_rng(4)
    u = [periodic(rng, 2, 2000, 4) for _ in range(2)]
    y = [x.sum(axis=0, keepdims=True) + 0.2 * rng.standard_normal((1, 8000)) for x in u]
    g = frequency_response(u, y, T, period_samples=2000)
    assert np.mean(g.residual_power) == pytest.approx(0.2**2 / 8000, rel=0.1)
    single = frequency_response([x[:, :2000] for x in u], [x[:, :2000] for x in y], T, period_samples=2000)
    assert not single.residual_power.any()


def test_segments_agree_with_scipy() -> None:
    rng = np.random.default_rng(5)
    u = rng.standard_normal((2, 2180))
    y = fir(u, rng.standard_normal((2, 2, 9))) + 0.3 * rng.standard_normal((2, 2180))
    g = frequency_response(u, y, T)  # of which segments have 256 samples

    def cross(a: Array, b: Array) -> NDArray[np.complex128]:
        # scipy conjugates its first argument
        return np.asarray(signal.csd(b[None, :], a[:, None], 1 / T, nperseg=256)[1].transpose(2, 0, 1))

    suu, syu = cross(u, u), cross(y, u)
    lines = slice(2, 128)
    assert np.allclose(g.response.transpose(2, 0, 1), (syu @ np.linalg.inv(suu))[lines], atol=1e-12)
    assert np.allclose(g.frequency_hz, np.arange(2, 128) / (256 * T))


def test_coherence_of_segments() -> None:
    rng = np.random.default_rng(6)
    u = [rng.standard_normal((2, 40_000)) for _ in range(2)]
    y = [np.array([[3.0, 4.0]]) @ x + 5.0 * rng.standard_normal((1, 40_000)) for x in u]
    g = frequency_response(u, y, T)
    assert np.mean(g.coherence) == pytest.approx(0.5, abs=0.02)  # signal power 3^2 + 4^2, noise 5^2


def test_a_resonance_by_segments() -> None:
    rng = np.random.default_rng(7)
    b, a = [0.0, 0.1], [1.0, -1.6, 0.8]
    u = rng.standard_normal((1, 60_000))
    g = frequency_response(u, signal.lfilter(b, a, u), T)
    truth = signal.freqz(b, a, 2 * np.pi * g.frequency_hz * T)[1]
    assert np.abs(g.response[0, 0] - truth).max() < 0.05 * np.abs(truth).max()


def test_inputs_that_move_together_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(8)
    u = rng.standard_normal((3, 20_000))
    u[2] = -2.0 * u[0] + 0.02 * rng.standard_normal(20_000)
    with pytest.raises(IdentificationError, match="inputs 1 and 3 are not moved independently"):
        frequency_response(u, u.sum(axis=0, keepdims=True), T)
    drive = [np.tile(x, (2, 1)) for x in (periodic(rng, 1, 100, 2), periodic(rng, 1, 100, 2))]
    with pytest.raises(IdentificationError, match="inputs 1 and 2 are not moved independently"):
        frequency_response(drive, drive, T, period_samples=100)


def test_one_experiment_cannot_separate_two_periodic_inputs() -> None:
    u = periodic(np.random.default_rng(9), 2, 100, 4)
    with pytest.raises(IdentificationError, match="1 spectra for 2 inputs"):
        frequency_response(u, u, T, period_samples=100)


def test_an_input_at_rest_is_named() -> None:
    u = np.vstack([np.random.default_rng(10).standard_normal(500), np.zeros(500)])
    with pytest.raises(IdentificationError, match="input 2 is never driven"):
        frequency_response(u, u[:1], T)


def test_inputs_driven_at_different_lines_share_none() -> None:
    t = np.arange(200)
    u = [
        np.vstack([np.sin(2 * np.pi * 3 * t / 200), 0 * t]),
        np.vstack([0 * t, np.sin(2 * np.pi * 5 * t / 200)]),
    ]
    with pytest.raises(IdentificationError, match="excited by every input"):
        frequency_response(u, u, T, period_samples=200)


def test_an_output_at_rest_has_no_coherence() -> None:
    u = periodic(np.random.default_rng(11), 1, 100, 2)
    g = frequency_response(u, np.vstack([u, 0 * u]), T, period_samples=100)
    assert np.all(g.coherence[1] == 0.0)
    assert np.all(g.response[1] == 0.0)


def test_records_that_are_too_short_are_refused() -> None:
    few = np.ones((1, 9))
    with pytest.raises(InputError, match="does not fit into 9 samples"):
        frequency_response(few, few, T, period_samples=10)
    with pytest.raises(InputError, match="cannot be cut from 9"):
        frequency_response(few, few, T)


def test_the_result_is_read_only_and_the_callers_arrays_are_not() -> None:
    u = periodic(np.random.default_rng(12), 1, 100, 2)
    g = frequency_response(u, u, T, period_samples=100)
    with pytest.raises(ValueError, match="read-only"):
        g.response[0, 0, 0] = 0.0
    mine = np.ones((1, 1, 49), dtype=complex)
    kept = replace(g, response=mine)
    mine[0, 0, 0] = 2.0
    assert np.all(kept.response == 1.0)


@pytest.mark.parametrize(("level", "percent"), [(100, 5.63), (200, 4.47), (300, 4.21)])
def test_measured_mirror(level: int, percent: float) -> None:
    """Error rms of the test realisations, mean of three outputs: figures of an independent calculation."""
    if not DATA.is_dir():
        pytest.skip("the measured records of the CubeSpec mirror are not on this machine")
    (u, y), (ut, yt) = (mirror(level, part) for part in ("train", "test"))
    g = frequency_response(u, y, 1 / 6400.0, period_samples=8192)
    assert len(g.frequency_hz) == 3839  # up to 3 kHz; above, the inputs hold noise only
    lines = np.arange(1, 3840)
    error = []
    for x, measured in zip(ut, yt, strict=True):
        spectrum = np.fft.rfft(x)
        model = np.zeros((3, 8193), dtype=complex)
        model[:, 2 * lines] = np.einsum("ijf,jf->if", g.response, spectrum[:, 2 * lines])
        error.append(np.mean((measured - np.fft.irfft(model)) ** 2, axis=1))
    ratio = np.sqrt(np.mean(error, axis=0) / np.mean([np.mean(x**2, axis=1) for x in yt], axis=0))
    assert 100 * np.mean(ratio) == pytest.approx(percent, abs=0.05)
    assert np.median(g.coherence) > 0.99


def mirror(level: int, part: str) -> tuple[list[Array], list[Array]]:
    """Inputs [V] and outputs [um], one array (axis, two periods) a realisation."""

    def load(name: str, scale: float) -> list[Array]:
        values = scale * np.load(DATA / f"{name}_{level}mV_{part}.npy")
        return [np.concatenate([one[..., 0], one[..., 1]]).T for one in np.moveaxis(values, 2, 0)]

    return load("u", 1.0), load("y", 1e6)


def test_sixteen_segments_are_cut_where_no_length_is_chosen() -> None:
    """Of N samples, half overlapping: 17 half segments of N/17 each."""
    u = np.random.default_rng(1).standard_normal((1, 3400))
    found = frequency_response([u], [2.0 * u], T)
    np.testing.assert_allclose(np.diff(found.frequency_hz), 1.0 / (400 * T))

"""Outliers are the same in any unit, and a step that stays is none."""

import numpy as np
import pytest
from scipy.signal import chirp, cont2discrete, lfilter, lsim, sawtooth

from hammerstein.records.outliers import Outliers, without_outliers
from hammerstein.signals import smooth_step

U = 10.0 * np.sin(np.linspace(0.0, 40.0, 4000))[None]


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_a_short_jump_away_and_back_is_one_in_any_unit(scale):
    """Five samples 30 um off in a range of 100 um: they stay within the range of the others."""
    y = 5.0 * U
    middle = int(np.argmin(np.abs(U[0, 1000:1300]))) + 1000
    y[0, middle : middle + 5] += 30.0
    found = without_outliers(U, scale * y)
    assert np.flatnonzero(found.lost_y[0]).tolist() == list(range(middle, middle + 5))
    np.testing.assert_allclose(found.y, scale * 5.0 * U, atol=1e-3 * scale)


@pytest.mark.parametrize(("times", "is_one"), [(6.0, True), (3.0, False)])
def test_a_jump_is_one_from_four_times_the_usual_large_step_on(times, is_one):
    y = 5.0 * U
    middle = int(np.argmin(np.abs(U[0, 1000:1300]))) + 1000
    y[0, middle] += times * np.abs(np.diff(y)).max()
    assert without_outliers(U, y).lost_y.any() == is_one


@pytest.mark.parametrize(("beyond", "are_some"), [(70.0, True), (40.0, False)])
def test_readings_half_a_range_outside_it_are_some_however_many_in_a_row(beyond, are_some):
    y = 5.0 * U  # 100 um
    y[0, 1200:1230] = 50.0 + beyond
    assert without_outliers(U, y).lost_y[0, 1200:1230].all() == are_some


def test_the_sample_before_the_last_may_be_one():
    y = 5.0 * U
    y[0, -2] += 30.0
    assert np.flatnonzero(without_outliers(U, y).lost_y[0]).tolist() == [U.shape[1] - 2]


@pytest.mark.parametrize("first", [1, 2, 3])
def test_rows_are_told_from_the_first_on(first):
    rows = np.array([first, first + 1, 30])
    told = Outliers("x", rows, np.array([-9.0, -9.0, 200.0]), 4000).describe()
    assert told == f"rows {first} to {first + 1} (-9), row 30 (200): 3 of 4000 samples"


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_a_jump_that_does_not_come_back_is_none(scale):
    """Two steps of opposite sign, the second a quarter of the first: the signal stays elsewhere."""
    y = 5.0 * U
    y[0, 2000:] += 30.0
    y[0, 2005:] -= 7.5
    assert not without_outliers(U, scale * y).lost_y.any()


def test_the_highest_peaks_of_a_multisine_are_none():
    """Voltages are spread like noise, and an actuator behind them rings, which no copies of them say well."""
    generator, n = np.random.default_rng(4), 16_384
    lines = np.arange(1, 1500)
    phases = generator.uniform(0.0, 2.0 * np.pi, (2, len(lines)))
    phases[:, ::11] = 0.0  # a part of them meets now and then
    spectrum = np.zeros((2, n // 2 + 1), complex)
    spectrum[:, lines] = np.exp(1j * phases)
    u = np.fft.irfft(spectrum, n)
    u /= u.std(axis=1, keepdims=True)
    assert 3 < np.count_nonzero(np.abs(u) > 4.2) < 100
    poles = np.poly(0.98 * np.exp([0.2j, -0.2j])).real
    y = lfilter([poles.sum()], poles, u, axis=1)
    found = without_outliers(u, y)
    assert not found.lost_u.any()
    assert not found.lost_y.any()
    u[0, 9000] += 40.0  # and a spike that the actuator never saw is one
    assert np.flatnonzero(without_outliers(u, y).lost_u[0]).tolist() == [9000]


def ringing(samples=60_000, rate_hz=10_000.0):
    """Voltage and output of a stage at 620 Hz with little damping: a slow sine, then a sweep across it."""
    t = np.arange(samples) / rate_hz
    u = np.where(t < 5.0, 50.0 * np.sin(2.0 * np.pi * t), 6.0 * chirp(t - 5.0, 20.0, 1.0, 1000.0))
    w, damping = 2.0 * np.pi * 620.0, 0.02
    b, a, _ = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / rate_hz)
    return u[None], 0.2 * lfilter(b.ravel(), a, u)[None] + 0.004 * np.random.default_rng(1).standard_normal(
        (1, samples)
    )


def test_a_resonance_that_is_swept_across_is_none():
    """Its steps are large beside those of the slow sine, but like those around them."""
    u, y = ringing()
    assert np.abs(y[0, 50_000:]).max() > 1.5 * np.abs(y[0, :50_000]).max()
    assert not without_outliers(u, y).lost_y.any()


def test_a_spike_beside_such_a_resonance_is_one():
    u, y = ringing()
    y[0, [12_345, 40_001]] += 60.0
    assert np.flatnonzero(without_outliers(u, y).lost_y[0]).tolist() == [12_345, 40_001]


@pytest.mark.parametrize("width", [30, 60])
def test_a_smooth_excursion_far_away_is_one(width):
    """A filter behind the fault has rounded it; it does not swing back."""
    y = 5.0 * U
    y[0, 1200 : 1200 + width] += 300.0 * np.hanning(width)
    found = without_outliers(U, y)
    lost = np.flatnonzero(found.lost_y[0])
    assert lost.min() > 1200
    assert lost.max() < 1200 + width
    assert np.abs(found.y - 5.0 * U).max() < 120.0


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_a_level_of_a_pulse_train_stands_for_no_missing_value(share):
    """Half of a pseudo-random drive was left out, and the record refused: 49.7 % outliers."""
    generator = np.random.default_rng(3)
    high = np.repeat(generator.random(400) < share, 20)
    u = np.where(high, 10.0, 1e-6 * generator.standard_normal(high.size))[None]
    y = 5.0 * lfilter([0.2], [1.0, -0.8], u, axis=1) + 0.01 * generator.standard_normal(u.shape)
    found = without_outliers(u, y)
    assert not found.lost_u.any()
    assert not found.lost_y.any()


def test_a_record_may_begin_elsewhere():
    """Held far away, then stepped to where it is driven: its first rows are no outliers."""
    u, y = U.copy(), 5.0 * U
    u[0, :12], y[0, :12] = -40.0, -200.0
    found = without_outliers(u, y)
    assert not found.lost_u.any()
    assert not found.lost_y.any()


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize(("ranges", "is_one"), [(4.0, True), (2.0, False)])
def test_a_record_may_begin_with_what_stands_for_nothing(ranges, is_one, scale):
    """The same number again and again, three ranges or more from all others, is no position."""
    y = 5.0 * U
    y[0, :9] = y.max() + ranges * np.ptp(y)
    assert np.flatnonzero(without_outliers(U, scale * y).lost_y[0]).tolist() == [*range(9)] * is_one


@pytest.mark.parametrize("seed", range(4))
def test_spikes_are_found_where_a_resonance_moves_as_far(seed):
    """Twenty of a quarter of the range; no fit without dynamics follows the multisine behind."""
    rng = np.random.default_rng(seed)
    t = 1e-4 * np.arange(12_000)
    f = np.arange(5.0, 900.0, 5.0)
    u = np.cos(2.0 * np.pi * f * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, f.size)).sum(axis=1)
    u[:8000] = 4.0 * np.abs(u).max() * sawtooth(2.0 * np.pi * 5.0 * t[:8000], 0.5)
    u[8000:] *= smooth_step((t[8000:] - t[8000]) / 0.02)
    _, y, _ = lsim(([1.0], [1 / 1200.0**2, 0.03 / 1200.0, 1.0]), u, t)
    y += 1e-3 * np.ptp(y) * rng.standard_normal(t.size)
    places = np.sort(rng.choice(np.arange(100, 11_900, 7), 20, replace=False))
    spiked = y.copy()
    spiked[places] += 0.25 * np.ptp(y) * rng.choice([-1.0, 1.0], 20)
    assert not without_outliers(u[None], y[None]).lost_y.any()
    found = np.flatnonzero(without_outliers(u[None], spiked[None]).lost_y[0])
    assert set(places) - set(found) == set()
    assert len(found) <= 22


@pytest.mark.parametrize("damping", [0.005, 0.03, 0.1])
@pytest.mark.parametrize("held", [300, 4000, 30_000])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_overshoot_of_a_step_is_no_outlier(damping, held, side):
    """Second order, 300 Hz at 10 kHz: the tip of its first half wave, after a rest and before a hold."""
    t, w = np.arange(held) * 1e-4, 2.0 * np.pi * 300.0
    turn = np.sqrt(1.0 - damping**2)
    ring = np.exp(-damping * w * t) * (np.cos(turn * w * t) + damping / turn * np.sin(turn * w * t))
    u = np.concatenate([np.zeros(1000), np.full(held, 60.0)])
    y = side * np.concatenate([np.zeros(1000), 40.0 * (1.0 - ring)])
    y = y + 0.005 * np.random.default_rng(1).standard_normal(y.size)
    found = without_outliers(u[None], y[None])
    assert not found.lost_y.any()
    assert not found.lost_u.any()
    y[1030] += 60.0 * side  # a spike beside it is one
    assert np.flatnonzero(without_outliers(u[None], y[None]).lost_y).tolist() == [1030]

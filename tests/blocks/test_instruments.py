import math

import numpy as np
import pytest

from hammerstein.blocks.instruments import Drive, Instruments, Sensor
from hammerstein.errors import InputError


def test_drive_clips_counts_and_rounds():
    held, saturated = Drive(range_v=1.0, resolution_v=0.25).apply(np.array([[-2.0, -0.3, 0.1, 0.2, 1.01]]))
    np.testing.assert_array_equal(held, [[-1.0, -0.25, 0.0, 0.25, 1.0]])
    np.testing.assert_array_equal(saturated, [[True, False, False, False, True]])


def test_ideal_instruments_change_nothing():
    ideal = Instruments.ideal()
    u = np.random.default_rng(0).normal(size=(2, 50)) * 1e6
    held, saturated = ideal.drive.apply(u)
    np.testing.assert_array_equal(held, u)
    assert not saturated.any()
    np.testing.assert_array_equal(ideal.sensor.read(u, np.random.default_rng(0)), u)


def test_noise_has_the_rms_that_was_asked_and_depends_on_the_seed_alone():
    sensor = Sensor(resolution_um=0.0, noise_um=0.04, range_um=math.inf)
    zeros = np.zeros((2, 100_000))
    a = sensor.read(zeros, np.random.default_rng(7))
    assert np.std(a) == pytest.approx(0.04, rel=0.01)
    np.testing.assert_array_equal(a, sensor.read(zeros, np.random.default_rng(7)))
    assert (a != sensor.read(zeros, np.random.default_rng(8))).any()


@pytest.mark.parametrize("outputs", [1, 3])
def test_noise_is_what_numpy_draws_sample_by_sample(outputs):
    """Long enough for numbers of the tail, which come once in 4000, and for a part of a block at the end."""
    sensor = Sensor(resolution_um=0.0, noise_um=1.0, range_um=math.inf)
    ours, theirs = np.random.default_rng(5), np.random.default_rng(5)
    drawn = theirs.standard_normal((200_001, outputs)).T
    np.testing.assert_array_equal(sensor.read(np.zeros((outputs, 200_001)), ours), drawn)
    assert np.abs(drawn).max() > 3.66  # where the tail begins
    assert ours.bit_generator.state == theirs.bit_generator.state


def test_reading_stays_on_the_steps_and_in_the_range():
    reading = Sensor(noise_um=0.0).read(np.array([[0.019, 0.021, 300.0]]), np.random.default_rng(0))
    np.testing.assert_allclose(reading, [[0.0, 0.04, 250.0]])


def test_published_set_up_is_the_default():
    published = Instruments()
    assert published.drive.range_v == (-10.0, 10.0)
    assert published.drive.sample_time_s == 50e-6
    assert (published.sensor.range_um, published.sensor.resolution_um) == (250.0, 0.04)
    assert published.sensor.bandwidth_hz == 2000.0


@pytest.mark.parametrize(
    "wrong", [{"range_v": -1.0}, {"resolution_v": -0.1}, {"sample_time_s": 0.0}, {"rng": 1}]
)
def test_drive_refuses(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Drive(**wrong)

"""What a model leaves is told by the frequency that takes most of it, whatever the lengths of the records."""

import made_up
import numpy as np
import pytest

from hammerstein.identification.identify import identify
from hammerstein.identification.residual_analysis import _strongest, certain_noise
from hammerstein.identification.settings import Settings
from hammerstein.records.faults import faults
from hammerstein.records.record import Record

T = 1e-3


def left(samples: int, amplitude: float, hz: float) -> tuple[Record, np.ndarray]:
    t = T * np.arange(samples)
    return Record([np.sin(t)], [np.cos(t)], T), amplitude * np.sin(2.0 * np.pi * hz * t)


def test_the_line_with_most_energy_is_the_strongest():
    """Energy goes with the square of the amplitude and with the time: 9 * 500 here, 4000 there."""
    records, errors = zip(left(500, 3.0, 40.0), left(4000, 1.0, 25.0), strict=True)
    assert _strongest(records, errors) == 40.0
    records, errors = zip(left(500, 2.0, 40.0), left(4000, 1.0, 25.0), strict=True)
    assert _strongest(records, errors) == 25.0


@pytest.mark.parametrize("samples", [500, 20_000])
def test_no_model_is_known_better_than_the_noise_is(samples):
    """Of white noise alone, rms^2 and the noise squared differ by about 2.6 / sqrt(N) of it."""
    rng, u = np.random.default_rng(4), np.sin(0.01 * np.arange(samples))
    record = Record([u], [u + 0.1 * rng.standard_normal(samples)], T)
    left = np.sqrt(0.1**2 - certain_noise([record], [0.1])[0] ** 2)
    assert left >= 0.1 * np.sqrt(2.6 / np.sqrt(samples)) * (1.0 - 1e-9)
    assert left < 0.1 * np.sqrt(8.0 / np.sqrt(samples))


@pytest.mark.full
def test_ringing_while_a_voltage_is_constant_is_no_clipped_reading():
    """A drive that holds its upper limit for a period of the resonance: the model predicts what swings on."""
    made = made_up.MadeUp(
        np.array([[0.0, 1.0, 4.0]]), np.array([[[1.0, 0.3, 0.2]]]), -10.0, 10.0, 5e3, (90.0,), (0.05,)
    )
    t = np.arange(4000) / made.rate_hz
    tones = made_up.wander(made, np.random.default_rng(3), seconds=1.0, highest_hz=200.0)
    told = []
    for hz, most in ((12.0, 10.0), (3.0, 12.0)):  # the drive holds 10 V, or a recorder of 10 V cuts it
        sent = -10.0 + 22.0 * (1.0 - np.abs((hz * t) % 1.0 * 2.0 - 1.0))
        cut, moved_by = np.minimum(sent, 10.0), np.minimum(sent, most)
        pairs = ((cut[None], made.position_um(moved_by[None])), (tones, made.position_um(tones)))
        records = [Record(u, y, 1.0 / made.rate_hz) for u, y in pairs]
        assert ["is clipped by its recorder" in fault.text for fault in faults(records[0])] == [True]
        _, fit = identify(records, Settings(creep_modes=0, error_curve=False))
        told.append(any("is clipped by its recorder" in flag for flag in fit.flags))
    assert told == [False, True]

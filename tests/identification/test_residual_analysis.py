"""What a model leaves is told by the frequency that takes most of it, whatever the lengths of the records."""

import numpy as np

from hammerstein.identification.residual_analysis import _strongest
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

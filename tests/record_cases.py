"""A record of one loop, as files and as arrays, for the tests of reading and checking."""

import numpy as np
import pytest
import theory

from hammerstein.errors import InputError
from hammerstein.identification.settings import Settings
from hammerstein.records.reading import read_records

N = 400
TIME = 5e-3 * np.arange(N)
U = 10.0 * np.sin(2.0 * np.pi * np.arange(N) / 200)
THRESHOLDS = np.array([0.07, 1.0, 3.0, 6.0])


def plain(**options):
    """Settings of the paper's static block: nothing is searched that is not asked for."""
    simple = {
        "operators": 15,
        "partition": "time",
        "dynamics": "none",
        "creep_modes": 0,
        "error_curve": False,
    }
    return Settings(**(simple | options))


def plays(u, thresholds, start=0.0):
    """Outputs (operator, sample) of play operators."""
    return np.array([theory.play(u, r, start) for r in thresholds])


X = np.array([4.0, 0.5, 0.8, 1.2]) @ plays(U, THRESHOLDS)


def message(call, *args, **kwargs) -> str:
    with pytest.raises(InputError) as caught:
        call(*args, **kwargs)
    return str(caught.value)


def table_text(rows, separator=",", decimal=".", end="\n", tail=""):
    lines = (separator.join(f"{value:.9f}".replace(".", decimal) for value in row) + tail for row in rows)
    return end.join(lines) + end


def read(path, **changes):
    options = {"inputs": ["u_x"], "outputs": ["x"], "rate_hz": 200.0} | changes
    return read_records([path], **options)

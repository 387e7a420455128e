"""What went before a record is judged with the block that is kept, not with the plays that came first."""

import numpy as np
import pytest

from hammerstein.hysteresis import BoucWen, BoucWenPair
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

T, NOISE_UM = 1e-3, 0.03


@pytest.mark.parametrize("seed", range(2))
def test_a_record_from_rest_is_told_as_such_by_the_kind_itself(seed):
    """Plays explain the curve of another kind from rest best as if something had gone before."""
    t = np.arange(1200) * T
    u = 10.0 * np.linspace(1.0, 0.3, t.size)[None] * np.sin(2.0 * np.pi * 5.0 * t)
    truth = BoucWen([[BoucWenPair(6.5, 1.9, 0.22, -0.04)]])
    clean = truth.respond(u)[0]
    noise = NOISE_UM * np.random.default_rng(seed).standard_normal(clean.shape)
    settings = Settings(
        hysteresis="bouc_wen", dynamics="none", error_curve=False, creep_modes=0, delay_samples=0
    )
    model, report = identify([Record(u, clean + noise, T)], settings)
    assert report.starts[0].kind == "rest"
    left = model.hysteresis.respond(u)[0] - clean
    # Four numbers and an offset of white noise: their errors leave sigma sqrt(5 / n) on the record.
    assert np.sqrt(np.mean(left**2)) < 3.0 * NOISE_UM * np.sqrt(5.0 / t.size)

"""Draws of a model differ from it on its records by what it misses there, whatever the kind."""

import numpy as np
import pytest

from hammerstein.blocks.instruments import Instruments
from hammerstein.hysteresis import BoucWen, BoucWenPair, RateDependent, RatePlays
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

T, NOISE_UM = 2e-4, 0.03
R = np.array([0.0, 1.39, 1.5, 2.49, 2.96, 3.65, 4.25, 4.53, 4.62, 4.67])
W = np.array([4.46, 0.58, 0.26, 0.55, 0.58, 0.06, 0.22, 0.30, 0.07, 0.38])
GROWN = RateDependent((RatePlays(R, np.where(R > 0.0, 4.7e-4, 0.0), 300.0),), ((W,),)).on_grid(T)
FALLS = BoucWen([[BoucWenPair(5.2, 2.3, 0.21, -0.08)]])
"""Its slope falls below 0 in some loops, so that no model with an inverse is the same."""


def drive():
    t = np.arange(6000) * T
    slow = 10.0 * np.linspace(1.0, 0.3, t.size) * np.sin(2.0 * np.pi * 5.0 * t)
    fast = 5.0 * np.sin(2.0 * np.pi * (20.0 * t + 0.5 * 400.0 / t[-1] * t**2))
    return np.concatenate([slow, fast])[None]


@pytest.mark.full
@pytest.mark.parametrize("truth", [GROWN, FALLS], ids=["thresholds between those of the model", "no inverse"])
def test_draws_leave_on_a_record_what_the_model_leaves(truth):
    u = drive()
    clean = truth.respond(u)[0]
    noise = NOISE_UM * np.random.default_rng(1).standard_normal(clean.shape)
    settings = Settings(
        hysteresis=truth.kind, dynamics="none", error_curve=False, creep_modes=0, delay_samples=0
    )
    model, _ = identify([Record(u, clean + noise, T)], settings, instruments=Instruments.ideal(T))
    said = model.simulate(u, T).position_um
    missed = np.std(said - clean)
    assert missed > NOISE_UM, "the model is as good as the readings, so that there is nothing to see"
    draws = [model.drawn(np.random.default_rng(i)).simulate(u, T).position_um - said for i in range(60)]
    assert 0.7 * missed < np.sqrt(np.mean(np.var(draws, axis=2))) < 1.6 * missed

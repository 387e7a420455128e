"""Drawn models of a block with an envelope explain the record it was identified from."""

from dataclasses import replace

import numpy as np
import pytest

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import StaticDynamics
from hammerstein.hysteresis import Envelope, Generalised, Pair, PrandtlIshlinskii
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.metrics import rms
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record


@pytest.mark.full
def test_drawn_models_stay_within_the_noise_of_their_record():
    """Thresholds of plays without weight were drawn past their neighbours, by up to 300 um."""
    rng = np.random.default_rng([1001, 28])
    plays = PrandtlIshlinskii([[Pair([0.0, 0.8, 2.0, 4.3, 5.5], [4.0, 0.5, 0.4, 0.3, 0.2])]])
    envelope = Envelope([-10.0, -2.2, 3.4, 10.0], [-9.0, -3.5, 2.8, 8.0])
    instruments = Instruments.ideal(1e-4)
    truth = HammersteinModel(
        "truth",
        Generalised((envelope,), plays),
        StaticDynamics(n_outputs=1),
        10.0,
        ("u",),
        ("y",),
        instruments,
    )
    t = np.arange(12000) * 1e-4
    u = 10.0 * np.linspace(1.0, 0.3, t.size)[None] * np.sin(10.0 * np.pi * t)
    y = truth.simulate(u, 1e-4).position_um
    record = Record(u, y + 0.03 * rng.standard_normal(y.shape), 1e-4)
    settings = Settings(hysteresis="generalised", dynamics="none", error_curve=False, delay_samples=0)
    model, _ = identify([record], settings, instruments=instruments)
    normal = replace(model.covariance, degrees=0)  # Student's t has wider draws now and then
    model = replace(model, covariance=normal)
    own = model.simulate(u, 1e-4).position_um
    off = []
    for number in range(20):
        drawn = model.drawn(np.random.default_rng(number)).simulate(u, 1e-4).position_um
        off.append(rms(drawn - own))
    assert np.median(off) < 0.03
    assert max(off) < 0.1

"""A delay is found where there is one, and none where thresholds and resonance explain the records."""

from dataclasses import replace

import made_up
import numpy as np
import pytest

from hammerstein.identification.identify import identify
from hammerstein.identification.search import best_delay
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record


@pytest.mark.full
def test_no_delay_stands_in_for_thresholds_that_were_not_fitted_yet():
    """Coarse thresholds asked for 0.17 samples; with them 0.0096 % of the range was left, not 0.0058."""
    stage = made_up.stage(1, noise_um=0.005)
    axis = replace(
        stage, thresholds_v=stage.thresholds_v[:1], weights_um_per_v=stage.weights_um_per_v[:1, :1]
    )
    u = made_up.triangles(axis, 0, hz=10.0, cycles=4)
    y = axis.record(u, np.random.default_rng(51))
    model, fit = identify([Record(u, y, 1e-4)], Settings())
    assert model.dynamics.input_delay_s == 0.0
    assert fit.fit["hammerstein"].nrmse_percent[0] < 0.007


def test_a_fit_begins_with_the_better_one_near_it():
    """A parabola with its least at 2.3 samples, which the two whole delays beside it do not show at once."""
    begun = {}

    def attempt(delay, begin):
        error, known = 1.0 + (delay - 2.3) ** 2 + 0.3 * np.cos(9.0 * delay), tuple(begun)
        begun[delay] = error, begin, known
        return [error], delay

    best_delay(attempt, None, parts=True)
    parts = [delay for delay in begun if delay % 1.0]
    assert len(parts) > 1
    for delay in parts:
        _, begin, known = begun[delay]
        near = [other for other in known if abs(other - delay) <= 1.0]
        assert begun[begin][0] == min(begun[other][0] for other in near)

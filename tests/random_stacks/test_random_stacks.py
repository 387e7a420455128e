"""One stack at random: the truth by itself, and the resonance that its model predicts."""

from functools import cache

import numpy as np
import pytest

from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from random_stacks.__main__ import ABOVE_V, BETWEEN_V, records, resonances_hz
from random_stacks.truth import PER_RESONANCE, at_random, width

pytestmark = pytest.mark.full  # the truth is compiled anew in every process; only the campaign uses it


@cache
def one_axis():
    """A seed."""
    return next(seed for seed in range(4, 30) if at_random(seed)[0].axes == 1)


def test_the_made_up_stacks_are_what_was_drawn():
    """Widths as asked; without stops the slow gain is T / K over 1, as V_z = u."""
    stacks, widths = at_random(one_axis())
    assert width(stacks, 0, 2.5) == pytest.approx(widths[0], abs=2e-3)
    stacks.stiffnesses[:] = 0.0
    x = stacks.position_um(np.ones((1, 60_000)))
    assert x[0, -1] == pytest.approx(stacks.numbers[0, 2], rel=1e-6)


def test_the_resonance_is_predicted_at_amplitudes_that_no_record_has():
    """Within 0.2 %, between the levels of the records and 30 % above them."""
    stacks, _ = at_random(one_axis())
    near = stacks.numbers[:, 0] / 2.0 / np.pi
    band = 1.6 / PER_RESONANCE / stacks.time_s
    model, _ = identify_in_loop(records(stacks, band, one_axis()), LoopSettings(order=2, minutes=3.0))

    def simulated(u):
        return model.simulate(u, stacks.time_s).position_um

    for level in (BETWEEN_V, ABOVE_V):
        true, told, at_rest = (
            resonances_hz(respond, 1, own, near, band, stacks.time_s)
            for respond, own in ((stacks.position_um, level), (simulated, level), (stacks.position_um, 0.05))
        )
        assert told == pytest.approx(true, rel=2e-3)
        assert abs(true - at_rest) > 2e-3 * true


@pytest.mark.long
def test_three_axes_sampled_twice_as_fast_are_identified():
    """Every level is among what is fitted and among what is held back, and no mode imitates a level."""
    stacks, _ = at_random(3, 2.0 * PER_RESONANCE)
    band = 0.8 / PER_RESONANCE / stacks.time_s
    _, fit = identify_in_loop(records(stacks, band, 3), LoopSettings(minutes=3.0))
    assert fit.fit["in_loop"].rms_um[0] < 0.15 * fit.fit["linear_dynamics"].rms_um[0]

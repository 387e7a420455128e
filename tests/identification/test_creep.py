"""Slow modes behind a known static block: those of the actuator where the record tells them, else refused."""

import numpy as np
import pytest
import theory
from scipy.signal import lfilter

from hammerstein.errors import IdentificationError
from hammerstein.identification.identify import identify
from hammerstein.identification.linear.creep import fit_creep
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

T = 0.1
STEPS_UM = np.repeat([0.0, 10.0, -5.0, 20.0, 0.0], 600)


def slow(v_um, time_constant_s, sample_time_s=T):
    """First-order lag of a held signal, exact on its grid."""
    pole = np.exp(-sample_time_s / time_constant_s)
    return lfilter([0.0, 1.0 - pole], [1.0, -pole], v_um)


def late(v_um):
    return np.append(0.0, v_um[:-1])


@pytest.mark.parametrize("gain", [0.5, 3.0])
def test_gains_are_in_parts_of_the_fast_motion_whatever_the_offset(gain):
    true = {2.0: 0.04, 40.0: 0.1}
    y = gain * (late(STEPS_UM) + sum(g * slow(STEPS_UM, tau) for tau, g in true.items())) + 7.0
    modes = fit_creep(STEPS_UM, y, T, 2)
    assert [mode.time_constant_s for mode in modes] == pytest.approx(list(true), rel=1e-3)
    assert [mode.gain for mode in modes] == pytest.approx(list(true.values()), rel=1e-3)


def test_a_fast_motion_against_its_block_is_refused():
    with pytest.raises(IdentificationError, match="does not identify 1 creep modes"):
        fit_creep(STEPS_UM, 0.5 * slow(STEPS_UM, 20.0) - late(STEPS_UM), T, 1)


def test_modes_that_all_end_at_one_time_are_refused():
    """A drift in proportion to time has no time constant: both modes go to the longest there may be."""
    v = np.repeat([0.0, 10.0], [5, 2995])
    with pytest.raises(IdentificationError, match="does not identify 2 creep modes"):
        fit_creep(v, late(v) + 0.002 * np.arange(3000), T, 2)


@pytest.mark.parametrize("dynamics", ["lag", "auto"])
def test_creep_is_tried_behind_plays_that_nothing_else_delays(dynamics):
    """Without it no dynamics lower the error."""
    r, w = np.array([0.0, 1.0, 3.0, 6.0]), np.array([3.0, 0.4, 0.5, 0.6])
    generator, records = np.random.default_rng(0), []
    for hz, seconds in ((0.01, 300.0), (0.04, 200.0)):
        t = T * np.arange(round(seconds / T))
        size = 10.0 * np.interp(t, [0.0, 0.6 * seconds, seconds], [1.0, 0.3, 0.8])
        u = np.append(size * np.sin(2.0 * np.pi * hz * t), np.full(1500, 6.0))[None]
        [v] = theory.prandtl_ishlinskii(u, [[r]], [[w]])
        y = v + 0.05 * slow(v, 30.0) + 0.01 * generator.standard_normal(v.size)
        records.append(Record(u, [y], T))
    given = Settings(thresholds_v=r, dynamics=dynamics, delay_samples=0, error_curve=False, start="rest")
    [axis] = identify(records, given)[0].dynamics.axes
    assert axis.lag_s is None
    assert [(mode.gain, mode.time_constant_s) for mode in axis.creep] == [
        (pytest.approx(0.05, rel=0.02), pytest.approx(30.0, rel=0.05))
    ]


def test_a_second_slow_mode_is_tried_once_the_first_is_kept():
    """Creep goes on over decades of time (1 and 30 s here); one mode leaves ten times the noise."""
    true = {1.0: 0.04, 30.0: 0.05}
    generator, records = np.random.default_rng(0), []
    for hz, seconds in ((0.02, 200.0), (0.3, 60.0)):
        t = 0.02 * np.arange(round(seconds / 0.02))
        u = np.append(10.0 * np.sin(2.0 * np.pi * hz * t), np.full(1500, 6.0))[None]
        [v] = theory.prandtl_ishlinskii(u, [[np.array([0.0, 2.0])]], [[np.array([3.0, 0.6])]])
        y = v + sum(gain * slow(v, tau, 0.02) for tau, gain in true.items())
        records.append(Record(u, [y + 0.003 * generator.standard_normal(v.size)], 0.02))
    given = Settings(
        thresholds_v=(0.0, 2.0), dynamics="auto", delay_samples=0, error_curve=False, start="rest"
    )
    [axis] = identify(records, given)[0].dynamics.axes
    found = sorted((mode.time_constant_s, mode.gain) for mode in axis.creep)
    assert found == [
        (pytest.approx(tau, rel=0.1), pytest.approx(gain, rel=0.05)) for tau, gain in true.items()
    ]

"""Loops that turn back while their voltage keeps its direction, told in any unit of the voltage."""

from types import SimpleNamespace

import numpy as np
import pytest

from hammerstein.identification.residual_analysis import butterfly_flags, record_flags, turning_back_flags
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

U = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("slope", [0.5, -1.0])
def test_an_output_that_returns_is_told_whatever_the_unit_and_the_direction(unit, sign, slope):
    """Beyond 6 V the output goes on at another slope; small turns, as of noise, are no turns of a loop."""
    u = U + 0.02 * np.sin(2.0 * np.pi * np.arange(1200) / 3)
    y = sign * (np.minimum(U, 6.0) + slope * np.maximum(U - 6.0, 0.0))
    record = Record([unit * u], [y], 1e-3)
    straight = SimpleNamespace(predict=lambda one, _: sign * one.u_v / unit)
    flags = list(turning_back_flags(straight, [record], [InitialState("rest")], [(0, 0)]))
    assert bool(flags) == (slope < 0.0)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("rise", [-0.51, -0.49, 0.49, 0.51, 1.0])
def test_a_loop_rises_if_its_tips_are_half_its_range_apart(unit, rise):
    """Level about both tips; between them it reaches one end of its range."""
    y = np.interp(U, [-8.9, 0.0, 8.9], [0.0, np.sign(rise), rise])
    record = Record([unit * U], [unit * y], 1e-3, verified=True)  # level, as if it were clipped
    flags = list(butterfly_flags([record], [(0, 0)]))
    assert bool(flags) == (abs(rise) < 0.5)
    assert all("its tips differ by only 49 % of the range" in flag for flag in flags)


@pytest.mark.parametrize(("share", "bend"), [(0.5, 0.0), (0.1, 0.0), (0.1, 0.3)])
def test_noise_makes_no_record_unrepresented_and_no_loop_turn_back(share, bend):
    """The model misses white noise alone, but for a bend that turns back by a quarter of the range."""
    noise = np.random.default_rng(5).standard_normal(U.size)
    beyond = np.maximum(U - 5.0, 0.0)
    record = Record([U], [U - 10.0 * bend * beyond + share * 20.0 * noise], 1e-3)
    own = SimpleNamespace(predict=lambda one, _: one.u_v, residual=lambda one, _: one.y_um - one.u_v)
    start = [InitialState("rest")]
    if not bend:
        assert list(record_flags(own, [record], start)) == []
    assert bool(list(turning_back_flags(own, [record], start, [(0, 0)]))) == (bend > 0.0)

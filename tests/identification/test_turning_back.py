"""Loops that turn back while their voltage keeps its direction, told in any unit of the voltage."""

from types import SimpleNamespace

import numpy as np
import pytest

from hammerstein.identification.residual_analysis import turning_back_flags
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
    flags = turning_back_flags(straight, [record], [InitialState("rest")], [(0, 0)])
    assert bool(flags) == (slope < 0.0)

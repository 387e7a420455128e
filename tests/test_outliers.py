"""Outliers are the same in any unit, and a step that stays is none."""

import numpy as np
import pytest

from hammerstein.records.outliers import without_outliers

U = 10.0 * np.sin(np.linspace(0.0, 40.0, 4000))[None]


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_a_short_jump_away_and_back_is_one_in_any_unit(scale):
    """Five samples 30 um off in a range of 100 um: they stay within the range of the others."""
    y = 5.0 * U
    middle = int(np.argmin(np.abs(U[0, 1000:1300]))) + 1000
    y[0, middle : middle + 5] += 30.0
    found = without_outliers(U, scale * y)
    assert np.flatnonzero(found.lost_y[0]).tolist() == list(range(middle, middle + 5))
    np.testing.assert_allclose(found.y, scale * 5.0 * U, atol=1e-3 * scale)


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_a_jump_that_does_not_come_back_is_none(scale):
    """Two steps of opposite sign, the second a quarter of the first: the signal stays elsewhere."""
    y = 5.0 * U
    y[0, 2000:] += 30.0
    y[0, 2005:] -= 7.5
    assert not without_outliers(U, scale * y).lost_y.any()

"""The damped search against SciPy's, on a problem with a curved valley."""

from itertools import islice

import numpy as np
import pytest
from scipy.optimize import least_squares

from hammerstein.identification.search import Damping, damped_change, steps


def left(x):
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def jacobian(x):
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def step(x, damping):
    j = jacobian(x)
    return x + damped_change(j.T @ j, -j.T @ left(x), damping)


def cost(x):
    return float(left(x) @ left(x))


def test_it_ends_where_scipy_s_ends():
    tried = list(islice(steps(np.array([-1.2, 1.0]), step, cost, Damping()), 100))
    np.testing.assert_allclose(tried[-1].best, least_squares(left, [-1.2, 1.0], jacobian).x, atol=1e-9)


def test_it_never_goes_where_more_is_left_and_is_damped_more_after_that():
    seen = []

    def noted(x, damping):
        seen.append(damping)
        return step(x, damping)

    tried = list(islice(steps(np.array([-1.2, 1.0]), noted, cost, Damping()), 30))
    assert not all(one.gained for one in tried)
    for one, now, then in zip(tried, seen, seen[1:], strict=False):
        assert cost(one.best) <= cost(one.before)
        assert then == (0.1 * now if one.gained else 10.0 * now)


@pytest.mark.parametrize("most", [1.0, 1e6])
def test_it_is_given_up_where_no_damping_helps(most):
    damping = Damping(most=most)
    tried = list(steps(np.array([1.0, 1.0]), lambda x, amount: x, cost, damping))
    assert len(tried) == round(np.log10(most / damping.first)) + 1
    assert not any(one.gained for one in tried)


def test_a_number_that_changes_nothing_stays_where_it_is():
    """Its pull is rounding; divided by a curvature of nothing it went as far as it could."""
    curvature, pull = np.array([[4.0, 1e-170], [1e-170, 0.0]]), np.array([2.0, 1e-17])
    np.testing.assert_allclose(damped_change(curvature, pull, 0.0), [0.5, 0.0], rtol=1e-12)

"""How records begin is decided by parts of an error, and what follows is found with how they begin."""

from types import SimpleNamespace

import numpy as np
import pytest

from hammerstein.dynamics import AxesDynamics, Axis
from hammerstein.identification import initialisation
from hammerstein.identification.linear import axis_fit
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState

NOTHING = AxesDynamics(axes=(Axis(),))
REST, STEPPED = (InitialState("rest"),), (InitialState("repeated"),)


class Models:
    """Quick models that are not looked into."""

    def __init__(self, records, guess, settings):
        self.dynamics = None

    def fitted(self, starts):
        return SimpleNamespace(residual=lambda record, start: None, predict=None, slow_s=(), dynamics=None)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("part", "kept"), [(0.5, STEPPED), (0.9999, REST)])
def test_a_start_in_motion_is_decided_by_a_part_of_the_error_in_any_unit(monkeypatch, unit, part, kept):
    left = {REST: 1.0, STEPPED: part}
    monkeypatch.setattr(initialisation, "_FirstModels", Models)
    monkeypatch.setattr(initialisation, "shortened", lambda records, starts, most: (records, starts))
    monkeypatch.setattr(initialisation, "decays", lambda error: True)
    monkeypatch.setattr(initialisation, "_all_stepped_from", lambda end, records, starts: STEPPED)
    monkeypatch.setattr(initialisation, "judged_starts", lambda *args, **kwargs: STEPPED)
    monkeypatch.setattr(initialisation, "_creeping_guess", lambda q, s, g, o: (unit * left[s], g))
    guess = SimpleNamespace(dynamics=NOTHING)
    told = initialisation.creeping_starts((None,), REST, guess, Settings(), lambda what: None)
    assert told == kept


@pytest.mark.parametrize("second", [REST, STEPPED])
def test_axes_are_guessed_with_the_starts_that_are_kept(monkeypatch, second):
    """Starts are found again behind the first axes; where they differ, so may the axes."""
    guessed_with = []

    def guess_of(records, starts, settings, tell):
        guessed_with.append(starts)
        return SimpleNamespace(dynamics=NOTHING, delay_samples=0, starts=starts)

    def judged(records, predict, settle_s, mode):
        raise StopIteration

    monkeypatch.setattr(initialisation, "_FirstModels", Models)
    monkeypatch.setattr(initialisation, "_first_starts", lambda r, s, guess=None: second if guess else REST)
    monkeypatch.setattr(initialisation, "guess_of", guess_of)
    monkeypatch.setattr(initialisation, "_left_by", lambda records, guess, s, starts: 0.0 if guess else 1.0)
    monkeypatch.setattr(initialisation, "judged_starts", judged)
    with pytest.raises(StopIteration):
        initialisation.first_task((None,), Settings(), lambda what: None)
    assert guessed_with[-1] == second
    assert len(guessed_with) == len({REST, second})  # never twice with the same


def test_a_parameter_at_its_limit_does_not_end_the_search_of_the_others(monkeypatch):
    """A curved valley (Rosenbrock) in two parameters; the third is pushed against its limit."""

    def point(task, x, slopes):
        left = np.array([5.0 * (x[1] - x[0] ** 2), 1.0 - x[0], 1.0 + x[2]])
        slope = np.array([[-10.0 * x[0], 5.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        curvature, pull = slope.T @ slope, -slope.T @ left
        return axis_fit.Point(x, slopes, float(np.sqrt(left @ left)), curvature, pull, np.zeros((1, 3)))

    monkeypatch.setattr(axis_fit, "_point", point)
    monkeypatch.setattr(axis_fit, "fit_slopes", lambda task, path: (np.zeros(1), 0.0))
    task = SimpleNamespace(limits=(np.array([-2.0, -2.0, 0.0]), np.full(3, 2.0)), path=float)
    found = axis_fit.refine(task, np.array([-1.2, 1.0, 0.0]))
    np.testing.assert_allclose(found.x, [1.0, 1.0, 0.0], atol=1e-3)

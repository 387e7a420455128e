"""How far a model is off: against numbers that stand on paper."""

import numpy as np
import pytest

from hammerstein.dynamics import StaticDynamics
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification.model_selection import CurvePoint, Trial, as_good, chosen, enough_operators
from hammerstein.identification.score import Candidate, rest_errors, score
from hammerstein.identification.search import best_delay
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit
from hammerstein.identification.static.threshold_search import gained
from hammerstein.records.record import Record


def test_errors_are_in_parts_of_range_and_of_power():
    """A line of 3 um/V from -2 to 2 V, and readings that lie 0.5 um above and below in turn."""
    u = np.linspace(-2.0, 2.0, 401)
    off = 0.5 * np.resize([1.0, -1.0], 401)
    model = Candidate(PrandtlIshlinskii([[Pair.linear(3.0)]]), StaticDynamics(n_outputs=1))
    y = 3.0 * u + off
    found = score(model, [Record([u], [y + 7.0], 1e-3)], [InitialState("rest")])
    assert found.rms_um == pytest.approx((0.5,), rel=1e-4)
    assert found.nrmse_percent == pytest.approx((100.0 * 0.5 / np.ptp(y),), rel=1e-4)
    assert found.output_percent == pytest.approx((100.0 * 0.5 / np.std(y),), rel=1e-4)
    assert found.mean_percent == found.nrmse_percent[0]


def test_an_error_at_rest_moves_the_whole_path():
    """An actuator that stands at 0 and jumps by 0.5 um as it moves, in 90 % of its record."""
    u = np.concatenate([np.zeros(40), np.sin(2.0 * np.pi * np.arange(360) / 90.0 + 0.1)])
    y = np.stack([3.0 * u + 0.5 * (np.arange(400) >= 40), 3.0 * u]) + 7.0
    gains = PrandtlIshlinskii([[Pair.linear(3.0)], [Pair.linear(3.0)]])
    model = Candidate(gains, StaticDynamics(n_outputs=2))
    record = Record([u], y, 1e-3)
    rest = InitialState("rest")
    np.testing.assert_allclose(rest_errors(model, [record], [rest]), [0.45, 0.0], atol=1e-12)
    begun_later = InitialState("turned", ((0.5,),))
    assert rest_errors(model, [record], [begun_later]) is None
    np.testing.assert_allclose(rest_errors(model, [record, record], [rest, begun_later])[0], 0.45)


def _fit(rms_um, thresholds, samples=1000):
    pair = Pair(np.arange(thresholds) / 10.0, np.ones(thresholds))
    return StaticFit(PrandtlIshlinskii([[pair]]), np.zeros((1, 1)), np.array([rms_um]), samples, (), ())


@pytest.mark.parametrize(
    ("start", "fitted", "gain"),
    [
        # 2 N ln(start / fitted) against the free numbers more, ln N = 6.9 each (Schwarz)
        (_fit(1.0, 1), _fit(0.99, 1), True),  # 20.1 against 6.9
        (_fit(1.0, 1), _fit(0.998, 1), False),  # 4.0 against 6.9
        (_fit(1.0, 4), _fit(0.99, 4), False),  # 20.1 against 27.6
        (_fit(1.0, 4), _fit(1.002, 2), False),  # -4.0 against 0
        (_fit(1.0, 4), _fit(1.0, 1), True),  # 0 against -13.8
        (_fit(0.9, 4), _fit(1.0, 4), False),
    ],
)
def test_fitted_thresholds_must_be_worth_their_number(start, fitted, gain):
    assert gained(start, fitted) == gain


@pytest.mark.parametrize(("less", "delay"), [(0.005, 0.0), (0.02, 1.0), (0.05, 1.0)])
def test_a_longer_delay_must_take_a_percent_away(less, delay):
    assert best_delay(lambda late, _: ([1.0 - less if late == 1.0 else 1.0], None), None)[0] == delay


def test_operators_are_enough_within_two_percent_of_the_least():
    curve = [CurvePoint(n, (error,)) for n, error in ((4, 0.9), (8, 0.83), (10, 0.815), (15, 0.8))]
    assert enough_operators(curve) == 10


@pytest.mark.parametrize(
    ("worse", "unsure", "good"),
    [(1.01, 0.0, True), (1.04, 0.0, False), (1.04, 2.0, True), (1.2, 2.0, False)],
)
def test_as_good_is_what_the_choice_takes_for_as_good(worse, unsure, good):
    """Rms error within 2 % of the least, or 5 % and one standard error; 33 % more passed as "as good"."""
    best = np.array([2.0, 2.4, 1.6, 2.0])
    more = worse**2 * best + unsure * np.array([1.0, -1.0, 1.0, -1.0])
    trials = [Trial("smaller", 5, more), Trial("least", 9, best)]
    assert as_good(trials) == ([0, 1] if good else [1])
    assert chosen(trials) == (0 if good else 1)

"""A beginning of a record that no start explains is left out, one that a start explains is kept."""

import numpy as np
import pytest

from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification import initialisation
from hammerstein.identification.excitation import counted, voltages_of
from hammerstein.identification.score import Candidate
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import (
    closed,
    each_alone,
    found_starts,
    judged_starts,
    shortened,
    whole_error,
)
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

U = 10.0 * np.sin(2.0 * np.pi * np.arange(2050) / 100)


def straight(record: Record, start: InitialState) -> np.ndarray:
    return 5.0 * record.u_v


def test_a_beginning_that_nothing_explains_is_left_out():
    bump = np.where(np.arange(U.size) < 30, 8.0, 0.0)
    (start,) = judged_starts([Record([U], [5.0 * U + bump], 1e-3)], straight, settle_s=0.0)
    assert start.kind == "repeated"
    assert 30 < start.first < 0.2 * U.size


def test_a_beginning_that_is_explained_is_kept():
    (start,) = judged_starts([Record([U], [5.0 * U], 1e-3)], straight, settle_s=0.0)
    assert start.first == 0


def test_of_models_that_explain_a_beginning_the_better_one_says_how_it_was():
    n = np.arange(U.size)
    bump, wobble = np.where(n < 60, 2.0, 0.0), np.where(n > 500, np.cos(n), 0.0)

    def better(record: Record, start: InitialState) -> np.ndarray:
        came_from_above = start.turn_v == ((0.0, U.max()),)
        return straight(record, start) + came_from_above * 0.5 * bump - (start.kind == "rest") * bump

    def simpler(record: Record, start: InitialState) -> np.ndarray:
        return straight(record, start) + (start.kind == "rest") * bump + wobble

    (start,) = judged_starts([Record([U], [5.0 * U + bump], 1e-3)], better, 0.0, simpler=[simpler])
    assert (start.first, start.turn_v) == (0, ((0.0, U.max()),))


def test_of_two_records_one_alone_may_have_begun_otherwise():
    bump = np.where(np.arange(U.size) < 500, 8.0, 0.0)

    def predict(record: Record, start: InitialState) -> np.ndarray:
        came_from_below = start.turn_v == ((0.0, U.min()),)
        return straight(record, start) + came_from_below * bump

    records = [Record([U], [5.0 * U], 1e-3), Record([U], [5.0 * U + bump], 1e-3)]
    begun = (InitialState("rest"), InitialState("rest"))
    first, second = each_alone(records, begun, lambda starts: predict, [0, 1])
    assert first == InitialState("rest")
    assert second.turn_v == ((0.0, U.min()),)
    assert each_alone(records, begun, lambda starts: predict, [0]) == begun
    assert each_alone(records, begun, lambda starts: predict, []) == begun


def test_beginnings_hold_the_whole_swing_of_every_input():
    slow, still = 10.0 * np.sin(2.0 * np.pi * np.arange(40_000) / 20_000), np.zeros(40_000)
    driven = ((slow, still), (still, slow), (0.3 * slow, slow / 9))
    records = [Record(both, both, 1e-4) for both in driven]
    few, _ = shortened(records, (InitialState("rest"),) * 3, 6000)
    lengths = [record.samples for record in few]
    lowest = 15_000  # after three quarters of the sine
    assert lengths == pytest.approx([lowest, lowest, 2000], rel=0.02)
    assert [np.ptp(few[k].u_v[k]) for k in range(2)] == pytest.approx([20.0, 20.0], rel=2e-3)


def test_a_beginning_is_not_over_before_anything_in_it_counts():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(40_000) / 1000)
    part, start = (
        found[0] for found in shortened([Record([u], [u], 1e-4)], [InitialState("rest", 30_000)], 2000)
    )
    assert start.first <= part.samples // 2


@pytest.mark.parametrize(("part", "rests"), [(0.0, True), (0.008, True), (0.013, False), (0.4, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_voltage_begins_at_rest_within_a_hundredth_of_an_end_of_its_range(part, rests, sign):
    """A record that begins in motion has its working point in the middle; so has one that is turned over."""
    u = 80.0 * np.concatenate([np.linspace(part, 1.0, 50), np.linspace(1.0, 0.0, 50)])[None] * sign
    record = Record(u, 0.1 * u, 1e-3)
    model = Candidate(PrandtlIshlinskii([[Pair([0.0], [0.1])]]), StaticDynamics(n_outputs=1))
    found = voltages_of([record], [counted(record)], [InitialState("repeated", 50)], model)
    assert found.working_point_v == pytest.approx([u[0, 0] if rests else 40.0 * sign])
    assert found.fastest_v_per_s == pytest.approx([80.0 / 49 / 1e-3])  # from 0 to 80 V in 49 samples


@pytest.mark.parametrize(("gap", "is_closed"), [(0.015, True), (0.025, False)])
def test_a_loop_is_closed_within_two_percent_of_its_height(gap, is_closed):
    u = 10.0 * np.cos(2.0 * np.pi * np.arange(401) / 400)
    drift = 100.0 * gap * np.linspace(0.0, 1.0, u.size)
    assert closed(Record([u], [5.0 * u + drift], 1e-3)) == is_closed


def test_what_a_record_adds_to_a_first_model_is_gathered_once_for_each_start(monkeypatch):
    gathered = []

    def counted(records, grids, starts, *more):
        gathered.append((records[0].y_um[0, 1], starts[0]))
        return static_moments(records, grids, starts, *more)

    static_moments = initialisation.static_moments
    monkeypatch.setattr(initialisation, "static_moments", counted)
    records = tuple(Record([U], [gain * U], 1e-3) for gain in (5.0, 5.0 + 1e-9))
    rest, again = InitialState("rest"), InitialState("repeated", 100)
    models = initialisation._FirstModels(records, None, Settings(dynamics="none"))
    for starts in ((rest, rest), (rest, again), (again, again), (again, rest)):
        predicted = models.fitted(starts).predict(records[0], rest)
        assert np.abs(predicted - 5.0 * U).max() < 1e-6
    assert len(gathered) == len(set(gathered)) == 4


@pytest.mark.parametrize("rest_serves", [True, False])
def test_a_beginning_without_a_model_is_none(rest_serves):
    """Inputs that only a supposed beginning leaves alike are told apart by the others."""
    t = np.linspace(0.0, 1.0, 200)
    u = np.sin(2.0 * np.pi * 2.0 * t)[None]
    records = [Record(u, 0.5 * u, 5e-3)] * 2

    def fit(starts):
        if not (rest_serves and all(start.kind == "rest" for start in starts)):
            raise IdentificationError("the records cannot separate inputs")
        return lambda record, start: 0.5 * record.u_v

    if rest_serves:
        assert [start.kind for start in found_starts(records, fit, 0.0)] == ["rest", "rest"]
    else:
        with pytest.raises(IdentificationError, match="cannot separate"):
            found_starts(records, fit, 0.0)


@pytest.mark.parametrize("mode", ["auto", "rest", "repeated"])
def test_a_model_has_its_own_start_unless_that_is_known(mode):
    """A model for which the record began at rest, and another one's start after a step from above."""
    bump = np.where(np.arange(U.size) < 500, 8.0, 0.0)
    record, given = Record([U], [5.0 * U], 1e-3), InitialState("stepped", turn_v=((0.0, U.max()),))

    def predict(one: Record, start: InitialState) -> np.ndarray:
        return straight(one, start) + (start.kind != "rest") * bump

    one = Candidate(None, None)
    object.__setattr__(one, "predict", predict)
    (found,) = one.own_starts([record], [given], mode)
    assert (found.kind == "rest") == (mode == "auto")
    assert mode == "auto" or found is given


def test_an_output_that_stands_still_does_not_count():
    """Exchanged inputs and outputs, with a voltage at rest among the outputs, once ended in an error."""
    u = 50.0 * np.sin(2.0 * np.pi * np.arange(800) / 200)
    record = Record([0.75 * u], np.vstack([u, np.zeros(u.size)]), 1e-3)
    error = whole_error([record], [InitialState("rest")], lambda record, start: 0.9 * record.y_um + 0.1)
    assert error == pytest.approx(0.5 * np.var(0.1 * u) / 100.0**2)

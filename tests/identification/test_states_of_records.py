"""Records that begin alike must begin alike for the model, too."""

from dataclasses import replace

import numpy as np
import pytest

from hammerstein.identification.residual_analysis import state_flags
from hammerstein.identification.static.initial_state import split_state
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

REST = InitialState("rest")
U = np.concatenate([np.zeros(20), 50.0 * (1.0 - np.cos(np.linspace(0.0, 12.0, 400)))])


def record(name, at_um=0.0, at_v=0.0, rests=True, part=1.0):
    u = part * (U if rests else U[20:]) + at_v
    return Record([u], [0.5 * (u - at_v) + at_um], 1e-3, source=f"{name}.csv")


@pytest.mark.parametrize(
    ("second", "apart_um", "flagged"),
    [
        (record("b"), 6.0, True),
        (record("b"), 4.0, False),  # five times the error of the model
        (record("b", at_um=3.0), 6.0, False),  # the sensor stands elsewhere: another state, or another zero
        (record("b", at_v=10.0), 6.0, False),
        (record("b", rests=False), 6.0, False),
        (
            record("b", at_v=0.5, part=0.1),
            6.0,
            True,
        ),  # half a percent of the largest swing is no other voltage
    ],
)
def test_one_state_that_is_two_for_the_model_is_a_flag(second, apart_um, flagged):
    told = list(state_flags([record("a"), second], np.array([[1.0], [1.0 + apart_um]]), np.array([1.0])))
    assert len(told) == flagged
    if flagged:
        assert told[0].startswith("a.csv and b.csv begin at rest at the same voltages and positions")
        assert "initial states that differ by 6 um of y1" in told[0]
        assert "--start rest" in told[0]
        given = [record("a"), second], np.array([[1.0], [1.0 + apart_um]]), np.array([1.0])
        assert "--start" not in next(state_flags(*given, chosen=False))  # it was given


@pytest.mark.parametrize(("drives", "flagged"), [((0, 0), True), ((0, 1), False)])
def test_an_input_that_rests_throughout_a_record_does_not_show_its_state(drives, flagged):
    """Axes that are conditioned and then driven one at a time: plays of the other one stand anywhere."""
    rows = [np.array([U, 0.0 * U])[:: 1 - 2 * k] for k in drives]
    two = [Record(u, 0.5 * u, 1e-3, source=f"{i}.csv") for i, u in enumerate(rows)]
    offsets_um = np.array([[-7.2, -0.1], [-0.1, -5.7]])
    assert bool(list(state_flags(two, offsets_um, np.array([0.01, 0.01])))) == flagged


TURNED = InitialState("turned", 0, ((50.0, 0.0),))


@pytest.mark.parametrize(
    ("second", "starts", "split"),
    [
        (record("b"), (REST, TURNED), True),
        (record("b"), (REST, REST), False),
        (record("b"), (TURNED, TURNED), False),
        (record("b", at_um=5.0), (REST, TURNED), False),  # another position may be another state
        (record("b", at_v=10.0), (REST, TURNED), False),
    ],
)
def test_records_that_begin_at_one_place_have_one_state(second, starts, split):
    assert split_state([record("a"), second], starts) == split


def test_noise_of_the_first_reading_is_no_other_place():
    generator = np.random.default_rng(3)
    noisy = [replace(one, y_um=one.y_um + generator.normal(0.0, 1.0, one.y_um.shape))
             for one in (record("a"), record("b"))]  # fmt: skip
    assert split_state(noisy, (REST, TURNED))

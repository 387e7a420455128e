"""The paper's identification: partition in time (eq. 12) and closed form (eq. 14-17)."""

from __future__ import annotations

import numpy as np
import pytest
import theory

from hammerstein.errors import IdentificationError
from hammerstein.identification.static.closed_form import (
    closed_form,
    closed_form_model,
    mean_cycle,
    nodes_uniform_in_time,
    rising_branch,
    thresholds_uniform_in_time,
    thresholds_uniform_in_voltage,
)
from hammerstein.records.record import Record

PERIOD = 400  # 50 Hz, samples of 50 us


def settled(r, w, amplitude=10.0, period=PERIOD, first=0):
    """Input and outputs of one settled cycle, from the closed form of both branches (theory)."""
    phase = 2.0 * np.pi * (np.arange(period) + first) / period
    u = amplitude * np.sin(phase)
    rising = np.cos(phase) >= 0.0
    half = np.array([theory.loop_amplitude(r, wo, amplitude) for wo in w])
    up = np.array([theory.rising_branch(r, wo, amplitude, u) for wo in w])
    down = np.array([theory.rising_branch(r, wo, amplitude, -u) for wo in w])
    return u, np.where(rising, up - half[:, None], half[:, None] - down)


def test_partition_gives_the_published_thresholds():
    thresholds, nodes = thresholds_uniform_in_time(10.0, 15, PERIOD / 2)
    assert np.abs(thresholds - theory.R_V).max() < 0.05  # printed with two digits, most within 0.01
    assert nodes.tolist() == [12 * j - 1 for j in range(1, 17)]


@pytest.mark.parametrize("operators", [1, 7, 49])
def test_nodes_are_evenly_spaced_and_fit_into_half_a_cycle(operators):
    nodes = nodes_uniform_in_time(operators, 50.0)
    assert len(nodes) == operators + 1
    assert set(np.diff(nodes)) <= {nodes[0] + 1}
    assert nodes[-1] < 50


def test_too_many_operators_for_the_samples_are_refused():
    with pytest.raises(IdentificationError, match=r"50 samples, too few for 50 operators; use at most 49"):
        thresholds_uniform_in_time(10.0, 50, 50.0)
    with pytest.raises(IdentificationError, match="at least one"):
        thresholds_uniform_in_voltage(10.0, 0)


def test_voltage_partition_starts_at_zero_and_stays_below_the_amplitude():
    assert thresholds_uniform_in_voltage(9.0, 3).tolist() == [0.0, 3.0, 6.0]


@pytest.mark.parametrize("first", [0, 1, 123, 399])
def test_published_weights_come_back_from_the_settled_loop(first):
    w = theory.W_UM_PER_V[:, 0]
    u, y = settled(theory.R_V, w, first=first)
    pairs = closed_form(u, y - 3.0, thresholds_v=[theory.R_V] * len(y))
    assert np.abs([pair.weights_um_per_v for pair in pairs] - w).max() < 1e-9


def test_partition_and_weights_come_back_from_their_own_loop():
    r, _ = thresholds_uniform_in_time(10.0, 15, PERIOD / 2)
    w = theory.W_UM_PER_V[:, 1]
    pairs = closed_form(*settled(r, w, first=77), 15)
    assert np.abs([pair.thresholds_v - r for pair in pairs]).max() < 1e-12
    assert np.abs([pair.weights_um_per_v for pair in pairs] - w).max() < 1e-9


def test_each_output_may_have_its_own_thresholds():
    u, y = settled(theory.R_V, theory.W_UM_PER_V[:, 0])
    grids = [theory.R_V, theory.R_V[::5]]
    assert [len(pair.thresholds_v) for pair in closed_form(u, y, thresholds_v=grids)] == [15, 3]


def test_fewer_operators_interpolate_the_rising_branch():
    u, y = settled(theory.R_V, theory.W_UM_PER_V[:1, 0])
    pair = closed_form(u, y, 8)[0]
    rise, branch = rising_branch(u, y)
    nodes = nodes_uniform_in_time(8, PERIOD / 2)
    model = theory.rising_branch(pair.thresholds_v, pair.weights_um_per_v, 0.0, rise)
    # The first operator passes through nothing but the origin: from the second node on the model is exact.
    assert np.abs((model - branch[0])[nodes[1:]]).max() < 1e-9


def test_unreachable_thresholds_and_still_inputs_are_refused():
    u, y = settled(theory.R_V, theory.W_UM_PER_V[:, 0])
    with pytest.raises(IdentificationError, match="threshold 11 V"):
        closed_form(u, y, thresholds_v=[[1.0, 11.0]] * len(y))
    with pytest.raises(IdentificationError, match=r"threshold 0.3 V"):
        closed_form(u, y, thresholds_v=[[0.1, 0.3, 0.30001]] * len(y))
    with pytest.raises(IdentificationError, match="does not move"):
        closed_form(np.zeros(100), np.zeros((1, 100)))
    with pytest.raises(IdentificationError, match="not symmetric"):
        closed_form(np.r_[np.linspace(0, 1, 5), np.linspace(1, 0, 95)], np.zeros((1, 100)), 15)
    with pytest.raises(IdentificationError, match="shapes"):
        closed_form(np.zeros(100), np.zeros((1, 99)))


@pytest.mark.parametrize("step", [0.0, -1e-3])
@pytest.mark.parametrize("at", range(7))
def test_a_branch_that_stands_or_falls_between_two_nodes_is_refused(at, step):
    """By a sentence that says so, at the tip as in the middle."""
    nodes = nodes_uniform_in_time(7, 50.0)
    u = np.concatenate([np.linspace(-1.0, 1.0, 50), np.linspace(1.0, -1.0, 50)])
    u[nodes[at] : nodes[at + 1] + 1] = u[nodes[at + 1]] + step * np.linspace(0.0, 1.0, nodes[0] + 2)
    u[nodes[at + 1] + 1 : 50] += 1e-6  # the highest sample is the last one
    with pytest.raises(IdentificationError, match="does not rise steadily"):
        closed_form(u, u[None], 7)


def driven_alone(k, cycles=4):
    """Record from rest in which input k alone is driven, by the textbook model."""
    u = np.zeros((2, cycles * PERIOD))
    u[k] = 10.0 * np.sin(2.0 * np.pi * np.arange(cycles * PERIOD) / PERIOD)
    grids = [[theory.R_V] * 2] * 2
    return Record(u, theory.prandtl_ishlinskii(u, grids, theory.W_UM_PER_V) + 7.0, 5e-5)


def test_paper_procedure_on_records_of_each_input():
    records = [driven_alone(0), driven_alone(1)]
    model = closed_form_model(records, 15, [[theory.R_V] * 2] * 2)
    found = np.array([[pair.weights_um_per_v for pair in row] for row in model.pairs])
    assert np.abs(found - theory.W_UM_PER_V).max() < 1e-9


def test_paper_procedure_needs_each_input_alone():
    with pytest.raises(IdentificationError, match="only input u2 is driven"):
        closed_form_model([driven_alone(0)], 15)


def test_mean_cycle_leaves_the_start_from_rest_out():
    record = driven_alone(0)
    u, y = mean_cycle(record, 0)
    tip = theory.loop_amplitude(theory.R_V, theory.W_UM_PER_V[0, 0], 10.0)
    assert len(u) == PERIOD
    assert y[0].max() == pytest.approx(7.0 + tip, abs=1e-9)
    assert y[0].min() == pytest.approx(7.0 - tip, abs=1e-9)


def test_where_no_operator_fits_a_half_cycle_none_are_proposed():
    """Half a cycle of one sample has room for none; one of two for one at most."""
    with pytest.raises(IdentificationError, match="use a lower frequency"):
        nodes_uniform_in_time(3, 1.5)
    with pytest.raises(IdentificationError, match="use at most 1 operators, a lower frequency"):
        nodes_uniform_in_time(3, 2.5)

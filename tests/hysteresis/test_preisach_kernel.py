"""Compiled loop of the Preisach model beside a plain sum of relays, and plays."""

from itertools import pairwise

import numpy as np
import pytest
import theory
from hypothesis import given, settings, strategies as st

from hammerstein.hysteresis.preisach_kernels import respond_preisach

LOW, HIGH = -4.0, 4.0
R, W = [0.0, 0.8, 1.6, 2.4], [0.5, 0.1, 0.15, 0.1]


def memory(turns=200):
    """One input at the low end of its plane."""
    return [np.ones(1, np.int64), np.full((1, turns), LOW), np.zeros((1, turns, 1)), np.array([LOW])]


def respond(weights, u, held=None):
    n = len(weights)
    size = (HIGH - LOW) / n
    node = np.zeros((1, n + 1, n + 1, 1))
    for i in range(n + 1):
        for j in range(i):
            node[0, i, j, 0] = size * np.tril(weights)[j:i, j:i].sum()
    beyond = np.array([[[weights[:, 0].sum()], [weights[-1].sum()]]])
    one = (np.array([value]) for value in (0.0, LOW, HIGH, size, n))
    u, y = np.asarray(u, dtype=float)[None], np.empty((1, len(u)))
    respond_preisach(u, *one, node, beyond, *(held or memory()), 0, u.shape[1], y)
    return y[0]


def plane(seed, n=8):
    return np.tril(np.random.default_rng(seed).uniform(0.0, 1.0, (n, n)))


def walk(seed, n=400):
    return HIGH * np.sin(np.cumsum(np.random.default_rng(seed).normal(0.0, 0.5, n)))


def chord(u, y):
    return np.abs(np.diff(y)) / np.abs(np.diff(u))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_between_levels_one_relay_a_cell_is_all_there_is(seed):
    weights = plane(seed)
    u = np.random.default_rng(seed).choice(LOW + np.arange(9.0), 200)
    np.testing.assert_allclose(respond(weights, u), theory.relay_sum(u, LOW, HIGH, weights), atol=1e-12)


def test_in_the_cells_the_relays_come_to_it_as_they_grow_in_number():
    weights, u = plane(1), walk(1)
    found = respond(weights, u)
    left = [np.abs(theory.relay_sum(u, LOW, HIGH, weights, sub) - found).max() for sub in (4, 8, 16, 32)]
    assert all(fine < 0.7 * coarse for coarse, fine in pairwise(left))
    assert left[-1] < 0.005 * np.ptp(found)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 399))
def test_parts_give_the_same_bits(seed, cut):
    weights, u, held = plane(seed), walk(seed), memory()
    parts = [respond(weights, u[:cut], held), respond(weights, u[cut:], held)]
    np.testing.assert_array_equal(np.concatenate(parts), respond(weights, u))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_a_way_that_comes_back_leaves_no_trace(seed):
    inner, turns = np.random.default_rng(seed).uniform(-1.0, 2.0, 9), [HIGH, -2.0, 2.5]
    there = respond(plane(seed), [*turns, *inner, 2.5, -3.0])
    plain = respond(plane(seed), [*turns, -3.0])
    assert there[-2:].tolist() == plain[-2:].tolist()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_loops_between_the_same_voltages_are_congruent(seed, one, other):
    """Whatever went before, a loop between two voltages has one shape."""
    weights, loop = plane(seed), np.concatenate([np.linspace(-1.2, 1.3, 40), np.linspace(1.3, -1.2, 40)])
    shapes = []
    for before in ([HIGH, 2.0 * one - 2.1], [1.5 + one, -1.5 - abs(other), 1.4]):
        y = respond(weights, [*before, *loop, *loop])[-80:]
        shapes.append(y - y[0])
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-12)


def test_plays_are_there_at_the_levels_and_come_nearer_between_them():
    path = np.concatenate([[LOW, HIGH, LOW], walk(2)])
    left = []
    for n in (10, 20, 40):
        size, weights = (HIGH - LOW) / n, np.zeros((n, n))
        for r, w in zip(R, W, strict=True):
            weights += w * np.eye(n, k=-round(2.0 * r / size))
        for u in (LOW + size * np.round((path - LOW) / size), path):
            plays = sum(w * theory.play(u, r, LOW + r) for r, w in zip(R, W, strict=True))
            error = (respond(weights, u) - plays)[2:]
            left.append(np.abs(error - error[0]).max())
    assert max(left[::2]) < 1e-13
    assert left[3] < 0.6 * left[1]
    assert left[5] < 0.5 * left[3]


def test_the_output_is_continuous():
    """No chord is steeper than all cells of a row or column together."""
    weights, u = (
        plane(3),
        np.concatenate([np.linspace(LOW, HIGH, 20_001), np.linspace(HIGH, -1.0, 20_001)[1:]]),
    )
    steepest = max(weights.sum(axis=0).max(), weights.sum(axis=1).max())
    assert chord(u, respond(weights, u)).max() <= steepest * (1.0 + 1e-6)


@pytest.mark.parametrize("turns", [100, 200])
def test_of_more_turns_than_it_holds_the_smallest_corners_go(turns):
    """A ring-down of 2000 cycles, then a way through all that it left."""
    ring = HIGH * np.linspace(1.0, 0.0, 4000) * np.where(np.arange(4000) % 2, -1.0, 1.0)
    u, weights = np.concatenate([ring, np.linspace(0.0, HIGH, 400)]), np.tril(np.ones((8, 8)))
    whole = respond(weights, u, memory(5000))
    assert np.abs(respond(weights, u, memory(turns)) - whole).max() < 1e-3 * np.ptp(whole)

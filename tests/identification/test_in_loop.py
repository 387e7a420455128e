"""Plays inside the loop, found from periods: derivatives, search, files and the benchmark's metric."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hammerstein import HammersteinModel
from hammerstein.dynamics import on_grid
from hammerstein.identification.in_loop import search
from hammerstein.identification.in_loop.parameters import (
    LoopParameters,
    SettledPeriod,
    with_band,
    with_ends,
    with_plays,
    with_products,
)
from hammerstein.identification.in_loop.search import Search
from reports.measured.one_model.make import benchmark_rms

WARM, SAMPLES = 300, 512
PAGE = Path(__file__).parents[2] / "reports" / "measured" / "one_model"


def made_up(seed=3, curved=False, moves=1):
    """Two modes, two axes, three plays in each of two loops; products of their inputs where it is curved."""
    rng = np.random.default_rng(seed)
    angles, n = np.array([0.5, 1.3]), 4
    a = np.array([0.95 * np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]) for t in angles])
    shapes = {"B": (n, 2), "C": (2, n), "D": (2, 2), "E": (n, 2), "F": (2, n), "G": (2, 2)}
    if moves == 2:
        shapes |= {"E": (n, 4), "F": (4, n), "G": (4, 2)}
    shapes["H"] = 2 * (moves - 1), 2
    sizes = {"B": 0.3, "C": 1.0, "D": 0.1, "E": 0.1, "F": 1.0, "G": 0.3, "H": 0.3}
    numbers = {name: sizes[name] * rng.normal(size=shape) for name, shape in shapes.items()}
    c, r = 0.1 * rng.uniform(0.5, 1.5, size=(2, 3)), np.array([[0.1, 0.4, 1.0], [0.15, 0.5, 0.9]])
    beta = np.array([[0.9, 0.7, 0.3], [0.9, 0.6, 0.4]])
    factors = np.array([[0, 0, 2], [0, 1, 1], [1, 1, 1]] if curved else np.zeros((0, 3)), dtype=np.int64)
    k, limit = 0.05 * rng.uniform(-1.0, 1.0, size=(2, len(factors))), np.array([2.0, 3.0])
    return LoopParameters(A=a, **numbers, c=c, r=r, beta=beta, K=k, limit=limit, factors=factors)


def multisine(seed, amplitude=1.0):
    """One period (2, SAMPLES) of random phases."""
    rng = np.random.default_rng(seed)
    lines = np.zeros((2, SAMPLES // 2 + 1), dtype=complex)
    lines[:, 1:200] = np.exp(2j * np.pi * rng.uniform(size=(2, 199)))
    u = np.fft.irfft(lines)
    return amplitude * u / u.std()


def periods(truth, amplitudes=(0.4, 1.0, 2.0)):
    inputs = [multisine(k, amplitude) for k, amplitude in enumerate(amplitudes)]
    return [SettledPeriod(u, truth.simulate(u, WARM), 1.0, WARM) for u in inputs]


@pytest.mark.parametrize("moves", [1, 2])
def test_derivatives_are_those_of_differences(moves):
    """Of every kind of number; a play that changes sides between the two ends is the only difference."""
    here, u = made_up(curved=True, moves=moves), multisine(1)
    period = SettledPeriod(u, np.zeros((2, SAMPLES)), 1.0, WARM)
    _, gradient = Search()._of_period(here, period)
    vector = here.vector()
    for i in range(len(vector)):
        step = 1e-7 * max(abs(vector[i]), 0.1)
        ends = [vector.copy(), vector.copy()]
        ends[0][i], ends[1][i] = vector[i] - step, vector[i] + step
        low, high = (0.5 * (period.left(here.at(v).simulate(u, WARM)) ** 2).sum() for v in ends)
        assert gradient[i] == pytest.approx(-(high - low) / (2 * step), rel=3e-3, abs=3e-3)


@pytest.mark.parametrize("moves", [1, 2])
def test_interpreted_the_derivatives_are_the_same(moves, monkeypatch):
    """Compiled, a place beyond the end of an array would be read and written all the same."""
    here = made_up(curved=True, moves=moves)
    period = SettledPeriod(multisine(1)[:, :12], multisine(2)[:, :12], 1.0, 3)
    compiled = Search()._of_period(here, period)
    monkeypatch.setattr(search, "differentiate", search.differentiate.py_func)
    for one, other in zip(compiled, Search()._of_period(here, period), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * np.abs(other).max())


def test_an_offset_of_the_readings_is_no_error():
    """What was before a record holds wide plays where they are: its positions may stand off by a constant."""
    truth = made_up()
    (period,) = periods(truth, (1.0,))
    moved = period._replace(y=period.y + np.array([[3.0], [-40.0]]))
    np.testing.assert_allclose(moved.left(truth.simulate(period.u, WARM)), 0.0, atol=1e-12)
    assert np.abs(moved.left(0.9 * period.y)).max() > 0.0


def test_a_period_is_entered_from_as_many_as_it_takes():
    u = multisine(3)
    sent = SettledPeriod(u, np.zeros((2, SAMPLES)), 1.0, 2 * SAMPLES + 5).sent
    np.testing.assert_array_equal(sent, np.tile(u, 4)[:, SAMPLES - 5 :])


@pytest.mark.parametrize("moves", [1, 2])
def test_poles_beyond_the_bound_have_their_derivatives(moves):
    here, margin = made_up(curved=True, moves=moves), 0.2
    beyond, moved = here.fastest(margin)
    assert len(beyond) > 0
    vector = here.vector()
    for i in range(len(vector)):
        ends = [vector.copy(), vector.copy()]
        ends[0][i] -= 1e-6
        ends[1][i] += 1e-6
        low, high = (here.at(v).fastest(margin)[0] for v in ends)
        np.testing.assert_allclose(moved[:, i], (high - low) / 2e-6, rtol=1e-4, atol=1e-6)


def test_poles_of_small_amplitudes_count_too():
    """Two plays, 0.1 (p - 0.9 z) each, are taken off a pole of 0.9.

    At rest none moves, and the pole is 0.9 + 0.18 = 1.08; with one of them it is 0.98, with both 0.88. Such a
    model hums by itself, although all large oscillations die away.
    """
    one, two, x = np.ones((1, 1)), np.ones((1, 2)), np.eye(2)[:1]
    humming = LoopParameters(
        A=np.diag([0.9, 0.0])[None], B=x.T, C=x, D=0.0 * one, E=x.T, F=x, G=0.0 * one,
        H=np.zeros((0, 1)), c=-0.1 * two, K=np.zeros((1, 0)), r=np.array([[1.0, 1.5]]), beta=0.9 * two,
        limit=np.ones(1), factors=np.zeros((0, 3), dtype=np.int64),
    )  # fmt: skip
    u = np.zeros((1, 4000))
    u[0, 0] = 0.1
    assert np.abs(humming.simulate(u, 0)[0, -100:]).max() > 0.1
    assert humming.fastest(0.0)[0] == pytest.approx([0.08], rel=1e-12)


def test_poles_where_one_path_moves_alone_count_too():
    """Two paths of one play, c (p - beta z) each, on a pole of 0.9 in one coordinate.

    At rest the pole is 0.9 - 0.05 = 0.85, with both 0.85 + 0.2 - 0.1 = 0.95, with the first alone 1.05.
    """
    x, two = np.eye(2)[:1], np.ones((2, 1))
    humming = LoopParameters(
        A=np.diag([0.9, 0.0])[None], B=x.T, C=x, D=np.zeros((1, 1)), E=x.T * np.ones((1, 2)),
        F=two * x, G=0.0 * two, H=np.zeros((0, 2)), c=np.array([[0.2], [-0.1]]), K=np.zeros((2, 0)), r=two,
        beta=np.array([[0.25], [0.0]]), limit=np.ones(2), factors=np.zeros((0, 3), dtype=np.int64),
    )  # fmt: skip
    assert humming.fastest(0.0)[0] == pytest.approx([0.05], rel=1e-12)


def test_larger_structures_begin_where_the_smaller_ended():
    """More plays, more paths, products and one move more change nothing before a search, as their w are 0."""
    truth = made_up(moves=2)
    seen, u = periods(truth), multisine(8)
    expected = truth.simulate(u, WARM)
    larger = with_products(with_band(with_plays(truth, seen), 0.0, np.pi, seen))
    assert larger.r.shape == (4, 7)
    np.testing.assert_allclose(larger.simulate(u, WARM), expected, rtol=1e-9, atol=1e-9)
    straight = replace(made_up(), c=np.zeros((2, 3)))
    np.testing.assert_allclose(with_ends(straight).simulate(u, WARM), straight.simulate(u, WARM), atol=1e-9)


@pytest.mark.parametrize("moves", [1, 2])
def test_search_finds_the_model_that_made_the_periods(moves):
    """From numbers that are all 3 % off, to a thousandth of the first error, on a period it has not seen."""
    truth = made_up(moves=moves)
    seen, unseen = periods(truth), periods(truth, (0.7, 1.5))[1:]
    wrong = truth.vector() * (1.0 + 0.03 * np.random.default_rng(5).normal(size=truth.vector().size))
    start = truth.at(wrong)
    with ThreadPoolExecutor(2) as pool:
        found = Search(steps=60, enough=1e-12).run(start, seen, pool)
    for period in unseen:
        before, after = ((period.y - p.simulate(period.u, WARM)).std() for p in (start, found))
        assert after < 1e-3 * before


@pytest.mark.filterwarnings("error")
def test_a_place_whose_derivatives_diverge_is_where_a_search_ends():
    """A growing mode that nothing drives: squares of derivatives overflow, which ended in LinAlgError."""
    truth = made_up()
    grows = truth.A[:1] / 0.95 * 1.08
    more = {name: np.vstack([getattr(truth, name), np.zeros((2, 2))]) for name in "BE"}
    more |= {name: np.hstack([getattr(truth, name), float(name == "C") * np.ones((2, 2))]) for name in "CF"}
    start = replace(truth, A=np.concatenate([truth.A, grows]), **more)
    with ThreadPoolExecutor(1) as pool:
        assert Search().run(start, periods(truth), pool) is start


@pytest.mark.parametrize("moves", [1, 2])
def test_parameters_are_the_same_after_their_text(moves):
    """To the last bit, with no product, and with no second move."""
    truth = made_up(moves=moves)
    found = LoopParameters.of(json.loads(json.dumps(truth.plain())))
    assert np.array_equal(found.vector(), truth.vector())
    u = periods(truth)[0].u
    assert np.array_equal(found.simulate(u, WARM), truth.simulate(u, WARM))
    assert (found.H.shape, found.K.shape, found.factors.shape) == (
        truth.H.shape,
        truth.K.shape,
        truth.factors.shape,
    )


@pytest.mark.parametrize("moves", [1, 2])
def test_the_dynamics_of_a_model_give_the_same_outputs(moves):
    here, u = made_up(curved=True, moves=moves), multisine(2)
    block = on_grid(here.dynamics(1e-3), 1e-3)
    twice, _ = block.respond(np.hstack([u[:, -WARM:], u]))
    expected = here.simulate(u, WARM)
    np.testing.assert_allclose(twice[:, WARM:], expected, rtol=1e-9, atol=1e-11 * np.abs(expected).max())


def test_the_benchmarks_metric_on_a_made_up_case():
    """Two records of two channels: errors of 3 and 4 on half of the samples that count each, 9 before."""
    measured = np.zeros((2, 2, 300))
    measured[..., :100] = 9.0
    measured[0, :, 100:], measured[1, :, 100:] = 3.0, 4.0
    assert benchmark_rms(np.zeros_like(measured), measured) == pytest.approx(np.sqrt(12.5), rel=1e-14)
    assert benchmark_rms(measured, measured) == 0.0


def test_thresholds_stay_above_zero_and_may_meet():
    here = made_up()
    shrunk = here.at(np.where(np.arange(here.vector().size) >= here.vector().size - 6, -50.0, here.vector()))
    assert (shrunk.r > 0.0).all()
    assert np.isfinite(replace(here, r=shrunk.r).vector()).all()
    u, block = multisine(2), on_grid(shrunk.dynamics(1e-3), 1e-3)  # whose thresholds are one
    np.testing.assert_allclose(block.respond(u)[0], shrunk.simulate(u, 0), rtol=1e-8, atol=1e-9)


def test_the_committed_model_of_the_mirror_is_stable_and_knows_no_level():
    """Its page has the benchmark's figures; the model has one set of numbers, in the grid of the records."""
    model = HammersteinModel.load(PAGE / "model.json")
    assert model.dynamics.instability() == ""
    u = 0.3 * np.random.default_rng(0).normal(size=(3, 4000))
    assert np.abs(model.simulate(u, 1 / 6400.0).position_um).max() < 60.0
    test = json.loads((PAGE / "table.json").read_text())["test"]
    text = (PAGE / "README.md").read_text()
    assert f"| {' | '.join(f'{v:.3f}' for v in test['rms_um'])} |" in text
    assert all(
        error < published for error, published in zip(test["rms_um"], (0.087, 0.131, 0.169), strict=True)
    )


def test_the_committed_model_of_the_mirror_comes_to_rest():
    """A second after the voltages end less than a thousandth of the sensor's noise of 0.014 um is left."""
    model = HammersteinModel.load(PAGE / "model.json")
    u = np.zeros((3, 12_800))
    u[:, :6400] = 0.3 * np.random.default_rng(0).normal(size=(3, 6400))
    left = model.simulate(u, 1 / 6400.0).position_um[:, -500:]
    assert (left - left.mean(axis=1, keepdims=True)).std() < 14e-6

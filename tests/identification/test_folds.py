"""What is left out in turn."""

import numpy as np
import pytest
import theory

from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.identification.model_selection import (
    enough_operators,
    error_curve,
    fold_squares,
    parameters_of,
    trial_of,
)
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.normal_equations import FOLDS, left_out, moments_of_folds
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record


def folds(parts, samples=90):
    generator = np.random.default_rng(1)
    x, y = generator.normal(size=(3, samples)), generator.normal(size=(2, samples))
    return x, y, moments_of_folds([(0, x)], y, 0, 3, parts)


@pytest.mark.parametrize("parts", [2, 3, 9])
def test_folds_together_hold_every_sample_once(parts):
    x, _, found = folds(parts)
    assert len(found) == min(parts, FOLDS)
    assert sum(m.samples for m in found.values()) == x.shape[1]


def test_one_part_leaves_nothing_to_choose_by():
    with pytest.raises(IdentificationError, match="too short for cross-validation"):
        folds(1)


@pytest.mark.parametrize("parts", [2, 3])
def test_a_fold_that_no_record_has_is_not_judged(parts):
    """The others hold every sample, and each is predicted once."""
    x, _, found = folds(parts)
    _, counted = left_out([found], lambda m: np.zeros(len(m.gram)))
    assert counted == x.shape[1]


def test_what_is_left_out_is_judged_with_the_coefficients_of_the_rest():
    """Sample by sample, each fold about its own mean."""
    samples, parts = 96, 16
    generator = np.random.default_rng(2)
    x, y = generator.normal(size=(3, samples)), generator.normal(size=(1, samples))
    found = moments_of_folds([(0, x)], y, 0, 3, parts)
    total, counted = left_out([found], lambda m: np.linalg.solve(m.gram, m.cross[:, 0]))
    own = np.arange(samples) * parts // samples % FOLDS
    about = [np.vstack([x, y])[:, own == f] for f in range(FOLDS)]
    about = [one - one.mean(axis=1, keepdims=True) for one in about]
    expected = 0.0
    for f, held in enumerate(about):
        rest = np.hstack([one for k, one in enumerate(about) if k != f])
        weights = np.linalg.lstsq(rest[:3].T, rest[3], rcond=None)[0]
        expected += np.sum((held[3] - weights @ held[:3]) ** 2)
    assert counted == samples
    assert total == pytest.approx(expected, rel=1e-9)


def test_numbers_of_operators_are_not_judged_by_what_one_part_alone_shows():
    """The first loops alone are the largest: without them the largest thresholds tell nothing."""
    t = np.arange(6000) * 2e-4
    loops = 10.0 * np.linspace(1.0, 0.3, t.size) * np.sin(2.0 * np.pi * 5.0 * t)
    u = np.concatenate([loops, np.zeros(t.size)])[None]
    r = np.array([0.0, 0.6, 1.3, 1.9, 2.8, 3.3, 4.4, 5.2, 5.9, 6.7])
    w = np.array([4.0, 0.3, 0.5, 0.2, 0.5, 0.4, 0.3, 0.5, 0.2, 0.4])
    clean = theory.prandtl_ishlinskii(u, [[r]], [[w]])
    noise_um = 0.03
    y = clean + noise_um * np.random.default_rng(0).standard_normal(clean.shape)
    curve = error_curve([Record(u, y, 2e-4)], [InitialState("rest")])
    held_out = {point.operators: point.mean_percent for point in curve}
    assert (
        held_out[60] * np.ptp(y) / 100.0 < 1.5 * noise_um
    )  # a grid of 0.16 V leaves w h / 4 about a threshold
    assert enough_operators(curve) > 20


R, W = np.array([0.0, 1.0, 2.5]), np.array([3.0, 0.8, 0.5])
PLAYS = Candidate(PrandtlIshlinskii([[Pair(R, W)]]), StaticDynamics(n_outputs=1))


def swings(samples, growth=0.0):
    u = np.linspace(1.0, 1.0 + growth, samples) * 4.0 * np.sin(0.13 * np.arange(samples))
    return u[None], theory.prandtl_ishlinskii(u[None], [[R]], [[W]])


@pytest.mark.parametrize("fold", range(FOLDS))
def test_a_model_is_judged_with_the_weights_that_suit_the_other_folds(fold):
    """Readings of one fold of one record suit the model; all others are twice as large."""
    (u, v), (other_u, other_v) = swings(800), swings(960, 0.5)
    own = np.arange(800) * 16 // 800 % FOLDS == fold
    records = [
        Record(u, np.where(own, v, 2.0 * v), 1e-3, verified=True),
        Record(other_u, 2.0 * other_v, 1e-3, verified=True),
    ]
    found = fold_squares(PLAYS, records, [InitialState("rest")] * 2).reshape(2, FOLDS)
    size = max(float(np.ptp(record.y_um)) for record in records)
    assert found[0, fold] == pytest.approx(v[:, own].var() / size**2, rel=0.02)


@pytest.mark.parametrize("more", [0, -1])
def test_three_readings_for_each_free_number_are_enough(more):
    u, v = swings(3 * parameters_of(PLAYS) + more)
    record = Record(u, v, 1e-3, verified=True)
    assert trial_of("plays", PLAYS, [record], [InitialState("rest")], invertible=True).told == (more == 0)

"""Hysteresis of any kind in the loop: the oscillator of the literature, and a loop found again."""

import json

import numpy as np
import pytest

from hammerstein.dynamics import FeedbackBlock
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import BoucWen, BoucWenPair
from hammerstein.identification.in_loop.parameters import SettledPeriod
from hammerstein.identification.in_loop.search import OpenLoop, fit_loop
from oscillator.__main__ import RESULTS, UNSEEN, WARM, decibels, judged, record, start
from oscillator.oscillator import multisine, positions

PUBLISHED_DB = -98.0
"""Of the best nonlinear state-space models of the literature."""


@pytest.fixture(scope="module")
def found():
    """The committed numbers, in a block whose start is found from the records anew."""
    numbers = np.array(json.loads(RESULTS.read_text())["numbers"])
    assert len(numbers) <= 40
    fitted = [record(1, 50.0, 2048), record(2, 20.0, 2048)]
    return start(fitted), start(fitted).at(numbers)


@pytest.mark.full
def test_the_committed_numbers_predict_a_multisine_that_was_not_fitted(found):
    begun, loop = found
    unseen = record(*UNSEEN, 8192)
    settled = SettledPeriod(unseen.u_v, unseen.y_um, 1.0, WARM)
    assert decibels(loop.error(settled)) < PUBLISHED_DB
    assert decibels(begun.error(settled)) > PUBLISHED_DB + 20.0


@pytest.mark.full
def test_the_committed_numbers_predict_a_sweep(found):
    assert judged(found[1])["sweep_db"] < PUBLISHED_DB


def test_the_oscillator_is_stepped_finely_enough():
    """Twice the step changes it by less than a hundredth of what a fit may leave, which is 12.6 um."""
    u = 50.0 * np.sin(2.0 * np.pi * 35.0 * np.arange(2 * 8000 + 1) / 60_000.0)
    fine, coarse = positions(u, 1.0 / 30_000.0, 40), positions(u[::2], 1.0 / 15_000.0, 20)
    assert np.abs(fine - coarse).max() < 1e-2 * 10.0 ** (PUBLISHED_DB / 20.0)
    assert np.std(multisine(1, 50.0, 512)[0]) == pytest.approx(50.0, rel=1e-12)


def in_loop(gamma, a=((0.0, 1.0), (-0.85, 1.6))):
    e, d, g = np.array([[0.0], [-0.05]]), np.zeros((1, 1)), np.zeros((1, 1))
    x = np.eye(2)[:1]
    block = FeedbackBlock(np.array(a), np.ones((2, 1)), x, d, e, x, g, gamma, sample_time_s=1e-3)
    return OpenLoop(block, {"A": np.array([[False, False], [True, True]]), "E": np.array([[False], [True]])})


@pytest.mark.full
def test_a_loop_with_bouc_wen_is_found_again():
    """From numbers that are 10 to 30 % off, to a hundred-thousandth of the swing."""
    truth = in_loop(BoucWen([[BoucWenPair(2.0, 1.0, 0.5, 0.1)]]))
    u = np.random.default_rng(0).normal(size=(1, 150))
    y = truth.block.respond(np.hstack([u[:, -50:], u]))[0][:, 50:]
    periods = [SettledPeriod(u, y, 1.0 / float(y.std()), 50)]
    begun = truth.at(truth.vector() * np.array([0.98, 0.99, 1.3, 0.9, 1.1]))
    found = fit_loop(begun, periods)
    assert np.abs(begun.error(periods[0])).max() > 1e-2
    assert np.abs(found.error(periods[0])).max() < 1e-5


def test_too_few_samples_are_refused():
    loop = in_loop(BoucWen([[BoucWenPair(2.0, 1.0, 0.5, 0.1)]]))
    with pytest.raises(IdentificationError, match="fewer samples than the loop has numbers"):
        fit_loop(loop, [SettledPeriod(np.ones((1, 3)), np.ones((1, 3)), 1.0, 0)])

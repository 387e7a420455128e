"""A few of the actuators drawn at random; ``python -m tests.random_actuators`` tries two hundred."""

from __future__ import annotations

import numpy as np
import pytest
import theory

from .trial import Outcome, tried
from .truth import LAWS, law


@pytest.mark.parametrize("name", LAWS)
def test_a_law_turns_back_into_itself(name):
    """Return-point memory: after a small loop a rise goes on as without it (Bouc-Wen has none)."""
    one = law(name, np.random.default_rng(1))
    rise = np.linspace(0.0, 1.0, 401)
    loop = np.concatenate([rise[:241], rise[240:100:-1], rise[100:]])
    there = one(loop)[-161:], one(rise)[-161:]
    difference = np.abs(there[0] - there[1]).max()
    assert difference < 1e-12 if name != "bouc_wen" else 1e-4 < difference < 0.2


def test_plays_are_those_of_theory():
    rng = np.random.default_rng(3)
    v = rng.uniform(0.0, 1.0, 200)
    r, share = (g := np.random.default_rng(1)).uniform(0.0, 0.4, g.integers(2, 30)), g.uniform(0.1, 0.4)
    wanted = (1.0 - share) * v + share * np.mean([theory.play(v, one) for one in r], axis=0)
    np.testing.assert_allclose(law("plays", np.random.default_rng(1))(v), wanted, atol=1e-12)


def test_what_is_judged():
    outcome = Outcome(0, "", "", stated_um=(1.0, 0.8), true_um=(1.0, 1.0), chosen_um=1.05, best_um=1.0)
    assert outcome.honest
    assert outcome.best_chosen
    assert not Outcome(0, "", "", stated_um=(1.0, 0.6), true_um=(1.0, 1.0)).honest
    assert not Outcome(0, "", "", stated_um=(1.6,), true_um=(1.0,)).honest
    assert not Outcome(0, "", "", chosen_um=1.2, best_um=1.0).best_chosen
    others = Outcome(0, "", "", true_um=(1.0,), others_um=((0.6,), (1.2,)))
    assert not others.alike
    assert others.foreseen


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 3, 5, pytest.param(10, marks=pytest.mark.long), 11, 38, 40])
def test_what_is_stated_of_an_actuator_is_true(seed):
    outcome = tried(seed)
    assert outcome.refused == ""
    assert outcome.honest, (outcome.stated_um, outcome.true_um)
    assert outcome.best_chosen, (outcome.kind, outcome.best)
    assert outcome.missed == ()


@pytest.mark.full
@pytest.mark.parametrize(
    "seed", [39, *(pytest.param(seed, marks=pytest.mark.long) for seed in (119, 138, 149))]
)
def test_what_an_axis_took_up_of_another_law_is_in_its_errors(seed):
    """Envelopes and relays: 3.2 to 3.5 standard errors, and a low-pass that the actuator does not have."""
    assert tried(seed).missed == ()

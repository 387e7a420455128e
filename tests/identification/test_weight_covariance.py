"""Covariance of the weights: that of refits with other noise; only of the free ones where a bound holds."""

import json

import numpy as np
import pytest
import theory

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, WeightCovariance
from hammerstein.hysteresis.pair import triangle
from hammerstein.identification.static.static_block import fit_static
from hammerstein.model import HammersteinModel, ModelFile
from hammerstein.records.record import Record
from hammerstein.scenario.variation import Uncertainty

R = [[np.array([0.0, 1.0, 2.5]), np.array([0.5, 2.0])]]
W = [[np.array([3.0, 0.5, 0.4]), np.array([0.3, 0.1])]]
NOISE_UM = 0.05


def drives(samples=900):
    t = np.arange(samples) / 300.0
    return np.stack([4.0 * np.sin(2 * np.pi * t), 3.0 * np.sin(2 * np.pi * 1.618 * t)])


def refitted(seed, solver="least_squares", weights=W, r=R):
    u = drives()
    y = theory.prandtl_ishlinskii(u, r, weights)
    noisy = y + NOISE_UM * np.random.default_rng(seed).standard_normal(y.shape)
    return fit_static([Record(u, noisy, 1e-3)], r, solver=solver)


def all_weights(fit):
    return np.concatenate([pair.weights_um_per_v for pair in fit.hysteresis.pairs[0]])


@pytest.mark.full
def test_covariance_is_that_of_refits():
    fits = [refitted(seed) for seed in range(400)]
    scatter = np.cov(np.array([all_weights(fit) for fit in fits]).T)
    (known,) = fits[0].hysteresis.weight_covariance
    assert known.slopes_at_bound == 0
    np.testing.assert_array_equal(np.triu(known.factor_um_per_v, 1), 0.0)
    np.testing.assert_allclose(np.sqrt(np.diag(known.covariance)), np.sqrt(np.diag(scatter)), rtol=0.2)
    # Errors of neighbours cancel: what counts is a sum of weights, such as the half height of the loop.
    height = np.concatenate([4.0 - R[0][0], np.zeros(2)])
    told, seen = (np.sqrt(height @ matrix @ height) for matrix in (known.covariance, scatter))
    assert told == pytest.approx(seen, rel=0.2)
    alone = np.sqrt(height**2 @ np.diag(known.covariance))
    assert told < 0.5 * alone
    errors = np.concatenate([pair.weight_errors_um_per_v for pair in fits[0].hysteresis.pairs[0]])
    np.testing.assert_allclose(errors, np.sqrt(np.diag(known.covariance)), rtol=1e-9)


def test_at_a_bound_it_is_the_covariance_of_the_free_weights():
    """The middle slope of the truth is negative: held at its bound, it has no error of its own."""
    bent = [[np.array([3.0, -3.2, 3.0]), W[0][1]]]
    fit = refitted(1, solver="invertible", weights=bent)
    (known,) = fit.hysteresis.weight_covariance
    assert known.slopes_at_bound == len(fit.bounded) == 1
    sums = np.zeros(5)
    sums[:2] = 1.0  # the slope that is held
    assert sums @ known.covariance @ sums == pytest.approx(0.0, abs=1e-12 * known.covariance.max())
    assert np.diag(known.covariance).min() > 0.0


def test_the_file_keeps_it():
    fit = refitted(1)
    model = HammersteinModel.from_json(_model(fit.hysteresis).to_json())
    ours, theirs = model.hysteresis.weight_covariance, fit.hysteresis.weight_covariance
    np.testing.assert_array_equal(ours[0].factor_um_per_v, theirs[0].factor_um_per_v)
    content = json.loads(model.to_json())
    rows = content["hysteresis"]["weight_covariance"][0]["factor_um_per_v"]
    assert [len(row) for row in rows] == [1, 2, 3, 4, 5]
    rows[2].append(0.0)
    with pytest.raises(InputError, match="row i of a factor must hold i numbers"):
        HammersteinModel.from_json(json.dumps(content))
    del rows[3:], rows[2][3:]
    with pytest.raises(InputError, match=r"one factor for each output, of \[5\] rows"):
        HammersteinModel.from_json(json.dumps(content))


def test_digest_follows_what_changes_numbers_alone():
    model = _model(refitted(1).hysteresis)
    content = json.loads(model.to_json())
    first = {k: v for k, v in content.items() if k not in {"hysteresis", "voltages"}}
    plain = _model(PrandtlIshlinskii(model.hysteresis.pairs))
    known = {name: content["hysteresis"][name] for name in ("kind", "pairs")}
    # the covariance is drawn from
    assert _digest(first | {"hysteresis": known}) == plain.digest() != model.digest()
    words = {"name": "another", "inputs": ["a", "b"], "outputs": ["c"], "provenance": [1, 2]}
    assert _digest(content | words | {"verdict": {"flagged": True}}) == model.digest()
    spelt = {"working_point_v": [0, 0], "lowest_v": [-4, -4], "highest_v": [4, 4], "poling": ["both", "both"]}
    assert _digest(content | {"voltages": spelt}) == model.digest()
    assert _digest(content | {"voltages": spelt | {"working_point_v": [1, 0]}}) != model.digest()


def test_a_file_without_voltages_is_symmetric_and_not_flagged():
    content = json.loads(_model(refitted(1).hysteresis).to_json())
    known = {name: content["hysteresis"][name] for name in ("kind", "pairs")}
    bare = HammersteinModel.from_json(json.dumps(content | {"hysteresis": known, "voltages": None}))
    assert bare.recorded.lowest_v == (-4.0, -4.0)
    assert bare.recorded.highest_v == (4.0, 4.0)
    assert bare.recorded.working_point_v == (0.0, 0.0)
    assert (bare.verdict, bare.hysteresis.weight_covariance) == (None, None)
    del content["hysteresis"]
    with pytest.raises(InputError, match=r"hysteresis +is missing"):
        HammersteinModel.from_json(json.dumps(content))


def _model(hysteresis):
    from hammerstein.dynamics import StaticDynamics

    return HammersteinModel("m", hysteresis, StaticDynamics(n_outputs=1), 4.0, ("u", "v"), ("y",))


def _digest(content):
    return ModelFile.model_validate_json(json.dumps(content)).model().digest()


def test_a_covariance_of_other_weights_is_refused():
    with pytest.raises(InputError, match=r"one factor for each output, of \[1\] rows"):
        PrandtlIshlinskii([[Pair([0.0], [1.0])]], (WeightCovariance(np.eye(2)),))


@pytest.mark.full
def test_draws_of_an_actuator_scatter_as_refits_do():
    """Half height of the loop: errors of neighbouring weights cancel, which draws one by one would miss."""
    fits = [refitted(seed) for seed in range(300)]
    known = HammersteinModel(
        "refitted", fits[0].hysteresis, StaticDynamics(n_outputs=1), 4.0, ("u", "v"), ("y",)
    )
    uncertain = Uncertainty(weights="standard_errors")
    drawn = [uncertain.draw(known, Instruments(), number)[0].hysteresis for number in range(300)]
    seen = np.std([fit.hysteresis.pairs[0][0].amplitude(4.0) for fit in fits])
    told = np.std([one.pairs[0][0].amplitude(4.0) for one in drawn])
    assert told == pytest.approx(seen, rel=0.2)


def test_a_model_that_knows_errors_one_by_one_cannot_be_drawn():
    pair = Pair([0.0, 1.0], [2.0, 1.0], [0.1, 0.1])
    model = HammersteinModel(
        "old", PrandtlIshlinskii([[pair]]), StaticDynamics(n_outputs=1), 4.0, ("u",), ("y",)
    )
    with pytest.raises(InputError, match="does not state the covariance"):
        Uncertainty(weights="standard_errors").draw(model, Instruments(), 0)


@pytest.mark.parametrize("columns", [2, 4, 9])
def test_a_triangle_has_the_covariance_of_its_spread_and_no_negative_diagonal(columns):
    spread = np.random.default_rng(columns).normal(size=(4, columns))
    factor = triangle(spread)
    np.testing.assert_allclose(factor @ factor.T, spread @ spread.T, atol=1e-12)
    np.testing.assert_array_equal(np.triu(factor, 1), 0.0)
    assert (np.diag(factor) >= 0.0).all()

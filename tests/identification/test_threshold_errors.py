"""Errors of fitted thresholds: those of refits with other noise, in the file, in the report and in draws."""

import json

import numpy as np
import pytest
import theory

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics, discretise
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii, ThresholdCovariance, WeightCovariance
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import fit_static
from hammerstein.identification.static.threshold_errors import with_threshold_errors
from hammerstein.identification.static.threshold_search import ThresholdTask, search_near
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.reporting.fit_page import fit_page
from hammerstein.scenario.uncertainty import Uncertainty

T = 1e-3
R = [np.array([0.3, 1.2, 2.6]), np.array([0.5, 1.9])]
W = [[np.array([3.0, 0.8, 0.6]), np.array([0.3, 0.2])], [np.array([0.2, 0.1, 0.3]), np.array([4.0, 1.0])]]
AXES = AxesDynamics(axes=tuple(Axis(resonance_hz=f, damping_ratio=0.2) for f in (60.0, 80.0)))


def drives(samples=900):
    t = np.arange(samples) / 300.0
    return np.stack([4.0 * np.sin(2 * np.pi * t), 3.0 * np.sin(2 * np.pi * 1.618 * t)])


def record(seed, noise_um=0.03, weights=W, through=None):
    u = drives()
    y = theory.prandtl_ishlinskii(u, [R, R], weights)
    y = y if through is None else through.respond(y)[0]
    return Record(u, y + noise_um * np.random.default_rng(seed).standard_normal(y.shape), T)


def refitted(seed, solver="least_squares", **options):
    own = record(seed, **options)
    through = options.get("through")
    task = ThresholdTask([own], [Start("rest")], 0, [] if through is None else [through])
    grids = list(search_near(task, tuple(R)).grids)
    fit = fit_static([own], [grids] * 2, solver=solver, through=through)
    return with_threshold_errors(task, fit).hysteresis


def flat(block):
    """Thresholds, weights of both outputs, half height of the first loop at 4 V."""
    thresholds = np.concatenate([pair.thresholds_v for pair in block.pairs[0]])
    weights = [pair.weights_um_per_v for row in block.pairs for pair in row]
    return np.concatenate([thresholds, *weights, [block.pairs[0][0].amplitude(4.0)]])


def errors(block):
    told = [pair.weight_errors_um_per_v for row in block.pairs for pair in row]
    return np.concatenate([block.threshold_covariance.errors_v, *told])


@pytest.mark.parametrize("through", [None, discretise(AXES, T)], ids=["static", "dynamics"])
def test_errors_and_draws_are_those_of_refits(through):
    fits = [refitted(seed, through=through) for seed in range(120)]
    seen = np.std([flat(fit) for fit in fits], axis=0)
    assert fits[0].threshold_covariance.open == ()
    np.testing.assert_allclose(np.mean([errors(fit) for fit in fits], axis=0), seen[:-1], rtol=0.2)
    model = HammersteinModel(
        "m", fits[0], StaticDynamics(n_outputs=2), 4.0, ("u", "v"), ("x", "y"), Instruments()
    )
    spec = Uncertainty(weights="standard_errors")
    drawn = [flat(spec.draw(model, Instruments(), n)[0].hysteresis) for n in range(400)]
    np.testing.assert_allclose(np.std(drawn, axis=0), seen, rtol=0.25)
    # What the draws would be without the thresholds: their errors are most of the errors of some weights.
    alone = PrandtlIshlinskii(fits[0].pairs, fits[0].weight_covariance)
    fixed = HammersteinModel("m", alone, model.dynamics, 4.0, ("u", "v"), ("x", "y"))
    held = np.std([flat(spec.draw(fixed, Instruments(), n)[0].hysteresis) for n in range(400)], axis=0)
    assert (held[:5] < 1e-12).all()
    assert (held[5:-1] < 0.7 * seen[5:-1]).any()


def test_slopes_at_a_bound_stay_there_and_thresholds_are_told_by_the_others():
    """A middle slope that is negative in truth is held at its bound by the fit."""
    bent = [[np.array([3.0, -3.2, 3.0]), W[0][1]], W[1]]
    block = refitted(1, "invertible", weights=bent)
    assert block.weight_covariance[0].slopes_at_bound == 1
    following = block.threshold_covariance.following_um_per_v2[0]
    np.testing.assert_allclose(following[:2].sum(axis=0), 0.0, atol=1e-9 * np.abs(following).max())


def test_a_threshold_of_no_weight_is_open_and_held():
    idle = [[np.array([3.0, 1e-4, 0.6]), W[0][1]], [np.array([0.2, 1e-4, 0.3]), W[1][1]]]
    found = refitted(2, weights=idle).threshold_covariance
    assert found.open == (1,)
    assert found.errors_v[1] == 0.0
    assert (np.delete(found.errors_v, 1) > 0.0).all()


def test_without_noise_there_is_no_error():
    found = refitted(3, noise_um=0.0)
    assert (found.threshold_covariance.errors_v < 1e-6).all()


def with_fitted_thresholds(operators):
    return identify([record(4)], Settings(operators=operators, partition="fitted", error_curve=False))


@pytest.fixture(scope="module")
def identified():
    return with_fitted_thresholds(6)


def test_file_and_report_hold_them(identified):
    model, fit = identified
    known = model.hysteresis.threshold_covariance
    again = HammersteinModel.from_json(model.to_json()).hysteresis.threshold_covariance
    np.testing.assert_array_equal(again.factor_v, known.factor_v)
    np.testing.assert_array_equal(again.following_um_per_v2, known.following_um_per_v2)
    assert again.open == known.open
    page = fit_page(model, fit).markdown()
    assert "## Thresholds" in page
    r = model.hysteresis.pairs[0][0].thresholds_v
    assert f"{r[-1]:.4g}" in page.split("## Thresholds")[1]
    assert any("place of" in text for text in fit.not_identifiable) == bool(known.open)
    content = json.loads(model.to_json())
    del content["hysteresis"]["threshold_covariance"]["following_um_per_v2"][0]
    with pytest.raises(InputError, match="share their thresholds"):
        HammersteinModel.from_json(json.dumps(content))
    del content["hysteresis"]["threshold_covariance"]
    assert HammersteinModel.from_json(json.dumps(content)).hysteresis.threshold_covariance is None


@pytest.mark.parametrize("operators", [3, 6])
def test_no_delay_stands_in_for_thresholds_not_yet_fitted(operators, identified):
    """With so few thresholds where the time partition puts them, one sample of delay fits better."""
    model, fit = identified if operators == 6 else with_fitted_thresholds(operators)
    assert fit.delay_samples == 0
    places = np.concatenate([pair.thresholds_v for pair in model.hysteresis.pairs[0]])
    errors_v = model.hysteresis.threshold_covariance.errors_v
    for r in np.concatenate(R):
        nearest = int(np.argmin(np.abs(places - r)))
        assert abs(places[nearest] - r) < max(4.0 * errors_v[nearest], 0.02)


def test_given_thresholds_have_no_error():
    model, fit = identify(
        [record(4)], Settings(thresholds_v=[0.0, 1.0, 2.0], dynamics="none", error_curve=False)
    )
    assert model.hysteresis.threshold_covariance is None
    assert "## Thresholds" not in fit_page(model, fit).markdown()


def test_a_covariance_of_other_thresholds_is_refused():
    pair, weights = Pair([0.0, 1.0], [1.0, 1.0]), (WeightCovariance(np.eye(2)),)
    good = ThresholdCovariance(np.eye(2), (np.eye(2),))
    PrandtlIshlinskii([[pair]], weights, good)
    for known, places in [
        (weights, ThresholdCovariance(np.eye(3), (np.eye(2),))),
        (weights, ThresholdCovariance(np.eye(2), (np.eye(2), np.eye(2)))),
        (weights, ThresholdCovariance(np.eye(2), (np.eye(2),), (2,))),
        (None, good),
    ]:
        with pytest.raises(InputError, match="threshold_covariance"):
            PrandtlIshlinskii([[pair]], known, places)
    with pytest.raises(InputError, match="share their thresholds"):
        PrandtlIshlinskii([[pair], [Pair([0.0], [1.0])]], (*weights, WeightCovariance(np.eye(1))), good)
    with pytest.raises(InputError, match="not finite"):
        ThresholdCovariance(np.full((2, 2), np.nan), (np.eye(2),))


def test_drawn_thresholds_stay_sorted_and_above_zero():
    wide = ThresholdCovariance(np.diag([0.5, 0.5]), (np.zeros((2, 2)),))
    block = PrandtlIshlinskii([[Pair([0.1, 0.4], [1.0, 2.0])]], (WeightCovariance(np.zeros((2, 2))),), wide)
    model = HammersteinModel("m", block, StaticDynamics(n_outputs=1), 4.0, ("u",), ("x",))
    spec = Uncertainty(weights="standard_errors")
    drawn = [spec.draw(model, Instruments(), n)[0].hysteresis.pairs[0][0] for n in range(50)]
    assert {pair.weights_um_per_v.tolist() == [1.0, 2.0] for pair in drawn} == {True, False}

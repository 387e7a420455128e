"""What the compensators beyond the paper must reach, on the true position, from identified models."""

from pathlib import Path

import pytest

from hammerstein.experiment.run import run
from hammerstein.scenario import Scenario

pytestmark = pytest.mark.full  # the baselines of the scenarios guard the same numbers

SCENARIOS = Path(__file__).parents[2] / "scenarios"
JOINT = {"method": "hammerstein", "partition": "fitted"}
DYNAMIC = {"label": "with dynamics", "law": "hammerstein_inverse", "identification": JOINT}


def _rows(reference, compensator=None, **tables):
    scenario = {
        "question": "?",
        "reference": {"smooth_start_s": 0.02, **reference},
        "compensators": [DYNAMIC | (compensator or {})],
        "measure": {"settle_cycles": 3, "measured_cycles": 2},
    }
    return run(Scenario.model_validate(scenario | tables)).rows


CIRCLE = {"kind": "circle", "radius_um": 50, "frequency_hz": 50}


def _lissajous(fx, fy, amplitude=48):
    return {"kind": "lissajous", "amplitude_um": amplitude, "frequency_x_hz": fx, "frequency_y_hz": fy}


@pytest.mark.parametrize("reference", [CIRCLE, _lissajous(50, 100 / 3), _lissajous(40, 30)])
def test_paths_stay_within_300_nm(reference):
    assert max(row.euclidean_max_true_um for row in _rows(reference)) <= 0.3


def test_half_the_sample_time_follows_a_circle_as_well():
    """Thresholds of the paper's partition are the actuator's at 50 us alone: at 25 us they left 0.36 um."""
    assert _rows(CIRCLE, instruments={"drive": {"sample_time_s": 25e-6}})[0].euclidean_max_true_um <= 0.1


def test_spiral_stays_within_300_nm():
    spiral = {"kind": "spiral", "radius_um": 50, "frequency_hz": 50, "trigger_s": 0.12, "decay_s": 0.05}
    rows = _rows(spiral, {"filter_hz": 2500}, measure={"settle_cycles": 4, "measured_cycles": 10})
    assert max(row.euclidean_max_true_um for row in rows) <= 0.3


@pytest.mark.parametrize("figure", [_lissajous(50, 100 / 3, 50), _lissajous(40, 30, 50)])
def test_what_is_out_of_reach_is_counted_and_the_rest_stays(figure):
    rows = _rows(figure)
    assert rows[0].saturated_samples > 0
    assert rows[0].euclidean_max_unsaturated_um <= 0.3
    assert rows[0].euclidean_max_true_um > 1.0


@pytest.mark.parametrize("frequency_hz", [100, 200])
def test_fast_circles_and_sines_stay_within_one_micrometre(frequency_hz):
    assert _rows(CIRCLE | {"frequency_hz": frequency_hz})[0].euclidean_max_true_um <= 1.0
    sine = {"kind": "sine", "amplitude_um": 50, "frequency_hz": frequency_hz}
    assert max(row.max_true_um for row in _rows(sine)) <= 1.0


@pytest.mark.parametrize("actuator", ["duo_bimorph", "duo_bimorph_resonant"])
def test_rms_error_of_small_references_at_every_frequency(actuator):
    sine = {"kind": "sine", "amplitude_um": 20, "frequency_hz": 50}
    rows = _rows(sine, actuator=actuator, sweep={"frequency_hz": [10, 30, 100, 200, 280, 306, 430, 420]})
    assert max(row.rms_true_um for row in rows) <= 0.5


def test_ten_minutes_with_creep():
    sine = {"kind": "sine", "amplitude_um": 10, "offset_um": 20, "frequency_hz": 1, "smooth_start_s": 0.5}
    creeping = DYNAMIC | {"identification": JOINT | {"creep_modes": 3, "sample_time_s": 50e-6}}
    static = {
        "label": "static",
        "law": "exact_inverse",
        "identification": {"frequency_hz": 50, "sample_time_s": 50e-6},
    }
    rows = _rows(
        sine,
        actuator="duo_bimorph_creep",
        instruments={"drive": {"sample_time_s": 0.001}},
        measure={"settle_cycles": 1, "measured_cycles": 600},
        compensators=[creeping, static],
    )
    drift = {(row.compensator, row.excited_axis): abs(row.drift_true_um) for row in rows if _direct(row)}
    for axis in "xy":
        assert drift["with dynamics", axis] < 0.2
        assert drift["static", axis] > 1.0


def _direct(row):
    return row.excited_axis == row.measured_axis


def test_exact_inverse_leaves_nothing_of_a_static_actuator():
    from hammerstein.scenario import load_scenario

    rows = run(load_scenario(SCENARIOS / "static_inverse.toml")).rows
    assert max(row.max_true_um for row in rows if row.compensator == "exact") < 1e-9
    assert max(row.max_true_um for row in rows if row.compensator == "paper") > 0.1


def test_feedback_alone_cannot_follow_what_feedforward_can():
    feedback = {"label": "feedback", "law": "feedback", "identification": JOINT}
    both = feedback | {"label": "both", "feedforward": "hammerstein_inverse"}
    best = feedback | {"label": "best feedback", "feedforward": "none", "derivative": True}
    plain = {"label": "gain", "law": "none", "identification": JOINT}
    rows = _rows(CIRCLE, compensators=[DYNAMIC, feedback, both, best, plain])
    worst = {row.compensator: row.euclidean_max_true_um for row in rows}
    assert worst["feedback"] > 10.0
    assert worst["both"] <= 0.3
    assert worst["best feedback"] < 0.5 * worst["gain"] < worst["feedback"]
    assert worst["both"] < 0.2 * worst["best feedback"]


@pytest.mark.parametrize("reference", [CIRCLE, _lissajous(50, 100 / 3)])
def test_fitted_thresholds_follow_an_actuator_with_other_ones(reference):
    worst = {}
    for partition in ("time", "fitted"):
        joint = DYNAMIC | {"identification": JOINT | {"operators": 20, "partition": partition}}
        rows = _rows(reference, joint, actuator="duo_bimorph_dense")
        worst[partition] = max(row.euclidean_max_true_um for row in rows)
    assert worst["fitted"] <= 0.2
    assert worst["fitted"] <= 0.5 * worst["time"]

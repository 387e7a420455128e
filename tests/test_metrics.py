import numpy as np
import pytest

import hammerstein
from hammerstein import metrics
from hammerstein.reporting.page import render

f, T = 50.0, 50e-6
t = np.arange(4000) * T
u = 10 * np.sin(2 * np.pi * f * t)


def test_lagging_sine_is_an_ellipse():
    y = 3 * np.sin(2 * np.pi * f * t - 0.3)
    (figures,) = metrics.loop_figures(u, y, f, T, 2, 40)
    assert figures.height_um == pytest.approx(6.0, rel=1e-3)
    assert figures.width_um == pytest.approx(6.0 * np.sin(0.3), rel=1e-3)
    assert figures.width_percent == pytest.approx(100 * np.sin(0.3), rel=1e-3)
    assert figures.gain == pytest.approx(0.3, rel=1e-9)
    assert figures.phase_deg == pytest.approx(np.degrees(-0.3), rel=1e-9)


@pytest.mark.parametrize("f", [150.0, 175.0, 420.0])
def test_period_need_not_be_a_whole_number_of_samples(f):
    y = 3 * np.sin(2 * np.pi * f * t - 0.3)
    (figures,) = metrics.loop_figures(10 * np.sin(2 * np.pi * f * t), y, f, T, 2, 4)
    assert figures.gain == pytest.approx(0.3, rel=2e-2)
    assert figures.height_um == pytest.approx(6.0, rel=2e-2)
    assert figures.phase_deg == pytest.approx(np.degrees(-0.3), abs=0.5)


def test_noise_above_the_sensors_bandwidth_does_not_widen_a_loop():
    noise = 0.04 * np.random.default_rng(0).normal(size=t.size)
    (figures,) = metrics.loop_figures(u, 1.4 * np.sin(2 * np.pi * f * t) + noise, f, T, 2, 40)
    assert figures.height_um == pytest.approx(2.8, rel=0.02)


def test_errors_of_a_shifted_circle():
    reference = 50 * np.stack([np.cos(2 * np.pi * f * t), np.sin(2 * np.pi * f * t)])
    error = np.array([[0.3], [0.4]])
    assert metrics.euclidean(np.broadcast_to(error, reference.shape)).max() == pytest.approx(0.5)
    assert metrics.worst(metrics.radial(reference, reference + error)) == pytest.approx(0.5, rel=1e-3)
    assert metrics.rms(np.broadcast_to(error, reference.shape)[1]) == pytest.approx(0.4)


def test_epsilon_is_the_printed_formula():
    reference, position = np.array([[30.0], [40.0]]), np.array([[30.1], [40.0]])
    theta = 70.0**2 - 70.1**2
    assert metrics.epsilon(reference, position)[0] == pytest.approx(-np.sqrt(-theta))


@pytest.fixture
def crossing_um():
    """A figure of merit as a plug-in would add it: the largest reading of an axis."""

    @metrics.metric("largest reading of either sign [um]")
    def crossing_um(measured):
        return [metrics.worst(row) for row in measured.reading_um]

    yield crossing_um
    del metrics.METRICS["crossing_um"]


def test_a_metric_from_outside_has_column_glossary_claim_tolerance_and_baseline(crossing_um, tmp_path):
    claim = {
        "id": "P1",
        "statement": "It moves far.",
        "quantity": {"metric": "crossing_um", "measured_axis": "x"},
        "agreement": {"at_least": 50.0},
    }
    scenario = {
        "question": "How far does it move?",
        "actuator": "duo_bimorph_static",
        "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0},
        "measure": {"settle_cycles": 1, "measured_cycles": 1},
        "claims": [claim],
        "tolerances": {"crossing_um": {"relative": 0.5}},
    }
    report = hammerstein.run(scenario)
    largest = float(report.to_frame()["crossing_um"].max())
    assert largest == pytest.approx(58.4, abs=0.3)  # facts: half height of the loop of x
    assert report.verdicts[0].agrees
    assert "largest reading of either sign" in render(report)
    baseline = tmp_path / "far.json"
    hammerstein.check(scenario, baseline, update=True)
    assert "crossing_um" in baseline.read_text()
    assert hammerstein.check(scenario, baseline).exit_code == 0


def test_a_metric_needs_a_name_of_its_own(crossing_um):
    with pytest.raises(hammerstein.InputError, match="is taken"):
        metrics.metric("twice")(crossing_um.of)


def test_a_claim_on_a_metric_that_is_not_there_names_the_nearest():
    claim = {"id": "P", "statement": "s", "quantity": {"metric": "rms_umm"}, "agreement": {"at_most": 1.0}}
    drive = {"kind": "sine", "amplitude_v": 1.0, "frequency_hz": 50.0}
    with pytest.raises(hammerstein.InputError, match="did you mean rms_um"):
        hammerstein.run({"question": "?", "drive": drive, "claims": [claim]})

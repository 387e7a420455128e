from dataclasses import replace

import numpy as np
import pytest

import hammerstein
from hammerstein import metrics
from hammerstein.metrics import PathErrors
from hammerstein.paper.assessment import epsilon
from hammerstein.reporting.run_page import run_page

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
    assert metrics.rms(np.broadcast_to(error, reference.shape)[1]) == pytest.approx(0.4)


def test_epsilon_is_the_printed_formula():
    reference, position = np.array([[30.0], [40.0]]), np.array([[30.1], [40.0]])
    theta = 70.0**2 - 70.1**2
    assert epsilon(reference, position)[0] == pytest.approx(-np.sqrt(-theta))


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
        "assessment": {"kind": "paper", "claims": [claim]},
        "tolerances": {"crossing_um": {"relative": 0.5}},
    }
    report = hammerstein.run(scenario)
    largest = float(report.to_frame()["crossing_um"].max())
    assert largest == pytest.approx(58.4, abs=0.3)  # facts: half height of the loop of x
    assert report.judgements[0].agrees
    assert "largest reading of either sign" in run_page(report).markdown()
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
    asked = {"kind": "paper", "claims": [claim]}
    with pytest.raises(hammerstein.InputError, match="did you mean rms_um"):
        hammerstein.run({"question": "?", "drive": drive, "assessment": asked})


def test_a_loop_is_opened_in_the_middle_of_its_input():
    """Opening 4 cos(phi) (1 + 0.8 sin(phi)) at the input 10 sin(phi): it grows to one side."""
    phase = 2 * np.pi * f * t
    (figures,) = metrics.loop_figures(
        u, 3 * np.sin(phase) + 2 * np.cos(phase) * (1 + 0.8 * np.sin(phase)), f, T, 2, 40
    )
    assert figures.width_um == pytest.approx(4.0, rel=2e-3)


@pytest.mark.parametrize(("harmonics", "height"), [(40, 2.0 * 1.2), (8, 2.0)])
def test_harmonics_up_to_the_sensors_bandwidth_are_kept(harmonics, height):
    """At its peak the ninth harmonic adds to the first."""
    phase = 2 * np.pi * f * t
    (figures,) = metrics.loop_figures(u, np.sin(phase) + 0.2 * np.sin(9 * phase), f, T, 2, harmonics)
    assert figures.height_um == pytest.approx(height, rel=2e-3)


@pytest.mark.parametrize("samples", [1, 511, 512, 513, 5000])
def test_one_pass_gives_the_figures_of_the_definitions(samples):
    rng = np.random.default_rng(samples)
    reference = 30.0 * rng.standard_normal((2, samples))
    reading, position = (reference + 0.1 * rng.standard_normal((2, samples)) for _ in range(2))
    middle = np.array([3.0, -7.0])
    saturated = np.zeros((2, samples), dtype=bool)
    arrays = (reading, position, saturated, reference, reference, reference)
    measured = metrics.Measured(T, *arrays, middle_um=middle)
    counted = [wire - middle[:, None] for wire in (reference, reading, position)]
    expected = {
        "rms_um": [metrics.rms(row) for row in reading - reference],
        "max_true_um": [metrics.worst(row) for row in position - reference],
        "euclidean_rms_true_um": metrics.rms(metrics.euclidean(position - reference)),
        "euclidean_max_um": metrics.worst(metrics.euclidean(reading - reference)),
        "radial_max_um": metrics.worst(np.hypot(*counted[1]) - np.hypot(*counted[0])),
        "radial_max_true_um": metrics.worst(np.hypot(*counted[2]) - np.hypot(*counted[0])),
        "epsilon_max_um": metrics.worst(epsilon(counted[0], counted[1])),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(metrics.METRICS[name].values(measured), values, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize(("scale", "order"), [(1024.0, [0, 1]), (1.0, [1, 0])])
def test_figures_have_the_unit_of_their_names_and_go_with_their_axes(scale, order):
    rng = np.random.default_rng(8)
    wires = 30.0 * rng.standard_normal((1, 2, 1)) + rng.standard_normal((5, 2, t.size))
    cut = np.zeros((2, t.size), dtype=bool)
    cut[:, 1200:1230] = [[True], [False]]

    def figures(scale, order):
        r, p, *targets = scale * wires[:, order]
        loops = [loop for row in r for loop in metrics.loop_figures(u, row, f, T, 2, 40)]
        measured = metrics.Measured(
            T, r, p, cut[order], *targets, 400, loops, scale * np.array([3.0, -7.0])[order]
        )
        return {name: metric.values(measured) for name, metric in metrics.METRICS.items()}

    first, other = figures(1.0, [0, 1]), figures(scale, order)
    assert set(first) >= {
        "drift_true_um",
        "euclidean_max_unsaturated_um",
        "radial_max_um",
        "phase_deg",
        "gain",
    }
    for name, values in first.items():
        unit = scale if name.endswith("_um") or name == "gain" else 1.0
        np.testing.assert_allclose(other[name], unit * np.array(values)[order], rtol=1e-9, err_msg=name)


def test_an_error_that_is_no_number_is_no_figure():
    path = np.zeros((2, 100))
    path[1, 70] = np.nan
    found = PathErrors.of(path, np.zeros((2, 100)))
    assert found.rms[0] == 0.0
    assert np.isnan([found.rms[1], found.distance_rms]).all()


def test_every_figure_is_of_the_wire_it_names():
    """A reading 3 and 4 um off on the two axes, a position 0.6 and 0.8 um off, both outwards at (30, 40)."""
    reference = np.array([[30.0, 0.0], [40.0, 0.0]])
    off = np.array([[1.0, 0.0], [1.0, 0.0]])
    measured = metrics.Measured(
        sample_time_s=T,
        reading_um=reference + np.array([[3.0], [4.0]]) * off,
        position_um=reference + np.array([[0.6], [0.8]]) * off,
        saturated=np.array([[False, False], [True, False]]),
        target_reading_um=reference,
        target_position_um=reference,
        reference_um=reference,
        cycle_samples=1,
    )
    half = np.sqrt(0.5)  # one of two samples is off
    expected = {
        "rms_um": [3.0 * half, 4.0 * half],
        "max_um": [3.0, 4.0],
        "rms_true_um": [0.6 * half, 0.8 * half],
        "max_true_um": [0.6, 0.8],
        "euclidean_rms_um": [5.0 * half] * 2,
        "euclidean_max_um": [5.0] * 2,
        "euclidean_rms_true_um": [1.0 * half] * 2,
        "euclidean_max_true_um": [1.0] * 2,
        "radial_max_um": [5.0] * 2,
        "radial_max_true_um": [1.0] * 2,
        "epsilon_max_um": [np.sqrt(77.0**2 - 70.0**2)] * 2,
        "drift_true_um": [-0.6, -0.8],
        "saturated_samples": [1, 1],
    }
    for name, values in expected.items():
        assert metrics.METRICS[name].values(measured) == pytest.approx(values), name
    whole = metrics.METRICS["euclidean_max_unsaturated_um"]
    assert whole.values(measured) == [None, None]  # 10 ms after a cut voltage nothing counts
    calm = replace(measured, saturated=np.zeros((2, 2), dtype=bool))
    assert whole.values(calm) == pytest.approx([1.0] * 2)

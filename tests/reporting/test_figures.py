"""Figures: what is drawn."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import theory
from figure_cases import CIRCLE, NONE, PAPER, SINE_V, circles, loops, report_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from hammerstein.comparison.result import Comparison, Left
from hammerstein.experiment.report import Report, Sensitivity
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record
from hammerstein.reporting.figures import LoopRun, figures_of, loops_figure
from hammerstein.reporting.figures.choice import legend_labels, legible_parts
from hammerstein.reporting.figures.identified import compared_figure
from hammerstein.reporting.figures.path import PathRun, path_errors_figure, path_figure
from hammerstein.reporting.figures.style import letter, line_style, new_figure, plain_numbers, styled
from hammerstein.reporting.figures.sweep import (
    DriftRun,
    SweepCurve,
    drift_figure,
    sensitivity_figure,
    sweep_figure,
)

SINE_UM = {"kind": "sine", "amplitude_um": 40.0, "frequency_hz": 50.0}
MODEL = {"label": "model", "identification": {}}
OTHER_MODEL = {"label": "other", "identification": {"frequency_hz": 80.0}}
FIVE = {"frequency_hz": [10.0, 20.0, 50.0, 80.0, 100.0]}


@cache
def sweep() -> Report:
    return report_of(reference=SINE_UM, sweep=FIVE, compensators=[PAPER, NONE])


def solid_line(axes: Axes) -> np.ndarray:
    return np.asarray(axes.lines[0].get_xydata())


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize(
    ("content", "names"),
    [
        ({"drive": SINE_V}, ["loops"]),
        ({"drive": SINE_V, "models": [MODEL]}, ["loops", "errors"]),
        ({"drive": SINE_V, "sweep": FIVE}, ["sweep"]),
        ({"drive": SINE_V, "sweep": FIVE, "models": [MODEL]}, ["sweep"]),
        ({"reference": SINE_UM, "compensators": [NONE]}, ["loops", "errors"]),
        ({"reference": SINE_UM, "compensators": [NONE], "sweep": FIVE}, ["sweep", "sweep_true"]),
        ({"reference": CIRCLE, "compensators": [NONE]}, ["path", "errors"]),
        (
            {"reference": CIRCLE, "compensators": [NONE], "sweep": {"radius_um": [20.0, 40.0]}},
            ["path", "errors"],
        ),
        ({"reference": SINE_UM | {"axis": "all"}, "compensators": [NONE]}, ["path", "errors"]),
        ({"drive": {"kind": "circle", "radius_v": 8.0, "frequency_hz": 50.0}}, ["path"]),
        (
            {
                "drive": SINE_V,
                "models": [{"label": str(n), "identification": {"operators": n}} for n in (3, 5, 8, 11, 15)],
            },
            ["loops", "operators"],
        ),
    ],
)
def test_figures_follow_from_the_scenario(content: dict[str, Any], names: list[str]) -> None:
    assert list(figures_of(report_of(**content))) == names


def test_loops_stand_in_the_paper_s_arrangement() -> None:
    panels = figures_of(loops())["loops"].axes
    assert [axes.get_title(loc="left") for axes in panels] == ["(a)", "(b)", "(c)", "(d)"]
    assert [axes.get_xlabel() for axes in panels] == ["voltage $u_x$ [V]", "voltage $u_y$ [V]"] * 2
    assert [axes.get_ylabel() for axes in panels] == ["reading $x$ [µm]"] * 2 + ["reading $y$ [µm]"] * 2
    assert [axes.get_title(loc="right") for axes in panels] == [
        "direct",
        "cross-coupling",
        "cross-coupling",
        "direct",
    ]


def test_loops_show_the_settled_loop_of_theory() -> None:
    panels = figures_of(loops())["loops"].axes
    half_heights = [np.ptp(solid_line(axes)[:, 1]) / 2.0 for axes in panels]
    # sum of w (A - r) of the published table at 10 V; the reading has noise of 0.04 um
    assert half_heights == pytest.approx([58.40, 1.41, 2.08, 50.57], abs=0.1)
    assert np.abs(solid_line(panels[0])[:, 0]).max() == pytest.approx(10.0, abs=1e-3)
    assert solid_line(panels[0])[0] == pytest.approx(solid_line(panels[0])[-1])


def test_many_models_are_not_drawn_over_one_loop() -> None:
    def lines(count: int) -> int:
        models = [{"label": str(n), "identification": {"operators": n}} for n in range(3, 3 + count)]
        return len(figures_of(report_of(drive=SINE_V, models=models))["loops"].axes[0].lines)

    assert (lines(4), lines(5)) == (1 + 4, 1)


def test_loops_of_one_driven_axis_have_one_column() -> None:
    report = report_of(reference=SINE_UM | {"axis": 2}, compensators=[NONE])
    panels = figures_of(report)["loops"].axes
    assert [axes.get_xlabel() for axes in panels] == ["reference $y_r$ [µm]"] * 2
    assert [axes.get_title(loc="right") for axes in panels] == ["cross-coupling", "direct"]
    ideal, reading = panels[1].lines[0], panels[1].lines[1]
    assert np.array_equal(ideal.get_xdata(), ideal.get_ydata())
    assert np.ptp(reading.get_ydata()) == pytest.approx(80.0, rel=0.2)


@pytest.mark.parametrize(("outputs", "inputs"), [(1, 1), (3, 2), (2, 3)])
def test_loops_of_any_number_of_axes(outputs: int, inputs: int) -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 50)
    runs = [LoopRun("a", k, np.sin(phase), np.tile(np.cos(phase), (outputs, 1))) for k in range(inputs)]
    figure = loops_figure(runs, [f"u{k}" for k in range(inputs)], [f"y{o}" for o in range(outputs)])
    assert len(figure.axes) == outputs * inputs
    assert legend_texts(figure) == ["a"]


def test_curves_of_many_compensators_are_split_by_compensator() -> None:
    frequencies = {"frequency_hz": [20.0, 50.0, 100.0, 150.0]}
    report = report_of(reference=SINE_UM, sweep=frequencies, compensators=[PAPER, NONE])
    assert list(legible_parts(report.traces)) == ["_1_paper", "_2_none"]
    assert list(figures_of(report)) == ["loops_1_paper", "errors_1_paper", "loops_2_none", "errors_2_none"]


def test_legend_tells_a_value_unless_the_label_does() -> None:
    named = [NONE | {"label": "none at 150 Hz"}, PAPER | {"label": "paper at 50 Hz"}]
    sources = [source | {"only_at_hz": [50.0]} for source in named]
    report = report_of(
        reference=SINE_UM, sweep={"frequency_hz": [50.0, 100.0]}, compensators=[*sources, NONE]
    )
    labels = dict.fromkeys(legend_labels(report, report.traces))
    assert list(labels) == ["none at 150 Hz, 50 Hz", "paper at 50 Hz", "none, 50 Hz", "none, 100 Hz"]


def test_sweep_draws_the_rows_and_marks_the_identification() -> None:
    report = report_of(drive=SINE_V, sweep=FIVE, models=[MODEL, OTHER_MODEL])
    panels = figures_of(report)["sweep"].axes
    rows = [
        r for r in report.rows if r.compensator == "other" and (r.excited_axis, r.measured_axis) == ("y", "x")
    ]
    curves = [line for line in panels[1].lines if line.get_marker() != "*"]
    marks = [
        line for line in panels[1].lines if line.get_marker() == "*"
    ]  # a tick looked like a bar of a band
    assert curves[1].get_ydata().tolist() == [row.rms_um for row in rows]
    assert [mark.get_xdata()[0] for mark in marks] == [50.0, 80.0]
    at_80 = next(row.rms_um for row in rows if row.frequency_hz == 80.0)
    assert marks[1].get_ydata()[0] == pytest.approx(at_80)
    assert marks[1].get_color() == curves[1].get_color()


def test_sweep_has_no_mark_outside_its_range() -> None:
    curve = SweepCurve("a", np.array([1.0, 10.0]), np.array([[[1.0, 2.0]]]), mark=50.0)
    figure = sweep_figure([curve], [["x"]], "rms error")
    assert legend_texts(figure) == ["a"]
    assert len(figure.axes[0].lines) == 1


@pytest.mark.parametrize(("number", "rows"), [(4, [4]), (5, [3, 2]), (9, [3, 3, 3])])
def test_many_curves_of_a_sweep_stand_in_several_rows(number: int, rows: list[int]) -> None:
    """At most four in a panel, nothing of the others behind them, all of them in the legend once."""
    at = np.array([1.0, 2.0, 3.0])
    curves = [SweepCurve(f"c{k}", at, (1.0 + k) * np.ones((2, 2, 3))) for k in range(number)]
    figure = sweep_figure(curves, [["a", "b"], ["c", "d"]], "rms error")
    panels = np.reshape(figure.axes, (-1, 4))
    drawn = [list(one.lines) for one in panels[:, 0]]
    assert [len(lines) for lines in drawn] == rows
    assert [line.get_label() for lines in drawn for line in lines] == [f"c{k}" for k in range(number)]
    assert all(len(one.lines) <= 4 for one in figure.axes)
    assert legend_texts(figure) == [f"c{k}" for k in range(number)]


def test_sweep_of_an_uncertain_actuator_has_bands() -> None:
    report = report_of(
        reference=SINE_UM, sweep=FIVE, compensators=[NONE], uncertainty={"draws": 3, "weights": 0.05}
    )
    figure = figures_of(report)["sweep"]
    (area,) = figure.axes[0].collections
    band = next(b for b in report.bands if b.metric == "rms_um" and b.excited_axis == b.measured_axis == "x")
    drawn = area.get_paths()[0].vertices
    heights = drawn[np.isclose(drawn[:, 0], band.frequency_hz), 1]
    assert sorted({heights.min(), heights.max()}) == pytest.approx([band.p5_um, band.p95_um])
    assert legend_texts(figure)[-2:] == ["median, 5 to 95 % of random actuators", "nominal actuator"]
    nominal = next(r for r in report.rows if r.key() == {n: getattr(band, n) for n in r.key()})
    at = list(FIVE["frequency_hz"]).index(band.frequency_hz)
    middle, thin = (figure.axes[0].lines[k].get_ydata()[at] for k in (0, -1))
    assert (thin, middle) == (nominal.rms_um, band.median_um)


def test_a_band_on_a_linear_axis_is_not_cut() -> None:
    """The axis was fitted to the medians: the band of a first trial went beyond it."""
    values = np.array([[[0.7, 0.57, 0.57]]])
    curve = SweepCurve("learned", np.arange(1.0, 4.0), values, band=(0.9 * values, 2.0 * values, values))
    (axes,) = sweep_figure([curve], [["x"]], "rms error").axes
    assert axes.get_yscale() == "linear"
    assert axes.get_ylim()[0] == 0.0
    assert axes.get_ylim()[1] > 1.4


@pytest.mark.parametrize("x", [[10.0, 20.0, 30.0], [1.0, 10.0, 100.0]])
def test_bands_of_several_compensators_stand_beside_each_other(x: list[float]) -> None:
    """Areas would hide each other: every band has bars of its own from its lower to its upper edge."""
    at, values = np.array(x), np.array([[[1.0, 2.0, 3.0]]])
    band = (0.5 * values, 2.0 * values, values)
    curves = [SweepCurve(label, at, values, band=band) for label in "abc"]
    (axes,) = sweep_figure(curves, [["x"]], "rms error").axes
    assert not axes.collections
    bars = [line for line in axes.lines if np.isnan(line.get_ydata()).any()]
    places = np.array([line.get_xdata()[::3] for line in bars])
    assert len({line.get_color() for line in bars}) == 3
    assert (np.diff(places, axis=0) > 0.0).all()
    np.testing.assert_allclose(places[1], x)
    for line in bars:
        ends = np.reshape(line.get_ydata(), (-1, 3))[:, :2]
        np.testing.assert_allclose(ends, np.transpose([band[0][0, 0], band[1][0, 0]]))


def test_an_index_that_too_few_draws_give_is_not_drawn() -> None:
    index, none = [0.4, 0.3, 0.5], [np.nan] * 3
    indices = np.array([index, none])
    (axes,) = sensitivity_figure(["weights", "noise"], {"exact": (indices, indices)}).axes
    assert [text.get_text().strip() for text in axes.texts] == ["too few draws"]
    assert [patch.get_width() for patch in axes.patches] == [0.4, 0.4, 0.0]
    assert not Sensitivity(
        **{"metric": "rms_um", "parameter": "noise", "compensator": "a", "excited_axis": "x"},
        **{"measured_axis": "x", "frequency_hz": 1.0},
        **{
            "first": 0.3,
            "first_low": 0.2,
            "first_high": 0.4,
            "total": 0.2,
            "total_low": 0.1,
            "total_high": 0.3,
        },
    ).is_estimated


def test_path_shows_every_radius_and_its_legend_the_worst_distance_of_the_largest() -> None:
    report = circles()
    figure = figures_of(report)["path"]
    plane = figure.axes[0]
    sizes = [np.hypot(*line.get_xydata().T).max() for line in plane.lines if line.get_color() == "#222222"]
    assert sizes == pytest.approx([15.0, 40.0], rel=1e-3)
    assert len(plane.lines) == 2 * 2 + 2
    row = next(r for r in report.rows if r.compensator == "paper" and r.amplitude_um == 40.0)
    worst = f"worst {row.euclidean_max_true_um:.2f} µm, radius 40 µm"
    assert legend_texts(figure)[0] == f"paper ({worst})"
    assert [axes.get_title("left") for axes in figure.axes] == ["(a)", "(b)", "(c)"]
    assert figure.legends[0].get_title().get_text() == "Circle: true position"


@pytest.mark.parametrize("every", [1, 7, 20, 57, 130])  # 400 to 3 samples a turn
def test_a_circle_is_drawn_as_a_circle_however_few_samples_are_kept(every: int) -> None:
    time_s = 50e-6 * np.arange(0, 801, every)
    turn = 2.0 * np.pi * 50.0 * time_s
    circle = 30.0 * np.array([np.cos(turn), np.sin(turn)])
    run = PathRun("", "", time_s, circle, circle + 2.0, 0.02, closes=True, lap_s=0.02)
    plane = path_figure([run], ["x", "y"], "reference").axes[0]
    drawn, target = (np.array(plane.lines[k].get_data()) for k in (0, -1))
    for points, centre in ((drawn, 2.0), (target, 0.0)):
        steps = 0.5 * (points[:, 1:] + points[:, :-1])  # in the middle of every straight line
        np.testing.assert_allclose(np.hypot(*(steps - centre)), 30.0, rtol=2e-3)
        assert np.hypot(*(points[:, -1] - points[:, 0])) < 2.0 * np.pi * 30.0 / 57.0  # it closes
    assert plane.get_aspect() == 1.0


def test_a_path_with_corners_is_not_rounded() -> None:
    report = report_of(
        reference={"kind": "triangle", "amplitude_um": 20.0, "frequency_hz": 50.0, "axis": "all"},
        compensators=[{"label": "none", "law": "none", "model": "duo_bimorph"}],
        measure={"record_every": 40},
    )
    plane = figures_of(report)["path"].axes[0]
    assert len(plane.lines[-1].get_xdata()) == 11  # the samples of one period, both ends included


def test_errors_of_a_path_keep_the_worst_sample_of_the_first_lap() -> None:
    report = circles()
    errors = figures_of(report)["errors"].axes
    largest = [np.abs(axes.lines[1].get_ydata()).max() for axes in errors[1::2]]
    (wire,) = [
        t.response for t in report.traces if t.label == "none" and t.signal.model_dump()["radius_um"] == 40.0
    ]
    lap = slice(0, round(0.02 / wire.sample_time_s) + 1)
    truly = np.abs(wire.position_um - wire.reference_um)[:, lap]
    assert largest == pytest.approx([np.hypot(*truly).max(), *truly.max(axis=1)])
    assert figures_of(report)["errors"].legends[0].get_title().get_text() == (
        "Circle: error of the true position"
    )
    assert [axes.get_title("left") for axes in errors] == [f"({letter})" for letter in "abcdef"]
    assert [axes.get_title("right") for axes in errors] == ["radius 15 µm", "radius 40 µm"] * 3


def test_errors_over_a_cycle_are_those_of_the_true_position() -> None:
    report = report_of(reference=SINE_UM, compensators=[NONE])
    figures = figures_of(report)
    figure = figures["errors"]
    assert figure.legends[0].get_title().get_text() == "Error of the true position"
    assert figures["loops"].legends[0].get_title().get_text().startswith("True position over reference")
    (trace,) = [trace for trace in report.traces if trace.excited_axis == "x"]
    wire = trace.response
    lap = slice(0, round(0.02 / wire.sample_time_s) + 1)
    off, seen = (np.abs(y - wire.reference_um)[0, lap].max() for y in (wire.position_um, wire.reading_um))
    assert seen > 1.2 * off  # the sensor lags
    assert np.abs(solid_line(figure.axes[0])[:, 1]).max() == pytest.approx(off, rel=1e-3)


def test_paths_of_many_compensators_are_shared_by_panels_of_the_same_kind() -> None:
    """Nine curves hide each other: three panels of three, each with the target, on one scale."""
    time_s = 50e-6 * np.arange(400)
    circle = np.array([np.cos(314.0 * time_s), np.sin(314.0 * time_s)])
    for names, target_um in ((["x", "y"], circle), (["x"], circle[:1])):
        runs = [PathRun(f"law {k}", "", time_s, target_um, (1 + k) * target_um, 0.02) for k in range(9)]
        path, errors = path_figure(runs, names, "reference"), path_errors_figure(runs, names)
        assert [len(axes.lines) for axes in path.axes] == [4, 4, 4]
        assert [len(axes.lines) for axes in errors.axes] == [3, 3, 3]
        assert len({axes.get_ylim() for axes in errors.axes}) == 1
        assert len(legend_texts(path)) == 10
        assert len(legend_texts(errors)) == 9
    four = [PathRun(f"law {k}", "", time_s, circle, (1 + k) * circle, 0.02) for k in range(4)]
    assert [len(axes.lines) for axes in path_figure(four, ["x", "y"], "reference").axes] == [5, 5, 5]
    assert [len(axes.lines) for axes in path_errors_figure(four, ["x", "y"]).axes] == [4, 4, 4]


def test_distance_is_logarithmic_where_one_curve_would_hide_another() -> None:
    many_passes = PAPER | {"label": "many passes", "iterations": 30}
    report = report_of(
        reference=CIRCLE, compensators=[many_passes, NONE], instruments={"sensor": {"bandwidth_hz": "inf"}}
    )
    scales = {axes.get_ylabel(): axes.get_yscale() for axes in figures_of(report)["errors"].axes}
    assert scales == {"distance [µm]\n(log)": "log", "$e_x$ [µm]": "linear", "$e_y$ [µm]": "linear"}
    assert {axes.get_yscale() for axes in figures_of(circles())["errors"].axes} == {"linear"}


def test_errors_of_one_axis_are_seen_beside_those_of_a_compensator_that_fails() -> None:
    time_s = 50e-6 * np.arange(400)
    target_um = np.sin(314.0 * time_s)[None]
    runs = [PathRun(f"{k}", "", time_s, target_um, (1.0 + k) * target_um, 0.02) for k in (1e-3, 1.0)]
    size, signed = path_errors_figure(runs, ["x"]).axes
    assert (size.get_yscale(), signed.get_yscale()) == ("log", "linear")
    assert size.get_ylim()[0] < 1e-3 < 1.0 < size.get_ylim()[1]


def test_an_error_of_rounding_does_not_stretch_an_axis() -> None:
    """The exact inverse knows the actuator: 1e-14 um beside micrometres."""
    exact = {"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}
    ideal = {"bandwidth_hz": "inf", "noise_um": 0, "resolution_um": 0}
    instruments = {"sensor": ideal, "drive": {"resolution_v": 0}}
    report = report_of(reference=CIRCLE, compensators=[exact, NONE], instruments=instruments)
    assert min(row.figures["euclidean_max_true_um"] for row in report.rows) < 1e-10
    (distance,) = (axes for axes in figures_of(report)["errors"].axes if axes.get_yscale() == "log")
    assert distance.get_ylim()[0] > 1e-5 * distance.get_ylim()[1]


def test_the_plane_shows_one_frequency_where_the_paths_lie_upon_each_other() -> None:
    swept = report_of(reference=CIRCLE, sweep={"frequency_hz": [50.0, 100.0]}, compensators=[NONE])
    sized = report_of(reference=CIRCLE, sweep={"radius_um": [20.0, 40.0]}, compensators=[NONE])
    lines = {n: len(figures_of(r)["path"].axes[0].lines) for n, r in (("swept", swept), ("sized", sized))}
    assert lines == {"swept": 2, "sized": 4}  # a path and its reference each
    assert figures_of(swept)["path"].axes[0].get_title(loc="right") == "50 Hz"


def test_a_question_on_drift_is_drawn_as_drift() -> None:
    slow = {"kind": "sine", "axis": 1, "amplitude_um": 10.0, "frequency_hz": 10.0}
    report = report_of(
        actuator="duo_bimorph_creep",
        reference=slow,
        compensators=[NONE],
        measure={"measured_cycles": 6},
        answered_by="drift_true_um",
    )
    (name,) = figures = figures_of(report)
    assert name == "drift"
    means = figures[name].axes[0].lines[0].get_ydata()
    row = next(row for row in report.rows if row.measured_axis == "x")
    assert len(means) == 6
    assert means[-1] - means[0] == pytest.approx(row.drift_true_um, abs=1e-12)


def test_three_axes_that_drift_have_three_panels() -> None:
    runs = [DriftRun("one", axis, np.arange(4.0), np.arange(4.0)) for axis in range(3)]
    assert [panel.get_ylabel()[-6] for panel in drift_figure(runs, ["x", "y", "z"]).axes] == ["x", "y", "z"]


def test_models_of_a_path_in_volts_are_compared_with_the_reading() -> None:
    report = report_of(drive={"kind": "circle", "radius_v": 8.0, "frequency_hz": 50.0}, models=[MODEL])
    figure = figures_of(report)["path"]
    worst = max(row.euclidean_max_um or 0.0 for row in report.rows)
    assert legend_texts(figure) == [
        f"model (worst {worst:.3f} µm)" if worst < 1 else f"model (worst {worst:.2f} µm)",
        "sensor's reading",
    ]


def test_labels_are_written_as_they_are() -> None:
    odd = [NONE | {"label": "_none"}, PAPER | {"label": "50 $ and $x"}]
    texts = legend_texts(figures_of(report_of(reference=SINE_UM, compensators=odd))["loops"])
    assert texts == [" _none", r"50 \$ and \$x", "ideal"]


def test_curves_differ_in_colour_and_in_line_or_marker() -> None:
    styles = [line_style(number) for number in range(7)]
    assert len({style["color"] for style in styles}) == 7
    assert len({(str(style["linestyle"]), style["marker"]) for style in styles}) == 7


def test_labels_have_one_unit():
    from hammerstein.reporting.figures.style import axis_label

    named = ("u_x", "X (um)", "u [V]", "Volt_1", "Weg / um", "2", "V", "[V]")
    for name in named:
        label = axis_label(name, "V")
        assert label.count("V]") <= 1
        assert "um]" not in label
        assert "um)" not in label


def test_the_largest_loop_of_falling_amplitudes_isas_matplotlib_draws():
    from hammerstein.reporting.figures.identified import measured_loops

    corners = [0.0, 100.0, 0.0, 60.0, 0.0, 30.0, 0.0]
    u = np.interp(np.linspace(0.0, 6.0, 1800), np.arange(7.0), corners)
    y = theory.prandtl_ishlinskii([u], [[[0.0, 5.0, 20.0]]], [[[0.4, 0.1, 0.1]]])
    _, fit = identify([Record([u], y, 1e-3)], Settings(operators=6, delay_samples=0, error_curve=False))
    measured = measured_loops(fit).axes[0].lines[0]
    assert np.ptp(measured.get_xdata()) == pytest.approx(100.0, rel=0.01)


def test_inputs_that_move_at_once_have_the_loop_of_each_pair_by_the_model() -> None:
    from hammerstein.reporting.figures.identified import SEPARATED, measured_loops

    time_s = 1e-3 * np.arange(3000)
    u = np.array([10.0 * np.sin(2 * np.pi * 1.0 * time_s), 10.0 * np.sin(2 * np.pi * 1.7 * time_s)])
    thresholds, weights = [[[0.0, 2.0, 4.0]] * 2] * 2, [[[3.0, 1.0, 0.5], [0.1, 0.1, 0.0]]] * 2
    weights[1] = weights[1][::-1]
    y = theory.prandtl_ishlinskii(u, thresholds, weights)
    given = Settings(
        thresholds_v=(0.0, 2.0, 4.0), dynamics="none", delay_samples=0, creep_modes=0, error_curve=False
    )
    _, fit = identify([Record(u, y, 1e-3, ("ux", "uy"), ("x", "y"))], given)
    figure = measured_loops(fit)
    assert [text.replace("\n", " ") for text in legend_texts(figure)] == [SEPARATED, "static hysteresis"]
    for panel, (o, k) in zip(figure.axes, [(0, 0), (0, 1), (1, 0), (1, 1)], strict=True):
        drawn = np.array(panel.lines[0].get_data())
        height = 2.0 * theory.loop_amplitude(thresholds[o][k], weights[o][k], 10.0)
        assert np.ptp(drawn[1]) == pytest.approx(height, rel=0.01)
        area = theory.loop_area(thresholds[o][k], weights[o][k], 10.0)
        assert abs(theory.polygon_area(*drawn)) == pytest.approx(area, rel=0.01)


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_a_long_remark_leaves_the_letter_of_its_panel_alone(columns):
    with styled():
        figure = new_figure(2.0)
        panels = np.ravel(figure.subplots(1, columns))
        for number, axes in enumerate(panels):
            letter(axes, number, "Spannung am Verstärker, Kanal 1 to Weg des Tisches (X)")
        figure.draw_without_rendering()
        for axes in panels:
            name, remark = (
                next(t for t in axes.findobj(Text) if t.get_text() == words)
                for words in (axes.get_title("left"), axes.get_title("right"))
            )
            assert name.get_window_extent().x1 < remark.get_window_extent().x0


def test_a_model_without_a_compensator_error_says_why_in_its_row() -> None:
    lefts = (Left(percent=0.3), Left(reason="this model replaces the actuator"), Left(reason="of " * 40))
    entries = [
        SimpleNamespace(
            name=name,
            parameters=3,
            left=left,
            validation_at={},
            fitted_at={10.0: SimpleNamespace(mean_percent=0.2)},
        )
        for name, left in zip("abc", lefts, strict=True)
    ]
    figure = compared_figure(
        cast(Comparison, SimpleNamespace(entries=entries, validation=(), recommended="a"))
    )
    rows = {text.get_position()[1]: text.get_text() for text in figure.axes[1].texts}
    assert rows == {1: "this model replaces the actuator", 2: "no compensator"}
    assert all(text.get_bbox_patch() for text in figure.axes[1].texts)  # no line of the grid strikes it out
    assert legend_texts(figure) == ["fitted", "recommended"]  # not one frequency


@pytest.mark.parametrize("ends", [(0.85, 1.4), (0.018, 0.026), (2.1, 3.9), (0.5, 40.0)])
def test_a_logarithmic_axis_has_at_least_two_numbers(ends: tuple[float, float]) -> None:
    with styled():
        axes = new_figure(2.0).subplots()
        axes.set(yscale="log", ylim=ends)
        plain_numbers(axes.yaxis)
        inside = [tick for tick in axes.yaxis.get_majorticklocs() if ends[0] <= tick <= ends[1]]
    assert len(inside) >= 2


def test_numbers_of_any_size_leave_room_for_the_panel() -> None:
    """An error of rounding is 1e-10 of one that is not: both have short labels, clear of the letter."""
    with styled():
        figure = new_figure(3.0)
        left, right = figure.subplots(1, 2)
        left.set(yscale="log", ylim=(1e-12, 1e7))
        plain_numbers(left.yaxis)
        right.plot([0.0, 1.0], [-3e-9, 4e-9])
        for number, axes in enumerate((left, right)):
            letter(axes, number)
        figure.draw_without_rendering()
        shown = {text.get_text() for text in left.get_yticklabels()}
        power = right.yaxis.get_offset_text()
        named = next(text for text in right.get_children() if getattr(text, "get_text", str)() == "(b)")
        assert {"1", "0.001", "$10^{-9}$"} <= shown
        assert "9" in power.get_text()
        assert power.get_window_extent().x1 <= named.get_window_extent().x0 + 0.5

"""The page of a report: a stranger reads it, so its sentences and tables must be those of the rows."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics
from hammerstein.escaping import markdown
from hammerstein.experiment.report import Report, number
from hammerstein.experiment.run import run
from hammerstein.metrics import KEY, METRICS, Row
from hammerstein.model import HammersteinModel
from hammerstein.reporting.figures import figures_of
from hammerstein.reporting.run_page import KEYS, run_page
from hammerstein.reporting.summary import sentences, unsettled_runs
from hammerstein.reporting.tables import number_tables

SINE_V = {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}
SINE_UM = {"kind": "sine", "amplitude_um": 40.0, "frequency_hz": 50.0}
CIRCLE = {"kind": "circle", "radius_um": 40.0, "frequency_hz": 50.0}
PAPER = {"label": "paper", "law": "inverse_multiplicative", "identification": {}}
NONE = {"label": "none", "law": "none", "identification": {}}
MODEL = {"label": "model", "identification": {"frequency_hz": 70.0}}
TEN = {"frequency_hz": [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 100.0]}
SIX = {"frequency_hz": TEN["frequency_hz"][:6]}


def report_of(**content: Any) -> Report:
    return run({"question": "How good?", "actuator": "duo_bimorph_static"} | content, "test")


def answer(report: Report, **quote: Any) -> str:
    """All sentences and tables in one line."""
    found = sentences(report, **quote)
    return " ".join(text for one in found for text in (one.words, *("; ".join(row) for row in one.table)))


def of_figure(figure: str) -> dict[str, str]:
    return {"kind": "paper", "figure": figure}


@cache
def circle() -> Report:
    return report_of(reference=CIRCLE, compensators=[PAPER, NONE], assessment=of_figure("Fig. 10"))


@cache
def sine() -> Report:
    return report_of(reference=SINE_UM, compensators=[PAPER, NONE], assessment=of_figure("Fig. 8"))


@cache
def swept() -> Report:
    return report_of(reference=SINE_UM, sweep=SIX, compensators=[PAPER, NONE], assessment=of_figure("Fig. 9"))


def render(report: Report, figures: Sequence[str] = ()) -> str:
    return run_page(report, figures).markdown()


def with_rms(report: Report, rms_of: Any) -> Report:
    """The same report with rms errors given by label and frequency, cross-couplings a tenth of them."""

    def changed(row: Row) -> Row:
        share = 1.0 if row.excited_axis == row.measured_axis else 0.1
        rms = share * rms_of(row.compensator, row.frequency_hz)
        return replace(row, figures={**row.figures, "rms_um": rms})

    return replace(report, rows=tuple(changed(row) for row in report.rows), statements=())


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_page_opens_with_the_question_and_the_paper_s_figure() -> None:
    report = report_of(drive=SINE_V, assessment=of_figure("Fig. 5"))
    lines = render(report).splitlines()
    assert lines[0] == "# test"
    assert lines[2] == "**How good?**"
    assert lines[4].startswith("In the paper: Fig. 5 (*Multivariable classical")


def test_equal_reports_give_equal_pages() -> None:
    again = report_of(reference=CIRCLE, compensators=[PAPER, NONE], assessment=of_figure("Fig. 10"))
    assert render(again, ["path.svg"]) == render(circle(), ["path.svg"])


def test_answer_gives_the_worst_distances_with_their_part_of_the_radius() -> None:
    report = circle()
    rows = [
        replace(
            row,
            figures={
                **row.figures,
                "euclidean_max_um": 2.0 if row.compensator == "paper" else 10.0,
                "euclidean_max_true_um": 1.5,
            },
        )
        for row in report.rows
    ]
    text = answer(replace(report, rows=tuple(rows)), quote=str.upper)
    assert text.startswith(
        "The worst distance of the reading from the reference: PAPER 2.00 um (5 % of 40 um), NONE "
        "10.0 um (25 % of 40 um). No "
    )


def test_what_an_ideal_sensor_reads_is_told_once() -> None:
    ideal = Instruments.ideal().sensor
    for noise_um, times in ((0.0, 1), (0.01, 2)):
        sensor = ideal.model_copy(update={"noise_um": noise_um}).model_dump()
        report = report_of(reference=CIRCLE, compensators=[NONE], instruments={"sensor": sensor})
        page = render(report)
        assert page.count("\nThe worst distance of the ") == 1
        assert page.count("\n### Error of the ") == times
        assert len(figures_of(report)["errors"].axes) == 3


def test_conditions_of_an_answer_are_points_of_a_list() -> None:
    two = report_of(
        reference=SINE_UM, sweep={"frequency_hz": [20.0, 50.0]}, compensators=[PAPER, NONE],
        assessment=of_figure("Fig. 9"),
    )  # fmt: skip
    page = render(with_rms(two, lambda label, f: f / (10.0 if label == "paper" else 5.0)))
    assert (
        "\nThe rms error of the reading for 40 um, worst axis, ranked by the geometric mean over 2 "
        "frequencies:\n\n"
        "| direct / cross-coupling [um] | 20 Hz | 50 Hz |\n"
        "| --- | ---: | ---: |\n"
        "| *paper* | 2.00 / 0.200 | 5.00 / 0.500 |\n"
        "| *none* | 4.00 / 0.400 | 10.0 / 1.00 |\n"
    ) in page


def test_what_is_said_of_several_stands_once() -> None:
    page = render(replace(sine(), statements=("paper: is slow", "The sensor lags.", "none: is slow")))
    assert "\n* paper; none: is slow\n* The sensor lags.\n" in page


def test_answer_tells_the_errors_of_a_single_frequency() -> None:
    text = answer(with_rms(sine(), lambda label, _: 3.0 if label == "paper" else 0.5))
    assert text == (
        "The rms error of the reading, worst axis: direct / cross-coupling [um]; 50 Hz, 40 um none; "
        "0.500 / 0.0500 "
        "paper; 3.00 / 0.300 No voltage was clipped. Every run had settled."
    )


def test_beyond_the_paper_the_true_position_comes_first() -> None:
    paths, sines = (
        replace(report, scenario=report.scenario.model_copy(update={"assessment": None}))
        for report in (circle(), sine())
    )
    assert answer(paths).startswith("The worst distance of the true position from the reference: ")
    assert answer(sines).startswith(
        "The rms error of the true position, worst axis: direct / cross-coupling [um]; "
    )


def test_answer_tells_who_is_best_where_and_shows_the_worst_of_the_best() -> None:
    def rms(label: str, frequency_hz: float) -> float:
        return 1.0 + abs(frequency_hz - 20.0) if label == "paper" else 15.0 + (frequency_hz == 50.0)

    found = sentences(with_rms(swept(), rms))[0]
    assert found.words == (
        "Smallest direct error: paper from 10 Hz to 30 Hz and none (no compensator is better) from 40 Hz to "
        "60 Hz. The rms error of the reading for 40 um, worst axis, ranked by the geometric mean "
        "over 6 frequencies:"
    )
    assert found.table == (
        ("direct / cross-coupling [um]", "10 Hz", "40 Hz", "60 Hz"),
        ("paper", "11.0 / 1.10", "21.0 / 2.10", "41.0 / 4.10"),
        ("none", "15.0 / 1.50", "15.0 / 1.50", "15.0 / 1.50"),
    )
    other = sentences(with_rms(swept(), lambda label, f: rms(label, f) / (4.0 if label == "none" else 1.0)))
    assert other[0].table[0] == ("direct / cross-coupling [um]", "10 Hz", "40 Hz", "50 Hz", "60 Hz")


def test_answer_counts_where_the_best_changes_too_often() -> None:
    text = answer(with_rms(swept(), lambda label, f: float((f % 20.0 == 0.0) == (label == "paper")) + 1.0))
    assert text.startswith("paper has the smallest direct error at 3 of 6 frequencies. The rms error ")


LINE = 105
"""Letters of a line of an answer on a page of 1400 points."""


def test_an_answer_has_three_lines_and_one_small_table() -> None:
    """Twelve methods over six frequencies took eight lines."""
    labels = [f"compensator {chr(97 + k)} at 50 Hz" for k in range(12)]
    few = swept()
    rows = [replace(row, compensator=n) for n in labels for row in few.rows if row.compensator == "paper"]
    unsettled = [
        f"{n} at {f:g} Hz, axis x: the position has not settled; try." for n in labels for f in (10, 60)
    ]
    report = with_rms(
        replace(few, rows=tuple(rows), statements=tuple(unsettled)),
        lambda label, f: 2.0 + (labels.index(label) + int(f)) % 5,
    )
    for one in (report, few, sine(), circle(), uncertain(), report_of(drive=SINE_V, sweep=SIX)):
        found = sentences(one)
        assert sum(-(-len(sentence.words) // LINE) for sentence in found) <= 3
        (table,) = [sentence.table for sentence in found if sentence.table] or [()]
        assert len(table) <= 6
        assert all(len(row) <= 5 for row in table)
    last = sentences(report)[0].table[-1][0]
    assert last.removeprefix("last of 12: ") in labels
    assert last not in labels


def test_a_question_of_yes_or_no_is_answered_so() -> None:
    """By the limits that the scenario gives, for its first compensator."""
    report = with_rms(sine(), lambda label, _: 5.0 if label == "none" else 0.2)

    def answered(**limits: float) -> str:
        return answer(replace(report, scenario=report.scenario.model_copy(update={"yes_if": limits})))

    words = "rms error of the sensor's reading 0.200 um (limit"
    assert answered(rms_um=0.3).startswith(f"Yes: {words} 0.3 um). The rms error ")
    assert answered(rms_um=0.1).startswith(f"No: {words} 0.1 um). The rms error ")
    assert answered(rms_um=0.3, gain=0.1).startswith(f"No: {words} 0.3 um) and first harmonic of ")


def test_a_question_of_how_many_operators_is_answered_by_a_number() -> None:
    models = [{"label": f"{n} plays", "identification": {"frequency_hz": 50, "operators": n}} for n in (2, 4)]
    report = report_of(drive=SINE_V, models=models)
    found = {label: float(label[0]) for label in ("2 plays", "4 plays")}
    rows = [replace(r, figures={**r.figures, "rms_true_um": found[r.compensator]}) for r in report.rows]
    assert answer(replace(report, rows=tuple(rows))).startswith("2 operators. More do not lower the largest ")
    rows = [replace(r, figures={**r.figures, "rms_true_um": -found[r.compensator]}) for r in report.rows]
    assert answer(replace(report, rows=tuple(rows))).startswith(
        "4 operators, the most here, have the smallest"
    )
    models[1]["identification"] = models[1]["identification"] | {"frequency_hz": 20}
    assert "operators" not in answer(report_of(drive=SINE_V, models=models))


def test_answer_describes_loops_where_there_is_nothing_to_compare_with() -> None:
    perfect = {"bandwidth_hz": float("inf"), "noise_um": 0.0, "resolution_um": 0.0}
    table = sentences(report_of(drive=SINE_V, instruments={"sensor": perfect}))[0].table
    assert table[0] == ("loop", "50 Hz, 10 V")
    # closed forms of the published table: 2 sum w (A - r), and the opening at zero voltage over it
    closed = {
        "x, height [um]": 2 * 58.40,
        "x, width [%]": 16.7,
        "y, height [um]": 2 * 50.57,
        "y, width [%]": 15.2,
        "largest cross-coupling, height [um]": 2 * 2.08,
    }
    assert {name: float(figure) for name, figure in table[1:]} == pytest.approx(closed, rel=0.01)


def test_answer_says_what_was_cut_and_what_had_not_settled() -> None:
    cut = report_of(drive=SINE_V, instruments={"drive": {"range_v": 8.0}})
    assert "The drive's range clipped 2 of 2 runs." in answer(cut)
    some = report_of(
        drive=SINE_V, instruments={"drive": {"range_v": 8.0}}, sweep={"amplitude_v": [5.0, 8.0, 9.0, 10.0]}
    )
    assert "clipped 4 of 8 runs: duo_bimorph_static (9 to 10 V)." in answer(some)
    hurried = report_of(drive=SINE_V, actuator="duo_bimorph", measure={"settle_cycles": 0, "settle_s": 0.0})
    said = answer(hurried)
    assert "No run had settled, so these numbers depend on when they are read; " in said
    assert "raise settle_cycles or settle_s" in said  # and what follows
    assert "settled" not in answer(report_of(drive=SINE_V, measure={"measured_cycles": 1}))
    creeping = replace(
        cut, statements=("x: the position has not settled; it does not settle in 20 times as many",)
    )
    assert "raise settle_cycles" not in answer(creeping)
    assert "more cycles do not change that" in answer(creeping)
    some = replace(creeping, statements=(*creeping.statements, "x: the position has not settled; try."))
    assert "raise settle_cycles or settle_s in [measure] (does not help 1 of them)." in answer(some)


def test_runs_that_differ_in_their_size_are_told_apart_and_written_as_one() -> None:
    """Circles of three radii had one statement: that of 50 Hz."""
    hurried = report_of(
        reference=SINE_UM | {"axis": "each"}, sweep={"amplitude_um": [20.0, 40.0]}, actuator="duo_bimorph",
        compensators=[NONE, NONE | {"label": "idle"}], measure={"settle_cycles": 0, "settle_s": 0.0},
    )  # fmt: skip
    said = [text for text in hurried.statements if "has not settled" in text]
    assert [text.partition(":")[0] for text in said] == [
        f"{label} at {size} um, axis {axis}"
        for size in (20, 40) for label in ("none", "idle") for axis in "xy"
    ]  # fmt: skip
    assert "\n* none; idle, all at 20 um, axis x and axis y; none; idle, all at 40 um, " in render(hurried)
    fewer = answer(replace(hurried, statements=tuple(said[:5])))
    assert "5 of 8 runs had not settled: none (3 runs, 20 to 40 um); idle (2 runs, 20 um). " in fewer


def test_a_limit_over_frequencies_stands_beside_the_worst_of_the_nominal_actuator() -> None:
    """The nominal error at the frequency of the largest limit was far below that at another one."""
    report = report_of(
        reference=SINE_UM, sweep={"frequency_hz": [20.0, 50.0]}, compensators=[NONE],
        uncertainty={"draws": 40, "weights": 0.05},
    )  # fmt: skip
    bands = [replace(b, p95_um=9.0 - b.frequency_hz / 10.0) for b in report.bands]
    found = sentences(replace(report, bands=tuple(bands)))[0]
    assert found.words.endswith("for 40 random actuators, each number at its worst frequency:")
    direct = [row for row in report.rows if row.excited_axis == row.measured_axis]
    assert found.table[1][3] == number(max(row.rms_true_um for row in direct))
    assert found.table[1][2] == "7.00"


def test_one_statement_that_is_left_out_is_one() -> None:
    texts = tuple(f"statement {k}" for k in range(16))
    assert "\n* 1 more statement is in `report.json`." in render(replace(sine(), statements=texts))


def test_many_loops_that_had_not_settled_are_named() -> None:
    said = tuple(f"law {k} at {10 * k} Hz, axis x: the position has not settled; try." for k in range(1, 6))
    text = answer(replace(swept(), statements=said))
    assert "5 of 24 runs had not settled: law 1; law 2; law 3; 2 more (10 to 50 Hz). Their " in text
    assert "law 1 (1 run, 10 Hz); law 2 (1 run, 20 Hz). " in answer(replace(swept(), statements=said[:2]))


def test_an_answer_about_drawn_actuators_is_about_their_spread() -> None:
    assert "cross-coupling" not in answer(uncertain())


def test_a_law_that_does_not_converge_never_wins() -> None:
    said = "paper: The inner iteration does not converge: slopes -2.77 to 15.2 um/V, spectral radius 1.182."
    best = with_rms(swept(), lambda label, f: 1.0 if label == "paper" else 15.0)
    assert answer(best).startswith("paper has the smallest direct error at every frequency. The ")
    found = sentences(replace(best, statements=(said,)))[0]
    assert "paper" not in found.words
    assert "paper (does not converge)" in [row[0] for row in found.table]
    few = replace(circle(), statements=(said,))
    assert "paper (does not converge) " in answer(few)


def test_the_figure_that_the_scenario_names_answers_first() -> None:
    report, name = circle(), "radial_max_true_um"
    asked = replace(report, scenario=report.scenario.model_copy(update={"answered_by": name}))
    values = {
        n: max(row.radial_max_true_um for row in report.rows if row.compensator == n)
        for n in ("paper", "none")
    }
    told = ", ".join(f"{n} {number(values[n])}" for n in sorted(values, key=values.__getitem__))
    worst = ", at the worst of 2 frequencies, amplitudes and axes"
    assert answer(asked).startswith(f"The {METRICS[name].meaning}{worst}: {told}.")
    one = replace(asked, rows=report.rows[:1])
    assert answer(one).startswith(f"The {METRICS[name].meaning}: ")


@cache
def uncertain() -> Report:
    return report_of(reference=SINE_UM, compensators=[NONE], uncertainty={"draws": 40, "weights": 0.05})


def test_an_uncertain_actuator_is_told_by_its_band_first() -> None:
    report = uncertain()
    direct = [b for b in report.bands if b.metric == "rms_true_um" and b.excited_axis == b.measured_axis]
    worst = max(direct, key=lambda band: band.p95_um)
    found = sentences(report)[0]
    assert found.words == "The rms error of the true position for 40 random actuators:"
    (nominal,) = [row.rms_true_um for row in report.rows if row.place == worst.place]
    figures = (worst.median_um, worst.p95_um, nominal)
    assert found.table[1] == ("none", *map(number, figures))


def test_a_band_says_of_how_many_draws_it_is_and_what_it_holds() -> None:
    """The part of all that lies between two of the sorted draws, simulated."""
    draws = np.sort(np.random.default_rng(5).uniform(size=(20_000, 40)), axis=1)
    held = np.quantile(draws[:, 37] - draws[:, 1], 0.05)  # of 0..39: 5 and 95 % are at 1.95 and 37.05
    title = next(table.title for table in number_tables(uncertain()) if "Spread" in table.title)
    assert "5 to 95 % of 40 draws" in title
    share = int(re.search(r"at least (\d+) %", title)[1])
    assert share == pytest.approx(100 * held, abs=4)


def test_tables_hold_the_rows() -> None:
    report = sine()
    reading, true, loops = number_tables(report)
    row = next(
        r for r in report.rows if (r.compensator, r.excited_axis, r.measured_axis) == ("none", "y", "x")
    )
    assert reading.header == ("compensator", "x to x", "x to y", "y to x", "y to y")
    assert reading.lines[1][0] == "none"
    assert reading.lines[1][3] == f"{number(row.rms_um)} / {number(row.max_um)}"
    assert true.lines[1][3] == f"{number(row.rms_true_um)} / {number(row.max_true_um)}"
    assert "reading against the reference at 50 Hz, 40 um, rms" in reading.title
    assert "true position" in true.title
    line = next(line for line in loops.lines if line[:2] == ("none", "y to x"))
    assert line[2:] == (
        number(row.height_um),
        number(row.width_um),
        number(row.width_percent),
        number(row.gain),
        f"{row.phase_deg:.1f}",
    )


def test_table_of_a_path_holds_distance_radius_and_the_paper_s_epsilon() -> None:
    report = circle()
    reading, true = number_tables(report)
    row = next(r for r in report.rows if r.compensator == "none")
    assert reading.header[-4:] == ("distance, rms", "distance, worst", "radius, worst", "epsilon (see below)")
    assert reading.lines[1][-4:] == tuple(
        number(value)
        for value in (row.euclidean_rms_um, row.euclidean_max_um, row.radial_max_um, row.epsilon_max_um)
    )
    assert true.header[-1] == "radius, worst"
    own, seen = number_tables(report_of(reference=CIRCLE, compensators=[NONE]))
    assert ("true position" in own.title, "reading" in seen.title) == (True, True), "the truth comes first"
    assert own.header[-1] == "radius, worst", "a run that answers no paper has none of its figures"
    assert true.lines[1][-1] == number(row.radial_max_true_um)


def test_a_sweep_is_shown_whole_where_the_page_can_hold_it() -> None:
    table = next(iter(number_tables(report_of(drive=SINE_V, sweep=TEN, models=[MODEL]))))
    assert [float(line[1]) for line in table.lines] == TEN["frequency_hz"]
    assert not table.remark


def test_a_longer_sweep_is_shown_at_its_ends_and_where_models_were_identified(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hammerstein.reporting.tables.MOST_LINES", 9)
    report = report_of(drive=SINE_V, sweep=TEN, models=[MODEL])
    table = next(iter(number_tables(report)))
    shown = [float(line[1]) for line in table.lines]
    assert len(shown) == 6
    assert {10.0, 70.0, 100.0} <= set(shown)
    assert table.remark == "This table shows 6 of 10 frequencies; `rms.csv` has all."
    assert table.remark in render(report)


def test_a_loop_that_several_models_share_is_shown_once() -> None:
    report = report_of(drive=SINE_V, models=[MODEL, MODEL | {"label": "other"}])
    *_, loops = number_tables(report)
    assert loops.header[0] == "transfer"
    assert len(loops.lines) == 4


def test_what_all_rows_share_is_in_the_title_and_what_differs_is_a_column() -> None:
    report = report_of(drive=SINE_V, sweep={"frequency_hz": [20.0, 50.0]}, models=[MODEL])
    errors, *_, loops = number_tables(report)
    assert errors.header[:2] == ("model", "frequency [Hz]")
    assert " at 10 V, rms / worst" in errors.title
    assert (loops.header[:2], loops.title) == (("frequency [Hz]", "transfer"), f"{LOOPS} at 10 V")


def test_a_phase_that_rounds_to_zero_has_no_sign() -> None:
    report = report_of(drive=SINE_V)
    rows = tuple(replace(row, figures={**row.figures, "phase_deg": -0.01}) for row in report.rows)
    *_, loops = number_tables(replace(report, rows=rows))
    assert {line[-1] for line in loops.lines} == {"0.0"}


def test_spread_of_an_uncertain_actuator_is_shown() -> None:
    report = report_of(reference=CIRCLE, compensators=[NONE], uncertainty={"draws": 3, "weights": 0.05})
    band = next(b for b in report.bands if b.metric == "euclidean_max_true_um")
    *_, spread = number_tables(report)
    assert spread.lines[0][-1] == f"{number(band.median_um)} ({number(band.p5_um)} to {number(band.p95_um)})"


def test_every_column_of_a_row_is_explained() -> None:
    assert set(KEYS) == set(KEY)
    assert all(metric.meaning for metric in METRICS.values())


def test_only_columns_that_are_filled_are_explained() -> None:
    page = render(sine())
    assert "| `gain` |" in page
    assert "epsilon" not in page
    assert "It cannot be the quantity that the paper plots" in render(circle())


def test_figures_are_embedded_by_relative_path_in_reading_order() -> None:
    page = render(circle(), ["errors.svg", "path.svg"])
    assert re.findall(r"!\[[^]]+\]\(([^)]+)\)", page) == ["path.svg", "errors.svg"]
    assert "## Figures" not in render(circle(), [])


def test_captions_speak_of_what_is_there() -> None:
    alone, modelled = report_of(drive=SINE_V), report_of(drive=SINE_V, models=[MODEL])
    assert "Dark dashes show the models" in render(modelled, ["loops.svg"])
    assert "models" not in render(alone, ["loops.svg"]).split("## Numbers")[0]
    assert "wide grey line is the ideal" in render(sine(), ["loops_1_paper.svg"])


def test_how_it_was_run_is_told_without_clock_and_place(tmp_path: Path) -> None:
    table = tmp_path / "scan.csv"
    table.write_text("time_s,x,y\n0,0,0\n0.01,5,3\n0.02,0,0\n")
    report = report_of(
        reference={"kind": "file", "path": str(table)},
        compensators=[PAPER | {"iterations": 3}],
        instruments={"sensor": {"noise_um": 0.02}},
        seed=7,
    )
    page = render(report, ["path.svg"])
    assert str(tmp_path) not in page
    for told in (
        "`path = scan.csv`",
        "`noise_um = 0.02`",
        "`bandwidth_hz = 2000`",
        "`range_v = [-10, 10]`",
        "| Seed of the noise | 7 |",
        report.digest,
        report.model_digest,
    ):
        assert told in page
    (line,) = [line for line in page.splitlines() if line.startswith("| paper |") and "identified" in line]
    assert cells(line)[1].startswith("The paper's law without inversion")
    assert cells(line)[2] == "iterations = 3"
    assert "frequency_hz = 50" in cells(line)[3]


def test_a_sensor_without_a_limit_of_bandwidth_is_told_in_words() -> None:
    page = render(report_of(drive=SINE_V, instruments={"sensor": {"bandwidth_hz": float("inf")}}))
    assert "`bandwidth_hz = unlimited`" in page


def test_a_model_file_is_named_without_its_folder() -> None:
    source = {"label": "given", "law": "exact_inverse", "model": "duo_bimorph_static"}
    assert "| file duo_bimorph_static |" in render(report_of(reference=CIRCLE, compensators=[source]))


LOOPS = "Loops of the sensor's reading"
CLAIM = {
    "id": "C1",
    "statement": "The loop of x is 2 x 58 um high",
    "paper": 116.0,
    "quote": "2 x 58 um",
    "unit": "um",
    "quantity": {"metric": "height_um", "excited_axis": "x", "measured_axis": "x"},
    "agreement": {"within": 0.02},
}


def test_claims_of_the_paper_are_a_table() -> None:
    page = render(
        report_of(
            drive=SINE_V,
            assessment={"kind": "paper", "claims": [CLAIM, CLAIM | {"id": "C2", "paper": 200.0}]},
        )
    )
    first, second = (cells(line) for line in page.splitlines() if re.match(r"\| C\d", line))
    assert first[:4] == ["C1", "The loop of x is 2 x 58 um high", "", "116 um"]
    assert float(first[5]) == pytest.approx(116.8 / 116.0, abs=0.01)
    assert (first[7], second[7]) == ("*met*", "**not met**")


def test_words_of_the_user_do_not_break_the_page() -> None:
    odd = NONE | {"label": "a|b *c* <d> _e"}
    page = render(report_of(reference=CIRCLE, compensators=[odd], question="Is 2 * 3 < 7 | really?"))
    assert r"**Is 2 \* 3 \< 7 \| really?**" in page
    for block in re.findall(r"(?:^\|.*\n)+", page, flags=re.M):
        assert len({len(cells(line)) for line in block.splitlines()}) == 1
    assert markdown("a_b [um]") == "a_b [um]"
    assert markdown("[a](b)") == r"[a]\(b)"


def test_many_statements_are_cut_short() -> None:
    page = render(replace(sine(), statements=tuple(f"statement {i}" for i in range(40))))
    assert "* statement 14\n* 25 more statements are in `report.json`." in page


def test_claims_that_are_undecided_are_counted_as_such() -> None:
    asked = {"kind": "paper", "claims": [CLAIM]}
    report = report_of(drive=SINE_V, assessment=asked)
    (judged,) = report.judgements
    open_ = replace(judged, simulated=(replace(judged.simulated[0], agrees=None),))
    for judgements, words in (
        ((judged,), "1 of 1 claims met"),
        ((judged, open_), "1 of 2 claims met, 1 undecided"),
    ):
        assert run_page(replace(report, judgements=judgements)).verdict.words == words


def test_claims_come_after_the_figures_and_name_other_actuators_in_their_details() -> None:
    asked = {"kind": "paper", "claims": [CLAIM], "also_on": [{"actuator": "duo_bimorph"}]}
    page = run_page(report_of(drive=SINE_V, assessment=asked), ["loops.svg"]).markdown()
    assert page.index("(loops.svg)") < page.index("## Claims of the paper") < page.index("## Numbers")
    heads, line = (
        next(cells(line) for line in page.splitlines() if line.startswith(start))
        for start in ("| claim", "| C1")
    )
    assert "reason" not in heads  # empty in every line
    assert re.fullmatch(r"11\d um", line[heads.index("simulated")])
    assert "Other actuators: duo" in line[heads.index("details")]


@pytest.mark.parametrize("settle_s", [0.002, 0.3])
def test_what_has_not_settled_is_one_sentence_for_page_and_terminal(settle_s: float, tmp_path: Path) -> None:
    """A resonance of 1 % at 280 Hz rings for 0.06 s (time constant)."""
    axis = {"resonance_hz": 280.0, "damping_ratio": 0.01}
    model = HammersteinModel.load("duo_bimorph")
    dynamics = AxesDynamics.model_validate({"axes": [axis, axis]})
    replace(model, dynamics=dynamics).save(tmp_path / "ringing.json")
    scenario = {"measure": {"settle_s": settle_s, "settle_cycles": 0}, "reference": SINE_UM}
    report = report_of(actuator=str(tmp_path / "ringing.json"), compensators=[NONE], **scenario)
    told = unsettled_runs(report)
    assert bool(told) == (settle_s < 0.1)
    assert told in answer(report)

"""The gate: what passes, and that it fails for everything that it is there for."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.report import Band, Report
from hammerstein.experiment.run import run
from hammerstein.metrics import METRICS, Row
from hammerstein.model import HammersteinModel
from hammerstein.paper.judgements import ClaimJudgement, Simulated
from hammerstein.regression.compare import (
    Baseline,
    Finding,
    Kind,
    compare,
    key_of,
    limit,
    numbers_of,
    tolerance_of,
)
from hammerstein.regression.result import CheckResult, ScenarioCheck, check_files
from hammerstein.scenario import Scenario
from hammerstein.scenario.scenario import Tolerance, load_scenario

LOOP = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = {amplitude}
frequency_hz = 50
"""
OUT_OF_REACH = """
question = "What happens out of reach?"
actuator = "duo_bimorph_static"
[reference]
kind = "circle"
radius_um = 500
frequency_hz = 50
[[compensators]]
label = "none"
law = "none"
model = "duo_bimorph_static"
"""
ROW = Row("exact", "all", "y", 50.0, amplitude_um=30.0, figures={"rms_um": 0.5, "max_true_um": 2.0})


@pytest.fixture(scope="module")
def loop() -> Report:
    return run(
        Scenario.model_validate(
            {
                "question": "How large is a loop?",
                "actuator": "duo_bimorph_static",
                "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0},
            }
        ),
        "loop",
    )


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two scenarios, where the commands run."""
    monkeypatch.chdir(tmp_path)
    Path("scenarios").mkdir()
    for name, amplitude in (("large", 10), ("small", 5)):
        Path(f"scenarios/{name}.toml").write_text(LOOP.format(amplitude=amplitude))
    return tmp_path


@pytest.fixture
def accepted(folder: Path) -> Path:
    """The same, with its baselines."""
    assert check_files([Path("scenarios")], update=True).exit_code == 0
    return folder


def with_rows(report: Report, *rows: Row) -> Report:
    return replace(report, rows=rows)


def kinds(findings: Iterable[Finding]) -> list[Kind]:
    return [finding.kind for finding in findings]


def compared(report: Report, before: dict[str, Any], now: dict[str, Any], **more: Any) -> list[Kind]:
    """Kinds of finding when a row's numbers were ``before`` and are ``now``."""
    bare = Row("exact", "all", "y", 50.0)
    baseline = Baseline.of(with_rows(report, replace(bare, figures=before)))
    return kinds(compare(with_rows(report, replace(bare, figures=now)), baseline, **more))


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_report_equals_its_own_baseline_through_the_file(loop: Report, tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    assert Baseline.of(loop).save(path).written
    stored = Baseline.load(path)
    assert stored.rows == numbers_of(loop)  # to the last bit
    assert compare(loop, stored) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("part", "found"), [(0.99e-3, []), (1.01e-3, [Kind.MOVED])])
def test_a_number_may_move_by_a_thousandth_either_way(
    loop: Report, sign: float, part: float, found: list[Kind]
) -> None:
    assert compared(loop, {"rms_um": 0.5}, {"rms_um": 0.5 * (1.0 + sign * part)}) == found


def test_every_figure_of_a_report_is_guarded(loop: Report) -> None:
    before = {name: 1.0 + i for i, name in enumerate(METRICS)}
    for name in METRICS:
        assert compared(loop, before, before | {name: 1.01 * before[name]}) == [Kind.MOVED], name


def test_saturated_samples_are_exact(loop: Report) -> None:
    before = {"saturated_samples": 100_000}
    assert compared(loop, before, {"saturated_samples": 100_001}) == [Kind.MOVED]


def test_a_zero_of_theory_is_bounded_and_not_compared_with_noise(loop: Report) -> None:
    before = {"rms_um": 3e-13}
    assert compared(loop, before, {"rms_um": 9e-7}) == []
    assert compared(loop, before, {"rms_um": 1.1e-6}) == [Kind.MOVED]


def test_a_changed_file_of_the_actuator_is_no_change_of_the_scenario(tmp_path: Path) -> None:
    """The actuator is the model of a compensator, too; a model of its own belongs to the scenario."""
    for name in ("stage", "other"):
        HammersteinModel.load("duo_bimorph_static").save(tmp_path / f"{name}.json")
    text = LOOP.format(amplitude=10.0).replace("duo_bimorph_static", "stage.json")
    models = "".join(f'[[models]]\nlabel = "{n}"\nmodel = "{n}.json"\n' for n in ("stage", "other"))
    (tmp_path / "loop.toml").write_text(text + models)
    before = Baseline.of(run(load_scenario(tmp_path / "loop.toml"), "loop"))
    for name, kind in (("stage", Kind.MODEL_CHANGED), ("other", Kind.SCENARIO_CHANGED)):
        plant = HammersteinModel.load(str(tmp_path / f"{name}.json"))
        changed = plant.hysteresis.with_weights([1.01 * np.asarray(w) for w in plant.hysteresis.weights])
        replace(plant, hysteresis=changed).save(tmp_path / f"{name}.json")
        found = {one.kind for one in compare(run(load_scenario(tmp_path / "loop.toml"), "loop"), before)}
        assert found & {Kind.MODEL_CHANGED, Kind.SCENARIO_CHANGED} == {kind}
        plant.save(tmp_path / f"{name}.json")


def test_angles_are_compared_the_short_way_round(loop: Report) -> None:
    before = {"gain": 1.0, "phase_deg": -179.99}
    assert compared(loop, before, {"gain": 1.0, "phase_deg": 179.99}) == []
    assert compared(loop, before, {"gain": 1.0, "phase_deg": 179.0}) == [Kind.MOVED]


def test_the_phase_and_the_relative_width_of_nothing_do_not_count(loop: Report) -> None:
    before, now = {"width_percent": 31.0, "phase_deg": 12.0}, {"width_percent": 4.0, "phase_deg": -80.0}
    nothing, something = {"height_um": 1e-12, "gain": 1e-13}, {"height_um": 1e-5, "gain": 1e-5}
    assert compared(loop, nothing | before, nothing | now) == []
    assert compared(loop, something | before, something | now) == [Kind.MOVED] * 2
    assert compared(loop, something | before, nothing | now) == [Kind.MOVED] * 4


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_equals_nothing_and_is_never_accepted(loop: Report, value: float) -> None:
    assert compared(loop, {"rms_um": 0.5}, {"rms_um": value}) == [Kind.MOVED]
    broken = with_rows(loop, replace(ROW, figures={"rms_um": value}))
    with pytest.raises(SimulationError, match=r"rms_um is (nan|inf) .*compensator exact"):
        Baseline.of(broken)
    stored = replace(Baseline.of(loop), rows=numbers_of(broken))
    assert kinds(compare(broken, stored)) == [Kind.MOVED]


def test_keys_are_compared_both_ways(loop: Report) -> None:
    other = replace(ROW, frequency_hz=60.0)
    baseline = Baseline.of(with_rows(loop, ROW, other))
    assert kinds(compare(with_rows(loop, ROW), baseline)) == [Kind.MISSING_ROW]
    assert kinds(compare(with_rows(loop, ROW, other, replace(ROW, compensator="new")), baseline)) == [
        Kind.EXTRA_ROW
    ]
    both, one = {"rms_um": 0.5, "max_um": 1.0}, {"rms_um": 0.5}
    first, then = (replace(ROW, frequency_hz=60.0, figures=figures) for figures in (both, one))
    full, poor = (with_rows(loop, replace(ROW, figures=both), row) for row in (first, then))
    assert kinds(compare(poor, Baseline.of(full))) == [Kind.MISSING_NUMBER]
    assert kinds(compare(full, Baseline.of(poor))) == [Kind.EXTRA_NUMBER]


def test_a_new_figure_of_merit_is_a_note_and_a_lost_one_a_finding(accepted: Path) -> None:
    """Whoever adds a figure of merit need not accept every baseline at once."""
    path = Path("reports/baseline/large.json")
    whole = Baseline.load(path)
    rows = {key: {k: v for k, v in row.items() if k != "height_um"} for key, row in whole.rows.items()}
    replace(whole, rows=rows).save(path)  # accepted before there was an height_um
    result = check_files([Path("scenarios")])
    assert (result.exit_code, result.findings) == (0, ())
    assert "note: new in the report: height_um; --update-baseline accepts it" in result.text()
    assert result.as_dict()["scenarios"][0]["new_columns"] == ["height_um"]
    assert "height_um" in result.markdown()
    rows = {key: row | {"smoothness": 1.0} for key, row in whole.rows.items()}
    replace(whole, rows=rows).save(path)  # a figure that is no more
    result = check_files([Path("scenarios")])
    assert [(f.kind, f.metric) for f in result.findings] == [(Kind.MISSING_COLUMN, "smoothness")]
    assert result.exit_code == 1
    assert "large: smoothness is missing from every row" in result.text()
    rows = {key: row | {"height_um": 2.0 * row["height_um"]} for key, row in whole.rows.items()}
    replace(whole, rows={k: {n: v for n, v in r.items() if n != "width_um"} for k, r in rows.items()}).save(
        path
    )
    result = check_files([Path("scenarios")])  # a new one hides no number that moved
    assert {(f.kind, f.metric) for f in result.findings} == {(Kind.MOVED, "height_um")}


def test_a_changed_scenario_or_model_is_told(loop: Report) -> None:
    baseline = Baseline.of(loop)
    assert kinds(compare(replace(loop, digest="other"), baseline)) == [Kind.SCENARIO_CHANGED]
    assert kinds(compare(replace(loop, model_digest="other"), baseline)) == [Kind.MODEL_CHANGED]


def test_a_scenario_sets_its_own_tolerances(loop: Report) -> None:
    wide = {"tolerances": {"rms_um": Tolerance(relative=0.1, absolute=0.0)}}
    before, now = {"rms_um": 0.5, "max_um": 1.0}, {"rms_um": 0.54, "max_um": 1.08}
    assert compared(loop, before, now, **wide) == [Kind.MOVED]  # max_um
    assert compared(loop, before, {"rms_um": 0.56, "max_um": 1.0}, **wide) == [Kind.MOVED]
    floor = {"tolerances": {"max_um": Tolerance(relative=0.0, absolute=0.04)}}
    assert compared(loop, before, {"rms_um": 0.5, "max_um": 1.039}, **floor) == []


def test_a_default_holds_for_what_is_not_named_and_for_no_count(loop: Report) -> None:
    wide = {"tolerances": {"default": Tolerance(relative=0.1), "max_um": Tolerance(relative=0.01)}}
    before = {"rms_um": 0.5, "max_um": 1.0, "saturated_samples": 100.0}
    assert compared(loop, before, before | {"rms_um": 0.54}, **wide) == []
    for name, value in (("rms_um", 0.56), ("max_um", 1.02), ("saturated_samples", 101.0)):
        assert compared(loop, before, before | {name: value}, **wide) == [Kind.MOVED]


def test_the_bands_of_an_uncertain_actuator_are_guarded(loop: Report) -> None:
    band = Band(
        *("exact", "all", "y", 50.0, None, 30.0, None), metric="rms_um", p5_um=0.4, median_um=0.5, p95_um=0.6
    )
    before = replace(with_rows(loop, ROW), bands=(band,))
    baseline = Baseline.of(before)
    now = replace(before, bands=(replace(band, p95_um=0.61),))
    assert [(f.kind, f.metric) for f in compare(now, baseline)] == [(Kind.MOVED, "rms_um.p95")]
    assert compare(now, baseline, {"rms_um": Tolerance(relative=0.02)}) == ()
    assert kinds(compare(with_rows(loop, ROW), baseline)) == [Kind.MISSING_COLUMN] * 3


def test_the_figure_of_a_claim_on_every_actuator_is_guarded(loop: Report) -> None:
    simulated = (
        Simulated("one", 1.0, True, 1.0, 1.0, "1"),
        Simulated("other", 2.0, True, 2.0, 2.0, "2"),
        Simulated("third", math.nan, False, math.nan, math.nan, "none"),
    )
    judgement = ClaimJudgement("C1", "It is one.", 1.0, "um", "within 2 %", simulated, "")
    before = replace(loop, judgements=(judgement,))
    moved = replace(judgement, simulated=(simulated[0], replace(simulated[1], value=2.01), simulated[2]))
    (finding,) = compare(replace(loop, judgements=(moved,)), Baseline.of(before))
    assert (finding.kind, finding.key) == (Kind.MOVED, (("actuator", "other"), ("claim", "C1")))
    line = result_of(finding).text().splitlines()[2]
    assert " ".join(line.split()) == "C1 other value 2 2.01 +0.5 % 0.1 %"
    assert kinds(compare(loop, Baseline.of(before))) == [Kind.MISSING_ROW] * 2


def test_a_phase_near_zero_may_move_by_a_thousandth_of_a_degree() -> None:
    # theory: seen from the origin, a turn by 0.001 degrees moves a point by 1.7e-5 of its distance
    allowed = limit(-0.0013, tolerance_of("phase_deg", {}))
    assert math.radians(allowed) == pytest.approx(1.745e-5, rel=1e-3)
    assert limit(90.0, tolerance_of("phase_deg.median", {})) == pytest.approx(0.09)
    assert limit(0.0, tolerance_of("rms_um", {})) == 1e-6
    assert tolerance_of("phase_deg", {"default": Tolerance(relative=0.1)}).relative == 0.1


def test_a_tolerance_for_an_unknown_number_is_refused(loop: Report) -> None:
    with pytest.raises(InputError, match=r"tolerances.rms_umm .*did you mean rms_um\?"):
        compare(loop, Baseline.of(loop), {"rms_umm": Tolerance()})


def test_rows_that_cannot_be_told_apart_are_refused(loop: Report) -> None:
    with pytest.raises(InputError, match=r"two rows are both .*compensator exact"):
        Baseline.of(with_rows(loop, ROW, ROW))


def test_a_check_passes_on_its_baseline_and_writes_nothing(accepted: Path) -> None:
    before = files_in(accepted)
    result = check_files([Path("scenarios")])
    assert (result.exit_code, result.findings) == (0, ())
    count = sum(len(numbers) for numbers in Baseline.load(Path("reports/baseline/large.json")).rows.values())
    assert (
        result.text() == f"large: {count} numbers within tolerance\nsmall: {count} numbers within tolerance"
    )
    Path("scenarios/small.toml").write_text(LOOP.format(amplitude=5.5))
    assert check_files([Path("scenarios")]).exit_code == 1
    Path("scenarios/small.toml").write_bytes(before["scenarios/small.toml"])
    assert files_in(accepted) == before
    assert sorted(before) == [
        *("reports/baseline/large.json", "reports/baseline/small.json"),
        *("scenarios/large.toml", "scenarios/small.toml"),
    ]


def test_one_scenario_fails_against_the_baseline_of_another(accepted: Path) -> None:
    baselines = Path("reports/baseline")
    (baselines / "small.json").replace(baselines / "large.json")
    found = kinds(check_files([Path("scenarios/large.toml")]).findings)
    assert found[0] is Kind.SCENARIO_CHANGED
    assert found.count(Kind.MISSING_ROW) == found.count(Kind.EXTRA_ROW) == 4  # 2 x 2 transfers
    said = check_files([Path("scenarios/large.toml")]).text()
    assert "rows of another amplitude_v are not compared: 5.0 in the baseline, 10.0 now" in said


def test_a_baseline_may_not_be_missing(accepted: Path) -> None:
    Path("reports/baseline/small.json").unlink()
    result = check_files([Path("scenarios")])
    assert (result.exit_code, kinds(result.findings)) == (1, [Kind.NO_BASELINE])
    assert "hammerstein check scenarios/small.toml --update-baseline" in result.text()


def test_an_orphan_counts_where_a_folder_is_checked(accepted: Path) -> None:
    Path("scenarios/small.toml").unlink()
    assert check_files([Path("scenarios/large.toml")]).exit_code == 0
    result = check_files([Path("scenarios")])
    assert (result.exit_code, kinds(result.findings)) == (1, [Kind.ORPHAN])
    assert "delete reports/baseline/small.json" in result.text()


def test_an_update_writes_whole_files_and_only_what_changed(accepted: Path) -> None:
    before = files_in(accepted)
    again = check_files([Path("scenarios")], update=True)
    assert [check.written for check in again.checks] == [False, False]
    assert again.text().startswith("large: baseline unchanged")
    Path("scenarios/small.toml").write_text(LOOP.format(amplitude=6))
    assert "small: baseline written" in check_files([Path("scenarios")], update=True).text()
    after = files_in(accepted)
    assert {name for name in after if after[name] != before.get(name)} == {
        *("reports/baseline/small.json", "scenarios/small.toml")
    }
    assert check_files([Path("scenarios")]).exit_code == 0


def test_a_scenario_that_cannot_run_does_not_hide_the_others(accepted: Path) -> None:
    Path("scenarios/far.toml").write_text(OUT_OF_REACH)
    Path("scenarios/small.toml").write_text(LOOP.format(amplitude=6))
    before = files_in(accepted)
    for update in (False, True):
        result = check_files([Path("scenarios")], update=update)
        assert result.exit_code == SimulationError.exit_code
        assert "far: could not be checked\n  far: the reference needs 500 um" in result.text()
        assert bool(result.findings) is not update
    changed = {name for name, data in files_in(accepted).items() if data != before.get(name)}
    assert changed == {"reports/baseline/small.json"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty"),
        ("{", "is not JSON"),
        ("{}", "is missing"),
        ('{"format": "hammerstein-baseline/1", "rows": [], "rows": []}', "contains the key 'rows' twice"),
        ('{"format": "hammerstein-baseline/9"}', "hammerstein-baseline/1"),
        (
            '{"format": "hammerstein-baseline/1", "scenario_digest": "a", "model_digest": "b", "rows": []}',
            "rows",
        ),
    ],
)
def test_a_broken_baseline_is_named_and_can_be_written_anew(
    accepted: Path, content: str, message: str
) -> None:
    Path("reports/baseline/small.json").write_text(content)
    result = check_files([Path("scenarios/small.toml")])
    assert result.exit_code == InputError.exit_code
    assert "reports/baseline/small.json" in result.text()
    assert message in result.text()
    assert "--update-baseline" in result.text()
    check_files([Path("scenarios/small.toml")], update=True)
    assert check_files([Path("scenarios/small.toml")]).exit_code == 0


def test_a_baseline_holds_no_nan(accepted: Path) -> None:
    path = Path("reports/baseline/small.json")
    content = json.loads(path.read_text())
    content["rows"][0]["numbers"]["gain"] = math.nan
    path.write_text(json.dumps(content))
    assert check_files([Path("scenarios/small.toml")]).exit_code == InputError.exit_code


@pytest.mark.full
def test_what_is_written_depends_neither_on_jobs_nor_on_the_folder(accepted: Path) -> None:
    elsewhere = Path("elsewhere")
    result = check_files([Path("scenarios")], elsewhere, update=True, jobs=2)
    assert [check.name for check in result.checks] == ["large", "small"]
    for name in ("large.json", "small.json"):
        assert (elsewhere / name).read_bytes() == (Path("reports/baseline") / name).read_bytes()


def test_finished_scenarios_are_told(accepted: Path) -> None:
    names: list[str] = []
    check_files([Path("scenarios")], finished=names.append)
    assert names == ["large", "small"]


def result_of(*findings: Finding, name: str = "circle") -> CheckResult:
    check = ScenarioCheck(name, Path(f"scenarios/{name}.toml"), 12, findings)
    return CheckResult((check, ScenarioCheck("spiral", Path("scenarios/spiral.toml"), 7)))


MOVED = Finding(Kind.MOVED, key_of(ROW.key() | {"amplitude_um": None}), "rms_um", 0.04127, 0.04391)


def test_a_number_that_moved_is_shown_with_what_to_do() -> None:
    assert result_of(MOVED).text() == (
        "circle: 1 of 12 numbers left its tolerance\n"
        "  compensator  frequency_hz  axis  metric  baseline  now      change  allowed\n"
        "  exact        50            y     rms_um  0.04127   0.04391  +6.4 %  0.1 %\n"
        "If you intended this change: hammerstein check scenarios/circle.toml --update-baseline\n"
        "spiral: 7 numbers within tolerance"
    )


def test_findings_of_every_kind_are_told_together() -> None:
    key = key_of(Row("", "x", "y", 50.0, amplitude_v=10.0).key())
    tiny = Finding(Kind.MOVED, key, "width_um", 0.0, 2e-6)
    text = result_of(
        Finding(Kind.SCENARIO_CHANGED, baseline="a", now="b"),
        Finding(Kind.MODEL_CHANGED, baseline="a", now="b"),
        tiny,
        Finding(Kind.MISSING_ROW, key),
        Finding(Kind.EXTRA_NUMBER, key, "gain", now=1.5),
    ).text()
    assert text.splitlines()[:5] == [
        "circle: the scenario, or a file beside its actuator, changed after the baseline was made, the "
        "actuator's model changed after the baseline was made, 1 of 12 numbers left its tolerance, 1 row is "
        "missing, 1 number is not in the baseline",
        "  frequency_hz  amplitude_v  axis    metric    baseline  now      change  allowed",
        "  50            10           x -> y  (row)     present   missing",
        "  50            10           x -> y  gain      missing   1.5",
        "  50            10           x -> y  width_um  0         2e-06    +2e-06  1e-06",
    ]


def test_a_long_table_shows_the_worst() -> None:
    many = [replace(MOVED, now=0.05 + 0.001 * i) for i in range(100)]
    lines = result_of(*many).text().splitlines()
    assert "0.149 " in lines[2]
    assert "the 20 worst are listed; 80 more" in lines[22]


def test_numbers_are_shown_with_the_digits_that_tell_them_apart() -> None:
    assert "0.12345678  0.12345679" in result_of(replace(MOVED, baseline=0.12345678, now=0.12345679)).text()


def test_junit_is_well_formed_whatever_the_labels_are() -> None:
    odd = replace(MOVED, key=(("compensator", "a\x01<b>&"),))
    stopped = ScenarioCheck("far", Path("scenarios/far.toml"), error=SimulationError("diverged"))
    result = CheckResult((*result_of(odd).checks, stopped))
    suite = ElementTree.fromstring(result.junit())[0]
    assert {name: suite.get(name) for name in ("tests", "failures", "errors")} == {
        "tests": "3",
        "failures": "1",
        "errors": "1",
    }
    assert [(case.get("name"), [child.tag for child in case]) for case in suite] == [
        ("circle", ["failure"]),
        ("spiral", []),
        ("far", ["error"]),
    ]
    assert "a\\x01<b>&" in str(suite[0][0].text)
    assert result.exit_code == SimulationError.exit_code


def test_the_summary_page_shows_every_scenario_and_every_table() -> None:
    page = result_of(replace(MOVED, key=(("compensator", "```"),)), name="a|b").markdown()
    assert "| a\\|b | **FAIL**: 1 of 12 numbers left its tolerance |" in page
    assert "| spiral | pass: 7 numbers within tolerance |" in page
    head, rule, row = [line for line in page.splitlines() if line.startswith("|")][4:]
    # a table, with the long name of the metric in its first column: lines of text scrolled sideways
    assert head.startswith("| compensator, metric |")
    assert set(rule) == set("|- ")
    assert row.startswith("| \\`\\`\\`, rms_um |")
    assert "| +6.4 % |" in row
    assert "--update-baseline" in page.split("```")[1]


def test_programs_get_plain_json() -> None:
    result = result_of(MOVED, Finding(Kind.NO_BASELINE), replace(MOVED, now=math.nan))
    content = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert content["exit_code"] == 1
    assert [scenario["passed"] for scenario in content["scenarios"]] == [False, True]
    finding = content["scenarios"][0]["findings"][0]
    assert (finding["kind"], finding["row"]["compensator"], finding["now"]) == ("moved", "exact", 0.04391)

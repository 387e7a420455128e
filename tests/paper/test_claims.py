import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import theory_linear
from pydantic import ValidationError

from hammerstein.errors import InputError
from hammerstein.experiment.run import run
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.paper import Paper
from hammerstein.paper.causes import Repeats, changes_of, variations
from hammerstein.paper.claims import Agreement, Claim, Quantity
from hammerstein.paper.judgements import Change, judgements
from hammerstein.paper.page import claims_csv, write_page
from hammerstein.scenario import Scenario, load_scenario

SCENARIOS = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))
ASSESSMENTS = [a for path in SCENARIOS if isinstance(a := load_scenario(path).assessment, Paper)]


def _row(rms, frequency=50.0, measured="x", true=None, label="a"):
    figures = {"rms_um": rms} | ({} if true is None else {"rms_true_um": true})
    return Row(label, "x", measured, frequency, amplitude_v=10.0, figures=figures)


ROWS = (_row(1.0, 10), _row(2.0, 50), _row(8.0, 200), _row(5.0, 50, "y"), _row(3.0, 50, label="b"))


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ({"compensator": "a", "measured_axis": "x", "frequency_hz": 50}, 2.0),
        ({"compensator": "a", "measured_axis": "x"}, 8.0),
        ({"measured_axis": "x", "of": "min"}, 1.0),
        ({"compensator": "a", "measured_axis": "x", "to_hz": 50, "of": "mean"}, 1.5),
        ({"compensator": "a", "measured_axis": "x", "from_hz": 50, "of": "spread"}, 4.0),
    ],
)
def test_quantity_selects_and_reduces(selection, expected):
    assert Quantity(metric="rms_um", **selection).value(ROWS) == expected


BENT = [_row(50.0 * math.sqrt(50 / f) if f < 50 else f, f) for f in (500, 150, 0.5, 5, 20, 50, 60)]
"""Errors that grow as f above 50 Hz, and as 1 / sqrt(f) below."""


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ({"of": "octaves_above"}, 1.0),
        ({"of": "octaves_above", "times": 3.0}, math.log2(3.0)),  # a frequency of the sweep
        ({"of": "octaves_above", "times": 9.99}, math.log2(9.99)),
        ({"of": "octaves_below"}, 2.0),
        ({"of": "octaves_below", "times": 4.0}, 4.0),
        ({"of": "octaves_below", "times": 9.99}, math.log2(9.99**2)),
        ({"of": "octaves_below", "times": 1.0}, 0.0),
    ],
)
def test_octaves_to_where_a_figure_has_grown(selection, expected):
    quantity = Quantity(metric="rms_um", found_hz=50, **selection)
    assert quantity.value(BENT) == pytest.approx(expected, rel=1e-12)
    assert quantity.value([*BENT, _row(0.01, 60), _row(0.01, 20)]) == pytest.approx(expected, rel=1e-12)
    assert math.isnan(quantity.value([row for row in BENT if row.frequency_hz != 50]))


def _claim(agreement, paper=None, **fields):
    return Claim.model_validate(
        {
            "id": "C0",
            "statement": "s",
            "paper": paper,
            "quantity": {"metric": "rms_um", "compensator": "a", "measured_axis": "x", "frequency_hz": 200},
            "agreement": agreement,
        }
        | fields
    )


def test_value_is_a_scaled_ratio():
    claim = _claim({"at_most": 1}, factor=0.5, over={"metric": "rms_um", "compensator": "b"})
    assert claim.value(ROWS) == pytest.approx(0.5 * 8.0 / 3.0)


@pytest.mark.parametrize(
    ("agreement", "value", "paper", "holds"),
    [
        ({"within": 0.1}, 1.09, 1.0, True),
        ({"within": 0.1}, 1.11, 1.0, False),
        ({"within": 0.1}, -1.09, -1.0, True),
        ({"at_most": 2.0}, 2.0, None, True),
        ({"at_most": 2.0}, 2.1, None, False),
        ({"at_least": 2.0, "at_most": 3.0}, 1.9, None, False),
        ({"at_least": 2.0}, math.nan, None, False),
    ],
)
def test_agreement(agreement, value, paper, holds):
    assert Agreement(**agreement).holds(value, paper) is holds


@pytest.mark.parametrize(
    ("agreement", "word"),
    [
        ({"at_least": 3.4}, "undecided"),
        ({"at_least": 3.3}, "met"),
        ({"at_least": 0.5, "at_most": 3.0}, "undecided"),
    ],
)
def test_a_sweep_that_ends_first_is_a_verdict_only_on_a_least_number_that_it_contains(agreement, word):
    """From 50 to 500 Hz are 3.32 octaves; the error does not grow a thousandfold in them."""
    quantity = {"metric": "rms_um", "of": "octaves_above", "found_hz": 50, "times": 1e3}
    (judgement,) = judgements([_claim(agreement, quantity=quantity)], {"plant": [BENT]})
    assert not math.isfinite(judgement.simulated[0].value)
    assert (judgement.word, judgement.agrees) == (word, word == "met")
    open_ = "The sweep ends before the value is reached." if word == "undecided" else ""
    assert judgement.reason == open_
    assert judgement.simulated[0].shown == "beyond the sweep"
    assert list(judgement.numbers()) == []


@pytest.mark.parametrize(
    ("values", "word", "shown"),
    [
        ((1.0,), "met", "1"),
        ((1.0, 1.9, 1.8), "met", "1 to 1.9"),
        ((3.0, 2.9, 3.1), "not met", "2.9 to 3.1"),
        ((1.9, 2.1, 1.9), "undecided", "1.9 to 2.1"),
        ((1.91, 1.912, 1.909), "met", "1.91"),
        ((1.93, 1.936, 1.931), "met", "1.93 to 1.94"),
        ((1.743, 1.796, 1.75), "met", "1.74 to 1.8"),
        ((116.44, 116.47, 116.45), "not met", "116"),
        ((116.2, 118.4, 117.0), "not met", "116 to 118"),
    ],
)
def test_a_claim_is_judged_where_all_seeds_and_sample_times_agree(values, word, shown):
    runs = [(_row(value, 200),) for value in values]
    (judgement,) = judgements([_claim({"at_most": 2.0})], {"plant": runs})
    assert (judgement.word, judgement.simulated[0].shown) == (word, shown)


def test_a_ratio_to_noise_is_more_than_its_lower_end():
    over = {"metric": "rms_um", "compensator": "b"}
    runs = [(_row(300.0, 200), _row(by, label="b")) for by in (1.0, 0.5)]
    (judgement,) = judgements([_claim({"at_least": 5.0}, over=over)], {"plant": runs})
    assert judgement.simulated[0].shown == "more than 300"
    (bounded,) = judgements([_claim({"at_least": 5.0, "at_most": 9e3}, over=over)], {"plant": runs})
    assert bounded.simulated[0].shown == "300 to 600"


def _changed(*changes):
    return lambda claim: [Change.of(factor, words, claim, values) for factor, words, *values in changes]


def _told(*changes, agreement=None):
    runs = {"plant": [(_row(8.0, 200),)]}
    (judgement,) = judgements([_claim(agreement or {"at_most": 2.0})], runs, _changed(*changes))
    assert len(judgement.reason.split()) <= 15
    return judgement


def test_the_cause_is_the_only_change_that_brings_agreement():
    one = _told(("passes", "with 16 passes", 7.5), ("dynamics", "without dynamics", 1.5))
    assert (one.cause, one.reason) == ("the dynamics", "The claim is met without dynamics: the value is 1.5.")
    assert one.details == "With 16 passes 7.5; without dynamics 1.5"
    two = _told(("sensor", "ideal", 1.9), ("dynamics", "without dynamics", 1.5))
    assert (two.cause, two.reason) == ("", "Not unique: more than one change brings agreement.")
    none = _told(("sensor", "ideal", 4.0), ("passes", "more", math.nan))
    assert (none.cause, none.reason) == (
        "",
        "No change of one or two factors of this actuator brings agreement.",
    )


def test_a_cause_brings_agreement_with_every_seed_and_sample_time():
    sometimes = ("passes", "with 16 passes", 1.1, 2.5, 1.4)
    one = _told(sometimes, ("dynamics", "without dynamics", 1.5, 1.61))
    assert (one.cause, one.reason) == (
        "the dynamics",
        "The claim is met without dynamics: the value is 1.5 to 1.6.",
    )
    assert one.details == "With 16 passes 1.1 to 2.5; without dynamics 1.5 to 1.6"
    assert _told(sometimes).reason == "No change of one or two factors of this actuator brings agreement."


def test_digits_of_a_change_do_not_agree_where_its_figure_does_not():
    claim = _claim({"at_most": 1.0})
    assert Change.of("passes", "with 16 passes", claim, [1.02]).shown == "1.02"
    assert Change.of("passes", "with 16 passes", claim, [1.06]).shown == "1.1"
    assert Change.of("passes", "with 16 passes", claim, [0.98]).shown == "0.98"


def test_a_change_that_brings_agreement_is_repeated_as_the_run_itself():
    scenario = load_scenario(SCENARIOS[0].with_name("circles.toml"))
    model = HammersteinModel.load(scenario.actuator)
    asked = scenario.assessment.claims[0].model_copy(update={"factors": ("sensor", "sample_time")})
    told = {c.factor: c for c in changes_of(scenario, model, asked, Repeats(seeds=2, finer=(2,)))}
    assert all(" to " not in change.shown for change in told.values())  # none brings agreement
    easy = asked.model_copy(update={"agreement": Agreement(at_least=0.1)})
    told = {c.factor: c for c in changes_of(scenario, model, easy, Repeats(seeds=2, finer=(2,)))}
    assert all(change.agrees for change in told.values())
    assert " to " in told["sensor"].shown  # T/2 is not T, though a sensor without noise has no seed


def test_a_pair_is_the_cause_where_no_single_factor_is():
    pair = ("sensor + dynamics", "with an ideal sensor and without dynamics", 1.0)
    found = _told(("sensor", "ideal", 4.0), ("dynamics", "without dynamics", 3.0), pair)
    assert found.cause == "the sensor and the dynamics"
    other = ("passes + dynamics", "more and without dynamics", 1.2)
    assert _told(("sensor", "ideal", 4.0), pair, other).cause == ""
    calibrated = _claim({"at_most": 2.0}, calibrated=True)
    (kept,) = judgements([calibrated], {"plant": [(_row(8.0, 200),)]}, _changed(pair))
    assert kept.reason == "The actuator was fitted to several such figures together; no change was tried."
    assert kept.changes == ()


def test_the_first_actuator_judges():
    claim = _claim({"at_most": 4.0}, paper=4.0, quote="four")
    (judgement,) = judgements([claim], {"own": [ROWS], "other": [(_row(2.0, 200),)]})
    assert [one.agrees for one in judgement.simulated] == [False, True]
    assert not judgement.agrees
    assert judgement.ratio == "2"
    assert judgement.word == "not met"


def test_the_ratio_has_the_digits_of_the_figure():
    claim = _claim({"at_most": 4.0}, paper=2.0, quote="two")
    (judgement,) = judgements([claim], {"own": [(_row(v, 200),) for v in (3.1, 2.9, 3.6)]})
    assert judgement.cells()["ratio"] == judgement.ratio == "1.4 to 1.8"


def test_cut_voltages_are_told_beside_the_claim():
    row = Row("a", "x", "x", 200.0, figures={"rms_um": 1.0, "saturated_samples": 12})
    (judgement,) = judgements([_claim({"at_most": 2.0})], {"plant": [(row,)]})
    assert judgement.agrees
    assert judgement.reason == ""
    assert judgement.details == "The reference exceeds the range: the drive clipped 12 samples"


def test_rows_are_divided_by_those_of_their_own_place():
    rows = [
        Row(label, "x", axis, 50.0, figures={"rms_um": value})
        for label, axis, value in (("a", "x", 2.0), ("a", "y", 9.0), ("b", "x", 1.0), ("b", "y", 3.0))
    ]
    quantities = {
        "quantity": {"metric": "rms_um", "compensator": "a"},
        "over": {"metric": "rms_um", "compensator": "b"},
    }
    assert _claim({"at_most": 2.0}, **quantities).value(rows) == 3.0  # 9 / 3, each the largest of its own
    assert _claim({"at_most": 2.0}, row_by_row=True, **quantities).value(rows) == 3.0
    turned = [replace(rows[0], figures={"rms_um": 8.0}), *rows[1:]]
    assert _claim({"at_most": 2.0}, row_by_row=True, **quantities).value(turned) == 8.0


def test_the_cause_of_a_lagging_sensor_is_found_on_the_chain_itself():
    content = {
        "question": "?",
        "actuator": "duo_bimorph_static",
        "instruments": {"sensor": {"bandwidth_hz": 500, "noise_um": 0, "resolution_um": 0}},
        "reference": {"kind": "sine", "amplitude_um": 20, "frequency_hz": 100, "axis": 1},
        "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
        "assessment": {
            "kind": "paper",
            "claims": [
                {
                    "id": "C",
                    "statement": "follows",
                    "quantity": {"metric": "rms_um", "measured_axis": "x"},
                    "agreement": {"at_most": 0.5},
                }
            ],
        },
    }
    (judgement,) = run(content).judgements
    half_a_hold = np.exp(-1j * np.pi * 100.0 * 50e-6)
    lag = 1.0 - theory_linear.first_order(100.0, 500.0) * half_a_hold
    assert judgement.simulated[0].value == pytest.approx(abs(lag) * 20 / np.sqrt(2), rel=0.02)
    changed = {change.factor: change.value for change in judgement.changes}
    assert changed["sensor"] < 1e-3
    assert changed["dynamics"] == pytest.approx(judgement.simulated[0].value, rel=1e-9)
    assert "passes" not in changed  # the law has none
    assert judgement.cause == "the sensor"


@pytest.mark.parametrize("octaves", [{}, {"of": "octaves_above", "found_hz": 50}])
def test_a_claim_that_counts_from_where_it_was_found_is_not_asked_what_finding_it_elsewhere_makes(octaves):
    content = {
        "question": "?",
        "actuator": "duo_bimorph",
        "reference": {"kind": "sine", "amplitude_um": 50, "frequency_hz": 50},
        "compensators": [
            {"label": "a", "law": "inverse_multiplicative", "identification": {"frequency_hz": 50}}
        ],
    }
    tried = variations(
        Scenario.model_validate(content),
        HammersteinModel.load("duo_bimorph"),
        _claim({"at_least": 0.5}, quantity={"metric": "rms_um", **octaves}),
    )
    found = {variation.factor for variation in tried}  # singles alone
    assert "dynamics" in found
    assert ("identification_frequency" in found) == (not octaves)


def test_met_claims_need_no_reason():
    (judgement,) = judgements([_claim({"at_most": 9.0})], {"plant": [ROWS]})
    assert judgement.agrees
    assert judgement.reason == ""
    assert judgement.word == "met"


def test_a_claim_that_selects_nothing_is_a_mistake():
    claim = _claim({"at_most": 1}, quantity={"metric": "rms_um", "compensator": "c"})
    with pytest.raises(InputError, match="selects no row"):
        judgements([claim], {"plant": [ROWS]})


@pytest.mark.parametrize(
    "fields",
    [
        {"agreement": {}},
        {"agreement": {"within": 0.1}},
        {"paper": 1.0},
        {"quantity": {"metric": "rms"}},
        {"quantity": {"metric": "rms_um", "of": "octaves_below"}},
        {"quantity": {"metric": "rms_um", "found_hz": 50}},
    ],
)
def test_refused(fields):
    with pytest.raises(ValidationError):
        _claim(
            fields.get("agreement", {"at_most": 1}), **{k: v for k, v in fields.items() if k != "agreement"}
        )


def test_the_page_opens_with_what_holds_where_and_puts_calibration_apart(tmp_path):
    claim = {
        "id": "C1",
        "statement": "moves",
        "quantity": {"metric": "height_um", "measured_axis": "x"},
        "agreement": {"at_least": 1.0},
    }
    claims = [
        claim,
        claim | {"id": "C2", "agreement": {"at_least": 1e6}},
        claim | {"id": "C3", "calibrated": True},
    ]
    content = {
        "question": "?",
        "actuator": "duo_bimorph_static",
        "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0, "axis": 1},
        "assessment": {
            "kind": "paper",
            "claims": claims,
            "also_on": [{"actuator": "duo_bimorph_paper"}],
        },
    }
    report = run(content, "one")
    write_page([report], tmp_path, tmp_path / "page")
    text = (tmp_path / "page" / "README.md").read_text()
    assert text.index("## Beyond the paper") < text.index("## Claims")  # claims come after the figures
    assert "| 1 of 2 met, 0 undecided | paper, equations 12 and 13 | `duo_bimorph_static` |" in text
    assert "* **C2**, not met. No change of one or two factors of this actuator brings agreement." in text
    counted, apart = text.split("The actuators were made from these loops")
    assert "| C3 |" in apart
    assert "| C3 |" not in counted
    assert ", no |" in counted
    table = {(row["id"], row["actuator"]): row for row in csv.DictReader(claims_csv([report]).splitlines())}
    assert table["C2", "duo_bimorph_static"]["reason"]
    assert not table["C2", "duo_bimorph_paper"]["reason"]  # found on the other actuator


def test_the_page_has_the_order_of_the_paper(tmp_path):
    """Section 5.3 stood between Figs. 5 and 6, with a small letter."""
    drive = {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}
    content = {"question": "?", "actuator": "duo_bimorph_static", "drive": drive}
    places = ("section 6: b", "Fig. 10", "", "section 5.3: a", "Fig. 7, and section 5.3")
    reports = [
        run(content | ({"assessment": {"kind": "paper", "figure": place}} if place else {}), f"one{k}")
        for k, place in enumerate(places)
    ]
    write_page(reports, tmp_path, tmp_path / "page")
    heads = [line for line in (tmp_path / "page/README.md").read_text().splitlines() if line[:3] == "## "]
    ordered = [
        "Fig. 7, and section 5.3",
        "Fig. 10",
        "Section 5.3: a",
        "Section 6: b",
        "Beyond the paper: `one2`",
    ]
    assert heads == [f"## {head}" for head in ordered]


def test_every_figure_of_the_paper_quotes_its_sentence_and_every_column_runs_the_same_law():
    claims = [c for a in ASSESSMENTS for c in a.claims]
    assert len(claims) > 35
    assert all(claim.quote for claim in claims)
    assert {name for a in ASSESSMENTS for other in a.also_on for name in other.model_fields_set} == {
        "actuator"
    }
    assert all(a.seeds >= 2 and a.finer for a in ASSESSMENTS if a.claims)

"""The committed scan of readings says of the packaged actuators what their accepted numbers say."""

import csv
import json
from pathlib import Path

import pytest

from hammerstein.paper import Paper
from hammerstein.scenario import load_scenario

REPORTS = Path(__file__).parents[2] / "reports"
SCENARIOS = REPORTS.parent / "scenarios"
SCAN = REPORTS / "paper/readings/readings.csv"


def accepted(actuator: str) -> dict[str, float]:
    """What an actuator answers to each claim, from the baselines."""
    rows = [
        row for path in (REPORTS / "baseline").glob("*.json") for row in json.loads(path.read_text())["rows"]
    ]
    mine = [row for row in rows if "claim" in row["key"] and row["key"]["actuator"] == actuator]
    return {row["key"]["claim"]: row["numbers"]["value"] for row in mine}


@pytest.mark.parametrize(
    ("actuator", "reading"),
    [
        ("duo_bimorph", ["-3 dB", "0.12", "True", "1", "False"]),
        ("duo_bimorph_resonant", ["resonance", "0.15", "True", "1", "False"]),
        ("duo_bimorph_paper", ["+3 dB", "0.01", "False", "1", "False"]),
        ("duo_bimorph_static_read", ["none", "0.0", "True", "1", "False"]),
    ],
)
def test_the_scan_holds_the_accepted_numbers(actuator: str, reading: list[str]) -> None:
    header, *lines = csv.reader(SCAN.read_text(encoding="utf-8").splitlines())
    (line,) = [line for line in lines if line[:5] == reading]
    scanned = {claim: float(value) for claim, value in zip(header[6:], line[6:], strict=True)}
    assert len(scanned) > 30
    known = accepted(actuator)
    assert scanned == pytest.approx({claim: known[claim] for claim in scanned}, rel=1e-3)


def test_every_claim_that_is_counted_can_fail() -> None:
    """Each holds under some reading and fails under another; the printed epsilon (C8.1) is not counted."""
    lines = list(csv.DictReader(SCAN.read_text(encoding="utf-8").splitlines()))
    assessments = [load_scenario(path).assessment for path in sorted(SCENARIOS.glob("*.toml"))]
    claims = [c for a in assessments if isinstance(a, Paper) for c in a.claims if c.id in lines[0]]
    counted = [claim for claim in claims if not claim.calibrated and claim.id != "C8.1"]
    assert len(counted) == 25
    for claim in counted:
        met = {claim.agreement.holds(float(row[claim.id]), claim.paper) for row in lines if row[claim.id]}
        assert met == {True, False}, claim.id


def test_the_packaged_reading_meets_as_many_claims_as_any_other_of_the_printed_law() -> None:
    """With dynamics, one pass a sample, identified at 10 V, as the paper says."""
    lines = list(csv.DictReader(SCAN.read_text(encoding="utf-8").splitlines()))
    printed = [v for v in lines if v["bandwidth"] != "none" and v["passes"] == "1"]
    printed = [line for line in printed if line["identified_at_path"] == "False"]
    (packaged,) = [v for v in printed if list(v.values())[:3] == ["+3 dB", "0.01", "False"]]
    assert packaged["met"] == max((line["met"] for line in printed), key=int)


def test_the_pages_say_how_close_the_literal_reading_comes_to_the_circle() -> None:
    literal = [
        v for v in csv.DictReader(SCAN.read_text(encoding="utf-8").splitlines()) if v["bandwidth"] == "-3 dB"
    ]
    closest = min(float(line["C8"]) for line in literal if line["C8"])
    once = min(float(line["C8"]) for line in literal if line["C8"] and line["passes"] == "1")
    for page, words in (
        (SCAN.parent / "README.md", "with one pass a sample within {:.2g} um. "),
        (REPORTS / "paper/README.md", "and within {:.2g} um if the law makes one pass per sample"),
    ):
        text = " ".join(page.read_text(encoding="utf-8").split())
        assert f"within {closest:.2g} um on each axis at best, " in text
        assert words.format(once) in text


def test_the_readings_page_names_ties() -> None:
    text = (SCAN.parent / "README.md").read_text(encoding="utf-8")
    lines = list(csv.DictReader(SCAN.read_text(encoding="utf-8").splitlines()))
    best = max(int(line["met"]) for line in lines)
    tied = [line for line in lines if int(line["met"]) == best]
    assert f"hold under {len(tied)} readings:" in text
    assert text.count("\n* ") == len(tied)

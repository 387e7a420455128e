"""The first screen: the digest of many reports, the overview, the first lines of a fit report."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import theory

from hammerstein.commands.cli import main
from hammerstein.experiment.report import Report
from hammerstein.experiment.run import run
from hammerstein.reporting.overview import digest, write_overview
from hammerstein.reporting.summary import sentences

CIRCLE = {"kind": "circle", "radius_um": 20, "frequency_hz": 50}
SINE = {"kind": "sine", "amplitude_um": 20, "frequency_hz": 80}


def _content(reference: dict[str, object]) -> dict[str, object]:
    return {
        "question": "?",
        "actuator": "duo_bimorph_static",
        "reference": reference,
        "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
    }


@pytest.fixture(scope="module")
def reports() -> list[Report]:
    claim = {
        "id": "C",
        "statement": "follows",
        "quantity": {"metric": "rms_um", "measured_axis": "x"},
        "agreement": {"at_most": 1e-9},
    }
    judged = _content(CIRCLE) | {"assessment": {"kind": "paper", "claims": [claim]}}
    examples = [run(_content(signal), f"one{i}") for i, signal in enumerate([CIRCLE, CIRCLE, CIRCLE, SINE])]
    return [*examples, *[run(judged, f"claim{i}") for i in range(20)]]


def test_many_reports_end_in_fifteen_lines(reports: list[Report], tmp_path: Path) -> None:
    lines = digest(reports, tmp_path)
    assert len(lines) <= 15
    assert lines[0] == f"open first: {tmp_path / 'index.html'}"
    told = [line for line in lines if line.endswith(" um (exact)")]
    assert len(told) == 3
    assert all("20 um" in line and "Hz" in line for line in told)
    assert any("sine, 20 um, 80 Hz" in line for line in told)  # not three of one kind
    assert "  duo_bimorph_static (paper, equations 12 and 13): 0 of 20 met, 0 undecided" in lines
    assert not any("not met" in line for line in lines)


@pytest.mark.parametrize("alone", [True, False])
def test_compensators_that_meet_nowhere_leave_no_cell_empty(alone: bool) -> None:
    """One number in each row and column: its rows are the runs, without a screen of empty cells."""
    found = []
    for hz in (50.0, 100.0):
        law = {"label": f"at {hz:g}", "law": "exact_inverse", "model": "duo_bimorph_static"}
        found.append(law | ({"only_at_hz": [hz]} if alone else {}))
    asked = _content(SINE) | {"sweep": {"frequency_hz": [50.0, 100.0]}, "compensators": found}
    (table,) = [one.table for one in sentences(run(asked)) if one.table]
    assert all(map(all, table))
    assert table[0] == (
        ("[um]", "direct", "cross-coupling") if alone else ("direct / cross-coupling [um]", "50 Hz", "100 Hz")
    )
    assert {row[0] for row in table[1:]} == (
        {"50 Hz, at 50", "100 Hz, at 100"} if alone else {"at 50", "at 100"}
    )


def test_a_headline_leaves_out_what_the_range_alone_decides(tmp_path: Path) -> None:
    """Input y moves y by 50.5 um at 10 V, so no law follows a circle of 52 um."""
    swept = run(_content(CIRCLE) | {"sweep": {"radius_um": [20, 52]}}, "swept")
    line = digest([swept], tmp_path)[1]
    words, _, value = line.removesuffix(" um (exact)").rpartition(": ")
    assert words == "swept: worst true error, circle, 20 um, 50 Hz"
    assert float(value) < 0.5
    write_overview([swept], tmp_path)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Beyond the drive's range, so not counted: 52\xa0um" in page
    assert "Keep this file with the folders beside it" in page  # and does not say that it is one file
    beyond = run(_content(CIRCLE | {"radius_um": 52}), "beyond")
    told = digest([beyond], tmp_path)[1]
    assert float(told.removesuffix(" um (exact)").rpartition(": ")[2]) > 0.5


def test_claims_have_a_section_of_their_own_below_the_examples(reports: list[Report], tmp_path: Path) -> None:
    write_overview(reports, tmp_path)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    examples, _, paper = page.partition(">Claims of the paper<")
    assert "one0/report.html" in examples
    assert "claim0/report.html" in paper
    assert "claim" not in examples.partition("<main")[2].replace("claims met", "claim")
    assert "circle, 20\xa0um, 50\xa0Hz" in examples
    assert 'class="bad"' not in page
    begun = "<p>Not met or undecided; each report says what is known of the cause:"
    told = re.search(rf"{begun}(.*?)</p>", page, re.S)[1]
    links = re.findall(r'<a href="(claim\d+)/report.html">\1</a> \(C\)', told)
    assert links == [f"claim{i}" for i in range(20)]
    assert "reports/paper/readings/README.md" in paper


def test_a_card_without_errors_tells_the_loops(tmp_path: Path) -> None:
    drive = {"kind": "sine", "amplitude_v": 10, "frequency_hz": 50}
    asked = {"question": "?", "actuator": "duo_bimorph_static", "drive": drive}
    report = run(asked | {"sweep": {"frequency_hz": [20, 50]}}, "loops")
    write_overview([report], tmp_path)
    page = (tmp_path / "index.html").read_text(encoding="utf-8").replace("\xa0", " ")
    assert "<p>Loops, sine, 10 V, 20 to 50 Hz: <em>x</em> 117 um high, " in page


def test_the_next_command_after_a_fit_without_validation_can_be_pasted(tmp_path: Path) -> None:
    """It repeats the identification as it was asked for, with a record that the person makes."""
    t = 1e-3 * np.arange(6000)
    for name, cycles in (("my record.csv", 2.0), ("my record_validation.csv", 3.0)):
        u = 5.0 * np.sin(2.0 * np.pi * cycles * t / t[-1])
        plays = theory.plays(u, np.array([0.0, 1.0]), np.zeros(2))
        pd.DataFrame({"t": t, "volts": u, "path": plays.sum(axis=0)}).to_csv(tmp_path / name, index=False)
    asked = [str(tmp_path / "my record.csv"), "--inputs", "volts", "--outputs", "path", "--time", "t"]
    asked += [
        "--units",
        "um",
        "--thresholds",
        "0,1",
        "--dynamics",
        "none",
        "--out",
        str(tmp_path / "own.json"),
        "--no-figures",
    ]
    with pytest.raises(SystemExit):
        main(["identify", *asked])
    page = (tmp_path / "own_fit" / "report.md").read_text(encoding="utf-8")
    command = next(line for line in page.splitlines() if line.startswith("* Next: record another motion"))
    words = shlex.split(command.split("`")[1])
    assert words[:2] == ["hammerstein", "identify"]
    assert [word for word in asked if word not in words] == ["--no-figures"]
    with pytest.raises(SystemExit) as caught:
        main(words[1:])
    assert not caught.value.code
    page = (tmp_path / "own_fit" / "report.md").read_text(encoding="utf-8")
    assert f"* Next: `hammerstein compensate '{tmp_path}" in page or f"compensate {tmp_path}/own.json" in page

"""All claims and figures of a run on one page, and the claims as a table."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from hammerstein.escaping import csv_text, markdown_page
from hammerstein.experiment.report import Report
from hammerstein.model import HammersteinModel, packaged_actuators
from hammerstein.paper.judgements import ClaimJudgement
from hammerstein.quantities import by_key
from hammerstein.reporting.run_page import place_of
from hammerstein.runtime.staging import Manifest, Owner, Stage, staged

CLAIMS = Owner("claims")
PAGE = Owner("page")
MARKS = {True: "", False: ", no", None: ", ?"}  # of a verdict, behind its figure
CLAIMS_FILE, PAGE_FILE = "claims.csv", "README.md"
MOST_PICTURES = 20  # one a report; the other figures are in the reports


def claimed(report: Report) -> list[ClaimJudgement]:
    """Judgements of claims in a report."""
    return [judgement for judgement in report.judgements if isinstance(judgement, ClaimJudgement)]


def printed_at(report: Report) -> str:
    """The figure of the paper that a report simulates; empty if none."""
    return str(getattr(report.scenario.assessment, "figure", ""))


def claims_csv(reports: Sequence[Report]) -> str:
    """All claims of all reports as CSV: one line for each claim and actuator."""
    return csv_text(
        [
            {
                "id": judgement.id,
                "scenario": report.name,
                "statement": judgement.statement,
                "paper": judgement.paper,
                "unit": judgement.unit,
                "wanted": judgement.wanted,
                "calibrated": judgement.calibrated,
                "actuator": one.actuator,
                "simulated": one.value,
                "lowest": one.low,
                "highest": one.high,
                "verdict": one.word,
                "reason": judgement.reason if one is judgement.simulated[0] else "",
            }
            for report in reports
            for judgement in claimed(report)
            for one in judgement.simulated
        ]
    )


def write_claims(reports: Sequence[Report], out: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write ``claims.csv``, if there are any; give the place of one that a person had changed.

    Raises InputError if it cannot be written.
    """
    if not any(map(claimed, reports)):
        return ()
    with staged(out, CLAIMS, overwrite) as stage:
        stage.write(CLAIMS_FILE, claims_csv(reports))
    return stage.kept


def write_page(reports: Sequence[Report], out: Path, page: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write one page from reports that are already written below ``out``: claims and figures.

    Reports that simulate a figure of the paper come first, in the order of the figures. Gives the places of
    files of an earlier page that a person had changed and that were kept.

    Raises InputError if the page cannot be written.
    """
    chosen = sorted(reports, key=_in_order)
    with staged(page, PAGE, overwrite) as stage:
        figures = {r.name: _copied(r, out, stage) for r in chosen[:MOST_PICTURES]}
        stage.write(PAGE_FILE, _rendered(chosen, figures))
    return stage.kept


def _in_order(report: Report) -> tuple[bool, bool, list[int], str]:
    """Figures of the paper by their numbers, then its sections, then what is not in the paper."""
    place = printed_at(report)
    numbers = [int(word) for word in re.findall(r"\d+", re.split("[,:]", place)[0])]
    return not place, not place.startswith("Fig"), numbers, report.name


def _copied(report: Report, out: Path, stage: Stage) -> list[str]:
    """Copy the key figure of a report beside the page; give its name.

    It shows the reading, as the paper does; beyond the paper the true position, where there is such a figure.
    """
    folder = out / report.name
    drawn = [name for name in Manifest.read(folder).files if name.endswith(".png")]
    printed = bool(printed_at(report))
    ordered = sorted(drawn, key=lambda name: (("_true" in name) is printed, place_of(name)))
    for figure in ordered[:1]:
        stage.write(f"{report.name}-{figure}", (folder / figure).read_bytes())
    return [f"{report.name}-{figure}" for figure in ordered[:1]]


def _rendered(reports: Sequence[Report], figures: dict[str, list[str]]) -> str:
    judgements = [judgement for report in reports for judgement in claimed(report)]
    actuators = list(dict.fromkeys(one.actuator for judgement in judgements for one in judgement.simulated))
    counted = [judgement for judgement in judgements if not judgement.calibrated]
    return markdown_page(
        "page.md.jinja",
        package="hammerstein.paper",
        reports=reports,
        figures=figures,
        places={report.name: (at := printed_at(report))[:1].upper() + at[1:] for report in reports},
        circle=next((j for j in counted if j.id == "C8"), None),  # in the words on the literal reading
        readings=readings_of(reports),
        tables=[_table(group, actuators) for group in (counted, [j for j in judgements if j.calibrated])],
        quoted={  # sentences of the paper, each with the claims that it makes
            quote: [judgement.id for judgement in own]
            for quote, own in by_key(judgements, lambda judgement: judgement.quote).items()
            if quote
        },
        unmet=[j for j in counted if not j.agrees],
        total=len(counted),
    )


def readings_of(reports: Sequence[Report]) -> list[Met]:
    """The counted claims of all reports, by the actuator that they were asked of."""
    counted = [j for report in reports for j in claimed(report) if not j.calibrated]
    answers = by_key((one for j in counted for one in j.simulated), lambda one: one.actuator)
    return [Met(name, _reading(name), [one.agrees for one in own]) for name, own in answers.items()]


class Met(NamedTuple):
    """Verdicts on the claims asked of one actuator, and the reading of the paper that it is."""

    actuator: str
    words: str
    verdicts: Sequence[bool | None]

    def text(self) -> str:
        """Counts of met and undecided claims."""
        met, undecided = self.verdicts.count(True), self.verdicts.count(None)
        return f"{met} of {len(self.verdicts)} met, {undecided} undecided"


def _reading(actuator: str) -> str:
    """Reading of the paper that a packaged actuator represents; empty for another actuator."""
    if actuator not in packaged_actuators():
        return ""
    told = HammersteinModel.load(actuator).provenance
    return str(told.get("bandwidth", told.get("source", ""))) if isinstance(told, dict) else ""


def _table(judgements: Sequence[ClaimJudgement], actuators: Sequence[str]) -> list[tuple[str, ...]]:
    """Cells of each claim: the figure of every actuator, with ``no`` or ``?`` where it is not met."""
    rows = []
    for judgement in judgements:
        found = {one.actuator: one for one in judgement.simulated}
        cells = [found[name].shown + MARKS[found[name].agrees] if name in found else "" for name in actuators]
        rows.append((judgement.id, judgement.statement, judgement.printed, judgement.wanted, *cells))
    return rows

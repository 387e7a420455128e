"""All claims and figures of a run on one page, and the claims as a table."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hammerstein.escaping import cell, markdown
from hammerstein.experiment.report import Report
from hammerstein.scenario.claims import Verdict
from hammerstein.storage.manifest import Manifest, Owner
from hammerstein.storage.staging import Stage, staged

CLAIMS = Owner("claims", sign=("claims.csv", "id,scenario,statement,paper,unit,"))
PAGE = Owner("page", sign=("README.md", "# The paper, simulated"))


@dataclass(frozen=True)
class Line:
    """One claim as text, for a terminal or a page."""

    id: str
    statement: str
    paper: str
    simulated: tuple[tuple[str, str], ...]
    ratio: str
    wanted: str
    verdict: str
    reason: str

    @classmethod
    def of(cls, verdict: Verdict) -> Line:
        """Give the text of a verdict."""
        return cls(
            id=verdict.id,
            statement=verdict.statement,
            paper="" if verdict.paper is None else f"{verdict.paper:g} {verdict.unit}".strip(),
            simulated=tuple((answer.actuator, f"{answer.value:.3g}") for answer in verdict.answers),
            ratio="" if verdict.ratio is None else f"{verdict.ratio:.2f}",
            wanted=verdict.wanted,
            verdict="met" if verdict.agrees else "not met",
            reason=verdict.reason,
        )


def claims_csv(reports: Sequence[Report]) -> str:
    """All claims of all reports as CSV: one line for each claim and actuator."""
    table = [
        {
            "id": verdict.id,
            "scenario": report.name,
            "statement": verdict.statement,
            "paper": verdict.paper,
            "unit": verdict.unit,
            "wanted": verdict.wanted,
            "actuator": answer.actuator,
            "simulated": answer.value,
            "agrees": answer.agrees,
            "reason": verdict.reason,
        }
        for report in reports
        for verdict in report.verdicts
        for answer in verdict.answers
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]) if table else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: cell(v) if isinstance(v, str) else v for k, v in line.items()} for line in table)
    return text.getvalue()


def write_claims(reports: Sequence[Report], out: Path) -> tuple[Path, ...]:
    """Write ``claims.csv``; give the place of one that a person had changed and that was kept.

    Raises InputError if it cannot be written.
    """
    with staged(out, CLAIMS) as stage:
        stage.write(CLAIMS.sign[0], claims_csv(reports))
    return stage.kept


def write_page(reports: Sequence[Report], out: Path, page: Path) -> tuple[Path, ...]:
    """Write one page from reports that are already written below ``out``: claims, figures, answers.

    Reports that answer a figure of the paper come first, in the order of the figures. Gives the places of
    files of an earlier page that a person had changed and that were kept.

    Raises InputError if the page cannot be written.
    """
    chosen = sorted(reports, key=_in_order)
    with staged(page, PAGE) as stage:
        figures = {report.name: _copied(report, out, stage) for report in chosen}
        stage.write(PAGE.sign[0], _rendered(chosen, figures))
    return stage.kept


def _in_order(report: Report) -> tuple[bool, list[int], str]:
    """Figures in the order of their numbers; what has no number first, what is not in the paper last."""
    words = "".join(c if c.isdigit() else " " for c in (report.scenario.paper_figure or "").split(",")[0])
    numbers = [int(word) for word in words.split()][:1]
    return report.scenario.paper_figure is None, numbers, report.name


def _copied(report: Report, out: Path, stage: Stage) -> list[str]:
    """Copy the figures of a report beside the page; give their names."""
    folder = out / report.name
    figures = sorted(name for name in Manifest.read(folder).files if name.endswith(".png"))
    for figure in figures:
        stage.write(f"{report.name}-{figure}", (folder / figure).read_bytes())
    return [f"{report.name}-{figure}" for figure in figures]


def _rendered(reports: Sequence[Report], figures: dict[str, list[str]]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("hammerstein"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # Markdown, which has its own filter
    )
    environment.filters["md"] = markdown
    lines = {report.name: [Line.of(verdict) for verdict in report.verdicts] for report in reports}
    every = [line for report in reports for line in lines[report.name]]
    met = sum(line.verdict == "met" for line in every)
    return environment.get_template("paper.md.jinja").render(
        reports=reports, figures=figures, lines=lines, met=met, total=len(every)
    )

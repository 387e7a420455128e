"""One page over a run of many scenarios: a card each, with its key figure and its worst numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from hammerstein.experiment.report import Report
from hammerstein.experiment.selection import is_direct, labels_of, number
from hammerstein.reporting.html.markup import rendered
from hammerstein.reporting.page import place_of
from hammerstein.storage.manifest import Manifest, Owner
from hammerstein.storage.staging import staged

OVERVIEW = Owner("overview", sign=("index.html", '<meta name="generator" content="hammerstein overview">'))
MOST_SHOWN = 3


@dataclass(frozen=True)
class Card:
    """One scenario.

    page, picture : places of its report and its key figure, as links; the picture may be missing
    worst : label and worst error of each compensator or model, best first
    """

    name: str
    question: str
    page: str
    picture: str
    worst: tuple[tuple[str, str], ...]
    more: int
    met: int
    claims: int


def write_overview(reports: Sequence[Report], out: Path) -> tuple[Path, ...]:
    """Write ``index.html`` over reports that lie below ``out``.

    Gives the place of one that a person had changed and that was kept; InputError if it cannot be written.
    """
    with staged(out, OVERVIEW) as stage:
        cards = [_card(report, out) for report in reports]
        stage.write(OVERVIEW.sign[0], rendered("overview.html.jinja", cards=cards))
    return stage.kept


def _card(report: Report, out: Path) -> Card:
    drawn = [name for name in Manifest.read(out / report.name).files if name.endswith(".png")]
    picture = min(drawn, key=place_of, default="")
    worst = _worst(report)
    return Card(
        name=report.name,
        question=report.scenario.question,
        page=quote(f"{report.name}/report.html"),
        picture=quote(f"{report.name}/{picture}") if picture else "",
        worst=tuple(worst[:MOST_SHOWN]),
        more=max(0, len(worst) - MOST_SHOWN),
        met=sum(verdict.agrees for verdict in report.verdicts),
        claims=len(report.verdicts),
    )


def _worst(report: Report) -> list[tuple[str, str]]:
    """Largest error of the true position of each label, over its direct transfers and paths."""
    found = {}
    for label in labels_of(report.rows):
        own = [row for row in report.rows if row.compensator == label]
        rows = [row for row in own if is_direct(report, row)] or own
        values = [
            value for row in rows if (value := row.euclidean_max_true_um or row.max_true_um) is not None
        ]
        if values:
            found[label] = max(values)
    return [(label, number(value)) for label, value in sorted(found.items(), key=lambda item: item[1])]

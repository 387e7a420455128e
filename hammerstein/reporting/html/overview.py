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
from hammerstein.runtime.storage.manifest import Manifest, Owner
from hammerstein.runtime.storage.staging import staged

OVERVIEW = Owner("overview", sign=("index.html", '<meta name="generator" content="hammerstein overview">'))
MOST_SHOWN = 3


@dataclass(frozen=True)
class Card:
    """One scenario.

    page, picture : places of its report and its key figure, as links; the picture may be missing
    told : what the numbers are
    worst : label and worst error of each compensator or model, best first
    """

    name: str
    question: str
    page: str
    picture: str
    told: str
    worst: tuple[tuple[str, str], ...]
    more: int
    met: int
    asked: int


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
        told=_told(report),
        worst=tuple(worst[:MOST_SHOWN]),
        more=max(0, len(worst) - MOST_SHOWN),
        met=sum(judgement.agrees for judgement in report.judgements),
        asked=len(report.judgements),
    )


def _told(report: Report) -> str:
    """What the numbers of a card are."""
    words, uncertainty = "Worst error", report.scenario.uncertainty
    if last := _last_trial(report):
        words += f" in trial {last}"
    if report.bands and uncertainty is not None:
        words += f" over {uncertainty.draws} drawn actuators, median (5 to 95 %)"
    return words


def _last_trial(report: Report) -> int | None:
    """Last trial of what learns; None where nothing does."""
    return max((row.trial for row in report.rows if row.trial is not None), default=None)


def _worst(report: Report) -> list[tuple[str, str]]:
    """Largest error of the true position of each label, over its direct transfers and paths.

    Of drawn actuators it is the band whose upper end is largest; of what learns that of the last trial.
    """
    last = _last_trial(report)
    bands = {(band.metric, *band.place): band for band in report.bands}
    found: dict[str, tuple[float, str]] = {}
    for label in labels_of(report.rows):
        own = [row for row in report.rows if row.compensator == label and row.trial == last]
        values = []
        for row in [row for row in own if is_direct(report, row)] or own:
            metric = "euclidean_max_true_um" if row.euclidean_max_true_um else "max_true_um"
            band, value = bands.get((metric, *row.place)), getattr(row, metric)
            if band is not None:
                spread = f"({number(band.p5_um)} to {number(band.p95_um)})"
                values.append((band.p95_um, f"{number(band.median_um)} {spread}"))
            elif value is not None:
                values.append((value, number(value)))
        if values:
            found[label] = max(values)
    return [(label, text) for label, (_, text) in sorted(found.items(), key=lambda item: item[1][0])]

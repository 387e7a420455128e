"""The report of a run as a page for a browser: the answer first, then what it rests on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePath

from markupsafe import Markup

from hammerstein.escaping import clean
from hammerstein.experiment.report import Report
from hammerstein.reporting.html.interactive import Interactive
from hammerstein.reporting.html.markup import link_to, rendered
from hammerstein.reporting.html.vector import Drawn, drawings
from hammerstein.reporting.page import (
    MOST_STATEMENTS,
    gathered,
    glossary_of,
    picture_of,
    place_of,
    setting_of,
    source_of,
)
from hammerstein.reporting.summary import sentences
from hammerstein.reporting.tables import NumberTable, number_tables

MOST_LINES = 250
"""Lines of all tables together; a longer sweep is thinned."""
SHOWN_FREQUENCIES = (1000, 40, 20, 10, 6)


def run_page(report: Report, files: Mapping[str, bytes], interactive: Interactive | None = None) -> str:
    """HTML page of a report; equal reports give equal bytes.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``
    files : bytes of its figures by name, as SVG; none gives a page without figures
    interactive : plots to zoom into, if they were asked for
    """
    figures = list(_figures(report, files))
    statements = gathered(report.statements)
    asked = report.scenario.assessment
    here = {
        "Explore": bool(interactive),
        **({asked.title: True} if asked is not None and report.judgements else {}),
        "Figures": bool(figures),
        "Numbers": True,
        "Keep in mind": bool(statements),
        "How it was run": True,
        "What the names mean": True,
    }
    return rendered(
        "report.html.jinja",
        report=report,
        answer=[sentence.map(_told) for sentence in sentences(report, _quoted)],
        facts=list(_facts(report)),
        met=sum(judgement.agrees for judgement in report.judgements),
        parts=[name for name, there in here.items() if there],
        asked=asked,
        figures=figures,
        statements=statements[:MOST_STATEMENTS],
        unsaid=len(statements[MOST_STATEMENTS:]),
        tables=_tables(report),
        setting=list(setting_of(report)),
        sources=[source_of(source) for source in (*report.scenario.compensators, *report.scenario.models)],
        glossary=glossary_of(report),
        links=[
            link_to("rms.csv", report.to_csv(), "text/csv"),
            *([link_to("bands.csv", report.bands_to_csv(), "text/csv")] if report.bands else []),
            *(
                [link_to("sensitivities.csv", report.sensitivities_to_csv(), "text/csv")]
                if report.sensitivities
                else []
            ),
            link_to("report.json", report.to_json(), "application/json"),
        ],
        interactive=interactive,
    )


_OPEN, _CLOSE = "\ue000", "\ue001"


def _quoted(label: str) -> str:
    return _OPEN + label.replace(_OPEN, "").replace(_CLOSE, "") + _CLOSE


def _told(sentence: str) -> Markup:
    """A sentence with its labels in italics, all of it escaped."""
    escaped = str(Markup.escape(clean(sentence)))
    return Markup(escaped.replace(_OPEN, "<em>").replace(_CLOSE, "</em>"))


def _facts(report: Report) -> Iterator[str]:
    scenario = report.scenario
    for number, what in ((len(scenario.compensators), "compensator"), (len(scenario.models), "model")):
        if number:
            yield f"{number} {what}{'s' * (number > 1)}"
    found = sorted({row.frequency_hz for row in report.rows if row.frequency_hz})
    if found:
        yield f"{found[0]:g} Hz" if len(found) == 1 else f"{found[0]:g} to {found[-1]:g} Hz"
    yield f"{scenario.signal.kind} {'in V' if scenario.drive is not None else 'in um'}"


def _figures(report: Report, files: Mapping[str, bytes]) -> Iterator[Drawn]:
    names = sorted((name for name in files if name.endswith(".svg")), key=place_of)
    shown = {PurePath(name).stem: picture_of(name, report) for name in names}
    titles = {name: f"{picture.title} ({name})" for name, picture in shown.items()}
    for (name, picture), drawing in zip(shown.items(), drawings(files, titles), strict=True):
        yield Drawn(name, picture.title, picture.caption, drawing)


def _tables(report: Report) -> list[NumberTable]:
    """Tables of as many frequencies as a page can hold."""
    for frequencies in SHOWN_FREQUENCIES:
        found = list(number_tables(report, frequencies))
        if sum(len(table.lines) for table in found) <= MOST_LINES:
            break
    return found

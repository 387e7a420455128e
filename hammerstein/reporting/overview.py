"""Overview of many reports: a page with one card for each, and a digest for the terminal."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from hammerstein.experiment.report import Condition, Report, labels_of, number, told_apart
from hammerstein.metrics import Row
from hammerstein.quantities import by_key
from hammerstein.reporting.page import rendered
from hammerstein.reporting.run_page import place_of
from hammerstein.reporting.summary import span
from hammerstein.runtime.staging import Manifest, Owner, staged
from hammerstein.scenario.assessment import Assessment

OVERVIEW = Owner("overview")
PAGE = "index.html"
MOST_SHOWN = 3  # headlines on the terminal
MOST_LINES = 7  # of what an assessment found, on the terminal


Card = dict[str, Any]
"""One scenario, for the template."""


def write_overview(reports: Sequence[Report], out: Path, overwrite: bool = False) -> tuple[Path, ...]:
    """Write ``index.html`` over reports that lie below ``out``.

    Gives the place of one that a person had changed and that was kept; InputError if it cannot be written.
    """
    with staged(out, OVERVIEW, overwrite) as stage:
        page = rendered("overview.html.jinja", sections=_sections(reports, out), total=len(reports))
        stage.write(PAGE, page)
    return stage.kept


def digest(reports: Sequence[Report], out: Path) -> list[str]:
    """At most fifteen lines on many reports: files to open, three headlines, place of the claims.

    Headlines are of reports without judgements, one of each kind of signal first.
    """
    lines = [f"open first: {out / PAGE}"]
    telling = [report for report in reports if report.scenario.compensators and _worst(report)]
    first = {report.scenario.signal.kind: report for report in reversed(telling)}.values()
    telling.sort(key=lambda report: (report not in first, report.name))
    for report in [report for report in telling if not report.judgements][:MOST_SHOWN]:
        (label, value), told = _worst(report)[0], _told(report)
        lines.append(f"{report.name}: {told[0].lower()}{told[1:]}: {value} um ({label})")
    for kind, asked in _assessed(reports).items():
        found = [f"  {line}" for line in kind.tally(asked)]
        lines += [f"{kind.title}, judged in each report and on the overview:", *found[:MOST_LINES]]
    return lines


def _assessed(reports: Sequence[Report]) -> dict[type[Assessment], list[Report]]:
    """Reports with judgements, by the kind of their assessment."""
    found: dict[type[Assessment], list[Report]] = {}
    for report in reports:
        if report.scenario.assessment is not None and report.judgements:
            found.setdefault(type(report.scenario.assessment), []).append(report)
    return found


def _sections(reports: Sequence[Report], out: Path) -> Iterator[tuple[str, list[str], str, list[Card]]]:
    """Title, result of an assessment over all, where its reasons are, and cards; assessed ones below."""
    assessed = _assessed(reports)
    judged = {id(report) for group in assessed.values() for report in group}
    examples = [_card(report, out) for report in reports if id(report) not in judged]
    if examples:
        yield "Examples" if assessed else "", [], "", examples
    for kind, group in assessed.items():
        yield kind.title, kind.tally(group), kind.more, [_card(report, out) for report in group]


def _card(report: Report, out: Path) -> Card:
    """Links to its report and its key figure, and the worst error of each compensator or model, best first.

    It also names omitted conditions, in which the drive's range clipped the voltages of every compensator.
    """
    drawn = [name for name in Manifest.read(out / report.name).files if name.endswith(".svg")]
    picture = min(drawn, key=place_of, default="")
    worst = [(label, f"{value} um") for label, value in _worst(report)]
    told, shown = (_told(report), worst) if worst else (f"Loops, {_conditions(report)}", _loops(report))
    words = [judgement.word for judgement in report.judgements]
    return {
        "name": report.name,
        "question": report.scenario.question,
        "page": quote(f"{report.name}/report.html"),
        "picture": quote(f"{report.name}/{picture}") if picture else "",
        "told": told,
        "shown": tuple(shown[:MOST_SHOWN]),
        "more": max(0, len(shown) - MOST_SHOWN),
        "beyond": _beyond_range(report),
        "verdicts": ", ".join(f"{words.count(word)} {word}" for word in sorted(set(words))),
        "unmet": [judgement.id for judgement in report.judgements if not judgement.agrees],
    }


def _loops(report: Report) -> list[tuple[str, str]]:
    """Ends of the height and of the width of the loops of each axis that is driven itself."""
    own = [row for row in _within_range(report) if row.height_um and report.is_direct(row)]
    return [
        (axis, f"{_ends(rows, 'height_um')} um high, {_ends(rows, 'width_percent')} % wide")
        for axis, rows in by_key(own, lambda row: row.measured_axis).items()
    ]


def _ends(rows: Sequence[Row], name: str) -> str:
    """Least and largest value of a figure."""
    values = [float(value) for row in rows if (value := getattr(row, name)) is not None]
    return " to ".join(dict.fromkeys([number(min(values)), number(max(values))])) if values else "?"


def _conditions(report: Report) -> str:
    """Signal, amplitude and frequency, such as ``circle, 50 um, 50 to 200 Hz``."""
    conditions = [Condition.of(row) for row in _within_range(report)]
    sizes = span([(c.amplitude, c.unit) for c in conditions if c.amplitude])
    frequencies = span([(c.frequency_hz, "Hz") for c in conditions if c.frequency_hz])
    return ", ".join(filter(None, (report.signal, sizes, frequencies)))


def _told(report: Report) -> str:
    """What the numbers of a card are."""
    words, uncertainty = f"Worst true error, {_conditions(report)}", report.scenario.uncertainty
    if last := _last_trial(report):
        words += f" in trial {last}"
    if report.bands and uncertainty is not None:
        words += f" over {uncertainty.draws} random actuators, median (5 to 95 %)"
    return words


def _within_range(report: Report) -> list[Row]:
    """Rows of conditions that some compensator reaches; all rows where none reaches any.

    Where the drive's range clips the voltages of every compensator, the error is the range's, not theirs.
    """
    runs = list(by_key(report.rows, Condition.of).values())
    cut = [{row.compensator for row in rows if row.saturated_samples} for rows in runs]
    reached = [rows for rows, those in zip(runs, cut, strict=True) if those != set(labels_of(rows))] or runs
    return [row for rows in reached for row in rows]


def _beyond_range(report: Report) -> str:
    """Conditions that the worst errors leave out, such as ``50 um``."""
    kept = {Condition.of(row) for row in _within_range(report)}
    names = told_apart(list(dict.fromkeys(map(Condition.of, report.rows))))
    return "; ".join(words for condition, words in names.items() if condition not in kept)


def _last_trial(report: Report) -> int | None:
    """Last trial of what learns; None where nothing does."""
    return max((row.trial for row in report.rows if row.trial is not None), default=None)


def _worst(report: Report) -> list[tuple[str, str]]:
    """Largest error of the true position of each label, over direct transfers and paths within range.

    Of random actuators it is the band whose upper end is largest; of what learns that of the last trial.
    """
    last = _last_trial(report)
    bands = {(band.metric, *band.place): band for band in report.bands}
    found: dict[str, tuple[float, str]] = {}
    rows = _within_range(report)
    for label in labels_of(rows):
        own = [row for row in rows if row.compensator == label and row.trial == last]
        values = []
        for row in [row for row in own if report.is_direct(row)] or own:
            metric = "euclidean_max_true_um" if row.euclidean_max_true_um else "max_true_um"
            band, value = bands.get((metric, *row.place)), getattr(row, metric)
            if band is not None:
                values.append((band.p95_um, band.words()))
            elif value is not None:
                values.append((value, number(value)))
        if values:
            found[label] = max(values)
    return [(label, text) for label, (_, text) in sorted(found.items(), key=lambda item: item[1][0])]

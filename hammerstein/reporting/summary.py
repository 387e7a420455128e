"""Answer of a report in sentences, from its rows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from hammerstein.experiment.report import (
    Condition,
    Report,
    banded_metric,
    is_direct,
    is_path,
    labels_of,
    largest,
    number,
    percent,
    told_apart,
)
from hammerstein.metrics import METRICS, Row
from hammerstein.quantities import by_key, number_of
from hammerstein.signals import OneFrequency

MOST_RANGES = 2  # ranges of a sweep that are told one by one; more are counted
MOST_COLUMNS = 4  # conditions in the table
MOST_ROWS = 8  # compensators or models in the table
MOST_LABELS = 3  # compensators or models that are told in one clause
NOT_SETTLED = "has not settled"  # the words of a statement of the report
NEVER_SETTLES = "does not settle in"  # of one that says that more cycles do not help
DRIVE_CUT = "the drive's range clipped"  # in statements of a run
SENSOR_CUT = "the sensor's range clipped"  # those of another
DIVERGES = "does not converge: slopes"  # the same
FLAGGED = ": flagged by its fit report"  # the same
ITSELF = ": designed from the simulated actuator itself"  # the same
GUESSED = "Its motion beyond is unknown"  # the same

Quote = Callable[[str], str]


class Sentence(NamedTuple):
    """A sentence of an answer.

    table : what it introduces: a head, then one row for each compensator, model or run
    """

    words: str
    table: tuple[tuple[str, ...], ...] = ()


def sentences(report: Report, quote: Quote = str) -> list[Sentence]:
    """Result in one sentence, with a table for several numbers; then remarks on the runs.

    quote : formats a label, for example in italics
    """
    named = Contest.of(report, quote)
    compared = any(row.rms_um is not None for row in report.rows)
    found = _answered(report, quote) or _uncertain(report, named)
    found = found or (_compared(report, named) if compared else _loops(report))
    return [found, Sentence(" ".join(_conduct(report)))]


@dataclass(frozen=True)
class Contest:
    """Labels in sentences, and those that cannot win: diverging laws, and no compensation."""

    quote: Quote
    diverging: frozenset[str]
    idle: frozenset[str]

    @classmethod
    def of(cls, report: Report, quote: Quote) -> Contest:
        """Return the contest of a report."""
        said = [text for text in report.statements if DIVERGES in text]
        labels = labels_of(report.rows)
        diverging = {label for label in labels if any(text.startswith(f"{label}: ") for text in said)}
        idle = {source.label for source in report.scenario.compensators if source.law == "none"}
        return cls(quote, frozenset(diverging), frozenset(idle))

    def named(self, label: str) -> str:
        """A label in a list."""
        return self.quote(label) + (" (does not converge)" if label in self.diverging else "")

    def winner(self, label: str) -> str:
        """A label that has the smallest value."""
        better = " (no law that converges is better)" if self.diverging else " (no compensator is better)"
        return self.quote(label) + (better if label in self.idle else "")

    def admitted(self, found: dict[str, float]) -> dict[str, float]:
        """Labels without the laws that do not converge."""
        return {label: value for label, value in found.items() if label not in self.diverging}


def _answered(report: Report, quote: Quote) -> Sentence | None:
    """The figure that answers the question, where the scenario names one: the largest of either sign."""
    name = report.scenario.answered_by
    if name is None:
        return None
    found: dict[str, float] = {}
    for row in report.rows:
        if is_direct(report, row) and (value := getattr(row, name)) is not None:
            found[row.compensator] = max(value, found.get(row.compensator, value), key=abs)
    ordered = sorted(found.items(), key=lambda item: abs(item[1]))
    told = ", ".join(f"{quote(label)} {number(value)}" for label, value in ordered)
    several = len({(Condition.of(row), row.measured_axis) for row in report.rows if is_direct(report, row)})
    worst = f", at the worst of {several} frequencies, amplitudes and axes" if several > 1 else ""
    return Sentence(f"The {METRICS[name].meaning}{worst}: {told}.") if found else None


def _uncertain(report: Report, contest: Contest) -> Sentence | None:
    """Median and 95 % limit over the random actuators, and the nominal one: the worst of each."""
    if not report.bands or report.scenario.uncertainty is None:
        return None
    metric, words = banded_metric(report)
    nominal = {row.place: getattr(row, metric) for row in report.rows if is_direct(report, row)}
    bands = [band for band in report.bands if band.metric == metric and band.place in nominal]
    rows = []
    for (trial, label), own in by_key(bands, lambda band: (band.trial, band.compensator)).items():
        name = contest.named(label) + ("" if trial is None else f", trial {trial}")
        each = zip(*((band.median_um, band.p95_um, nominal[band.place]) for band in own), strict=True)
        rows.append((name, *(number(max(values)) for values in each)))
    at = ", each number at its worst frequency" if len({row.frequency_hz for row in report.rows}) > 1 else ""
    return Sentence(
        f"The {words} of the true position for {report.scenario.uncertainty.draws} random actuators{at}:",
        (("[um]", "median", "95 % limit", "nominal actuator"), *rows),
    )


def _compared(report: Report, contest: Contest) -> Sentence:
    """The error of the true position, or of the reading if the scenario's assessment is about it."""
    target = "reference" if report.scenario.reference is not None else "prediction"
    if is_path(report):
        prefix, words = ("euclidean_", "distance") if len(report.axes) > 1 else ("", "error")
        name, of = ("max_um", "reading") if report.reading_first else ("max_true_um", "true position")
        name, words = f"{prefix}{name}", f"worst {words} of the {of} from the {target}"
        groups: list[list[Row]] = [list(report.rows)]
    else:
        name, of = ("rms_um", "reading") if report.reading_first else ("rms_true_um", "true position")
        words = f"rms error of the {'predicted ' * (target == 'prediction')}{of}"
        direct = [row for row in report.rows if is_direct(report, row)]
        groups = [direct, [row for row in report.rows if not is_direct(report, row)]]
    kinds = [
        {c: _values(rows, name) for c, rows in by_key(group, Condition.of).items()}
        for group in groups
        if group
    ]
    ((condition, found), *more) = kinds[0].items()
    if more or len(kinds) > 1:
        return _table(kinds, words, contest)
    texts = [f"{contest.named(n)} {number(v)} um" for n, v in found.items()]
    if condition.amplitude and condition.unit == "um" and "max" in name:  # as a part of the path's size
        parts = [percent(value / condition.amplitude) for value in found.values()]
        texts = [f"{text} ({part})" for text, part in zip(texts, parts, strict=True)]
    if len(texts) > MOST_LABELS + 1:
        texts = [*texts[:MOST_LABELS], f"largest: {texts[-1]}"]
    return Sentence(f"The {words}: {', '.join(texts)}.")


def _values(rows: Iterable[Row], name: str) -> dict[str, float]:
    """Largest value over the axes by label, smallest first."""
    own = by_key(rows, lambda row: row.compensator)
    known = [(n, value) for n, rows in own.items() if (value := largest(rows, name)) is not None]
    return dict(sorted(known, key=lambda item: item[1]))


def _table(kinds: Sequence[dict[Condition, dict[str, float]]], words: str, contest: Contest) -> Sentence:
    """Figures of one or two kinds: one row for each label, the best first, or for each run.

    Of a long sweep some conditions are shown, and its sentence says who has the smallest value where.
    """
    first = kinds[0]
    ordered = sorted(first, key=lambda c: (c.amplitude or 0.0, c.frequency_hz, c.trial or 0))
    names = told_apart(ordered)
    labels = sorted({n for found in first.values() for n in found}, key=lambda n: (_typical(first, n), n))
    shown = ordered
    if len(ordered) > MOST_COLUMNS:  # the ends, the middle, and where the best one is worst
        worst = max(ordered, key=lambda c: first[c].get(labels[0], 0.0))
        kept = {ordered[0], ordered[len(ordered) // 2], worst, ordered[-1]}
        shown = [condition for condition in ordered if condition in kept]
    winners = [min(rest, key=rest.__getitem__) for c in ordered if (rest := contest.admitted(first[c]))]
    best = ""
    if len(ordered) > MOST_COLUMNS and len(labels) > 1 and winners:
        ranges = _ranges([names[c] for c in ordered if contest.admitted(first[c])], winners, contest.winner)
        best = f"; smallest{' direct error' * (len(kinds) > 1)}: {ranges}"

    def figures(condition: Condition, label: str) -> list[str]:
        return [number(found.get(condition, {}).get(label)) for found in kinds]

    both = ", direct / cross-coupling" * (len(kinds) > 1)
    if any(len(found) > 1 for found in first.values()):
        told = labels if len(labels) <= MOST_ROWS else [*labels[: MOST_ROWS - 1], labels[-1]]
        rows = [(contest.named(n), *(" / ".join(filter(None, figures(c, n))) for c in shown)) for n in told]
        return Sentence(f"The {words}{both}{best}:", (("[um]", *(names[c] for c in shown)), *rows))
    rows = [
        (f"{names[c]}, {contest.named(n)}" if len(labels) > 1 else names[c], *figures(c, n))
        for c in shown
        for n in first[c]
    ]
    heads = ("direct", "cross-coupling") if both else ("error",)
    return Sentence(f"The {words}{best}:", (("[um]", *heads), *rows))


def listed(texts: Sequence[str]) -> str:
    """Join texts with commas and "and".

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _typical(values: dict[Condition, dict[str, float]], label: str) -> float:
    """Geometric mean over the sweep: the large values near a resonance do not decide alone."""
    logarithms = [math.log(max(found[label], 1e-12)) for found in values.values() if label in found]
    return sum(logarithms) / len(logarithms)


def _ranges(names: Sequence[str], winners: Sequence[str], quote: Quote) -> str:
    """``A from 10 Hz to 40 Hz and B at 50 Hz``; who has most of them where that gets long."""
    pairs = groupby(zip(winners, names, strict=True), key=lambda pair: pair[0])
    groups = [(label, [name for _, name in own]) for label, own in pairs]
    if len(groups) == 1:
        return f"{quote(winners[0])} throughout"
    if len(groups) > MOST_RANGES:
        most = max(dict.fromkeys(winners), key=winners.count)
        return f"{quote(most)} at {winners.count(most)} of {len(winners)} points of the sweep"
    told = [
        f"{quote(label)} {f'at {inside[0]}' if len(inside) == 1 else f'from {inside[0]} to {inside[-1]}'}"
        for label, inside in groups
    ]
    return listed(told)


def _loops(report: Report) -> Sentence:
    """Height and width of the loops in the first and in the last run of a sweep."""
    measured = [row for row in report.rows if row.height_um is not None]
    if not measured:
        return Sentence("There is no reference to compare with: the figures show the sensor's readings.")
    inside = by_key(measured, Condition.of)
    ends = list(dict.fromkeys([next(iter(inside)), next(reversed(inside))]))
    lines: dict[str, list[str]] = {}
    for condition in ends:
        for row in (row for row in inside[condition] if is_direct(report, row)):
            lines.setdefault(f"{row.measured_axis}, height [um]", []).append(number(row.height_um))
            lines.setdefault(f"{row.measured_axis}, width [%]", []).append(number(row.width_percent))
        cross = largest((row for row in inside[condition] if not is_direct(report, row)), "height_um")
        if cross is not None:
            lines.setdefault("largest cross-coupling, height [um]", []).append(number(cross))
    head = ("loop", *(condition.words() for condition in ends))
    told = ((name, *cells) for name, cells in lines.items())
    return Sentence("The loops of the sensor's reading:", (head, *told))


def _grouped(runs: Sequence[str]) -> str:
    """Runs by their compensator or model, such as ``paper (3 runs, 15 to 40 Hz)``."""
    found: dict[str, list[tuple[float, str]]] = {}
    for run in runs:
        label, _, place = run.partition(": ")[0].rpartition(" at ")
        at = re.match(r"([\d.e+-]+) (Hz|um|V)", place)
        found.setdefault(label or place, []).extend([(float(at[1]), at[2])] if at else [])
    if len(found) >= MOST_LABELS:
        return f"{len(found)} methods{_spread([at for own in found.values() for at in own])}, listed below"
    return "; ".join(f"{label}{_spread(own)}" for label, own in found.items())


def _spread(places: Sequence[tuple[float, str]]) -> str:
    """Number of runs and their frequencies or sizes, in brackets."""
    if not places:
        return ""
    ends = " to ".join(f"{value:g}" for value, _ in dict.fromkeys([min(places), max(places)]))
    return f" ({number_of(len(places), 'run')}, {ends} {places[0][1]})"


def doubts(report: Report) -> list[str]:
    """Statements of a report that make its figures doubtful."""
    return [text for text in report.statements if FLAGGED in text or GUESSED in text]


def unsettled_runs(report: Report) -> str:
    """Sentence on runs that had not settled; empty if all had."""
    texts, runs = [text for text in report.statements if NOT_SETTLED in text], len(_runs(report))
    if not texts:
        return ""
    never = sum(NEVER_SETTLES in text for text in texts)
    after = "raise settle_cycles or settle_s in [measure]"
    if never:
        some = f"{after} (does not help {never} of them)"
        after = some if never < len(texts) else "more cycles do not help, see the limits of these results"
    named = f"{len(texts)} of {runs} runs had not settled: {_grouped(texts)}"
    named = named if len(texts) != runs else "No run had settled"
    return f"{named}. These numbers still change; {after}."


def _runs(report: Report) -> dict[tuple[str, str, Condition], Row]:
    """A row of each run: each compensator is one, models share theirs."""
    compared = report.scenario.reference is not None
    return {(r.compensator if compared else "", r.excited_axis, Condition.of(r)): r for r in report.rows}


def _clipped(report: Report, words: str, what: str) -> str:
    """Sentence on runs that a range clipped; empty if it clipped none."""
    texts, runs = [text for text in report.statements if words in text], len(_runs(report))
    named = f": {_grouped(texts)}" if len(texts) < runs else ""
    return f"{what} in {len(texts)} of {runs} runs{named}." if texts else ""


def _conduct(report: Report) -> Iterator[str]:
    """Whether the drive's range was enough, and whether what repeats had settled."""
    if any(ITSELF in text for text in report.statements):
        yield "A law designed from the simulated actuator itself has a perfect model, unlike a real one."
    if flagged := [text.partition(FLAGGED)[0] for text in report.statements if FLAGGED in text]:
        yield f"Flagged by {'its' if len(flagged) == 1 else 'their'} fit report: {', '.join(flagged)}."
    if any(GUESSED in text for text in report.statements):
        yield "The voltages exceed the records of the simulated actuator: its motion there is extrapolated."
    yield _clipped(report, DRIVE_CUT, "The drive's range clipped the voltage") or "No voltage was clipped."
    if reading := _clipped(report, SENSOR_CUT, "The sensor's range clipped the reading"):
        yield reading
    signal = report.scenario.signal
    if unsettled := unsettled_runs(report):
        yield unsettled
    elif isinstance(signal, OneFrequency) and signal.repeats and report.scenario.measure.measured_cycles > 1:
        yield "Every run had settled."

"""The answer of a report in plain sentences, made from its rows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from hammerstein.experiment.report import Band, Report
from hammerstein.experiment.selection import (
    Condition,
    by_condition,
    is_direct,
    is_path,
    labels_of,
    largest,
    number,
    percent,
    told_apart,
)
from hammerstein.metrics import METRICS, Row
from hammerstein.signals import OneFrequency

MOST_CLAUSES = 4  # conditions that are told one by one; more are told as ranges of frequency
MOST_LABELS = 4  # compensators or models that are told in one clause
NOT_SETTLED = "has not settled"  # the words of a statement of the report
NEVER_SETTLES = "does not settle in"  # of one that says that more cycles do not help
SENSOR_CUT = "the sensor's range cut"  # those of another
DIVERGES = "does not converge: slopes"  # the same
FLAGGED = ": flagged by its fit report"  # the same
ITSELF = ": designed from the simulated actuator itself"  # the same
GUESSED = "Its motion beyond is unknown"  # the same

Quote = Callable[[str], str]


@dataclass(frozen=True)
class Sentence:
    """A sentence of an answer; what differs from condition to condition are its points.

    table : the points as a table: a head, then one row for each compensator or model
    """

    words: str
    points: tuple[str, ...] = ()
    table: tuple[tuple[str, ...], ...] = ()

    def __str__(self) -> str:
        return f"{self.words} {'; '.join(self.points)}." if self.points else self.words


@dataclass(frozen=True)
class Merit:
    """A figure by which compensators and models are compared: its name in a row, and its meaning."""

    name: str
    words: str


def answer(report: Report, quote: Quote = str) -> str:
    """One paragraph: results, saturated drives, and loops that had not settled.

    Parameters
    ----------
    report : report of a run
    quote : formats a label, for example in italics
    """
    return " ".join(map(str, sentences(report, quote)))


def sentences(report: Report, quote: Quote = str) -> list[Sentence]:
    """The sentences of the answer, the figure that the scenario asks for first."""
    compared = any(row.rms_um is not None for row in report.rows)
    found = _compared(report, quote) if compared else map(Sentence, _loops(report))
    before = [*_answered(report, quote), *_uncertain(report, quote)]
    return [*map(Sentence, before), *found, Sentence(" ".join(_conduct(report)))]


@dataclass(frozen=True)
class Contest:
    """How labels are written, and which of them cannot win: laws that do not converge, and doing nothing."""

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
        """Without the laws that do not converge."""
        return {label: value for label, value in found.items() if label not in self.diverging}


def _answered(report: Report, quote: Quote) -> Iterator[str]:
    """The figure that answers the question, where the scenario names one: the largest of either sign."""
    name = report.scenario.answered_by
    if name is None:
        return
    found = {}
    for label in labels_of(report.rows):
        rows = [row for row in report.rows if row.compensator == label and is_direct(report, row)]
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        if values:
            found[label] = max(values, key=abs)
    if found:
        ordered = sorted(found.items(), key=lambda item: abs(item[1]))
        told = listed([f"{number(value)} with {quote(label)}" for label, value in ordered])
        yield f"The {METRICS[name].meaning} is {told}."


def _uncertain(report: Report, quote: Quote) -> Iterator[str]:
    """What the drawn actuators do: median and 95 % of the worst condition."""
    if not report.bands or report.scenario.uncertainty is None:
        return
    path = is_path(report) and len(report.axes) > 1
    metric, words = (
        ("euclidean_max_true_um", "worst distance")
        if path
        else ("rms_true_um", "rms error of the true position (direct transfers)")
    )
    direct = {row.place for row in report.rows if is_direct(report, row)}
    told_bands = [band for band in report.bands if band.metric == metric and band.place in direct]
    trials = sorted({band.trial for band in told_bands}, key=lambda trial: trial or 0)
    clauses = []
    for trial in dict.fromkeys([*trials[:1], *trials[-1:]]):
        told = listed(list(_worst_bands([band for band in told_bands if band.trial == trial], quote)))
        clauses.append(told if trial is None else f"in trial {trial}: {told}")
    if told_bands:
        draws = report.scenario.uncertainty.draws
        yield (
            f"For {draws} random actuators, the {words}, median and 95 % limit in the worst run: "
            f"{'; '.join(clauses)}. For the nominal (undisturbed) actuator:"
        )


def _worst_bands(bands: Sequence[Band], quote: Quote) -> Iterator[str]:
    """Median and 95 % limit of each label, in the row where it is worst."""
    for label in dict.fromkeys(band.compensator for band in bands):
        worst = max((band for band in bands if band.compensator == label), key=lambda band: band.p95_um)
        yield f"{number(worst.median_um)} and {number(worst.p95_um)} um with {quote(label)}"


def _compared(report: Report, quote: Quote) -> Iterator[Sentence]:
    """Sentences on every merit, of the reading and of the true position.

    The true position comes first, or the reading if the scenario's assessment is about it. With an ideal
    sensor, both are the same and only one is given.
    """
    target = "reference" if report.scenario.reference is not None else "prediction"
    contest = Contest.of(report, quote)
    if is_path(report):
        prefix, words = ("euclidean_", "distance") if len(report.axes) > 1 else ("", "error")
        reading = Merit(f"{prefix}max_um", f"worst {words} of the reading from the {target}")
        true = Merit(f"{prefix}max_true_um", f"worst {words} of the true position from the {target}")
        merits = (reading, true) if report.reading_first else (true, reading)
        yield from _sentences(report.rows, merits[0], contest)
        return
    direct = [row for row in report.rows if is_direct(report, row)]
    crossed = [row for row in report.rows if not is_direct(report, row)]
    reads = report.reading_first or report.reads_truth
    name, of = ("rms_um", "") if reads else ("rms_true_um", " of the true position")
    yield from _sentences(direct, Merit(name, f"rms error{of} (direct transfers)"), contest)
    yield from _sentences(crossed, Merit(name, f"rms error{of} (cross-couplings)"), contest)


def _sentences(rows: Sequence[Row], merit: Merit, contest: Contest) -> Iterator[Sentence]:
    inside = by_condition(rows)
    conditions = sorted(inside, key=lambda c: (c.amplitude or 0.0, c.frequency_hz, c.trial or 0))
    values = {c: found for c in conditions if (found := _values(inside[c], merit))}
    if 0 < len(values) <= MOST_CLAUSES:
        yield _one_by_one(values, merit, contest)
    elif values:
        values = {condition: contest.admitted(found) for condition, found in values.items()}
        values = {condition: found for condition, found in values.items() if found}
        if values:
            yield from map(Sentence, _over_frequency(values, merit, contest))


def _values(rows: Iterable[Row], merit: Merit) -> dict[str, float]:
    """Largest value over the axes by label, smallest first."""
    rows = list(rows)
    found = {n: largest((row for row in rows if row.compensator == n), merit.name) for n in labels_of(rows)}
    known = [(label, value) for label, value in found.items() if value is not None]
    return dict(sorted(known, key=lambda item: item[1]))


def _one_by_one(values: dict[Condition, dict[str, float]], merit: Merit, contest: Contest) -> Sentence:
    names = told_apart(list(values))
    points = []
    for condition, found in values.items():
        texts = [f"{contest.named(n)} {number(v)} um{_share(condition, v, merit)}" for n, v in found.items()]
        if len(texts) > MOST_LABELS:
            texts = [*texts[: MOST_LABELS - 1], f"largest: {texts[-1]}"]
        points.append((f"at {names[condition]}: " if len(values) > 1 else "") + ", ".join(texts))
    if len(points) == 1:
        return Sentence(f"The {merit.words}: {points[0]}.")
    compared = any(len(found) > 1 for found in values.values())  # a diagonal is no table
    return Sentence(f"The {merit.words}:", tuple(points), _table(values, names, contest) if compared else ())


def _table(
    values: dict[Condition, dict[str, float]], names: dict[Condition, str], contest: Contest
) -> tuple[tuple[str, ...], ...]:
    """One row for each label, the best worst value first; one column for each condition."""
    labels = {label for found in values.values() for label in found}
    worst = {n: max(found[n] for found in values.values() if n in found) for n in labels}
    head = ("[um]", *(names[condition] for condition in values))
    rows = (
        (contest.named(n), *(number(found.get(n)) for found in values.values()))
        for n in sorted(labels, key=lambda n: (worst[n], n))
    )
    return (head, *rows)


def listed(texts: Sequence[str]) -> str:
    """Join texts as a person would.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _share(condition: Condition, value: float, merit: Merit) -> str:
    """The worst distance as a part of the path's size."""
    if not condition.amplitude or condition.unit != "um" or "max" not in merit.name:
        return ""
    return f" ({percent(value / condition.amplitude)})"


def _over_frequency(
    values: dict[Condition, dict[str, float]], merit: Merit, contest: Contest
) -> Iterator[str]:
    """Who has the smallest value where, and the course of the best one on the whole."""
    names = told_apart(list(values))
    winners = [next(iter(found)) for found in values.values()]
    compared = len({label for found in values.values() for label in found}) > 1
    best = min(
        [n for n in dict.fromkeys(winners) if n not in contest.idle] or winners,
        key=lambda label: _typical(values, label),
    )
    course = {names[condition]: found[best] for condition, found in values.items() if best in found}
    tags = {next(iter(course)): ""}
    tags |= {
        min(course, key=course.__getitem__): " (smallest)",
        max(course, key=course.__getitem__): " (largest)",
    }
    told = listed([f"{number(course[at])} um at {at}{tag}" for at, tag in tags.items()])
    if not compared:
        yield f"The {merit.words} is {told}."
        return
    first = _ranges(list(names.values()), winners, contest.winner)
    course_of = "" if len(set(winners)) == 1 and best == winners[0] else f"{contest.quote(best)} "
    yield f"Smallest {merit.words}: {first}; {course_of}{told}."


def _typical(values: dict[Condition, dict[str, float]], label: str) -> float:
    """Geometric mean over the sweep: the large values near a resonance do not decide alone."""
    logarithms = [math.log(max(found[label], 1e-12)) for found in values.values() if label in found]
    return sum(logarithms) / len(logarithms)


def _ranges(names: Sequence[str], winners: Sequence[str], quote: Quote) -> str:
    """``A from 10 Hz to 40 Hz and B at 50 Hz``; counts where that gets long."""
    groups: list[tuple[str, list[str]]] = []
    for name, label in zip(names, winners, strict=True):
        if not groups or groups[-1][0] != label:
            groups.append((label, []))
        groups[-1][1].append(name)
    if len(groups) == 1:
        return f"{quote(winners[0])} throughout"
    if len(groups) > MOST_CLAUSES:
        order = sorted(dict.fromkeys(winners), key=winners.count, reverse=True)
        return listed([f"{quote(n)} in {winners.count(n)} of {len(winners)} runs" for n in order])
    return listed(
        [
            f"{quote(label)} {f'at {inside[0]}' if len(inside) == 1 else f'from {inside[0]} to {inside[-1]}'}"
            for label, inside in groups
        ]
    )


def _loops(report: Report) -> Iterator[str]:
    """Height and width of the loops in the first and in the last run of a sweep."""
    measured = [row for row in report.rows if row.height_um is not None]
    inside = by_condition(measured)
    conditions = list(inside)
    if not measured:
        yield "There is no reference to compare with: the figures show the sensor's readings."
    for condition in dict.fromkeys([*conditions[:1], *conditions[-1:]]):
        rows = inside[condition]
        texts = [
            f"{row.measured_axis} moves {number(row.height_um)} um from end to end, with a loop "
            f"{number(row.width_percent)} % wide"
            for row in rows
            if is_direct(report, row)
        ]
        cross = largest((row for row in rows if not is_direct(report, row)), "height_um")
        if cross is not None:
            texts.append(f"the largest cross-coupling is {number(cross)} um from end to end")
        yield f"At {condition.words()}: {'; '.join(texts)}."


def _grouped(runs: Sequence[str]) -> str:
    """Runs by their compensator or model, such as ``paper (3 runs, 15 to 40 Hz)``."""
    found: dict[str, list[float]] = {}
    for run in runs:
        label, _, place = run.rpartition(" at ")
        hertz = re.match(r"([\d.e+-]+) Hz", place)
        found.setdefault(label or run, []).extend([float(hertz[1])] if hertz else [])
    return "; ".join(f"{label}{_spread(hertz)}" for label, hertz in found.items())


def _spread(hertz: Sequence[float]) -> str:
    """Number of runs and their frequencies, in brackets."""
    if not hertz:
        return ""
    ends = " to ".join(f"{f:g}" for f in dict.fromkeys([min(hertz), max(hertz)]))
    return f" ({len(hertz)} run{'s' * (len(hertz) > 1)}, {ends} Hz)"


def doubts(report: Report) -> list[str]:
    """Statements of a report for which its figures may be worth nothing."""
    return [text for text in report.statements if FLAGGED in text or GUESSED in text]


def _conduct(report: Report) -> Iterator[str]:
    """Whether the drive's range was enough, and whether what repeats had settled."""
    if any(ITSELF in text for text in report.statements):
        yield (
            "A law designed from the simulated actuator itself has a perfect model, which no real "
            "actuator offers."
        )
    if flagged := [text.partition(FLAGGED)[0] for text in report.statements if FLAGGED in text]:
        yield f"Flagged by {'its' if len(flagged) == 1 else 'their'} fit report: {', '.join(flagged)}."
    if any(GUESSED in text for text in report.statements):
        yield "The voltages exceed the records of the simulated actuator: its motion there is extrapolated."
    compared = report.scenario.reference is not None  # each compensator is a run, models share theirs
    runs = {(r.compensator if compared else "", r.excited_axis, Condition.of(r)): r for r in report.rows}
    cut = sum(bool(row.saturated_samples) for row in runs.values())
    clipped = sum(SENSOR_CUT in statement for statement in report.statements)
    unsettled = [text.partition(": ")[0] for text in report.statements if NOT_SETTLED in text]
    yield (
        f"The drive's range cut the voltage in {cut} of {len(runs)} runs."
        if cut
        else ("The drive's range cut no voltage.")
    )
    if clipped:
        yield f"The sensor's range cut the reading in {clipped} of {len(runs)} runs."
    signal = report.scenario.signal
    if unsettled:
        helps = any(NOT_SETTLED in text and NEVER_SETTLES not in text for text in report.statements)
        after = (
            "raise settle_cycles or settle_s in [measure]" if helps else "more cycles do not help, see below"
        )
        yield (
            f"In {len(unsettled)} of {len(runs)} runs the loop had not settled: {_grouped(unsettled)}. Their "
            f"figures still change from cycle to cycle: {after}."
        )
    elif isinstance(signal, OneFrequency) and signal.repeats and report.scenario.measure.measured_cycles > 1:
        yield "Every run had settled."

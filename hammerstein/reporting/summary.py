"""The answer of a report in plain sentences, made from its rows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from hammerstein.experiment.report import Band, Report
from hammerstein.experiment.selection import (
    Condition,
    banded_metric,
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
    """A sentence of an answer.

    table : what it introduces: a head, then one row for each compensator, model or run
    """

    words: str
    table: tuple[tuple[str, ...], ...] = ()

    def __str__(self) -> str:
        return " ".join([self.words, *("; ".join(row) for row in self.table)])


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
    found: dict[str, float] = {}
    for row in report.rows:
        if is_direct(report, row) and (value := getattr(row, name)) is not None:
            found[row.compensator] = max(value, found.get(row.compensator, value), key=abs)
    if found:
        ordered = sorted(found.items(), key=lambda item: abs(item[1]))
        told = ", ".join(f"{quote(label)} {number(value)}" for label, value in ordered)
        yield f"The {METRICS[name].meaning}: {told}."


def _uncertain(report: Report, quote: Quote) -> Iterator[str]:
    """What the drawn actuators do: median and 95 % of the worst condition."""
    if not report.bands or report.scenario.uncertainty is None:
        return
    metric, words = banded_metric(report)
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
            f"For {draws} random actuators, the {words} of the true position, median and 95 % limit: "
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
        name, of = ("max_um", "reading") if report.reading_first else ("max_true_um", "true position")
        told = f"worst {words} of the {of} from the {target}"
        yield from _sentences(report.rows, f"{prefix}{name}", told, contest)
        return
    direct = [row for row in report.rows if is_direct(report, row)]
    crossed = [row for row in report.rows if not is_direct(report, row)]
    reads = report.reading_first or report.reads_truth
    name, of = ("rms_um", "") if reads else ("rms_true_um", " of the true position")
    if direct and 1 < len(by_condition(report.rows)) <= MOST_CLAUSES:
        kinds = [{c: _values(r, name) for c, r in by_condition(k).items()} for k in (direct, crossed) if k]
        yield _table(kinds, ("direct transfers", "cross-couplings"), f"rms error{of}", contest)
        return
    yield from _sentences(direct, name, f"rms error{of} (direct transfers)", contest)
    if not report.bands:  # of drawn actuators, the answer is about their spread
        yield from _sentences(crossed, name, f"rms error{of} (cross-couplings)", contest)


def _sentences(rows: Sequence[Row], name: str, words: str, contest: Contest) -> Iterator[Sentence]:
    inside = by_condition(rows)
    conditions = sorted(inside, key=lambda c: (c.amplitude or 0.0, c.frequency_hz, c.trial or 0))
    values = {c: found for c in conditions if (found := _values(inside[c], name))}
    if 0 < len(values) <= MOST_CLAUSES:
        yield _one_by_one(values, name, words, contest)
    elif values:
        values = {condition: contest.admitted(found) for condition, found in values.items()}
        values = {condition: found for condition, found in values.items() if found}
        if values:
            yield from map(Sentence, _over_frequency(values, words, contest))


def _values(rows: Iterable[Row], name: str) -> dict[str, float]:
    """Largest value over the axes by label, smallest first."""
    rows = list(rows)
    found = {n: largest((row for row in rows if row.compensator == n), name) for n in labels_of(rows)}
    known = [(label, value) for label, value in found.items() if value is not None]
    return dict(sorted(known, key=lambda item: item[1]))


def _one_by_one(
    values: dict[Condition, dict[str, float]], name: str, words: str, contest: Contest
) -> Sentence:
    if len(values) > 1:
        return _table([values], ("error",), words, contest)
    ((condition, found),) = values.items()
    texts = [f"{contest.named(n)} {number(v)} um{_share(condition, v, name)}" for n, v in found.items()]
    if len(texts) > MOST_LABELS:
        texts = [*texts[: MOST_LABELS - 1], f"largest: {texts[-1]}"]
    return Sentence(f"The {words}: {', '.join(texts)}.")


def _table(
    kinds: Sequence[dict[Condition, dict[str, float]]], heads: Sequence[str], words: str, contest: Contest
) -> Sentence:
    """Figures of one or two kinds: one row for each label, the best worst value first, or for each run."""
    first = kinds[0]
    names = told_apart(sorted(first, key=lambda c: (c.amplitude or 0.0, c.frequency_hz, c.trial or 0)))
    worst: dict[str, float] = {}
    for label, value in [pair for found in first.values() for pair in found.items()]:
        worst[label] = max(value, worst.get(label, value))

    def figures(condition: Condition, label: str) -> list[str]:
        return [number(found.get(condition, {}).get(label)) for found in kinds]

    if any(len(found) > 1 for found in first.values()):
        told = f", {' / '.join(heads)}" if len(kinds) > 1 else ""
        head = ("[um]", *names.values())
        labels = sorted(worst, key=lambda n: (worst[n], n))
        rows = [(contest.named(n), *(" / ".join(filter(None, figures(c, n))) for c in names)) for n in labels]
        return Sentence(f"The {words}{told}:", (head, *rows))
    runs = [
        (c, n, f"{names[c]}, {contest.named(n)}" if len(worst) > 1 else names[c])
        for c in names
        for n in first[c]
    ]
    head = ("[um]", *heads[: len(kinds)])
    return Sentence(f"The {words}:", (head, *((name, *figures(c, n)) for c, n, name in runs)))


def listed(texts: Sequence[str]) -> str:
    """Join texts as a person would.

    >>> listed(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _share(condition: Condition, value: float, name: str) -> str:
    """The worst distance as a part of the path's size."""
    if not condition.amplitude or condition.unit != "um" or "max" not in name:
        return ""
    return f" ({percent(value / condition.amplitude)})"


def _over_frequency(values: dict[Condition, dict[str, float]], words: str, contest: Contest) -> Iterator[str]:
    """Who has the smallest value where, and the course of the best one on the whole."""
    names = told_apart(list(values))
    winners = [next(iter(found)) for found in values.values()]
    compared = len({label for found in values.values() for label in found}) > 1
    best = min(
        [n for n in dict.fromkeys(winners) if n not in contest.idle] or winners,
        key=lambda label: _typical(values, label),
    )
    course = {names[condition]: found[best] for condition, found in values.items() if best in found}
    ends = (min(course, key=course.__getitem__), max(course, key=course.__getitem__))
    told = " to ".join(f"{number(course[at])} um ({at})" for at in dict.fromkeys(ends))
    if not compared:
        yield f"The {words} is {told}."
        return
    first = _ranges(list(names.values()), winners, contest.winner)
    course_of = "" if len(set(winners)) == 1 and best == winners[0] else f"{contest.quote(best)} "
    yield f"Smallest {words}: {first}; {course_of}{told}."


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
        counts = [f"{quote(n)} in {winners.count(n)}" for n in order]
        return listed([f"{counts[0]} of {len(winners)} runs", *counts[1:]])
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
    if len(found) >= MOST_LABELS:
        return f"{len(found)} methods{_spread([f for hertz in found.values() for f in hertz])}, listed below"
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
    yield f"The drive's range cut {f'the voltage in {cut} of {len(runs)} runs' if cut else 'no voltage'}."
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

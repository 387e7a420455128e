"""Answer of a report in sentences, from its rows."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from hammerstein.experiment.report import Condition, Report, differing, labels_of, largest, number, told_apart
from hammerstein.metrics import METRICS, Row
from hammerstein.quantities import by_key, number_of, percent
from hammerstein.signals import OneFrequency

MOST_RANGES = 2  # ranges of a sweep that are told one by one; more are counted
MOST_COLUMNS = 4  # conditions in the table
MOST_ROWS = 5  # compensators or models in the table
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
    first = " ".join([*filter(None, (_yes_or_no(report), _enough_operators(report, named))), found.words])
    return [found._replace(words=first), Sentence(" ".join(_conduct(report)))]


def _yes_or_no(report: Report) -> str:
    """Yes or no, where the scenario gives the limits that decide; the first compensator or model is asked."""
    label, parts = next(iter(labels_of(report.rows)), ""), []
    for name, limit in report.scenario.yes_if.items():
        rows = (row for row in report.rows if row.compensator == label and report.is_direct(row))
        value = largest(rows, name)
        if value is not None:
            words, _, unit = METRICS[name].meaning.partition(" [")
            unit = unit.partition("]")[0].partition(",")[0]
            parts.append((value <= limit, f"{words} {number(value)} {unit} (limit {limit:g} {unit})"))
    verdict = "Yes" if all(kept for kept, _ in parts) else "No"
    return f"{verdict}: {listed([words for _, words in parts])}." if parts else ""


def _enough_operators(report: Report, contest: Contest) -> str:
    """Number of operators with the smallest error, where the models differ in it."""
    numbers = report.operators
    name = "rms_um" if report.reading_first else "rms_true_um"
    found = _values((row for row in report.rows if report.is_direct(row)), name) if numbers else {}
    if not found:
        return ""
    best = next(iter(contest.admitted(found)))
    if numbers[best] == max(numbers.values()):
        return f"{numbers[best]} operators, the most here, have the smallest error."
    return f"{numbers[best]} operators. More do not lower the largest rms error."


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
        if report.is_direct(row) and (value := getattr(row, name)) is not None:
            found[row.compensator] = max(value, found.get(row.compensator, value), key=abs)
    ordered = sorted(found.items(), key=lambda item: abs(item[1]))
    told = ", ".join(f"{quote(label)} {number(value)}" for label, value in ordered)
    several = len({(Condition.of(row), row.measured_axis) for row in report.rows if report.is_direct(row)})
    worst = f", at the worst of {several} frequencies, amplitudes and axes" if several > 1 else ""
    return Sentence(f"The {METRICS[name].meaning}{worst}: {told}.") if found else None


def _uncertain(report: Report, contest: Contest) -> Sentence | None:
    """Median and 95th percentile over the random actuators, and the nominal one: the worst of each."""
    if not report.bands or report.scenario.uncertainty is None:
        return None
    metric, words = report.banded_metric
    nominal = {row.place: getattr(row, metric) for row in report.rows if report.is_direct(row)}
    bands = [band for band in report.bands if band.metric == metric and band.place in nominal]
    rows, medians = [], dict[str, float]()
    for (trial, label), own in by_key(bands, lambda band: (band.trial, band.compensator)).items():
        name = contest.named(label) + ("" if trial is None else f", trial {trial}")
        each = zip(*((band.median_um, band.p95_um, nominal[band.place]) for band in own), strict=True)
        rows.append((name, *(number(max(values)) for values in each)))
        medians |= {name: max(band.median_um for band in own)} if trial is None else {}
    least = min(medians, key=medians.__getitem__, default="")
    best = f"{least} has the smallest median. " * (len(medians) > 1)
    at = ", each number at its worst frequency" if len({row.frequency_hz for row in report.rows}) > 1 else ""
    drawn = f"{report.scenario.uncertainty.draws} random actuators"
    return Sentence(
        f"{best}The {words} of the true position for {drawn}{at}:",
        (("[um]", "median", "95th percentile", "nominal actuator"), *rows),
    )


def _compared(report: Report, contest: Contest) -> Sentence:
    """The error of the true position, or of the reading if the scenario's assessment is about it."""
    target = "reference" if report.scenario.reference is not None else "prediction"
    if report.is_path:
        prefix, words = ("euclidean_", "distance") if len(report.axes) > 1 else ("", "error")
        name, of = ("max_um", "reading") if report.reading_first else ("max_true_um", "true position")
        name, words = f"{prefix}{name}", f"worst {words} of the {of} from the {target}"
        groups: list[list[Row]] = [list(report.rows)]
    else:
        name, of = ("rms_um", "reading") if report.reading_first else ("rms_true_um", "true position")
        words = f"rms error of the {'predicted ' * (target == 'prediction')}{of}"
        words += _common_size(report) + ", worst axis" * (len(report.axes) > 1)
        direct = [row for row in report.rows if report.is_direct(row)]
        groups = [direct, [row for row in report.rows if not report.is_direct(row)]]
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
        parts = [
            f"{percent(value / condition.amplitude)} of {condition.amplitude:g} um"
            for value in found.values()
        ]
        texts = [f"{text} ({part})" for text, part in zip(texts, parts, strict=True)]
    if len(texts) > MOST_LABELS + 1:
        texts = [*texts[:MOST_LABELS], f"largest: {texts[-1]}"]
    return Sentence(f"The {words}: {', '.join(texts)}.")


def _common_size(report: Report) -> str:
    """Amplitude that several runs share, such as `` for 20 um``."""
    conditions = set(map(Condition.of, report.rows))
    sizes = {(condition.amplitude, condition.unit) for condition in conditions if condition.amplitude}
    return " for {:g} {}".format(*sizes.pop()) if len(conditions) > 1 and len(sizes) == 1 else ""


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
    shown, words = ordered, f"The {words}:"
    if len(ordered) > MOST_COLUMNS:  # the ends, the middle, and where the best one is worst
        worst = max(ordered, key=lambda c: first[c].get(labels[0], 0.0))
        kept = {ordered[0], ordered[len(ordered) // 2], worst, ordered[-1]}
        shown = [condition for condition in ordered if condition in kept]
        if len(labels) > 1:
            direct = "direct " * (len(kinds) > 1)
            words = (
                f"{_best({c: contest.admitted(first[c]) for c in ordered}, contest.winner, direct)}{words}"
            )

    def figures(condition: Condition, label: str) -> list[str]:
        return [number(found.get(condition, {}).get(label)) for found in kinds]

    if any(len(found) > 1 for found in first.values()):
        told = {n: contest.named(n) for n in labels}
        if len(labels) > MOST_ROWS:
            few = [*labels[: MOST_ROWS - 1], labels[-1]]
            told = {n: f"last of {len(labels)}: " * (n == few[-1]) + told[n] for n in few}
        if len(ordered) > 1:
            over = "frequencies" if differing(ordered) == ["frequency_hz"] else "runs"
            words = f"{words[:-1]}, ranked by the geometric mean over {len(ordered)} {over}:"
        rows = [(told[n], *(" / ".join(filter(None, figures(c, n))) for c in shown)) for n in told]
        head = "direct / cross-coupling [um]" if len(kinds) > 1 else "[um]"
        return Sentence(words, ((head, *(names[c] for c in shown)), *rows))
    rows = [
        (f"{names[c]}, {contest.named(n)}" if len(labels) > 1 else names[c], *figures(c, n))
        for c in shown
        for n in first[c]
    ]
    heads = ("direct", "cross-coupling") if len(kinds) > 1 else ("error",)
    return Sentence(words, (("[um]", *heads), *rows))


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


def _best(found: dict[Condition, dict[str, float]], quote: Quote, kind: str) -> str:
    """Say who has the smallest error at each point of a sweep; who has most of them where that gets long."""
    winners = {c: min(values, key=values.__getitem__) for c, values in found.items() if values}
    names, labels = told_apart(list(winners)), list(winners.values())
    pairs = groupby(winners.items(), key=lambda pair: pair[1])
    groups = [(label, [names[condition] for condition, _ in own]) for label, own in pairs]
    if not groups:
        return ""
    if 1 < len(groups) <= MOST_RANGES:
        told = [
            f"{quote(label)} {f'at {inside[0]}' if len(inside) == 1 else f'from {inside[0]} to {inside[-1]}'}"
            for label, inside in groups
        ]
        return f"Smallest {kind}error: {listed(told)}. "
    most = max(dict.fromkeys(labels), key=labels.count)
    one, many = (
        ("frequency", "frequencies") if differing(list(winners)) == ["frequency_hz"] else ("run", "runs")
    )
    where = f"every {one}" if len(groups) == 1 else f"{labels.count(most)} of {len(labels)} {many}"
    return f"{quote(most)} has the smallest {kind}error at {where}. "


def _loops(report: Report) -> Sentence:
    """Height and width of the loops in the first and in the last run of a sweep."""
    measured = [row for row in report.rows if row.height_um is not None]
    if not measured:
        return Sentence("There is no reference to compare with: the figures show the sensor's readings.")
    inside = by_key(measured, Condition.of)
    ends = list(dict.fromkeys([next(iter(inside)), next(reversed(inside))]))
    lines: dict[str, list[str]] = {}
    for condition in ends:
        for row in (row for row in inside[condition] if report.is_direct(row)):
            lines.setdefault(f"{row.measured_axis}, height [um]", []).append(number(row.height_um))
            lines.setdefault(f"{row.measured_axis}, width [%]", []).append(number(row.width_percent))
        cross = largest((row for row in inside[condition] if not report.is_direct(row)), "height_um")
        if cross is not None:
            lines.setdefault("largest cross-coupling, height [um]", []).append(number(cross))
    head = ("loop", *(condition.words() for condition in ends))
    told = ((name, *cells) for name, cells in lines.items())
    return Sentence("The loops of the sensor's reading:", (head, *told))


def _grouped(report: Report, runs: Sequence[str]) -> str:
    """Runs by their compensator or model, such as ``paper (3 runs, 15 to 40 Hz)``; what all share once."""
    found: dict[str, list[tuple[float, str]]] = {}
    for run in runs:
        label, _, place = run.partition(": ")[0].rpartition(" at ")
        at = re.match(r"([\d.e+-]+) (Hz|um|V)", place)
        found.setdefault(label or place, []).extend([(float(at[1]), at[2])] if at else [])
    places = {label: span(own) for label, own in found.items()}
    if len(found) < MOST_LABELS and len(set(places.values())) > 1:
        counts = {label: number_of(len(own), "run") for label, own in found.items()}
        return "; ".join(f"{n} ({counts[n]}{f', {at}' * bool(at)})" for n, at in places.items())
    more = [f"{len(found) - MOST_LABELS} more"] * (len(found) > MOST_LABELS)
    here = span([at for own in found.values() for at in own])
    whole = span([(row.frequency_hz, "Hz") for row in report.rows])
    return "; ".join([*list(found)[:MOST_LABELS], *more]) + f" ({here})" * (here not in ("", whole))


def span(places: Sequence[tuple[float, str]]) -> str:
    """Lowest and highest frequency or size."""
    if not places:
        return ""
    ends = dict.fromkeys([min(places), max(places)])
    return f"{' to '.join(f'{value:g}' for value, _ in ends)} {places[0][1]}"


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
        after = some if never < len(texts) else "more cycles do not change that"
    named = f"{len(texts)} of {runs} runs had not settled: {_grouped(report, texts)}"
    if len(texts) == runs:
        return f"No run had settled, so these numbers depend on when they are read; {after}."
    whose = "Its" if len(texts) == 1 else "Their"
    return f"{named}. {whose} numbers depend on when they are read; {after}."


def _runs(report: Report) -> dict[tuple[str, str, Condition], Row]:
    """A row of each run: each compensator is one, models share theirs."""
    compared = report.scenario.reference is not None
    return {(r.compensator if compared else "", r.excited_axis, Condition.of(r)): r for r in report.rows}


def _clipped(report: Report, words: str, what: str) -> str:
    """Sentence on runs that a range clipped; empty if it clipped none."""
    texts, runs = [text for text in report.statements if words in text], len(_runs(report))
    named = f": {_grouped(report, texts)}" if len(texts) < runs else ""
    return f"{what} {len(texts)} of {runs} runs{named}." if texts else ""


def _conduct(report: Report) -> Iterator[str]:
    """Whether the drive's range was enough, and whether what repeats had settled."""
    if any(ITSELF in text for text in report.statements):
        yield "A law designed from the simulated actuator itself has a perfect model, unlike a real one."
    if flagged := [text.partition(FLAGGED)[0] for text in report.statements if FLAGGED in text]:
        yield f"Flagged by {'its' if len(flagged) == 1 else 'their'} fit report: {', '.join(flagged)}."
    if any(GUESSED in text for text in report.statements):
        yield "The voltages exceed the records of the simulated actuator: its motion there is extrapolated."
    yield _clipped(report, DRIVE_CUT, "The drive's range clipped") or "No voltage was clipped."
    if reading := _clipped(report, SENSOR_CUT, "The sensor's range clipped"):
        yield reading
    signal = report.scenario.signal
    if unsettled := unsettled_runs(report):
        yield unsettled
    elif isinstance(signal, OneFrequency) and signal.repeats and report.scenario.measure.measured_cycles > 1:
        yield "Every run had settled."

"""A comparison of models as a page for people."""

from __future__ import annotations

from collections.abc import Iterator

from hammerstein.comparison.inverting import HEADROOM, SETTLING
from hammerstein.comparison.result import RULE, Comparison, Entry
from hammerstein.escaping import markdown
from hammerstein.identification.score import Score
from hammerstein.reporting.fit_page import table

CAPTION = (
    "One line a model. Left: its errors, filled where they are judged, hollow on the fitted records beside "
    "them, one sign for each frequency of the records. Middle: what its compensator leaves on the best model "
    "of another kind. Right: its free numbers."
)
ERRORS = (
    "Rms errors about the mean of each record in percent of the range of the readings, mean of the outputs; "
    "at each frequency in percent of the range there."
)
COMPENSATED = (
    "What is left: the path is what the best model of another kind says to the judged records, from rest; "
    "the model's compensator computes the voltages for it, and that other model plays them. It is the rms "
    f"error about its mean in percent of the range of the path, after the first {SETTLING:.1%} of each "
    f"record. Voltages may leave the recorded range by {HEADROOM:.0%} of it."
)
TIMES = (
    "Identified: processor time of the identification that gave the model; plays and linear models come out "
    "of one. A sample: time of the forward model, all axes together. Both are of the machine it ran on."
)


def compare_page(found: Comparison, with_figure: bool) -> str:
    """Markdown page of a comparison."""
    parts = [
        "# Models compared",
        " ".join(markdown(sentence) for sentence in found.sentences()),
        *([f"[![compare](compare.png)](compare.svg)\n\n*{CAPTION}*"] if with_figure else []),
        compare_body(found),
        "Every number with full precision is in `compare.json`.",
    ]
    return "\n\n".join(parts) + "\n"


def compare_body(found: Comparison) -> str:
    """Markdown of the tables."""
    return "\n\n".join(_body(found))


def _body(found: Comparison) -> Iterator[str]:
    yield "## Models"
    yield table(HEADER, [_line(found, entry) for entry in found.entries])
    yield RULE + (
        " Models as good as the best are marked in the column *as good*. "
        + ("Judged are the records held back." if found.held else "Judged are the fitted records themselves.")
    )
    yield f"{COMPENSATED} {TIMES}"
    yield "## Errors at each frequency"
    yield ERRORS
    for title, at in (("Records held back", "held_at"), ("Fitted records", "fitted_at")):
        frequencies = list(getattr(found.entries[0], at))
        if frequencies:
            yield f"### {title}"
            header = ["model", *(f"{hz:g} Hz [%]" for hz in frequencies)]
            yield table(header, [_at(entry, getattr(entry, at)) for entry in found.entries])
    if found.failed:
        yield "## Kinds that could not be fitted"
        yield table(("kind", "why"), [(one.name, markdown(one.reason)) for one in found.failed])
    yield "## Inverses"
    yield table(
        ("model", "linear block", "compensator", "played on", "at the range [%]"),
        [_words(entry) for entry in found.entries],
    )
    yield from _faults(found)
    yield f"Fitted: {_listed(found.records)}. Held back: {_listed(found.held) or 'none'}."


def _faults(found: Comparison) -> Iterator[str]:
    """What models cannot represent; what holds for all of them is said once."""
    told: dict[str, list[str]] = {}
    for entry in found.entries:
        for flag in entry.flags:
            told.setdefault(flag, []).append(entry.name)
    if told:
        yield "## What models cannot represent"
        all_ = len(found.entries)
        yield "\n".join(
            f"* {'all models' if len(names) == all_ else ', '.join(names)}: {markdown(flag)}"
            for flag, names in told.items()
        )


HEADER = (
    "model",
    "parameters",
    "fitted [%]",
    "held back [%]",
    "as good",
    "exact inverse",
    "left [%]",
    "identified [s]",
    "a sample [ns]",
)


def _line(found: Comparison, entry: Entry) -> list[str]:
    name = f"**{entry.name}**" if entry.name == found.recommended else entry.name
    return [name, *cells(entry)]


def cells(entry: Entry) -> list[str]:
    """Figures of a model, in the order of ``HEADER``."""
    return [
        str(entry.parameters),
        f"{entry.fitted.mean_percent:.3g}",
        "" if entry.held is None else f"{entry.held.mean_percent:.3g}",
        "yes" if entry.as_good else "no",
        "yes" if entry.has_inverse else "no",
        "none" if entry.left.percent is None else f"{entry.left.percent:.3g}",
        f"{entry.seconds:.2g}",
        f"{entry.ns_a_sample:.3g}",
    ]


def _at(entry: Entry, scores: dict[float, Score]) -> list[str]:
    return [entry.name, *(f"{score.mean_percent:.3g}" for score in scores.values())]


def _words(entry: Entry) -> list[str]:
    left = entry.left
    played = left.on if left.percent is not None else markdown(left.reason)
    at_range = "" if left.at_range_percent is None else f"{left.at_range_percent:.2g}"
    return [entry.name, markdown(entry.dynamics), markdown(entry.inverse), played, at_range]


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(markdown(name) for name in dict.fromkeys(names))

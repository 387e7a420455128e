"""A comparison of models as a page for people."""

from __future__ import annotations

from hammerstein.comparison.inverting import HEADROOM, SETTLING
from hammerstein.comparison.result import RULE, Compared, Comparison
from hammerstein.escaping import Markdown, markdown_page

CAPTION = (
    "One line a model, with its free numbers in brackets. Left: its errors, filled where they are judged, "
    "hollow on the fitted records beside them, one sign for each frequency of the records. Right: what its "
    "compensator leaves on the best model of another kind."
)


def compare_page(found: Comparison, with_figure: bool) -> str:
    """Markdown page of a comparison."""
    figure = Markdown("![compare](compare.svg)\n\n*{}*").format(CAPTION)
    parts = [
        Markdown("# Models compared"),
        " ".join(found.sentences()),
        *([figure] if with_figure else []),
        compare_body(found),
        Markdown("Every number with full precision is in `compare.json`.\n"),
    ]
    return Markdown("\n\n").join(parts)


def compare_body(found: Comparison) -> Markdown:
    """Markdown of the tables."""
    faults: dict[str, list[str]] = {}  # what holds for several models is said once
    for entry in found.entries:
        for flag in entry.flags:
            faults.setdefault(flag, []).append(entry.name)
    return markdown_page(
        "compare_body.md.jinja",
        found=found,
        header=HEADER,
        lines=[(entry, cells(entry)) for entry in found.entries],
        rule=RULE,
        settling=f"{SETTLING:.1%}",
        headroom=f"{HEADROOM:.0%}",
        faults=faults,
    ).strip()


HEADER = (
    "model",
    "parameters",
    "fitted [%]",
    "validation [%]",
    "as good",
    "exact inverse",
    "left [%]",
)
"""No times: two comparisons of the same records make the same page."""


def cells(entry: Compared) -> list[str]:
    """Figures of a model, in the order of ``HEADER``."""
    return [
        str(entry.parameters),
        f"{entry.fitted.mean_percent:.3g}",
        "" if entry.held is None else f"{entry.held.mean_percent:.3g}",
        "yes" if entry.as_good else "no",
        "yes" if entry.has_inverse else "no",
        "none" if entry.left.percent is None else f"{entry.left.percent:.3g}",
    ]

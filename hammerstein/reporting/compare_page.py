"""A comparison of models as a page for people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hammerstein.comparison.inverting import HEADROOM, SETTLING
from hammerstein.comparison.result import RULE, Compared, Comparison
from hammerstein.escaping import Markdown, markdown_page
from hammerstein.reporting.account_page import AccountPage
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import staged

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPARISON = Owner("comparison")
ALWAYS = ("compare.html", "compare.json", "compare.md")

CAPTION = (
    "One line a model, with its free numbers in brackets. Left: its errors, filled where they are judged, "
    "hollow on the fitted records beside them, one sign for each frequency of the records. Right: what its "
    "compensator leaves on the best model of another kind."
)


def compare_page(found: Comparison) -> AccountPage:
    """Page of a comparison."""
    return AccountPage(
        heading=Markdown("# Models compared"),
        what="Comparison",
        title="Which model for these records",
        points=(),
        answer=found.sentences(),
        facts=[f"{len(found.entries)} models", f"records: {', '.join(dict.fromkeys(found.records))}"],
        captions={"compare": ("Error of every model", CAPTION)},
        body=_body(found),
        numbers=("compare.json", found.to_json()),
    )


def write_comparison(
    found: Comparison, folder: Path, figures: bool = True, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write both pages, ``compare.json`` and the figure: all of them, or none.

    Gives the places of files of an earlier comparison that a person had changed and that were kept.

    Raises InputError if they cannot be written.
    """
    with staged(folder, COMPARISON, overwrite) as stage:
        drawn: dict[str, Figure] = {}
        if figures:
            from hammerstein.reporting.figures.compared import compared_figure

            drawn = {"compare": compared_figure(found)}
        compare_page(found).write(stage, "compare", drawn)
    return stage.kept


def _body(found: Comparison) -> Markdown:
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

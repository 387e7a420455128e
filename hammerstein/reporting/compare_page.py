"""Page of a comparison of models."""

import shlex
from collections.abc import Collection
from pathlib import Path

from hammerstein.comparison.compare import HEADROOM, SETTLING
from hammerstein.comparison.result import Compared, Comparison
from hammerstein.escaping import Markdown, markdown, markdown_page
from hammerstein.reporting.figures.identified import compared_figure
from hammerstein.reporting.figures.write import files_of
from hammerstein.reporting.page import NumberFile, Page, Shown, figures_section, paragraphs
from hammerstein.runtime.staging import Owner, staged

COMPARISON = Owner("comparison")
ALWAYS = ("compare.html", "compare.json", "compare.md")

CAPTION = (
    "One line for each model, with its number of parameters in brackets. (a): errors on the validation "
    "records (filled) and on the fitted ones (hollow; filled if there are no others), one symbol for each "
    "frequency. (b): compensator error; the model with the lowest cross-validation error replaces "
    "the actuator."
)


def compare_page(found: Comparison, figures: Collection[str] = ()) -> Page:
    """Page of a comparison.

    figures : names of its files beside the page
    """
    shown = [Shown("compare", "Error of every model", CAPTION)] if "compare.svg" in figures else []
    return Page(
        heading=Markdown("# Models compared"),
        what="Comparison",
        title="Which model fits these records best?",
        answer=paragraphs(map(markdown, found.sentences())),
        facts=[f"{len(found.entries)} models", f"records: {', '.join(dict.fromkeys(found.records))}"],
        body=paragraphs([figures_section(shown), _body(found)]),
        numbers=[NumberFile("compare.json", found.to_json())],
    )


def write_comparison(
    found: Comparison, folder: Path, figures: bool = True, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write both pages, ``compare.json``, the figure and the file of every model: all of them, or none.

    Gives the places of files of an earlier comparison that a person had changed and that were kept.

    Raises InputError if they cannot be written.
    """
    with staged(folder, COMPARISON, overwrite) as stage:
        drawn = dict(files_of({"compare": compared_figure(found)} if figures else {}))
        compare_page(found, drawn).write(stage, "compare", drawn)
        for entry in found.entries:
            stage.write(entry.file, entry.model.to_json())
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
        header=("model", *figures(found.entries[0])),
        lines=[(entry, figures(entry).values()) for entry in found.entries],
        rule=found.rule,
        settling=f"{100.0 * SETTLING:g} %",
        headroom=f"{100.0 * HEADROOM:g} %",
        faults=faults,
    ).strip()


def figures(entry: Compared) -> dict[str, str]:
    """Figures of a model by heading, without times, so that equal comparisons give equal pages."""
    held = {"validation [%]": f"{entry.validation.mean_percent:.3g}"} if entry.validation else {}
    return {
        "parameters": str(entry.parameters),
        "fitted [%]": f"{entry.fitted.mean_percent:.3g}",
        "cross-validation [%]": f"{entry.folds_percent:.3g}",
        **held,
        "as good": "yes" if entry.as_good else "no",
        "exact inverse": "yes" if entry.has_inverse else "no",
        "compensator error [%]": entry.left.words,
    }


def next_command(found: Comparison, folder: Path) -> str:
    """Command that compensates with the recommended model; empty without an inverse."""
    chosen = found[found.recommended]
    law = chosen.left.law
    words = ["compensate", str(folder / chosen.file), "path.csv", "--law", law, "--out", "drive.csv"]
    words += ["--accept-flagged"] * bool(chosen.flags)
    return f"hammerstein {shlex.join(words)}" if law else ""

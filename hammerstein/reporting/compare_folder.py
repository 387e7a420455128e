"""Write what a comparison found."""

from __future__ import annotations

from pathlib import Path

from hammerstein.comparison.result import Comparison
from hammerstein.reporting.compare_page import compare_page
from hammerstein.reporting.html.compare_html import compare_html
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import staged

COMPARISON = Owner("comparison")
ALWAYS = ("compare.html", "compare.json", "compare.md")


def write_comparison(
    found: Comparison, folder: Path, figures: bool = True, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write both pages, ``compare.json`` and the figure: all of them, or none.

    Gives the places of files of an earlier comparison that a person had changed and that were kept.

    Raises InputError if they cannot be written.
    """
    with staged(folder, COMPARISON, overwrite) as stage:
        drawn: dict[str, bytes] = {}
        if figures:
            from hammerstein.reporting.figures.compared import compared_figure
            from hammerstein.reporting.figures.write import files_of, write_drawn

            drawn = write_drawn(stage, files_of({"compare": compared_figure(found)}))
        stage.write("compare.md", compare_page(found, bool(drawn)))
        stage.write("compare.html", compare_html(found, drawn))
        stage.write("compare.json", found.to_json())
    return stage.kept

"""A comparison of models as a page for a browser."""

from __future__ import annotations

from collections.abc import Mapping

from hammerstein.comparison.result import Comparison
from hammerstein.reporting.compare_page import CAPTION, compare_body
from hammerstein.reporting.html.markup import link_to, page_of, rendered
from hammerstein.reporting.html.vector import Drawn, drawings

TITLE = "Error of every model"


def compare_html(found: Comparison, files: Mapping[str, bytes]) -> str:
    """HTML page of a comparison.

    files : bytes of its figure as SVG; none gives a page without it
    """
    shown = drawings(files, {"compare": TITLE} if files else {})
    return rendered(
        "account.html.jinja",
        what="Comparison",
        title="Which model for these records",
        answer=found.sentences(),
        facts=[f"{len(found.entries)} models", f"records: {', '.join(dict.fromkeys(found.records))}"],
        figures=[Drawn("compare", TITLE, CAPTION, drawing) for drawing in shown],
        body=page_of(compare_body(found)),
        links=[link_to("compare.json", found.to_json(), "application/json")],
    )

"""A comparison of models as a page for a browser."""

from __future__ import annotations

from collections.abc import Mapping

from hammerstein.comparison.result import Comparison
from hammerstein.reporting.compare_page import CAPTION, compare_body
from hammerstein.reporting.html.markup import MOST_DRAWING_BYTES, link_to, page_of, rendered
from hammerstein.reporting.html.vector import Drawn, pictures

TITLE = "Error of every model"


def compare_html(found: Comparison, files: Mapping[str, bytes]) -> str:
    """HTML page of a comparison.

    files : bytes of its figure as SVG and as PNG; none gives a page without it
    """
    drawings = pictures(files, {"compare": TITLE} if files else {}, MOST_DRAWING_BYTES)
    return rendered(
        "account.html.jinja",
        what="Comparison",
        title="Which model for these records",
        answer=found.sentences(),
        facts=[f"{len(found.entries)} models", f"records: {', '.join(dict.fromkeys(found.records))}"],
        figures=[Drawn("compare", TITLE, CAPTION, drawing) for drawing in drawings],
        body=page_of(compare_body(found)),
        links=[link_to("compare.json", found.to_json(), "application/json")],
    )

"""The account of an identification as a page for a browser."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath

from hammerstein.identification.fit import KIND_NAMES, Fit
from hammerstein.model import HammersteinModel
from hammerstein.reporting.fit_page import CAPTIONS, fit_body, fit_json, headline, summary
from hammerstein.reporting.html.markup import link_to, page_of, rendered
from hammerstein.reporting.html.vector import Drawn, drawings

TITLES = {
    "loops": "Loops",
    "residual": "What the models leave",
    "operators": "Error against the number of operators",
    "response": "Gain over frequency",
}


def fit_html(model: HammersteinModel, fit: Fit, files: Mapping[str, bytes]) -> str:
    """HTML page of a fit; equal fits give equal bytes.

    Parameters
    ----------
    model, fit : what ``identify`` gave
    files : bytes of its figures by name, as SVG; none gives a page without figures
    """
    here = {PurePath(name).stem for name in files}
    names = [name for name in TITLES if name in here] + sorted(here - set(TITLES))
    titles = {name: TITLES.get(name, name) for name in names}
    records = [PurePath(record.source).name for record in fit.records]
    return rendered(
        "account.html.jinja",
        what="Fit report",
        title=f"How far to trust {model.name}",
        answer=[*summary(model, fit), headline(model, fit), fit.verdict],
        facts=[KIND_NAMES[fit.kind], f"records: {', '.join(records)}"],
        figures=[
            Drawn(name, title, CAPTIONS.get(name, ""), drawing)
            for (name, title), drawing in zip(titles.items(), drawings(files, titles), strict=True)
        ],
        body=page_of(fit_body(model, fit)),
        links=[link_to("fit.json", fit_json(model, fit), "application/json")],
    )

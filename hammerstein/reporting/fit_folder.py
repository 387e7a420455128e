"""Write what an identification found: the model file, and the fit report beside it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from hammerstein.identification.fit import Fit
from hammerstein.model import HammersteinModel
from hammerstein.reporting.fit_page import fit_json, fit_page
from hammerstein.reporting.html.fit_html import fit_html
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import staged, staged_beside

FIT = Owner("fit")
MODEL = Owner("model", single=True)
ALWAYS = ("fit.json", "report.html", "report.md")


def write_fit(
    model: HammersteinModel, fit: Fit, path: Path, folder: Path, figures: bool = True, overwrite: bool = False
) -> tuple[Path, ...]:
    """Write the model file, both pages, ``fit.json`` and the figures: all of them, or none.

    Gives the places of files of an earlier fit that a person had changed and that were kept.

    Raises InputError if they cannot be written.
    """
    with ExitStack() as opened:
        stage = opened.enter_context(staged(folder, FIT, overwrite))
        together = folder.resolve() == path.parent.resolve()
        models = stage if together else opened.enter_context(staged_beside(path, MODEL, overwrite))
        drawn: dict[str, bytes] = {}
        if figures:
            from hammerstein.reporting.figures.identified import identified_figures
            from hammerstein.reporting.figures.write import files_of, write_drawn

            drawn = write_drawn(stage, files_of(identified_figures(fit)))
        stage.write("report.md", fit_page(model, fit, sorted(drawn)))
        stage.write("report.html", fit_html(model, fit, drawn))
        stage.write("fit.json", fit_json(model, fit))
        models.write(path.name, model.to_json(), MODEL)
    return tuple(dict.fromkeys(stage.kept + models.kept))

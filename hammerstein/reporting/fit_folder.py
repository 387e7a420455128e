"""Write what an identification found: the model file, and the fit report beside it."""

from __future__ import annotations

from pathlib import Path

from hammerstein.files import write_atomic
from hammerstein.identification.fit import Fit
from hammerstein.model import HammersteinModel
from hammerstein.reporting.fit_page import fit_json, fit_page


def write_fit(model: HammersteinModel, fit: Fit, path: Path, folder: Path, figures: bool = True) -> None:
    """Write the model file, ``report.md``, ``fit.json`` and the figures.

    Raises InputError if they cannot be written. The model file comes last.
    """
    names: list[str] = []
    if figures:
        from hammerstein.reporting.figures import save_figures
        from hammerstein.reporting.figures.identified import identified_figures

        drawn = save_figures(identified_figures(fit), folder)
        names = sorted(place.name for place in drawn if place.suffix == ".png")
    write_atomic(folder / "report.md", fit_page(model, fit, names))
    write_atomic(folder / "fit.json", fit_json(model, fit))
    model.save(path)

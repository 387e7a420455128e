"""Reports that are written without a run, and figures without being drawn: nothing has changed for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from hammerstein.blocks.instruments import Instruments
from hammerstein.experiment.report import Band, Report, Sensitivity
from hammerstein.metrics import Row
from hammerstein.runtime.storage.manifest import Manifest, digest_of, is_inside
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario import Scenario
from hammerstein.scenario.scenario import WORDS


def drawn(report: Report, store: Store | None = None, png: bool = False) -> dict[str, bytes]:
    """Bytes of each file of a report's figures by name; drawn where the store does not have them.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``, with its traces
    store : where figures are kept and found; all are drawn if not given
    png : whether PNG files are wanted beside SVG
    """
    key = None if store is None else key_of_figures(report, png)
    entry = None if store is None or key is None else store.read(key)
    if entry is not None:
        return _bytes(entry)
    from hammerstein.reporting.figures.choice import figures_of
    from hammerstein.reporting.figures.write import files_of

    made = dict(files_of(figures_of(report), png))
    if store is not None and key is not None:
        store.write(key, Kept(None, _arrays(made)))
    return made


def key_of_figures(report: Report, png: bool) -> str | None:
    """Key of all figures of a report, which no question and no tolerance changes; None as for a report."""
    try:
        portable, files = report.scenario.content()
    except OSError:
        return None
    shown = {name: value for name, value in portable.items() if name not in WORDS}
    return key_of("figures", [shown, files, report.reading_first, png])


def _arrays(files: Mapping[str, bytes]) -> dict[str, Any]:
    return {name: np.frombuffer(content, np.uint8) for name, content in files.items()}


def _bytes(entry: Kept) -> dict[str, bytes]:
    return {name: content.tobytes() for name, content in entry.arrays.items()}


def key_of_report(name: str, scenario: Scenario, form: str) -> str | None:
    """Key of the files of a report; None where a file that the scenario names cannot be read.

    Parameters
    ----------
    name, scenario : what would be run
    form : which files it has
    """
    try:
        return key_of("report", [name, scenario.content(), form])
    except OSError:
        return None


def keep(store: Store, key: str, report: Report, folder: Path, names: list[str]) -> None:
    """Keep a report and its files, as they were written into a folder, if nobody has changed one since."""
    listed = Manifest.read(folder).files
    contents = {name: (folder / name).read_bytes() for name in names}
    if all(name in listed and digest_of(folder / name) == listed[name].sha256 for name in names):
        store.write(key, Kept(_document(report), _arrays(contents)))


def found(store: Store, key: str, name: str, scenario: Scenario) -> tuple[Report, dict[str, bytes]] | None:
    """A report, without its traces, and its files by name; None where it is not kept."""
    entry = store.read(key)
    if entry is None or not all(map(is_inside, entry.arrays)):
        return None
    return _report(entry.document, name, scenario), _bytes(entry)


def _document(report: Report) -> dict[str, Any]:
    asked = {"name", "scenario", "traces"}  # of these the new report has its own, or none
    names = [item.name for item in fields(report) if item.name not in asked]
    return {name: to_jsonable_python(getattr(report, name)) for name in names}


def _report(document: Mapping[str, Any], name: str, scenario: Scenario) -> Report:
    asked = scenario.assessment
    content: dict[str, Any] = {
        key: tuple(found) if isinstance(found, list) else found for key, found in document.items()
    }
    content["instruments"] = Instruments.model_validate(document["instruments"])
    for key, made in (("rows", Row), ("bands", Band), ("sensitivities", Sensitivity)):
        content[key] = tuple(made(**found) for found in document[key])
    content["judgements"] = (
        tuple(asked.judgement_of(found) for found in document["judgements"]) if asked else ()
    )
    return Report(name=name, scenario=scenario, **content)

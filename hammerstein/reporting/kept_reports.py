"""Reports that are written without a run: nothing that they depend on has changed."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.blocks.instruments import Instruments
from hammerstein.experiment.report import Band, Report, Sensitivity
from hammerstein.metrics import Row
from hammerstein.runtime.storage.manifest import Manifest, digest_of
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario import Scenario


def key_of_report(name: str, scenario: Scenario, form: str) -> str | None:
    """Key of the files of a report; None where a file that the scenario names cannot be read.

    Parameters
    ----------
    name, scenario : what would be run
    form : which files it has
    """
    try:
        files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in scenario.files()]
    except OSError:
        return None
    return key_of("report", [name, scenario.portable(), files, form])


def keep(store: Store, key: str, report: Report, folder: Path, names: list[str]) -> None:
    """Keep a report and its files, as they were written into a folder, if nobody has changed one since."""
    listed = Manifest.read(folder).files
    contents = {name: (folder / name).read_bytes() for name in names}
    if all(name in listed and digest_of(folder / name) == listed[name].sha256 for name in names):
        files = {name: np.frombuffer(content, np.uint8) for name, content in contents.items()}
        store.write(key, Kept(_document(report), files))


def found(store: Store, key: str, name: str, scenario: Scenario) -> tuple[Report, dict[str, bytes]] | None:
    """A report, without its traces, and its files by name; None where it is not kept."""
    entry = store.read(key)
    if entry is None:
        return None
    files = {file: content.tobytes() for file, content in entry.arrays.items()}
    return _report(entry.document, name, scenario), files


def _document(report: Report) -> dict[str, Any]:
    return {
        "actuator": report.actuator,
        "digest": report.digest,
        "model_digest": report.model_digest,
        "instruments": report.instruments.model_dump(),
        "inputs": report.inputs,
        "axes": report.axes,
        "rows": [asdict(row) for row in report.rows],
        "statements": report.statements,
        "verdicts": [asdict(verdict) for verdict in report.verdicts],
        "bands": [asdict(band) for band in report.bands],
        "sensitivities": [asdict(found) for found in report.sensitivities],
    }


def _report(document: Mapping[str, Any], name: str, scenario: Scenario) -> Report:
    asked = scenario.assessment
    return Report(
        name=name,
        scenario=scenario,
        actuator=document["actuator"],
        digest=document["digest"],
        model_digest=document["model_digest"],
        instruments=Instruments.model_validate(document["instruments"]),
        inputs=tuple(document["inputs"]),
        axes=tuple(document["axes"]),
        rows=tuple(Row(**row) for row in document["rows"]),
        statements=tuple(document["statements"]),
        verdicts=tuple(asked.verdict_of(found) for found in document["verdicts"]) if asked else (),
        bands=tuple(Band(**band) for band in document["bands"]),
        sensitivities=tuple(Sensitivity(**found) for found in document["sensitivities"]),
    )

"""Figures that are drawn once: what they show is hashed, and equal pictures come from the store."""

from __future__ import annotations

import hashlib
import json

import numpy as np

from hammerstein.experiment.report import Report
from hammerstein.model.simulation import WIRES
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario.scenario import WORDS


def drawn(report: Report, store: Store | None = None, png: bool = False) -> dict[str, bytes]:
    """Bytes of each file of a report's figures by name; drawn where the store does not have them.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``, with its traces
    store : where figures are kept and found; all are drawn if not given
    png : whether PNG files are wanted beside SVG
    """
    from hammerstein.reporting.figures.choice import figures_of
    from hammerstein.reporting.figures.write import files_of

    if store is None:
        return dict(files_of(figures_of(report), png))
    shown = [digest_of_shown(report), png]
    listed = store.read(key_of("figures", shown))
    figures = {} if listed else figures_of(report)
    names: list[str] = listed.document if listed else list(figures)
    files: dict[str, bytes] = {}
    for name in names:
        key = key_of("figure", [*shown, name])
        known = store.read(key)
        if known is None:
            figures = figures or figures_of(report)
            made = files_of({name: figures[name]}, png)
            known = Kept(None, {file: np.frombuffer(content, np.uint8) for file, content in made})
            store.write(key, known)
        files |= {file: content.tobytes() for file, content in known.arrays.items()}
    if listed is None:
        store.write(key_of("figures", shown), Kept(names))
    return files


def digest_of_shown(report: Report) -> str:
    """Hash of everything in a report that a figure may show."""
    content = json.loads(report.to_json())
    for name in ("statements", "verdicts", "name"):
        del content[name]
    content["scenario"] = {k: v for k, v in content["scenario"].items() if k not in WORDS}
    content["axes"] = [report.inputs, report.axes]
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
    for trace in report.traces:
        response = trace.response
        words = [trace.label, repr(trace.signal), trace.excited_axis, trace.first_sample]
        digest.update(json.dumps([*words, response.sample_time_s]).encode())
        wires = [getattr(response, name) for name in WIRES]
        wires += [wire for p in trace.predictions for wire in (p.reading_um, p.position_um)]
        for wire in wires:
            if wire is not None:
                digest.update(repr(wire.shape).encode())
                digest.update(np.ascontiguousarray(wire).data)
        digest.update(json.dumps([p.label for p in trace.predictions]).encode())
    return digest.hexdigest()

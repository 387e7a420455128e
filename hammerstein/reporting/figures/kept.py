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
    key = None if store is None else key_of("figures", [digest_of_shown(report), png])
    known = None if store is None or key is None else store.read(key)
    if known is not None:
        return {name: content.tobytes() for name, content in known.arrays.items()}
    from hammerstein.reporting.figures.choice import figures_of
    from hammerstein.reporting.figures.write import files_of

    files = dict(files_of(figures_of(report), png))
    if store is not None and key is not None:
        arrays = {name: np.frombuffer(content, np.uint8) for name, content in files.items()}
        store.write(key, Kept(None, arrays))
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

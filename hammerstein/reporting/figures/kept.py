"""Figures that are drawn once: what they show is hashed, and equal pictures come from the store."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator

import numpy as np

from hammerstein.experiment.report import Report
from hammerstein.model.simulation import WIRES
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario.scenario import WORDS


def drawn(report: Report, store: Store | None = None) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of each file of a report's figures; drawn where the store does not have them.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``, with its traces
    store : where figures are kept and found; all are drawn if not given
    """
    if store is None:
        yield from _all_drawn(report)
        return
    shown = digest_of_shown(report)
    names = store.read(key_of("figures", shown))
    files = None if names is None else [store.read(_key(shown, name)) for name in names.document]
    if names is not None and files is not None and all(file is not None for file in files):
        for name, file in zip(names.document, files, strict=True):
            if file is not None:
                yield name, file.arrays["content"].tobytes()
        return
    found = []
    for name, content in _drawn_one_by_one(report, store, shown):
        found.append(name)
        yield name, content
    store.write(key_of("figures", shown), Kept(found))


def _all_drawn(report: Report) -> Iterator[tuple[str, bytes]]:
    from hammerstein.reporting.figures.choice import figures_of
    from hammerstein.reporting.figures.write import files_of

    yield from files_of(figures_of(report))


def _drawn_one_by_one(report: Report, store: Store, shown: str) -> Iterator[tuple[str, bytes]]:
    """Files figure by figure, each kept as soon as it is there."""
    from hammerstein.reporting.figures.choice import figures_of
    from hammerstein.reporting.figures.write import KINDS, files_of

    for figure_name, figure in figures_of(report).items():
        names = [f"{figure_name}.{kind}" for kind in KINDS]
        files = [store.read(_key(shown, name)) for name in names]
        known = {
            name: file.arrays["content"].tobytes()
            for name, file in zip(names, files, strict=True)
            if file is not None
        }
        if len(known) == len(names):
            yield from known.items()
            continue
        for name, content in files_of({figure_name: figure}):
            store.write(_key(shown, name), Kept(None, {"content": np.frombuffer(content, np.uint8)}))
            yield name, content


def _key(shown: str, name: str) -> str:
    return key_of("figure", [shown, name])


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

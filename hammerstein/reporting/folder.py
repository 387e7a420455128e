"""Files of a report: numbers, page, figures, traces.

Nothing is run or drawn again where the store has it and nothing has changed for it.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from markupsafe import Markup
from pydantic_core import to_jsonable_python

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.errors import InputError
from hammerstein.escaping import csv_text
from hammerstein.experiment.report import Band, Report, Sensitivity, Trace
from hammerstein.metrics import Row
from hammerstein.reporting.figures.write import FIGURES, files_of
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.staging import Manifest, Owner, digest_of, is_inside, prepare, staged
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario import Scenario
from hammerstein.scenario.scenario import WORDS

TraceFormat = Literal["csv", "mat"]
LONGEST_NAME = 60  # a character takes up to four of the 255 bytes that most systems allow


REPORT = Owner("report", replaces=(FIGURES.name,))
ALWAYS = ("report.html", "report.json", "report.md", "rms.csv")


@dataclass(frozen=True)
class Writer:
    """Write each report into its folder below ``out``.

    figures : whether to draw
    traces : format of the traces, one file a case, every wire a column (CSV) or a variable (MATLAB); none if
        not given
    interactive : whether the page holds plots to zoom into
    store : where reports and figures are kept and found; all are drawn if not given
    overwrite : whether to replace files that other programs wrote or a person changed
    png : whether to draw PNG files beside SVG, for a page that shows them
    """

    out: Path
    figures: bool = True
    traces: TraceFormat | None = None
    interactive: bool = False
    store: Store | None = None
    overwrite: bool = False
    png: bool = False

    def on(self, jobs: Jobs) -> Writer:
        """Return the writer for results of these workers."""
        elsewhere = getattr(jobs, "elsewhere", "")
        return self if self.store is None else replace(self, store=self.store.computed(elsewhere))

    def prepare(self, names: Iterable[str]) -> None:
        """Before the work, raise InputError for folders that cannot hold a report."""
        for name in names:
            prepare(self.out / name, REPORT, ALWAYS, self.overwrite)

    def __call__(self, report: Report) -> tuple[Path, ...]:
        """Write ``report.json``, ``rms.csv``, both pages, figures and, on request, traces.

        They take the place of those of an earlier run together; where one cannot be written, that report
        stays. Files that this program did not write stay as well. Gives the places of files that were kept
        under another name.

        Raises InputError where the folder cannot be written, is a link, or holds other people's files.
        """
        from hammerstein.reporting.run_page import run_page

        with staged(self.out / report.name, REPORT, self.overwrite) as stage:
            files = drawn(report, self.store, self.png) if self.figures else {}
            for number, trace in enumerate(report.traces if self.traces else (), start=1):
                name = f"traces/{number:03d}_{_file_name(trace)}.{self.traces}"
                columns = {"time_s": trace.time_s} | trace.response.columns()
                is_csv = self.traces == "csv"
                stage.write(name, csv_text(columns) if is_csv else _matlab(columns, stage.folder / name))
            plots = Markup()
            if self.interactive:
                from hammerstein.reporting.figures.choice import explored_figures
                from hammerstein.reporting.interactive import interactive_of

                plots = interactive_of(*explored_figures(report))
            run_page(report, files).write(stage, "report", files, plots)
        if self.store is not None and (key := self._key(report.name, report.scenario)) is not None:
            keep(self.store, key, report, stage.folder, stage.names)
        return stage.kept

    def again(self, name: str, scenario: Scenario) -> tuple[Report, tuple[Path, ...]] | None:
        """Write the stored report of an earlier run with equal inputs.

        Gives the report, without its traces, and the places of files that were kept; None where it must be
        run.
        """
        key = self._key(name, scenario)
        entry = None if self.store is None or key is None else self.store.read(key)
        if entry is None or not all(map(is_inside, entry.arrays)):
            return None
        report = _report(entry.document, name, scenario)
        with staged(self.out / name, REPORT, self.overwrite) as stage:
            for file, content in _bytes(entry).items():
                stage.write(file, content)
        return report, stage.kept

    def _key(self, name: str, scenario: Scenario) -> str | None:
        """Key of the files of a report; None where a file that the scenario names cannot be read."""
        form = f"figures {self.figures}, traces {self.traces}, interactive {self.interactive}, png {self.png}"
        try:
            return key_of("report", [name, scenario.content(), form])
        except OSError:
            return None


def _file_name(trace: Trace) -> str:
    words = f"{trace.label or 'drive'} {trace.excited_axis} {trace.signal.highest_frequency_hz:g}Hz"
    return "".join(c if c.isalnum() or c in ".-" else "_" for c in words[:LONGEST_NAME])


def _matlab(columns: dict[str, Array], path: Path) -> bytes:
    from scipy.io import savemat

    if any(len(name) > 31 for name in columns):
        raise InputError(str(path), "MATLAB variables have at most 31 characters; shorten the axis names")
    buffer = io.BytesIO()
    savemat(cast("Any", buffer), columns, oned_as="column")  # SciPy's stubs of some versions know paths only
    # SciPy stamps the time of writing into the first 116 bytes, a free text.
    text = b"MATLAB 5.0 MAT-file, written by hammerstein".ljust(116)
    return text + buffer.getvalue()[116:]


def drawn(report: Report, store: Store | None = None, png: bool = False) -> dict[str, bytes]:
    """Bytes of each file of a report's figures by name, from the store or newly drawn.

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

    made = dict(files_of(figures_of(report), png))
    if store is not None and key is not None:
        store.write(key, Kept(None, _arrays(made)))
    return made


def key_of_figures(report: Report, png: bool) -> str | None:
    """Key of all figures of a report, independent of question and tolerances; None as for a report."""
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


def keep(store: Store, key: str, report: Report, folder: Path, names: list[str]) -> None:
    """Store a report and its files from a folder, if they are unchanged."""
    listed = Manifest.read(folder).files
    contents = {name: (folder / name).read_bytes() for name in names}
    if all(name in listed and digest_of(folder / name) == listed[name].sha256 for name in names):
        asked = {"name", "scenario", "traces"}  # of these the new report has its own, or none
        names = [item.name for item in fields(report) if item.name not in asked]
        document = {name: to_jsonable_python(getattr(report, name)) for name in names}
        store.write(key, Kept(document, _arrays(contents)))


def _report(document: Mapping[str, Any], name: str, scenario: Scenario) -> Report:
    """A report, without its traces, as it was kept."""
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

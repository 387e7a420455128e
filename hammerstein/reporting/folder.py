"""Write a report's folder: numbers, page, figures, traces."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.escaping import csv_text
from hammerstein.experiment.report import Report, Trace
from hammerstein.reporting.figures.write import FIGURES
from hammerstein.reporting.html.interactive import Interactive
from hammerstein.reporting.kept_reports import drawn, found, keep, key_of_report
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import Stage, prepare, staged
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario

TraceFormat = Literal["csv", "mat"]
LONGEST_NAME = 60  # a character takes up to four of the 255 bytes that most systems allow


REPORT = Owner("report", replaces=(FIGURES.name,))
ALWAYS = ("report.html", "report.json", "report.md", "rms.csv")


@dataclass(frozen=True)
class WrittenReport:
    """Files of a report, and those of a person that were kept under another name."""

    files: tuple[Path, ...]
    kept: tuple[Path, ...]


def write_report(
    report: Report,
    folder: Path,
    *,
    figures: bool = True,
    traces: TraceFormat | None = None,
    interactive: bool = False,
    store: Store | None = None,
    overwrite: bool = False,
    png: bool = False,
) -> WrittenReport:
    """Write ``report.json``, ``rms.csv``, ``report.md``, ``report.html``, figures and, on request, traces.

    They take the place of those of an earlier run together; where one cannot be written, that report stays.
    Files that this program did not write stay as well.

    Parameters
    ----------
    report : what to write
    folder : where to; made if it does not exist
    figures : whether to draw
    traces : format of the traces, none if not given
    interactive : whether the page holds plots to zoom into
    store : where figures are kept and found; all are drawn if not given
    overwrite : whether to replace files that other programs wrote or a person changed
    png : whether to draw PNG files beside SVG, for a page that shows them

    Raises
    ------
    InputError : the folder cannot be written, is a link, or holds other people's files under these names
    """
    from hammerstein.reporting.run_page import run_page

    with staged(folder, REPORT, overwrite) as stage:
        files = drawn(report, store, png) if figures else {}
        if traces is not None:
            _write_traces(report, stage, traces)
        run_page(report, files).write(stage, "report", files, _plots(report) if interactive else None)
    return WrittenReport(tuple(stage.written), stage.kept)


def _plots(report: Report) -> Interactive | None:
    from hammerstein.reporting.figures.choice import explored_figures
    from hammerstein.reporting.html.interactive import interactive_of

    return interactive_of(*explored_figures(report))


@dataclass(frozen=True)
class Writer:
    """Write each report into its folder below ``out``."""

    out: Path
    figures: bool = True
    traces: TraceFormat | None = None
    interactive: bool = False
    store: Store | None = None
    overwrite: bool = False
    png: bool = False

    def on(self, jobs: Jobs) -> Writer:
        """Return the writer of what these workers find."""
        elsewhere = getattr(jobs, "elsewhere", "")
        return self if self.store is None else replace(self, store=self.store.computed(elsewhere))

    def prepare(self, names: Iterable[str]) -> None:
        """Refuse folders that cannot take a report, before the work; InputError says why."""
        for name in names:
            prepare(self.out / name, REPORT, ALWAYS, self.overwrite)

    def __call__(self, report: Report) -> tuple[Path, ...]:
        """Write one report; give the places of files that were kept."""
        folder = self.out / report.name
        written = write_report(
            report,
            folder,
            figures=self.figures,
            traces=self.traces,
            interactive=self.interactive,
            store=self.store,
            overwrite=self.overwrite,
            png=self.png,
        )
        key = self._key(report.name, report.scenario)
        if self.store is not None and key is not None:
            names = [path.relative_to(folder).as_posix() for path in written.files]
            keep(self.store, key, report, folder, names)
        return written.kept

    def again(self, name: str, scenario: Scenario) -> tuple[Report, tuple[Path, ...]] | None:
        """Write the report of an earlier run, if nothing that it depends on has changed.

        Gives the report, without its traces, and the places of files that were kept; None where it must be
        run.
        """
        key = self._key(name, scenario)
        known = None if self.store is None or key is None else found(self.store, key, name, scenario)
        if known is None:
            return None
        report, files = known
        with staged(self.out / name, REPORT, self.overwrite) as stage:
            for file, content in files.items():
                stage.write(file, content)
        return report, stage.kept

    def _key(self, name: str, scenario: Scenario) -> str | None:
        written = (
            f"figures {self.figures}, traces {self.traces}, interactive {self.interactive}, png {self.png}"
        )
        return key_of_report(name, scenario, written)


def _write_traces(report: Report, stage: Stage, kind: TraceFormat) -> None:
    """One file a case, every wire a column (CSV) or a variable (MATLAB)."""
    for number, trace in enumerate(report.traces, start=1):
        name = f"traces/{number:03d}_{_file_name(trace)}.{kind}"
        columns = {"time_s": trace.time_s} | trace.response.columns()
        stage.write(name, csv_text(columns) if kind == "csv" else _matlab(columns, stage.folder / name))


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

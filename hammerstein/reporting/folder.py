"""Write a report's folder: numbers, page, figures, traces."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from hammerstein.errors import InputError
from hammerstein.experiment.report import Report, Trace
from hammerstein.files import write_atomic

TraceFormat = Literal["csv", "mat"]


def write_report(
    report: Report, folder: Path, *, figures: bool = True, traces: TraceFormat | None = None
) -> list[Path]:
    """Write ``report.json``, ``rms.csv``, ``report.md``, figures and, on request, traces.

    Every file is written in one piece; ``report.json`` comes last, so that a folder that holds it is whole.

    Parameters
    ----------
    report : what to write
    folder : where to; made if it does not exist
    figures : whether to draw
    traces : format of the traces, none if not given

    Raises
    ------
    InputError : the folder cannot be written
    """
    from hammerstein.reporting.page import render

    written: list[Path] = []
    drawn: list[Path] = []
    _clear(folder)
    if figures:
        from hammerstein.reporting.figures import write_figures

        drawn = write_figures(report, folder)
        written += drawn
    if traces is not None:
        written += _write_traces(report, folder / "traces", traces)
    names = sorted(path.name for path in drawn if path.suffix == ".png")
    texts = {
        "rms.csv": report.to_csv(),
        "report.md": render(report, names),
        "report.json": report.to_json(),
    }
    if report.bands:
        texts = {"bands.csv": report.bands_to_csv()} | texts
    for name, text in texts.items():
        write_atomic(folder / name, text)
        written.append(folder / name)
    return written


@dataclass(frozen=True)
class Writer:
    """Write each report into its folder below ``out``."""

    out: Path
    figures: bool = True
    traces: TraceFormat | None = None

    def __call__(self, report: Report) -> None:
        """Write one report."""
        write_report(report, self.out / report.name, figures=self.figures, traces=self.traces)


def _clear(folder: Path) -> None:
    """Remove what an earlier run of the scenario wrote, so that no stale figure stays."""
    for pattern in ("*.png", "*.svg", "rms.csv", "bands.csv", "report.md", "report.json", "traces/*.*"):
        for path in folder.glob(pattern):
            try:
                path.unlink()
            except OSError as error:
                raise InputError(str(path), f"cannot be replaced ({error.strerror})") from None


def _write_traces(report: Report, folder: Path, kind: TraceFormat) -> list[Path]:
    """One file a case, every wire a column (CSV) or a variable (MATLAB)."""
    paths = []
    for number, trace in enumerate(report.traces, start=1):
        path = folder / f"{number:03d}_{_file_name(trace)}.{kind}"
        columns = {"time_s": trace.time_s} | trace.response.columns()
        write_atomic(path, _csv(columns) if kind == "csv" else _matlab(columns, path))
        paths.append(path)
    return paths


def _file_name(trace: Trace) -> str:
    words = f"{trace.label or 'drive'} {trace.excited_axis} {trace.signal.highest_frequency_hz:g}Hz"
    return "".join(c if c.isalnum() or c in ".-" else "_" for c in words)


def _csv(columns: dict[str, NDArray[np.float64]]) -> str:
    import pandas as pd

    return str(pd.DataFrame(columns).to_csv(index=False, lineterminator="\n"))


def _matlab(columns: dict[str, NDArray[np.float64]], path: Path) -> bytes:
    from scipy.io import savemat

    if any(len(name) > 31 for name in columns):
        raise InputError(str(path), "MATLAB variables have at most 31 characters; shorten the axis names")
    buffer = io.BytesIO()
    savemat(cast("Any", buffer), columns, oned_as="column")  # SciPy's stubs of some versions know paths only
    # SciPy stamps the time of writing into the first 116 bytes, a free text.
    text = b"MATLAB 5.0 MAT-file, written by hammerstein".ljust(116)
    return text + buffer.getvalue()[116:]

"""Figures into files: SVG for zooming, PNG for everywhere."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from hammerstein.figures.choice import figures_of
from hammerstein.figures.style import PNG_DPI, styled
from hammerstein.files import write_atomic
from hammerstein.report import Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_figures(report: Report, folder: Path) -> list[Path]:
    """Draw the figures of a report and write each as SVG and PNG; equal reports give equal bytes.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run``, with its traces
    folder : where to; made if it does not exist

    Raises
    ------
    InputError : the folder cannot be written
    """
    written = []
    for name, figure in figures_of(report).items():
        for kind, content in images(figure).items():
            path = folder / f"{name}.{kind}"
            write_atomic(path, content)
            written.append(path)
    return written


def images(figure: Figure) -> dict[str, bytes]:
    """Give the bytes of a figure as ``svg`` and ``png``, without date or version."""
    formats = {"svg": {"Date": None, "Creator": "hammerstein"}, "png": {"Software": None}}
    content = {}
    with styled():
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # the layout is found; both files keep it
        for kind, metadata in formats.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=PNG_DPI, metadata=metadata)
            content[kind] = buffer.getvalue()
    return content

"""Figures into files: SVG for zooming, PNG for everywhere."""

from __future__ import annotations

import io
from collections.abc import Mapping
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
    return save_figures(figures_of(report), folder)


def save_figures(figures: Mapping[str, Figure], folder: Path) -> list[Path]:
    """Write figures, by name, as SVG and PNG.

    Raises
    ------
    InputError : the folder cannot be written
    """
    written = []
    for name, figure in figures.items():
        for kind, content in images(figure).items():
            path = folder / f"{name}.{kind}"
            write_atomic(path, content)
            written.append(path)
    return written


def images(figure: Figure) -> dict[str, bytes]:
    """Give the bytes of a figure as ``svg`` and ``png``, without date or version."""
    metadata: dict[str, dict[str, str | None]] = {
        "svg": {"Date": None, "Creator": "hammerstein"},
        "png": {"Software": None},
    }
    content = {}
    with styled():
        layout = figure.get_layout_engine()
        if layout is not None:
            layout.execute(figure)
            figure.set_layout_engine(None)  # found once, it holds for both files
        for kind, about in metadata.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=PNG_DPI, metadata=about)
            content[kind] = buffer.getvalue()
    return content

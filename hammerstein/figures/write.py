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

PNG_COMPRESSION = 3  # half the time of the usual 6, and hardly larger

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
    with styled():
        _laid_out(figure)
        return {"svg": _svg(figure), "png": _png(figure)}


def _laid_out(figure: Figure) -> None:
    """Find the layout once; it holds for both files."""
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": "hammerstein"})
    return buffer.getvalue()


def _png(figure: Figure) -> bytes:
    """Without transparency: a third less to compress."""
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    buffer = io.BytesIO()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])  # type: ignore[no-untyped-call]
    picture.save(buffer, format="png", dpi=(PNG_DPI, PNG_DPI), compress_level=PNG_COMPRESSION)
    return buffer.getvalue()

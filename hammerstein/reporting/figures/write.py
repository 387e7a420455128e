"""Figures into files: SVG for zooming, PNG for everywhere."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.experiment.report import Report
from hammerstein.reporting.figures.choice import figures_of
from hammerstein.reporting.figures.palette import in_few_colours
from hammerstein.reporting.figures.png import png_of
from hammerstein.reporting.figures.style import PNG_DPI, styled
from hammerstein.runtime.storage.manifest import Owner
from hammerstein.runtime.storage.staging import Stage, staged

KINDS = ("svg", "png", "narrow")
"""What is drawn of each figure; the last one, a PNG for a narrow screen, lies in a page alone."""

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FIGURES = Owner("figures")


def write_figures(report: Report, folder: Path, overwrite: bool = False) -> list[Path]:
    """Draw the figures of a report and write each as SVG and PNG; equal reports give equal bytes.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``, with its traces
    folder : where to; made if it does not exist
    overwrite : whether to replace files that other programs wrote or a person changed

    Raises
    ------
    InputError : the folder cannot be written, or holds other people's files under these names
    """
    return save_figures(figures_of(report), folder, overwrite=overwrite)


def save_figures(
    figures: Mapping[str, Figure], folder: Path, owner: Owner = FIGURES, overwrite: bool = False
) -> list[Path]:
    """Write figures, by name, as SVG and PNG, in place of those that the same owner wrote before.

    Raises
    ------
    InputError : the folder cannot be written, or holds other people's files under these names
    """
    with staged(folder, owner, overwrite) as stage:
        write_drawn(stage, files_of(figures))
    return stage.written


def write_drawn(stage: Stage, files: Iterable[tuple[str, bytes]]) -> dict[str, bytes]:
    """Write drawn files, but those that lie in a page alone; gives all of them by name."""
    found = dict(files)
    for name, content in found.items():
        if not name.endswith(KINDS[-1]):
            stage.write(name, content)
    return found


def files_of(figures: Mapping[str, Figure]) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of each file of the figures."""
    for name, figure in figures.items():
        for kind, content in images(figure).items():
            yield f"{name}.{kind}", content


def images(figure: Figure) -> dict[str, bytes]:
    """Give the bytes of a figure, by ``KINDS``, without date or version."""
    from hammerstein.reporting.figures.drawing import drawing_of
    from hammerstein.reporting.figures.narrow import narrow_figure

    with styled():
        drawing = drawing_of(figure)
        wide, narrow = drawing.painted(), narrow_figure(figure, drawing)
        return dict(zip(KINDS, (_svg(wide), _png(wide), _png(narrow)), strict=True))


def png(figure: Figure) -> bytes:
    """Give the bytes of a figure as PNG alone."""
    from hammerstein.reporting.figures.drawing import drawing_of

    with styled():
        return _png(drawing_of(figure).painted())


def _svg(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": "hammerstein"})
    return buffer.getvalue()


def _png(figure: Figure) -> bytes:
    """With a palette and without transparency: a line drawing has few colours."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)  # given with the drawing
    canvas.draw()  # type: ignore[no-untyped-call]
    palette, numbers = in_few_colours(np.asarray(canvas.buffer_rgba()))  # type: ignore[no-untyped-call]
    return png_of(palette, numbers, PNG_DPI)

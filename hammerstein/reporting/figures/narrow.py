"""Figures for a telephone: the panels of a wide figure below each other, its letters as they were."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

NARROW_IN = 4.0
NARROW_DPI = 125  # 500 pixels
MOST_LETTERS, MOST_OF_TWO = 42, 17  # of a line of the legend, of one or of two columns
LINE_IN, BELOW_IN, BETWEEN_IN = 0.18, 0.5, 0.15


def make_narrow(figure: Figure) -> None:
    """Put the panels of a figure below each other; those that share a horizontal axis stay together.

    The figure, which was laid out before, is changed.
    """
    axes = _in_order(figure.axes)
    heights = [panel.get_position().height * figure.get_figheight() for panel in axes]
    lines = sum(_narrow_legend(figure, legend) for legend in list(figure.legends))
    shown = [_labelled(panel, below) for panel, below in zip(axes, [*axes[1:], None], strict=True)]
    room_in = sum(BELOW_IN if labels else BETWEEN_IN for labels in shown)
    figure.set_size_inches(NARROW_IN, sum(heights) + room_in + LINE_IN * (lines + 1))
    figure.set_dpi(NARROW_DPI)
    grid = figure.add_gridspec(len(axes), 1, height_ratios=heights)
    for number, panel in enumerate(axes):
        panel.set_subplotspec(grid[number])
        if panel.get_xscale() == "linear":
            panel.locator_params(axis="x", nbins=5)
    figure.set_layout_engine("constrained", h_pad=0.06, w_pad=0.06)


def _in_order(panels: Sequence[Axes]) -> list[Axes]:
    """Panels as they were made, each followed by those that share its horizontal axis."""
    found: list[Axes] = []
    for panel in panels:
        siblings = panel.get_shared_x_axes().get_siblings(panel)
        found += [other for other in panels if other in siblings and other not in found]
    return found


def _labelled(panel: Axes, below: Axes | None) -> bool:
    """Let a panel have its own labels, but those of a horizontal axis that the next one below shares."""
    last = below is None or not panel.get_shared_x_axes().joined(panel, below)
    if last:
        panel.tick_params(labelbottom=True)
        panel.xaxis.label.set_visible(True)
    panel.tick_params(labelleft=True)
    panel.yaxis.label.set_visible(True)
    if not panel.get_ylabel():
        others = panel.get_shared_y_axes().get_siblings(panel)
        panel.set_ylabel(next((other.get_ylabel() for other in others if other.get_ylabel()), ""))
    return last


def _narrow_legend(figure: Figure, legend: Legend) -> int:
    """Put a legend of short lines in the place of a wide one; gives the number of its lines."""
    handles = [handle for handle in legend.legend_handles if handle is not None]
    words = ["\n".join(textwrap.wrap(text.get_text(), MOST_LETTERS)) for text in legend.get_texts()]
    title = "\n".join(textwrap.wrap(legend.get_title().get_text(), MOST_LETTERS))
    legend.remove()
    columns = 2 if max(map(len, words), default=0) <= MOST_OF_TWO else 1
    made = figure.legend(handles, words, loc="outside upper center", ncols=columns, title=title or None)
    made.get_title().set(fontweight="bold", multialignment="center")
    lines = sum(1 + word.count("\n") for word in words) / columns
    return math.ceil(lines) + (1 + title.count("\n") if title else 0)

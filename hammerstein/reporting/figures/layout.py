"""Places of the panels of a figure, from one look at their labels.

What stands beside a panel takes the same room wherever the panel is: it is measured once, and what is left
is shared out. No solver is needed for one grid.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.layout_engine import LayoutEngine
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike

from hammerstein.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

Ends = tuple[float, float]
Room = tuple[Ends, Ends]

EDGE_IN = 0.06
"""Room around each panel with its labels, and above and below a legend."""
APART_IN = 0.14
"""The same left and right of a panel."""
USUAL_IN: Room = (0.55, 0.1), (0.4, 0.25)
"""Room of usual labels left and right of a panel, and below and above it: where it stands for the look."""
SMALLEST = 0.1
"""Part of a figure that its panels have at least, however long their labels."""


class OneLook(LayoutEngine):
    """Gives the panels of a single grid, equal ones, what their labels and the legend above leave."""

    _adjust_compatible = _colorbar_gridspec = False

    def execute(self, fig: Figure) -> None:
        """Place the panels of a figure."""
        panels = {axes: place for axes in fig.axes if (place := axes.get_subplotspec()) is not None}
        legends_in = sum(one.get_window_extent().height / fig.dpi + 2.0 * EDGE_IN for one in fig.legends)
        size_in: Ends = tuple(fig.get_size_inches())
        _place(panels, [USUAL_IN] * len(panels), size_in, legends_in)
        _place(panels, [_room_in(axes, fig.dpi) for axes in panels], size_in, legends_in)


def _room_in(axes: Axes, dpi: float) -> Room:
    """Room that the labels of a panel take left and right of it, and below and above."""
    box, panel = axes.get_tightbbox(for_layout_only=True), axes.bbox
    assert box is not None  # of a panel that is seen
    across = (panel.x0 - box.x0) / dpi + APART_IN, (box.x1 - panel.x1) / dpi + APART_IN
    return across, ((panel.y0 - box.y0) / dpi + EDGE_IN, (box.y1 - panel.y1) / dpi + EDGE_IN)


def _place(panels: dict[Axes, SubplotSpec], rooms: Sequence[Room], size_in: Ends, legends_in: float) -> None:
    if not panels:
        return
    (width, height), grid = size_in, next(iter(panels.values())).get_gridspec()
    columns = ((one.colspan, across) for one, (across, _) in zip(panels.values(), rooms, strict=True))
    rows = ((one.rowspan, up[::-1]) for one, (_, up) in zip(panels.values(), rooms, strict=True))
    left, right = _edges(width, grid.get_width_ratios(), columns)
    top, bottom = _edges(height - legends_in, grid.get_height_ratios(), rows)
    for axes, place in panels.items():
        x0, x1 = left[place.colspan.start], right[place.colspan.stop - 1]
        y0, y1 = bottom[place.rowspan.stop - 1], top[place.rowspan.start]
        box = Bbox.from_extents(x0, height - legends_in - y0, x1, height - legends_in - y1)
        axes.set_position(Bbox(box.get_points() / size_in))
        axes.set_in_layout(True)  # a given position ends that


def _edges(length: float, ratios: ArrayLike, rooms: Iterable[tuple[range, Ends]]) -> tuple[Array, Array]:
    """Begin and end of each cell of a grid, from the room beside each panel and the cells that it spans."""
    before, after = np.zeros((2, np.size(ratios)))
    for cells, (first, last) in rooms:
        before[cells.start] = max(before[cells.start], first)
        after[cells.stop - 1] = max(after[cells.stop - 1], last)
    free = max(length - before.sum() - after.sum(), SMALLEST * length)
    parts = np.asarray(ratios, dtype=float)
    sizes = free * parts / parts.sum()
    ends = np.cumsum(before + sizes + after) - after
    return ends - sizes, ends

"""Figures for a telephone: the panels of a wide figure below each other, its letters as they were.

Nothing is drawn anew but the legend: lines are squeezed to the width, and words follow their places.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from matplotlib.transforms import Affine2D, Bbox, BboxTransform

from hammerstein.reporting.figures.drawing import Drawing, Placed, Stroke, Words, drawing_of, empty, paint
from hammerstein.reporting.figures.style import in_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Side = Literal["left", "below", "above", "inside"]
Ends = Sequence[float]

NARROW_PX, NARROW_DPI = 500, 125
LEGEND_LETTERS, LEGEND_LETTERS_OF_TWO = 42, 17  # of a line of the legend, of one or of two columns
EDGE_PX = 8.0
BETWEEN_PX, JOINED_PX = 16.0, 8.0  # from panel to panel; of those that share a horizontal axis
APART_PX = 6.0  # from number to number of an axis
TICK_PX = 7.0


def narrow_figure(figure: Figure, drawing: Drawing) -> Figure:
    """Put the panels of a drawn figure below each other; those that share a horizontal axis together."""
    legends = empty((NARROW_PX / NARROW_DPI, 1.0), NARROW_DPI)
    below_px = -sum(_narrow_legend(legends, legend, drawing) for legend in figure.legends)
    panels = list(_panels(figure, drawing))
    labels = [label for panel in panels for label in panel.labels]
    left = EDGE_PX + max([label.panel.x0 - label.room.x0 for label in labels] + [0.0])
    right = EDGE_PX + max([label.room.x1 - label.panel.x1 for label in labels] + [0.0])
    high_px, drawn = legends.bbox.height, drawing_of(legends).strokes
    strokes: list[Placed] = [(stroke, Affine2D().translate(0.0, -high_px)) for stroke in drawn]
    for panel in panels:
        place = panel.sized(left, NARROW_PX - right)
        place = place.translated(0.0, below_px - panel.room(place).y1)
        strokes += panel.put(place)
        below_px = panel.room(place).y0 - (JOINED_PX if panel.joined else BETWEEN_PX)
    height_px = math.ceil(-below_px)
    made = empty((NARROW_PX / NARROW_DPI, height_px / NARROW_DPI), NARROW_DPI)
    return paint(made, [(stroke, move.translate(0.0, height_px)) for stroke, move in strokes])


@dataclass(frozen=True, eq=False)
class _Label:
    """Words at a panel of the wide figure: the room that they take there, and the panel's place [pixel]."""

    words: Words
    room: Bbox
    panel: Bbox

    @property
    def side(self) -> Side:
        if self.room.x1 <= self.panel.x0 + 1.0:
            return "left"
        if self.room.y1 <= self.panel.y0 + 1.0:
            return "below"
        return "above" if self.room.y0 >= self.panel.y1 - 1.0 else "inside"

    def at(self, place: Bbox) -> Bbox:
        """Room that they take at a panel elsewhere: as far from its edge, or at the same part of it."""
        room, panel, side = self.room, self.panel, self.side
        across = room.intervalx, panel.intervalx, place.intervalx
        up = room.intervaly, panel.intervaly, place.intervaly
        x = _middled(*across) if side == "below" else _within(*across)
        y = _middled(*up) if side == "left" else _within(*up)
        if side == "left":
            x = place.x0 + room.x0 - panel.x0
        elif side == "below":
            y = place.y0 + room.y0 - panel.y0
        elif side == "above":
            y = place.y1 + room.y0 - panel.y1
        x = max(min(x, NARROW_PX - EDGE_PX - room.width), EDGE_PX)
        return Bbox.from_bounds(x, y, room.width, room.height)


def _middled(room: Ends, old: Ends, new: Ends) -> float:
    """Begin where the middle of the room is at the same part of the new panel."""
    part = (0.5 * (room[0] + room[1]) - old[0]) / (old[1] - old[0])
    return new[0] + part * (new[1] - new[0]) - 0.5 * (room[1] - room[0])


def _within(room: Ends, old: Ends, new: Ends) -> float:
    """Begin where the room is as close to one edge, compared with the other, as it was."""
    size = room[1] - room[0]
    part = (room[0] - old[0]) / max(old[1] - old[0] - size, 1.0)
    return new[0] + part * (new[1] - new[0] - size)


@dataclass(frozen=True, eq=False)
class _Panel:
    """A panel of the wide figure: its place there [pixel], its lines, and all labels that it needs.

    joined : whether the next one below shares its horizontal axis
    square : whether both of its axes have one scale
    """

    place: Bbox
    lines: Sequence[Stroke]
    labels: Sequence[_Label]
    joined: bool
    square: bool

    def sized(self, left: float, right: float) -> Bbox:
        """Place between two edges."""
        part = (right - left) / self.place.width if self.square else 1.0
        return Bbox.from_extents(left, 0.0, right, part * self.place.height)

    def room(self, place: Bbox) -> Bbox:
        """Room that it takes in a place, with ticks and labels."""
        ticks = Bbox.from_extents(place.x0, place.y0 - TICK_PX, place.x1, place.y1)
        return Bbox.union([ticks, *(room for _, room in _legible(self.labels, place))])

    def put(self, place: Bbox) -> Iterator[Placed]:
        """Its strokes in a place."""
        for line in self.lines:
            yield line, Affine2D(BboxTransform(self.place, place).get_matrix())
        for label, room in _legible(self.labels, place):
            yield label.words, Affine2D().translate(room.x0 - label.room.x0, room.y0 - label.room.y0)


def _legible(labels: Sequence[_Label], place: Bbox) -> Iterator[tuple[_Label, Bbox]]:
    """Labels and their rooms; of numbers below a panel every second, or third, where all would overlap."""
    lines: dict[int, list[tuple[_Label, Bbox]]] = defaultdict(list)
    for label in labels:
        found = label, label.at(place)
        if label.side == "below":
            lines[round(label.words.y)].append(found)
        else:
            yield found
    for line in lines.values():
        line.sort(key=lambda found: found[1].x0)
        every = 1
        while any(b.x0 - a.x1 < APART_PX for (_, a), (_, b) in pairwise(line[::every])):
            every += 1
        yield from line[::every]


def _panels(figure: Figure, drawing: Drawing) -> Iterator[_Panel]:
    """Panels in their order below each other, with the numbers that their row or column has but once."""
    strokes = dict(zip(figure.axes, drawing.panels, strict=True))
    order = _in_order(figure.axes)
    labels = {axes: [*_labels(axes, strokes[axes], drawing)] for axes in order}
    for axes, below in zip(order, [*order[1:], None], strict=True):
        row = [axes, *(one for one in order if _row(one) == _row(axes))]
        column = [axes, *(one for one in order if _column(one) == _column(axes))]
        joined = below is not None and axes.get_shared_x_axes().joined(axes, below)
        lent = _lent("left", [labels[one] for one in row])
        if not joined:
            lent += _lent("below", [labels[one] for one in column])
        lines = [stroke for stroke in strokes[axes] if not isinstance(stroke, Words)]
        square = axes.get_aspect() != "auto"
        yield _Panel(axes.bbox.frozen(), lines, labels[axes] + lent, joined, square)


def _row(axes: Axes) -> tuple[object, ...]:
    """Give what panels have in common whose vertical axis has its numbers but once."""
    return axes.get_ylim(), axes.get_yscale(), *axes.bbox.intervaly.round()


def _column(axes: Axes) -> tuple[object, ...]:
    """Give what panels have in common whose horizontal axis has its numbers but once."""
    return axes.get_xlim(), axes.get_xscale(), *axes.bbox.intervalx.round()


def _in_order(panels: Sequence[Axes]) -> list[Axes]:
    """Panels as they were made, each followed by those that share its horizontal axis."""
    found: list[Axes] = []
    for panel in panels:
        siblings = panel.get_shared_x_axes().get_siblings(panel)
        found += [other for other in panels if other in siblings and other not in found]
    return found


def _labels(axes: Axes, strokes: Sequence[Stroke], drawing: Drawing) -> Iterator[_Label]:
    for stroke in strokes:
        if isinstance(stroke, Words):
            yield _Label(stroke, stroke.box(drawing.measures), axes.bbox.frozen())


def _lent(side: Side, own_and_others: Sequence[Sequence[_Label]]) -> list[_Label]:
    """Labels of this side of the first other panel that has some, if the own one has none."""
    found = [[label for label in labels if label.side == side] for labels in own_and_others]
    return [] if found[0] else next(filter(None, found), [])


def _narrow_legend(legends: Figure, legend: Legend, drawing: Drawing) -> float:
    """Put a legend of short lines in the place of a wide one; gives its height [pixel]."""
    handles = [handle for handle in legend.legend_handles if handle is not None]
    words = [in_lines(text.get_text(), LEGEND_LETTERS) for text in legend.get_texts()]
    title = in_lines(legend.get_title().get_text(), LEGEND_LETTERS)
    columns = 2 if max(map(len, words), default=0) <= LEGEND_LETTERS_OF_TWO else 1
    narrow = legends.legend(handles, words, loc="upper center", ncols=columns, title=title or None)
    narrow.get_title().set(fontweight="bold", multialignment="center")
    return narrow.get_window_extent(drawing.measures).height + BETWEEN_PX

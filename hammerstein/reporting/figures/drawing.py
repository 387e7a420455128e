"""A figure drawn once: its strokes and words are kept, to be painted as pixels, as SVG, and elsewhere.

To find out what a figure consists of takes most of the time of drawing it; painting what was found is quick.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backend_bases import FigureCanvasBase, GraphicsContextBase, RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.figure import Figure
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Affine2D, Affine2DBase, Bbox, TransformedPath
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path
    from matplotlib.text import Text

Pen = GraphicsContextBase
Paint = Any  # a colour as matplotlib holds it

SPARE_PX = 2  # round the measured room of a text: letters lean over it


@dataclass(frozen=True, eq=False)
class Line:
    """A path, with or without a filling."""

    pen: Pen
    path: Path
    place: Affine2DBase
    filling: Paint

    def paint(self, renderer: RendererBase, move: Affine2D, size: float) -> None:
        """Draw it with a renderer, its places moved [pixel]; size: of a pixel there."""
        renderer.draw_path(_moved(self.pen, renderer, move), self.path, _then(self.place, move), self.filling)


@dataclass(frozen=True, eq=False)
class Marks:
    """A mark at each point of a path; one at the corner of the figure alone stands where its shape says."""

    pen: Pen
    mark: Path
    shape: Affine2DBase
    path: Path
    place: Affine2DBase
    filling: Paint

    def paint(self, renderer: RendererBase, move: Affine2D, size: float) -> None:
        """Draw it with a renderer, its places moved [pixel]; size: of a pixel there."""
        shape, place = _then(self.shape, Affine2D().scale(size)), _then(self.place, move)
        if not self.place.transform(self.path.vertices).any():  # so matplotlib draws a filled band
            shape, place = _then(self.shape, move), Affine2D()
        pen = _moved(self.pen, renderer, move)
        renderer.draw_markers(pen, self.mark, shape, self.path, place, self.filling)


@dataclass(frozen=True, eq=False)
class Words:
    """A line of text; x and y are where it begins on its base line, counted from below."""

    pen: Pen
    x: float
    y: float
    text: str
    font: FontProperties
    angle: float
    formula: Any
    source: Text | None

    def paint(self, renderer: RendererBase, move: Affine2D, size: float) -> None:
        """Draw it with a renderer, its places moved [pixel]; size: of a pixel there."""
        x, y = move.transform((self.x, self.y))
        pen = _moved(self.pen, renderer, move)
        if isinstance(renderer, RendererAgg):
            font, colour = self.font.copy(), pen.get_rgb()
            stamp, right, above = _stamp(self.text, font, self.angle, self.formula, colour, renderer.dpi)
            pen.set_alpha(1.0)  # the stamp has its own
            renderer.draw_image(pen, round(x) + right, round(y) + above, stamp)
            return
        height = renderer.get_canvas_width_height()[1]
        renderer.draw_text(pen, x, height - y, self.text, self.font, self.angle, self.formula, self.source)

    def box(self, renderer: RendererBase) -> Bbox:
        """Give the room that it takes; it stands level or upright."""
        width, height, descent = renderer.get_text_width_height_descent(self.text, self.font, self.formula)
        if round(self.angle) % 180 == 90:
            return Bbox.from_bounds(self.x - height + descent, self.y, height, width)
        return Bbox.from_bounds(self.x, self.y - descent, width, height)


Stroke = Line | Marks | Words
Placed = tuple[Stroke, Affine2D]


@dataclass(frozen=True, eq=False)
class Drawing:
    """What was drawn of a figure.

    size_in, dpi : width and height [inch], and pixels an inch
    measures : renderer that measured its text
    strokes : all of them, in order
    panels : those of each of its axes, in the order of the figure
    """

    size_in: tuple[float, float]
    dpi: float
    measures: RendererBase
    strokes: Sequence[Stroke]
    panels: Sequence[Sequence[Stroke]]

    def painted(self) -> Figure:
        """Give a figure that shows it as it is."""
        figure = empty(self.size_in, self.dpi)
        return paint(figure, [(stroke, Affine2D()) for stroke in self.strokes])


def drawing_of(figure: Figure) -> Drawing:
    """Lay a figure out and draw it once; the layout asks for the same measures of text."""
    recorder = _Recorder(figure)
    _Canvas(figure).renderer = recorder
    for axes in figure.axes:
        for spine in axes.spines.values():
            spine.set_in_layout(False)  # it stands on the edge of its panel: nothing to measure
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)
    figure.set_frameon(False)  # every figure that this is painted on has its own
    figure.draw(recorder)
    width, height = figure.get_size_inches()
    return Drawing((width, height), figure.dpi, recorder, recorder.strokes, recorder.panels)


def empty(size_in: tuple[float, float], dpi: float) -> Figure:
    """Give a figure to paint on."""
    figure = Figure(size_in, dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def paint(figure: Figure, strokes: Iterable[Placed]) -> Figure:
    """Put strokes onto a figure, each moved [pixel]; words and marks keep their size."""
    figure.add_artist(Painting(list(strokes), figure.dpi))
    return figure


class Painting(Artist):
    """Paints strokes; the SVG counts in points, not in pixels."""

    def __init__(self, strokes: list[Placed], dpi: float) -> None:
        super().__init__()
        self.strokes, self.dpi = strokes, dpi

    def draw(self, renderer: RendererBase) -> None:
        """Paint all strokes with a renderer of whatever resolution."""
        figure = self.get_figure(root=True)
        assert figure is not None
        size = figure.dpi / self.dpi
        _know_formulas(renderer)
        for stroke, move in self.strokes:
            stroke.paint(renderer, Affine2D(move.get_matrix()).scale(size), size)


class _Canvas(FigureCanvasBase):
    """Gives the recorder to whatever asks how large a text is."""

    renderer: RendererBase

    def get_renderer(self) -> RendererBase:
        return self.renderer


class _Recorder(RendererBase):
    """Keeps what it is told to draw; pixels and text are measured as where pixels are painted."""

    def __init__(self, figure: Figure) -> None:
        super().__init__()
        self.dpi, self.width, self.height = figure.dpi, figure.bbox.width, figure.bbox.height
        self.strokes: list[Stroke] = []
        self.panels: list[list[Stroke]] = []
        self.inside = False

    def open_group(self, s: str, gid: str | None = None) -> None:
        if s == "axes":
            self.inside = True
            self.panels.append([])

    def close_group(self, s: str) -> None:
        self.inside = self.inside and s != "axes"

    def draw_path(self, gc: Pen, path: Path, transform: Any, rgbFace: Paint = None) -> None:
        self._keep(Line(_copied(gc), path, transform.frozen(), rgbFace))

    def draw_markers(
        self,
        gc: Pen,
        marker_path: Path,
        marker_trans: Any,
        path: Path,
        trans: Any,
        rgbFace: Paint = None,
    ) -> None:
        self._keep(Marks(_copied(gc), marker_path, marker_trans.frozen(), path, trans.frozen(), rgbFace))

    def draw_text(
        self,
        gc: Pen,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Text | None = None,
    ) -> None:
        self._keep(Words(_copied(gc), x, self.height - y, s, prop, angle, ismath, mtext))

    def get_text_width_height_descent(
        self, s: str, prop: FontProperties, ismath: Any
    ) -> tuple[float, float, float]:
        return _measured(s, prop.copy(), ismath, self.dpi)

    def get_canvas_width_height(self) -> tuple[float, float]:
        return self.width, self.height

    def points_to_pixels(self, points: Any) -> Any:
        return points * self.dpi / 72.0

    def _keep(self, stroke: Stroke) -> None:
        self.strokes.append(stroke)
        if self.inside:
            self.panels[-1].append(stroke)


@lru_cache(4096)
def _measured(text: str, font: FontProperties, formula: Any, dpi: float) -> tuple[float, float, float]:
    """Width, height and depth of a text [pixel]: the figures of a run say the same again and again."""
    width, height, depth = _ruler(dpi).get_text_width_height_descent(text, font, formula)
    return width, height, depth


@lru_cache(1024)
def _stamp(
    text: str, font: FontProperties, angle: float, formula: Any, colour: Paint, dpi: float
) -> tuple[NDArray[np.uint8], int, int]:
    """Pixels of a text (row from below, column, 4), and where they begin, right of and above where it does.

    It stands on whole pixels, wherever it is. To paint letters takes longer than to paint all lines, and the
    pictures of a run have most of their words in common.
    """
    width, height, depth = _measured(text, font, formula, dpi)
    corners = Bbox.from_bounds(0.0, -depth, width, height).corners()
    corners = Affine2D().rotate_deg(angle).transform(corners)
    right, above = map(int, np.floor(corners.min(axis=0)) - SPARE_PX)
    columns, rows = (np.ceil(corners.max(axis=0)) + SPARE_PX).astype(int) - (right, above)
    renderer = cast("Any", RendererAgg)(columns, rows, dpi)
    _know_formulas(renderer)
    pen = renderer.new_gc()
    pen.set_foreground(colour, isRGBA=True)
    renderer.draw_text(pen, -right, rows + above, text, font, angle, formula)
    return np.array(renderer.buffer_rgba())[::-1], right, above


@cache
def _ruler(dpi: float) -> Any:
    return cast("Any", RendererAgg)(1, 1, dpi)


def _know_formulas(renderer: RendererBase) -> None:
    """Let a renderer know the formulas of those before it: to read one takes long."""
    outlines = getattr(renderer, "_text2path", None)  # of a renderer that has none, every formula is read
    if isinstance(renderer, RendererAgg):
        renderer.mathtext_parser = _ruler(renderer.dpi).mathtext_parser
    elif outlines is not None:
        outlines.mathtext_parser = text_to_path.mathtext_parser


def _copied(pen: Pen) -> Pen:
    found = GraphicsContextBase()
    found.copy_properties(pen)
    box = pen.get_clip_rectangle()
    found.set_clip_rectangle(None if box is None else Bbox(box.get_points()))
    return found


def _moved(pen: Pen, renderer: RendererBase, move: Affine2D) -> Pen:
    """Pen of a renderer, whose clipping moves too."""
    found = renderer.new_gc()
    found.copy_properties(pen)
    box = pen.get_clip_rectangle()
    if box is not None:
        found.set_clip_rectangle(Bbox(move.transform(box.get_points())))
    path, place = cast("Any", pen).get_clip_path()
    if path is not None:
        found.set_clip_path(TransformedPath(path, _then(place, move)))
    return found


def _then(place: Affine2DBase, move: Affine2D) -> Affine2D:
    return Affine2D(move.get_matrix() @ place.get_matrix())

"""Files of figures: SVG for pages and zooming, PNG for pages of a repository."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from hammerstein.reporting.figures.style import COLOURS, DARK, PALE, PNG_COLOURS, PNG_DPI, styled
from hammerstein.runtime.staging import Owner, staged

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.transforms import Bbox

FIGURES = Owner("figures")
SVG = "{http://www.w3.org/2000/svg}"
POINTS_AN_INCH = 72.0  # by definition
EDGE_PT = 2.5
"""Round each part of a drawing: letters lean over the room that they are measured to take."""
_BEYOND = re.compile(r"(?<=\.\d\d)\d+")
_GAPS = re.compile(r"\s+(?=[A-Za-z]|$)|(?<=[A-Za-z])\s+")
_LENGTHS = frozenset({"x", "y", "width", "height"})

ElementTree.register_namespace("", SVG[1:-1])
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")


def save_figures(
    figures: Mapping[str, Figure], folder: Path, owner: Owner = FIGURES, overwrite: bool = False
) -> list[Path]:
    """Write figures, by name, as SVG and PNG; they replace earlier ones of the same owner.

    Raises
    ------
    InputError : the folder cannot be written, or holds other people's files under these names
    """
    with staged(folder, owner, overwrite) as stage:
        for name, content in files_of(figures, png=True):
            stage.write(name, content)
    return [folder / name for name in stage.names]


def files_of(figures: Mapping[str, Figure], png: bool = False) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of each file of the figures: SVG, and PNG on request."""
    for name, figure in figures.items():
        yield f"{name}.svg", svg_of(figure)
        if png:
            yield f"{name}.png", png_of(figure)


def png_of(figure: Figure) -> bytes:
    """Bytes of a figure as PNG of few colours: half a byte a pixel of a line drawing.

    They are the colours of curves, however little of a curve is seen, and the most frequent others.
    """
    from PIL import Image

    drawn, packed = io.BytesIO(), io.BytesIO()
    with styled():
        figure.savefig(drawn, format="png", dpi=PNG_DPI)
    with Image.open(drawn) as shown:
        picture = shown.convert("RGB")
    counted: Any = picture.getcolors(picture.width * picture.height)
    palette = Image.new("P", (1, 1))
    pens = {tuple(bytes.fromhex(pen[1:])) for pen in (*COLOURS, DARK, PALE)}
    ordered = sorted(counted, key=lambda found: (found[1] in pens, found), reverse=True)
    palette.putpalette([part for _, colour in ordered[:PNG_COLOURS] for part in colour])
    few = picture.quantize(palette=palette, dither=Image.Dither.NONE)
    few.save(packed, "PNG", optimize=True, dpi=(PNG_DPI, PNG_DPI))
    return packed.getvalue()


def svg_of(figure: Figure) -> bytes:
    """Bytes of a figure as SVG, without date or version.

    Its title, each entry of its legend and each of its panels is an ``svg`` element of its own, in the place
    that it has in the figure: a page can put them elsewhere. Numbers are cut after a hundredth of a point,
    which no screen shows.
    """
    drawn, dpi = io.BytesIO(), figure.dpi
    with styled():
        figure.set_dpi(POINTS_AN_INCH)  # of this file: places are asked for in its points
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None, "Format": None})
        boxes = {
            "axes": list(_panel_boxes(figure)),
            "legend": [box for legend in figure.legends for box in _legend_boxes(legend)],
        }
        figure.set_dpi(dpi)
    root = ElementTree.fromstring(drawn.getvalue())
    for element in root.iter():
        element.text = element.tail = None  # text is drawn as outlines; the rest is space
        element.attrib |= {name: _short(name, value) for name, value in element.attrib.items()}
    named = [(group.attrib["id"].split("_")[0], group) for group in root.findall(f"{SVG}g/{SVG}g")]
    parts = [(kind, entry) for kind, group in named if kind == "legend" for entry in _entries(group)]
    parts += [(kind, list(group)) for kind, group in named if kind == "axes"]
    height_pt = float(root.attrib["viewBox"].split()[3])
    shown = [_part(kind, elements, boxes[kind].pop(0), height_pt) for kind, elements in parts]
    root[:] = [*shown, *root.findall(f"{SVG}defs")]
    root.attrib |= {"stroke-linejoin": "round", "stroke-linecap": "butt"}
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _short(name: str, value: str) -> str:
    if name == "d":
        return _GAPS.sub("", _BEYOND.sub("", value))
    return _BEYOND.sub("", value) if name in _LENGTHS else value


def _part(
    kind: str, elements: Sequence[ElementTree.Element], box: Bbox, height_pt: float
) -> ElementTree.Element:
    """One region of a drawing as a drawing of its own."""
    room = (box.x0 - EDGE_PT, height_pt - box.y1 - EDGE_PT, box.width + 2 * EDGE_PT, box.height + 2 * EDGE_PT)
    place = dict(zip(("x", "y", "width", "height"), (f"{length:.2f}" for length in room), strict=True))
    part = ElementTree.Element(f"{SVG}svg", {"class": kind, "viewBox": " ".join(place.values()), **place})
    part.extend(elements)
    return part


def _panel_boxes(figure: Figure) -> Iterator[Bbox]:
    """Room of each panel with its labels [pt]; those of a column begin and end alike."""
    from matplotlib.transforms import Bbox

    tight = [box for axes in figure.axes if (box := axes.get_tightbbox()) is not None]
    places = [axes.bbox.intervalx.round().tolist() for axes in figure.axes]
    for place, box in zip(places, tight, strict=True):
        column = Bbox.union([other for at, other in zip(places, tight, strict=True) if at == place])
        yield Bbox.from_extents(column.x0, box.y0, column.x1, box.y1)


def _legend_boxes(legend: Legend) -> Iterator[Bbox]:
    """Room of the title, if there is one, and of each entry with its handle [pt]."""
    from matplotlib.transforms import Bbox

    if legend.get_title().get_text():
        yield legend.get_title().get_window_extent()
    for text in legend.get_texts():
        box = text.get_window_extent()
        handle = float(legend.handlelength + legend.handletextpad) * float(text.get_fontsize())
        yield Bbox.from_extents(box.x0 - handle, box.y0, box.x1, box.y1)


def _entries(legend: ElementTree.Element) -> Iterator[list[ElementTree.Element]]:
    """Elements of the title and of each entry of a legend: handles, then the text that ends it."""
    entry: list[ElementTree.Element] = []
    for element in legend:
        entry.append(element)
        if element.attrib.get("id", "").startswith("text"):
            yield entry
            entry = []

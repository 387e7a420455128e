"""Figures inside a page: drawings as SVG, or as PNG where drawings would make the page too large."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

from markupsafe import Markup

_SVG = "{http://www.w3.org/2000/svg}"
_BEYOND = re.compile(r"(?<=\.\d\d)\d+")
_GAPS = re.compile(r"\s+(?=[A-Za-z]|$)|(?<=[A-Za-z])\s+")
_REFERENCE = re.compile(r"#([\w.-]+)")
_LENGTHS = frozenset({"x", "y", "width", "height"})


@dataclass(frozen=True)
class Drawn:
    """One figure on a page.

    name : of its files, without ending
    title, caption : what it is, and how to read it
    picture : the drawing
    """

    name: str
    title: str
    caption: str
    picture: Markup


def pictures(files: Mapping[str, bytes], titles: Mapping[str, str], most_bytes: int) -> Iterator[Markup]:
    """Each figure as PNG at least; for narrow screens too, while all stay below ``most_bytes`` together.

    What is left then is spent on SVG in place of PNG. A figure without a narrow drawing scrolls there.

    Parameters
    ----------
    files : bytes of ``NAME.svg`` and ``NAME.png``, and of ``NAME.narrow``, a PNG for a narrow screen
    titles : text alternative of each name, in the order of the page
    most_bytes : of all drawings together
    """
    wide = [embedded(files[f"{name}.png"], title, "wide") for name, title in titles.items()]
    left = most_bytes - sum(map(len, wide))
    narrow = [embedded(files[f"{name}.narrow"], title, "narrow") for name, title in titles.items()]
    for number, picture in enumerate(narrow):
        fits = len(picture) <= left
        left -= len(picture) * fits
        narrow[number] = picture if fits else Markup()
    for number, (name, title) in enumerate(titles.items()):
        drawing = inlined(files[f"{name}.svg"], f"f{number + 1}", title)
        if (more := len(drawing) - len(wide[number])) <= left:
            wide[number] = drawing
            left -= more
    for large, small in zip(wide, narrow, strict=True):
        yield large + small if small else Markup('<div class="alone">{}</div>').format(large)


def inlined(svg: bytes, prefix: str, title: str) -> Markup:
    """SVG of matplotlib as an element of a page.

    Ids get the prefix, since all drawings of a page share their names; numbers are cut after a hundredth of
    a point, which no screen shows; what draws nothing is left out.
    """
    root = ElementTree.fromstring(svg)
    used = set(_REFERENCE.findall(svg.decode("utf-8")))
    for parent in root.iter():
        for child in list(parent):
            if child.tag in (f"{_SVG}metadata", f"{_SVG}style"):
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        element.text = element.tail = None  # text is drawn as outlines; the rest is space
        element.attrib = dict(_attributes(element.attrib, prefix, used))
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    # what matplotlib says for every element of its file would hold for the whole page
    root.attrib |= {
        "class": "wide",
        "role": "img",
        "aria-label": title,
        "stroke-linejoin": "round",
        "stroke-linecap": "butt",
    }
    return Markup(ElementTree.tostring(root, encoding="unicode"))  # serialised, not pasted


def _attributes(attributes: Mapping[str, str], prefix: str, used: set[str]) -> Iterator[tuple[str, str]]:
    for long_name, value in attributes.items():
        name = long_name.rpartition("}")[2]
        if name == "id":
            if value in used:
                yield name, f"{prefix}-{value}"
        elif name == "href":
            yield name, f"#{prefix}-{value[1:]}"
        elif name == "d":
            yield name, _GAPS.sub("", _BEYOND.sub("", value))
        elif name in _LENGTHS:
            yield name, _BEYOND.sub("", value)
        else:
            yield name, value.replace("url(#", f"url(#{prefix}-")


def embedded(png: bytes, title: str, kind: str) -> Markup:
    """PNG as an element of a page; kind: class of the screens that show it."""
    data = base64.b64encode(png).decode("ascii")
    return Markup('<img class="{}" alt="{}" src="data:image/png;base64,{}">').format(kind, title, data)

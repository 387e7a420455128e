"""Figures inside a page: their drawings, whose parts stand below each other on a telephone."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree

from markupsafe import Markup

_SVG = "{http://www.w3.org/2000/svg}"
PAGE_PT = 576.0
"""Width of a drawing that is as wide as a page [pt]."""
_REFERENCE = re.compile(r"#([\w.-]+)")


def inlined(svg: bytes, prefix: str, title: str) -> Markup:
    """Drawing of ``svg_of`` as an element of a page, each of its parts a drawing of its own.

    Ids get the prefix, since all drawings of a page share their names. Each part knows its place in percent
    of the whole, and its width in points.
    """
    root = ElementTree.fromstring(svg)
    used = set(_REFERENCE.findall(svg.decode("utf-8")))
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        element.attrib = dict(_attributes(element.attrib, prefix, used))
    width, height = map(float, root.attrib["viewBox"].split()[2:])
    parts = Markup()
    for part in root.findall("svg"):
        x, y, across, high = (float(part.attrib.pop(name)) for name in ("x", "y", "width", "height"))
        part.attrib["style"] = (
            f"--x:{100 * x / width:.2f}%;--y:{100 * y / height:.2f}%;--w:{100 * across / width:.2f}%;"
            f"--pt:{across:.1f};aspect-ratio:{across:.1f}/{high:.1f}"
        )
        part.attrib["aria-hidden"] = "true"
        parts += Markup(ElementTree.tostring(part, encoding="unicode"))  # serialised, not pasted
    shared = [Markup(ElementTree.tostring(found, encoding="unicode")) for found in root.findall("defs")]
    return Markup(
        '<div class="drawing" role="img" aria-label="{}" style="aspect-ratio:{:.1f}/{:.1f};--most:{:.3f}">'
        '{}<svg class="shared" aria-hidden="true">{}</svg></div>'
    ).format(title, width, height, width / PAGE_PT, parts, Markup().join(shared))


def _attributes(attributes: Mapping[str, str], prefix: str, used: set[str]) -> Iterator[tuple[str, str]]:
    for long_name, value in attributes.items():
        name = long_name.rpartition("}")[2]
        if name == "id":
            if value in used:
                yield name, f"{prefix}-{value}"
        elif name == "href":
            yield name, f"#{prefix}-{value[1:]}"
        else:
            yield name, value.replace("url(#", f"url(#{prefix}-")

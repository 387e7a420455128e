"""The page of a run, a fit, a comparison or a check: one Markdown text, also rendered for a browser."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree

from markupsafe import Markup, escape

from hammerstein.escaping import Markdown, templates_of, unbroken
from hammerstein.runtime.staging import Stage

if TYPE_CHECKING:
    from jinja2 import Environment
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

LARGEST_LINK_BYTES = 200_000
"""Size from which a file is linked beside the page instead of embedded."""
MOST_BESIDE = 4
"""Columns that fit beside each other on a telephone."""
FOLDED = "details"
"""Column whose cells open at a click."""
LEVEL = 8
"""Letters of a heading up to which it stays horizontal on a telephone."""
LONGEST_NUMBER = 36
"""Length of a cell from which it counts as text."""
NO_PLOTS = Markup()
_OPTION = re.compile(r"(?<!\S)--?[a-z][\w-]*")
"""Option of a command, which must not be broken across lines."""


def rendered(template: str, **content: Any) -> str:
    """Fill a template; all texts are escaped, and terminal control characters are made visible."""
    return environment().get_template(template).render(**content)


@cache
def environment() -> Environment:
    """Templates of the pages."""
    found = templates_of("hammerstein", Markup)
    found.filters["unbroken"] = unbroken
    assert found.loader is not None
    for name, file in (("style", "page.css"), ("script", "page.js")):
        found.globals[name] = Markup(found.loader.get_source(found, file)[0])  # of this package
    return found


def html_of(text: Markdown, drawn: Mapping[str, bytes] | None = None) -> tuple[Markup, list[tuple[str, str]]]:
    r"""HTML from Markdown of this program, and its second-level headings with their ids.

    drawn : figures that its pictures name, as SVG; they stand where the pictures do, each with its caption

    >>> html_of(Markdown("a *b* `c` {}").format("<script>"))[0]
    Markup('<p>a <em>b</em> <code>c</code> &lt;script&gt;</p>\n')
    """
    reader = _reader()
    tokens = reader.parse(text)
    headings = _anchored(tokens)
    for child in (child for token in tokens for child in token.children or () if child.type == "text"):
        child.content = unbroken(child.content.replace(" / ", "\xa0/ "))  # no line ends before the stroke
    for child in (one for token in tokens for one in (token, *(token.children or ())) if one.tag == "code"):
        before, after = ("", "") if child.type == "code_inline" else ("<pre>", "</pre>\n")
        words = _OPTION.sub(r'<span class="option">\g<0></span>', str(escape(child.content)))
        child.type, child.content = "html_inline", f"{before}<code>{words}</code>{after}"
    _tabulated(tokens)
    _framed(tokens, drawn or {})
    return Markup(reader.renderer.render(tokens, reader.options, {})), headings


@cache
def _reader() -> MarkdownIt:
    from markdown_it import MarkdownIt

    return MarkdownIt("commonmark", {"html": False}).enable("table")


def _anchored(tokens: Sequence[Token]) -> list[tuple[str, str]]:
    """Return each heading an id of its own."""
    found: list[tuple[str, str]] = []
    taken: set[str] = set()
    for token, words in pairwise(tokens):
        if token.type == "heading_open":
            text = "".join(child.content for child in words.children or ())
            stem = "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())
            id_ = next(i for i in (stem, *(f"{stem}-{n}" for n in range(2, len(tokens)))) if i not in taken)
            taken.add(id_)
            token.attrSet("id", id_)
            found += [(text, id_)] * (token.tag == "h2")
    return found


def _tabulated(tokens: Sequence[Token]) -> None:
    """Tables scroll by themselves; every cell names its column for a telephone, which shows no heads.

    Numbers stand to the right on one line; long words are broken; a table without heads lists facts; details
    fold out.
    """
    from markdown_it.token import Token

    title = ""
    for start, token in enumerate(tokens):
        if token.type == "heading_open":
            title = tokens[start + 1].content
        if token.type != "table_open":
            continue
        stop = next(i for i in range(start, len(tokens)) if tokens[i].type == "table_close")
        inside, close = tokens[start:stop], tokens[stop]
        named = [(head, text.content) for head, text in pairwise(inside) if head.type == "th_open"]
        heads = [text for _, text in named]
        for head in (head for head, text in named if len(text) > LEVEL):
            head.attrSet("class", "upright")
        cells = [(cell, text) for cell, text in pairwise(inside) if cell.type == "td_open"]
        for number, (cell, text) in enumerate(cells):
            cell.attrSet("data-name", heads[number % len(heads)])
            if heads[number % len(heads)] == FOLDED and text.content:
                ends = ("<details><summary>show</summary>", "</details>")
                before, after = (Token("html_inline", "", 0, content=end) for end in ends)
                text.children = [before, *(text.children or ()), after]
        if not any(heads):
            kind = "words pairs"
        elif max((len(text.content) for _, text in cells), default=0) > LONGEST_NUMBER:
            kind = "sortable words"
        else:
            kind = "sortable numbers" + " wide" * (len(heads) > MOST_BESIDE)
        scroll = Markup('<div class="scroll" tabindex="0" role="region" aria-label="{}">').format(title)
        table = Markup('<table class="{}" style="--numbers:{}">').format(kind, len(heads) - 1)
        _replaced(token, scroll + table)
        _replaced(close, Markup("</table></div>\n"))


def _framed(tokens: Sequence[Token], drawn: Mapping[str, bytes]) -> None:
    """Put a drawing in the place of each picture, and the paragraph after it below as its caption."""
    number = 0
    for at, token in enumerate(tokens):
        children = token.children or []
        if token.type != "inline" or [child.type for child in children] != ["image"]:
            continue
        number += 1
        name = unquote(str(children[0].attrs["src"]))
        title = "".join(child.content for child in children[0].children or ())
        tokens[at - 1].tag, tokens[at + 1].hidden, tokens[at + 2].tag = "figure", True, "figcaption"
        tokens[at - 1].attrSet("id", f"figure-{PurePath(name).stem}")
        drawing = inlined(drawn[name], f"f{number}", title)
        _replaced(token, Markup('<div class="draw" tabindex="0">{}</div>').format(drawing))
        _replaced(tokens[at + 4], Markup("</figcaption></figure>\n"))


def _replaced(token: Token, html: Markup) -> None:
    token.type, token.children, token.content = "html_block", None, str(html)  # Markup would escape the rest


_SVG = "{http://www.w3.org/2000/svg}"
PAGE_PT = 576.0
"""Width of a drawing that is as wide as a page [pt]."""
_REFERENCE = re.compile(r"#([\w.-]+)")


def inlined(svg: bytes, prefix: str, title: str) -> Markup:
    """Drawing of ``svg_of`` as an element of a page, each part as a separate drawing.

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


class NumberFile(NamedTuple):
    """File with numbers for programs, beside a page."""

    name: str
    content: str
    media_type: str = "application/json"

    @property
    def href(self) -> str:
        """Link that embeds the whole file if it is small."""
        data = self.content.encode("utf-8")
        if len(data) > LARGEST_LINK_BYTES:
            return self.name
        return f"data:{self.media_type};charset=utf-8;base64,{base64.b64encode(data).decode('ascii')}"


class Judged(NamedTuple):
    """Result of a judgement in few words, and whether everything agrees."""

    words: str
    good: bool


@dataclass(frozen=True)
class Page:
    """Result and its basis, as one page.

    heading : of the Markdown page
    what, title : of the page for a browser
    answer : sentences, the most important first
    body : figures, tables and remarks, under headings
    facts : few words each
    verdict : result of judging the numbers, if they were judged
    numbers : files with every number
    """

    heading: Markdown
    what: str
    title: str
    answer: Markdown
    body: Markdown
    facts: Sequence[str] = ()
    verdict: Judged | None = None
    numbers: Sequence[NumberFile] = ()

    def markdown(self) -> str:
        """Page as Markdown; equal values give equal bytes."""
        names = Markdown(", ").join(Markdown("`{}`").format(Markdown(file.name)) for file in self.numbers)
        end = Markdown("Every number with full precision is in {}.\n").format(names)
        return Markdown("\n\n").join([self.heading, self.answer, self.body, end])

    def html(self, drawn: Mapping[str, bytes], interactive: Markup = NO_PLOTS) -> str:
        """Page for a browser; equal values give equal bytes.

        drawn : bytes of its figures by name, as SVG
        interactive : scripts of plots to zoom into, if they were asked for
        """
        body, headings = html_of(self.body, drawn)
        return rendered(
            "page.html.jinja",
            page=self,
            answer=html_of(self.answer)[0],
            headings=headings,
            body=body,
            interactive=interactive,
        )

    def write(
        self, stage: Stage, stem: str, drawn: Mapping[str, bytes], interactive: Markup = NO_PLOTS
    ) -> None:
        """Write both pages, the figures, and the files with every number."""
        for name, content in drawn.items():
            stage.write(name, content)
        for file in self.numbers:
            stage.write(file.name, file.content)
        stage.write(f"{stem}.md", self.markdown())
        stage.write(f"{stem}.html", self.html(drawn, interactive))


class Shown(NamedTuple):
    """Figure on a page: file without suffix, title, and caption."""

    name: str
    title: str
    caption: str = ""

    def markdown(self) -> Markdown:
        """Picture and caption."""
        picture = Markdown("![{} ({})]({}.svg)\n\n*{}.* {}").format(
            self.title, self.name, self.name, self.title, self.caption
        )
        return Markdown(picture.rstrip())


def figures_section(shown: Iterable[Shown]) -> Markdown:
    """Figures under their heading; empty where there are none."""
    figures = [one.markdown() for one in shown]
    return Markdown("\n\n").join([Markdown("## Figures"), *figures]) if figures else Markdown()


def points(texts: Iterable[str]) -> Markdown:
    """List of sentences."""
    return Markdown("\n").join(map(Markdown("* {}").format, texts))


def paragraphs(parts: Iterable[str]) -> Markdown:
    """Parts of a page below each other, without empty ones."""
    return Markdown("\n\n").join(part for part in parts if part)

"""What all pages share: the template, what is escaped in it, and files that a page carries along."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from hammerstein.escaping import Markdown, templates_of

if TYPE_CHECKING:
    from jinja2 import Environment
    from markdown_it import MarkdownIt
    from markdown_it.token import Token

LARGEST_LINK_BYTES = 200_000
"""A larger file is linked where it lies beside the page, not carried along."""
LONGEST_NUMBER = 36
"""Characters of a cell; a longer one holds words."""


@dataclass(frozen=True)
class Link:
    """A file that belongs to a page.

    name : of the file beside the page; href : that, or all of it
    """

    name: str
    href: str


def link_to(name: str, content: str, media_type: str) -> Link:
    """Link that holds the whole file where it is small, so that it comes along with the page."""
    data = content.encode("utf-8")
    if len(data) > LARGEST_LINK_BYTES:
        return Link(name, name)
    return Link(name, f"data:{media_type};charset=utf-8;base64,{base64.b64encode(data).decode('ascii')}")


def rendered(template: str, **content: Any) -> str:
    """Fill a template; every text in it is escaped, and what a terminal would obey is made visible."""
    return environment().get_template(template).render(**content)


@cache
def environment() -> Environment:
    """Templates of the pages."""
    found = templates_of("hammerstein", Markup)
    found.filters |= {"line": line_of, "slug": _slug}
    found.globals |= {"style": _own_file(found, "page.css"), "script": _own_file(found, "page.js")}
    return found


def _own_file(found: Environment, name: str) -> Markup:
    assert found.loader is not None
    return Markup(found.loader.get_source(found, name)[0])  # of this package


def _slug(text: str) -> str:
    return "-".join("".join(c if c.isalnum() else " " for c in text.lower()).split())


def line_of(text: str) -> Markup:
    """One line of Markdown as HTML; any other text as it is.

    >>> line_of(Markdown("a *b* `c` <script>"))
    Markup('a <em>b</em> <code>c</code> &lt;script&gt;')
    """
    return Markup(_reader().renderInline(Markdown.escape(text)))  # the reader escapes HTML


def page_of(text: Markdown) -> Markup:
    """Markdown of ours as HTML, its tables as those of the templates."""
    return Markup(_reader().render(text))


@cache
def _reader() -> MarkdownIt:
    from markdown_it import MarkdownIt

    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    reader.add_render_rule("table_open", _table_open)
    reader.add_render_rule("table_close", _table_close)
    return reader


def _table_open(_: object, tokens: Sequence[Token], start: int, *__: object) -> str:
    """Numbers stand to the right on one line; long words are broken; a table without heads lists facts."""
    stop = next(i for i in range(start, len(tokens)) if tokens[i].type == "table_close")
    cells: dict[str, list[str]] = {"th_open": [], "td_open": []}
    for before, token in pairwise(tokens[start:stop]):
        if token.type == "inline":
            cells[before.type].append(token.content)
    if not any(cells["th_open"]):
        kind = "words facts"
    elif max(map(len, cells["td_open"]), default=0) > LONGEST_NUMBER:
        kind = "sortable words"
    else:
        kind = "sortable numbers"
    scroll = '<div class="scroll" tabindex="0" role="region" aria-label="table">'
    return f'{scroll}<table class="{kind}">'


def _table_close(*_: object) -> str:
    return "</table></div>"

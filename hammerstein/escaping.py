"""Text of strangers in what people open, and its templates: nothing in it is obeyed, all can be read."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
_SPECIAL = re.compile(r"[\\`*<>|&~]|^#|(?<![a-zA-Z0-9])_|_(?![a-zA-Z0-9])|(?<=\])[(:\[]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def clean(text: str) -> str:
    r"""Text without what a terminal would obey: control characters are shown by their numbers.

    >>> clean("\x1b[31mred")
    '\\x1b[31mred'
    """
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def markdown(text: object) -> str:
    r"""Text that Markdown, and the HTML that is made of it, show as it is.

    >>> print(markdown("a|b *c* d_e [um] <script>"))
    a\|b \*c\* d_e [um] \<script\>
    """
    one_line = clean(str(text).replace("\n", " "))
    return _SPECIAL.sub(lambda found: f"\\{found[0]}", one_line)


def code(text: object) -> str:
    r"""Text as code in Markdown, in a table too.

    >>> code("stage"), code("a`b|c")
    ('`stage`', '`ab\\|c`')
    """
    return "`" + clean(str(text)).replace("`", "").replace("|", r"\|") + "`"


def cell(text: str) -> str:
    """Text in a CSV file that no spreadsheet takes for a formula.

    >>> [cell(text) for text in ("=1+1", "paper, 50 Hz", "-")]
    ["'=1+1", 'paper, 50 Hz', "'-"]
    """
    shown = clean(text)
    return f"'{shown}" if text.startswith(_FORMULA) else shown


def templates_of(package: str, **options: Any) -> Environment:
    """Templates of a package, in which an unknown name is a mistake; ``options`` are those of jinja2."""
    import jinja2

    return jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        **options,
    )


@cache
def _pages(package: str) -> Environment:
    """Pages in Markdown, whose every text of a stranger goes through a filter of its own."""
    found = templates_of(package, autoescape=False)
    found.filters |= {"md": markdown, "code": code}
    return found


def markdown_page(template: str, package: str = "hammerstein", **content: Any) -> str:
    """Page in Markdown; no two empty lines follow each other."""
    return re.sub(r"\n{3,}", "\n\n", _pages(package).get_template(template).render(**content))

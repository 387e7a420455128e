"""Text of strangers in what people open: nothing in it is obeyed, all of it can be read."""

from __future__ import annotations

import re

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

"""Untrusted text in what people open: one escape a target, which its templates apply to every value.

Targets: ``clean`` for the terminal and for whatever has no escape of its own, ``Markdown``, ``C``, ``Markup``
of markupsafe for HTML and XML, ``cell`` for CSV.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING, Any, Self

from markupsafe import Markup

if TYPE_CHECKING:
    from jinja2 import Environment

_UNUSUAL = re.compile(r"[^\n\t -~]")
_UNSHOWN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of Unicode: control and format characters (direction, no width), surrogates, ends of lines."""
_SPECIAL = re.compile(
    r"[\\`*<>|&~]|^#|^(?:[-+]|\d+[.)])(?=\s)|(?<![a-zA-Z0-9])_|_(?![a-zA-Z0-9])|(?<=\])[(:\[]"
)
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_WORD_OF_C = re.compile(r"[\w.+-]*", re.ASCII)
_LEAVES_COMMENT = re.compile(r"\*(?=/)|/(?=\*)|\?(?=\?)|\\")


def clean(text: str) -> str:
    r"""Text without characters that a terminal obeys or an editor hides: they are shown by their numbers.

    >>> clean("\x1b[31mred"), clean("\u202egnp.exe")
    ('\\x1b[31mred', '\\u202egnp.exe')
    """
    return _UNUSUAL.sub(_shown, text)


def _shown(found: re.Match[str]) -> str:
    character = found[0]
    hidden = unicodedata.category(character) in _UNSHOWN or ord(character) & 0xFFFE == 0xFFFE
    return ascii(character)[1:-1] if hidden else character


def one_line(text: str) -> str:
    r"""Clean text without ends of lines, such as the name of a file in a message.

    >>> one_line("a\nb")
    'a\\nb'
    """
    return clean(text).replace("\n", r"\n").replace("\t", r"\t")


class Markdown(Markup):
    r"""Text in Markdown; whatever is formatted into it or joined with it is escaped.

    >>> print(Markdown("*{}*").format("a|b *c* d_e [um] <script>"))
    *a\|b \*c\* d_e [um] \<script\>*
    >>> print(Markdown("* {}").format("1. no list"))
    * 1\. no list
    """

    @classmethod
    def escape(cls, s: Any) -> Self:
        """Markdown that reads as a text, in one line; Markdown as it is."""
        if isinstance(s, cls):
            return s
        shown = clean(str(s).replace("\n", " "))
        return cls(_SPECIAL.sub(lambda found: f"{found[0][:-1]}\\{found[0][-1]}", shown))


class C(Markup):
    """Source code of C; only words and numbers can be put into it, and text by ``comment``."""

    @classmethod
    def escape(cls, s: Any) -> Self:
        """A word or a number of C, or code as it is; TypeError for anything else."""
        if not isinstance(s, cls) and not _WORD_OF_C.fullmatch(str(s)):
            raise TypeError(f"{str(s)[:100]!r} is not a word of C; is it text for a comment?")
        return cls(s)

    @classmethod
    def comment(cls, text: object) -> Self:
        r"""Text within a comment, in one line: nothing in it ends the comment or joins two lines.

        >>> print(C.comment("x */ system(0); /* \\"))
        x * / system(0); / * /
        """
        shown = one_line(str(text)).replace("\\", "/")
        return cls(_LEAVES_COMMENT.sub(lambda found: f"{found[0]} ", shown))


def markdown(text: object) -> Markdown:
    """Text that Markdown, and the HTML that is made of it, show as it is."""
    return Markdown.escape(text)


def code(text: object) -> Markdown:
    r"""Text as code in Markdown, in a table too.

    >>> str(code("stage")), str(code("a`b|c"))
    ('`stage`', '`ab\\|c`')
    """
    return Markdown("`" + one_line(str(text)).replace("`", "").replace("|", r"\|") + "`")


def cell(text: str) -> str:
    """Text in a CSV file that no spreadsheet takes for a formula.

    >>> [cell(text) for text in ("=1+1", "paper, 50 Hz", "-")]
    ["'=1+1", 'paper, 50 Hz', "'-"]
    """
    shown = clean(text)
    return f"'{shown}" if text.startswith(_FORMULA) else shown


def csv_text(rows: Any) -> str:
    r"""Text of what pandas takes for a table, in which no word is a formula; numbers as they are.

    >>> csv_text([{"label": "=1+1", "rms_um": 0.5, "max_um": None}])
    "label,rms_um,max_um\n'=1+1,0.5,\n"
    """
    import pandas as pd

    table = pd.DataFrame(rows)
    words = table.select_dtypes(exclude=["number", "bool"])
    table[words.columns] = words.map(lambda value: cell(value) if isinstance(value, str) else value)
    return str(table.to_csv(index=False, header=[cell(str(name)) for name in table], lineterminator="\n"))


def templates_of(package: str, target: type[Markup]) -> Environment:
    """Templates of a package, in which an unknown name is a mistake and every value is escaped.

    package : that has the templates
    target : language of the templates; a value of this type, as a macro gives it, is put in as it is
    """
    import jinja2

    def escaped(value: Any) -> Markup:
        if type(value) in (target, Markup):
            return Markup(value)
        return target.escape(clean(str(value)))

    found = jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=True,
        finalize=escaped,
    )

    def joined(parts: Iterable[object], sign: str = "") -> Markup:
        return target(sign).join(escaped(part) for part in parts)

    found.filters |= {"join": joined}
    return found


@cache
def _pages(package: str) -> Environment:
    """Pages in Markdown."""
    found = templates_of(package, Markdown)
    found.filters |= {"code": code}
    return found


def markdown_page(template: str, package: str = "hammerstein", **content: Any) -> Markdown:
    """Page in Markdown; no two empty lines follow each other."""
    return Markdown(re.sub(r"\n{3,}", "\n\n", _pages(package).get_template(template).render(**content)))


JOINT = "\u00a0"  # a space at which no line ends


def unbroken(text: str) -> str:
    """Text in which no line ends between a number and its unit, sign, or the word that it numbers."""
    unit, sign = r"(?<=\d) (?=(?:µm|um|nm|V|k?Hz|min|[mu]?s|%)(?!\w))", r"(?:(?<=[<±])|(?<=\btrial)) (?=\d)"
    return re.sub(f"{unit}|{sign}", JOINT, text)

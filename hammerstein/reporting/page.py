"""The page of a run, a fit, a comparison or a check: one Markdown text, also rendered for a browser."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hammerstein.escaping import Markdown
from hammerstein.reporting.html.interactive import Interactive
from hammerstein.reporting.html.markup import html_of, link_to, rendered
from hammerstein.runtime.storage.staging import Stage


class NumberFile(NamedTuple):
    """File with numbers for programs, beside a page."""

    name: str
    content: str
    media_type: str = "application/json"


class Judged(NamedTuple):
    """Result of a judgement in few words, and whether everything is as required."""

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

    def html(self, drawn: Mapping[str, bytes], interactive: Interactive | None = None) -> str:
        """Page for a browser; equal values give equal bytes.

        drawn : bytes of its figures by name, as SVG
        interactive : plots to zoom into, if they were asked for
        """
        body, headings = html_of(self.body, drawn)
        return rendered(
            "page.html.jinja",
            page=self,
            answer=html_of(self.answer)[0],
            headings=headings,
            body=body,
            links=[link_to(*file) for file in self.numbers],
            interactive=interactive,
        )

    def write(
        self, stage: Stage, stem: str, drawn: Mapping[str, bytes], interactive: Interactive | None = None
    ) -> None:
        """Write both pages, the figures, and the files with every number."""
        for name, content in drawn.items():
            stage.write(name, content)
        for file in self.numbers:
            stage.write(file.name, file.content)
        stage.write(f"{stem}.md", self.markdown())
        stage.write(f"{stem}.html", self.html(drawn, interactive))


class Shown(NamedTuple):
    """A figure on a page: its file without ending, what it is, and how to read it."""

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
    """Parts of a page below each other, but for empty ones."""
    return Markdown("\n\n").join(part for part in parts if part)

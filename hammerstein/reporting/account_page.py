"""The page of a fit or of a comparison as one value, for people as Markdown and for a browser as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING

from hammerstein.escaping import Markdown
from hammerstein.reporting.html.markup import link_to, page_of, rendered
from hammerstein.reporting.html.vector import Drawn, drawings
from hammerstein.runtime.storage.staging import Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class AccountPage:
    """What was found, and what it rests on.

    heading : of the Markdown page
    what, title : of the page for a browser
    points : what it is good for, and what to do next
    answer : sentences, the most important first
    facts : few words each
    captions : title and caption of each figure that there may be, by its name, in their order
    body : tables
    numbers : name and content of the file with every number
    """

    heading: Markdown
    what: str
    title: str
    points: Sequence[str]
    answer: Sequence[str]
    facts: Sequence[str]
    captions: Mapping[str, tuple[str, str]]
    body: Markdown
    numbers: tuple[str, str]

    def markdown(self, files: Sequence[str] = ()) -> str:
        """Page as Markdown; equal values give equal bytes.

        files : names of SVG files beside the page
        """
        figures = [
            Markdown("![{}]({})\n\n*{}*").format(title, f"{name}.svg", caption)
            for name, title, caption in self._figures(files)
        ]
        parts = [
            self.heading,
            *([Markdown("\n").join(map(Markdown("* {}").format, self.points))] if self.points else []),
            *self.answer,
            *([Markdown("## Figures"), *figures] if figures else []),
            self.body,
            Markdown("Every number with full precision is in `{}`.\n").format(Markdown(self.numbers[0])),
        ]
        return Markdown("\n\n").join(parts)

    def html(self, files: Mapping[str, bytes]) -> str:
        """Page for a browser; equal values give equal bytes.

        files : bytes of its figures by name, as SVG; none gives a page without figures
        """
        figures = list(self._figures(list(files)))
        shown = drawings(files, {name: title for name, title, _ in figures})
        return rendered(
            "account.html.jinja",
            what=self.what,
            title=self.title,
            answer=[*self.points, *self.answer],
            facts=self.facts,
            figures=[Drawn(*figure, drawing) for figure, drawing in zip(figures, shown, strict=True)],
            body=page_of(self.body),
            links=[link_to(*self.numbers, "application/json")],
        )

    def write(self, stage: Stage, stem: str, figures: Mapping[str, Figure]) -> None:
        """Write both pages, the figures, and the file with every number."""
        drawn: dict[str, bytes] = {}
        if figures:
            from hammerstein.reporting.figures.write import files_of, write_drawn

            drawn = write_drawn(stage, files_of(figures))
        stage.write(f"{stem}.md", self.markdown(list(drawn)))
        stage.write(f"{stem}.html", self.html(drawn))
        stage.write(*self.numbers)

    def _figures(self, files: Sequence[str]) -> list[tuple[str, str, str]]:
        """Name, title and caption of each figure that is there."""
        here = [PurePath(name).stem for name in files]
        return [(name, *self.captions[name]) for name in self.captions if name in here]

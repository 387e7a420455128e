"""Write the documentation site: ``site.py FOLDER``.

No text has a second copy. The site is every Markdown page that the README links to, directly or not, with the
files that they show, and three pages made from the package: keys of scenario files, gallery, constants.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from constants import constants
from markdown_it import MarkdownIt

from hammerstein.commands.start import guide_pages
from hammerstein.plugins import load_plugins
from hammerstein.scenario import Scenario

TOP = Path(__file__).resolve().parents[1]
MARKDOWN = MarkdownIt("commonmark").enable("table")
LINK = re.compile(r'(<(?:a|img) [^>]*?(?:href|src)=")([^"#]*)')
STYLE = """
body { margin: 0; font: 16px/1.55 system-ui, sans-serif; color: #222; display: flex; flex-wrap: wrap }
nav { flex: 0 0 13rem; padding: 1.5rem; background: #f5f6f8; font-size: .92rem }
nav a { display: block; padding: .15rem 0; text-decoration: none }
main { flex: 1 1 30rem; min-width: 0; max-width: 52rem; padding: 1.5rem }
a { color: #0a5ca8 } img { max-width: 100% }
pre { background: #f5f6f8; padding: .8rem; overflow-x: auto } code { font-size: .9em }
table { border-collapse: collapse; display: block; overflow-x: auto }
.keys { display: table; table-layout: fixed; width: 100%; overflow-wrap: anywhere }
.keys th:nth-child(1) { width: 17% } .keys th:nth-child(2) { width: 24% } .keys th:nth-child(3) { width: 14% }
@media (max-width: 40rem) { .keys tr, .keys td { display: block } .keys tr:first-child { display: none }
  .keys td.default:not(:empty)::before { content: "default: " }
  .keys td { border: 0; padding: .1rem .7rem } .keys tr { border-bottom: 1px solid #ddd; padding: .4rem 0 } }
th, td { border-bottom: 1px solid #ddd; padding: .3rem .7rem; text-align: left; vertical-align: top }
"""


def main(folder: Path) -> None:
    """Write all pages; links to the API reference lead to ``reference``, if it is in the folder already."""
    site = Site(folder.resolve())
    site.reach(TOP / "README.md")
    site.reach(TOP / ".github/paper.md")
    for notebook in sorted((TOP / "hammerstein/examples").glob("*.ipynb")):
        site.write(notebook.with_suffix(".html"), notebook_text(notebook))
    site.write(TOP / "keys.html", keys())
    site.write(TOP / "gallery.html", gallery(site))
    site.write(TOP / "constants.html", constant_tables())
    shutil.copy(site.place(TOP / "README.md"), folder / "index.html")


class Site:
    """A folder in which every page has the place of its source in the tree."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.reached: set[Path] = set()

    def place(self, source: Path) -> Path:
        """Where a file of the tree goes; no folder's name begins with a dot, which servers leave out."""
        target = self.folder / str(source.relative_to(TOP)).removeprefix(".github/")
        return target.with_suffix(".html") if source.suffix == ".md" else target

    def reach(self, source: Path) -> None:
        """Write a page, or copy a file, and all that its links lead to."""
        if source in self.reached:
            return
        self.reached.add(source)
        if source.suffix == ".md":
            text = re.sub(r"\A---\n.*?\n---\n", "", source.read_text(encoding="utf-8"), flags=re.S)
            self.write(source, self.linked(source, MARKDOWN.render(text)))
        else:
            self.place(source).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, self.place(source))

    def linked(self, source: Path, text: str) -> str:
        """Let the links of a page lead to places of the site; a folder's to a list of its files."""

        def here(found: re.Match[str]) -> str:
            target = (source.parent / found[2]).resolve()
            if re.match(r"[a-z]+:", found[2]) or not found[2] or not target.is_relative_to(TOP):
                return found[0]
            if target.is_dir():
                return found[1] + relative(self.listed(target), self.place(source))
            self.reach(target)
            return found[1] + relative(self.place(target), self.place(source))

        return LINK.sub(here, text)

    def listed(self, folder: Path) -> Path:
        """Page with the files of a folder."""
        page = folder / "index.html"
        if page not in self.reached:
            self.reached.add(page)
            files = [
                file for file in sorted(folder.iterdir()) if file.is_file() and file.name != "__init__.py"
            ]
            for file in files:
                self.reach(file)
            links = [f'<li><a href="{quote(self.place(file).name)}">{file.name}</a>' for file in files]
            self.write(page, f"<h1>{folder.name}</h1><ul>{''.join(links)}</ul>")
        return self.place(page)

    def write(self, source: Path, text: str) -> None:
        """Put a page round its text."""
        target = self.place(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        title = re.search(r"<h1>(.*?)</h1>", text, re.S)
        name = re.sub("<.*?>", "", title[1]) if title else target.stem
        target.write_text(
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{name}</title>'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<style>{STYLE}</style><nav>{self.navigation(target)}</nav><main>{text}</main></html>",
            encoding="utf-8",
        )

    def navigation(self, page: Path) -> str:
        """Links to the pages that a person looks for."""
        named = {"hammerstein": self.folder / "index.html"}
        for guide in guide_pages().values():
            title = guide.read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
            named[title] = self.place(TOP / "hammerstein/guide" / guide.name)  # even if installed elsewhere
        named |= {"Examples": self.folder / "gallery.html", "Keys of scenarios": self.folder / "keys.html"}
        for notebook in sorted((TOP / "hammerstein/examples").glob("*.ipynb")):
            named[notebook.stem.replace("_", " ").capitalize()] = self.place(notebook.with_suffix(".html"))
        named["Constants"] = self.folder / "constants.html"
        named["Paper"] = self.folder / "paper.html"
        if (self.folder / "reference").is_dir():
            named["API reference"] = self.folder / "reference/index.html"
        return "".join(
            f'<a href="{relative(place, page)}">{html.escape(title)}</a>' for title, place in named.items()
        )


def relative(target: Path, page: Path) -> str:
    """Link from a page."""
    return quote(Path(os.path.relpath(target, page.parent)).as_posix())


def notebook_text(notebook: Path) -> str:
    """Text and code of a notebook."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    parts = {"markdown": "{}", "code": "```python\n{}\n```"}
    return str(
        MARKDOWN.render("\n\n".join(parts[c["cell_type"]].format("".join(c["source"])) for c in cells))
    )


def keys() -> str:
    """Give every table of a scenario file with its keys, from the JSON Schema."""
    load_plugins()
    schema = Scenario.model_json_schema()
    heads = {"": "the file itself"}
    name_tables(schema, schema["$defs"], "", heads)
    tables = {"": schema, **schema["$defs"]}
    rows = [
        f'<h2 id="{name}">{html.escape(head)}</h2>'
        f"<p>{html.escape(tables[name].get('description', '').partition(chr(10))[0])}</p>"
        '<table class="keys"><tr><th>key<th>type<th>default<th>meaning'
        + "".join(key_row(key, node, tables[name], heads) for key, node in tables[name]["properties"].items())
        + "</table>"
        for name, head in heads.items()
        if tables[name].get("properties")
    ]
    return "<h1>Keys of scenario files</h1>" + "".join(rows)


def name_tables(table: dict[str, Any], defined: dict[str, Any], path: str, heads: dict[str, str]) -> None:
    """Add the tables below one as a file writes them: [sweep], or [reference] kind = "circle"."""
    for key, node in table.get("properties", {}).items():
        own = f"{path}.{key}".lstrip(".")
        for ref, bracket in tables_of(node):
            name = ref.rpartition("/")[2]
            if name not in heads:
                own_keys = defined[name]["properties"].items()
                fixed = [(word, one["const"]) for word, one in own_keys if "const" in one]
                kinds = "".join(f' {word} = "{value}"' for word, value in fixed)
                heads[name] = f"{bracket}{own}{']' * len(bracket)}{kinds}"
                name_tables(defined[name], defined, own, heads)


def tables_of(node: dict[str, Any], bracket: str = "[") -> Iterator[tuple[str, str]]:
    """Give the tables that a value may be; those in a list are written with two brackets."""
    if "$ref" in node:
        yield node["$ref"], bracket
    for part in (*node.get("anyOf", []), *node.get("oneOf", [])):
        yield from tables_of(part, bracket)
    items = node.get("items", node.get("additionalProperties"))
    if isinstance(items, dict):
        yield from tables_of(items, "[[" if "items" in node else bracket)


def key_row(key: str, node: dict[str, Any], table: dict[str, Any], heads: dict[str, str]) -> str:
    """One key: its type, its default, its meaning."""
    default = node.get("default", "")
    said = "none" if default is None else "empty" if default in ([], {}, "") else json.dumps(default)
    if "$ref" in node or "default" not in node:
        said = ""
    needed = (
        "<td>required" if key in table.get("required", ()) else f'<td class="default">{html.escape(said)}'
    )
    meaning = html.escape(str(node.get("description", "")))
    return f"<tr><td><code>{key}</code><td>{kind_of(node, heads)}{needed}<td>{meaning}"


MOST_LISTED = 10
"""Names from which a list of them is folded."""
TYPES = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
    "object": "table",
    "array": "list",
    "null": "none",
}
"""Types of JSON in words."""


def kind_of(node: dict[str, Any], heads: dict[str, str]) -> str:
    """Type of a value in words, with links to tables and its limits."""
    if "$ref" in node:
        name = str(node["$ref"]).rpartition("/")[2]
        return f'<a href="#{name}">{html.escape(heads.get(name, name))}</a>'
    for several in ("anyOf", "oneOf"):
        if several in node:
            first, *others = [kind_of(part, heads) for part in node[several]]
            same = first.partition("&quot;")[0].partition(">")[2]  # of tables of several kinds: said once
            return " or ".join([first, *(text.replace(f">{same}", ">") if same else text for text in others)])
    if "const" in node or "enum" in node:
        values = node.get("enum", [node.get("const")])
        listed = ", ".join(json.dumps(value) for value in values)
        folded = f"<details><summary>one of {len(values)} names</summary>{listed}</details>"
        return listed if len(values) < MOST_LISTED else folded
    if node.get("type") == "array" and isinstance(node.get("items"), dict):
        return f"list of {plural(kind_of(node['items'], heads))}"
    if parts := node.get("prefixItems"):
        return f"list of {len(parts)} {plural(kind_of(parts[0], heads))}"
    return TYPES[node["type"]] + limits_of(node) if "type" in node else "any"


def plural(words: str) -> str:
    """Of a type: ``lists of numbers``."""
    return re.sub(r"^(whole number|number|list|table|text)\b", r"\1s", words)


def limits_of(node: dict[str, Any]) -> str:
    """Limits of a number in words."""
    low, high = (short(node[end]) if end in node else "" for end in ("minimum", "maximum"))
    if low and high:
        return f" from {low} to {high}"
    return f" of at least {low}" if low else f" of at most {high}" if high else ""


def short(value: float) -> str:
    """Number without zeros that say nothing: 1e-6, 1e8."""
    return re.sub(
        r"e([+-])0*",
        lambda sign: "e" + sign[1].strip("+"),
        f"{value:.15g}" if abs(value) < 1e5 else f"{value:g}",
    )


def constant_tables() -> str:
    """Give the numbers by which the package decides, a table a room."""
    rooms: dict[str, list[str]] = {}
    for found in constants():
        row = f"<tr><td><code>{found.names}</code><td>{html.escape(found.value)}<td>"
        row += f"{html.escape(found.reason)}<td>{found.module.removesuffix('.py')}"
        rooms.setdefault(found.module.partition("/")[0].removesuffix(".py"), []).append(row)
    return "<h1>Constants</h1><p>Numbers by which the package decides, and why they are so.</p>" + "".join(
        f'<h2 id="{room}">{room}</h2><table><tr><th>name<th>value<th>reason<th>module{"".join(rows)}</table>'
        for room, rows in rooms.items()
    )


def gallery(site: Site) -> str:
    """Give every shipped scenario: its question, its file, and its figure where one is kept."""
    parts = [
        "<h1>Examples</h1><p>Run one with <code>hammerstein run FILE</code>; it writes the whole report.</p>"
    ]
    for scenario in sorted((TOP / "scenarios").glob("*.toml")):
        site.reach(scenario)
        question = tomllib.loads(scenario.read_text(encoding="utf-8"))["question"]
        parts.append(f'<h2 id="{scenario.stem}">{scenario.stem}</h2><p>{html.escape(question)} ')
        parts.append(f'<a href="scenarios/{scenario.name}">{scenario.name}</a></p>')
        for figure in sorted((TOP / "reports/paper").glob(f"{scenario.stem}-*.png")):
            site.reach(figure)
            parts.append(f'<img src="reports/paper/{figure.name}" alt="{html.escape(question)}">')
    return "".join(parts)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Files of a meaner kind: their names and several of their values are hostile at once, for every command."""

from __future__ import annotations

import contextlib
import copy
import gzip
import json
import random
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from markdown_it import MarkdownIt

from hammerstein.escaping import clean

from . import campaign, strategies
from .campaign import FindingError

MARK = "zqx"
"""Stands in every payload, and in nothing of ours."""
TEXTS = (f"<{MARK}>", f"<script>{MARK}</script>", f"[{MARK}]({MARK}:1)", f"x */ int {MARK}; /*", f"={MARK}()",
         f"a|{MARK}|`b`", f"{MARK}\x1b[31m", f"\u202e{MARK}", f"{MARK}\0", f"{MARK}\ufffe", f"{MARK}\nb",
         "{{ 7*7 }}", f"$\\frac{{{MARK}", "", "x" * 101, f"&{MARK};", "\u4e16\u754c")  # fmt: skip
NUMBERS = (10**400, 1e308, -1e308, 5e-324, 0.0, -0.0, -1, 2**63, 1e15, float("nan"), float("inf"), 1e-9, 1e9)
OTHERS = (True, None, [], {}, [[]], "1")
NAMES = ("a", "a b", f"[{MARK}]({MARK})", f"<{MARK}>", f"\u202e{MARK}", f"{MARK}\x1b[31m", "=1+1", "a\nb",
         "ü", "{{7}}", "$(x)", "n" * 120, "a,b", "#a", "a'b\"c")  # fmt: skip
ORDERS = (b"IM", b"MI", b"XX", b"\0\0", b"II", b"\xff\xff")
INFINITE = re.compile(r"(?i)(?<![\w.'\"])[-+]?(nan|inf)(?![\w'\"])")
OWN_HTML = re.compile(r"</?(details|summary)>")
"""Folds of the page of claims."""
LARGEST = 2_000_000


class Seeds:
    """Good files of every kind, made once; a case alters one of them."""

    def __init__(self, folder: Path):
        from . import options

        self.place = options.furnish(folder)
        with contextlib.chdir(self.place):
            for line in (("export", "model.json", "--law", "exact_inverse", "--out", "code"),
                         ("run", "small.toml", "--no-figures", "--out", "runs", "--jobs", 1)):  # fmt: skip
                campaign.call(*line)
        self.models = strategies.good_models()
        self.scenarios = strategies.good_scenarios()
        self.records = campaign.records(folder)
        self.export = {path.name: path.read_bytes() for path in (self.place / "code").iterdir()}
        self.report = (self.place / "runs/small/report.json").read_bytes()
        self.path = campaign.path_bytes()


def altered(content: Any, draw: random.Random) -> Any:
    """Content with one to four hostile values, and seldom a hostile key."""
    content = json.loads(json.dumps(content))
    words = draw.random() < 0.5
    for _ in range(draw.choice((1, 1, 2, 4))):
        table, key = _place(content, draw)
        for _ in range(20 * words):  # names and texts alone, most of which are taken
            if isinstance(table[key], str) and key not in ("kind", "law", "format", "model", "actuator"):
                break
            table, key = _place(content, draw)
        if isinstance(table, dict) and draw.random() < 0.1:
            table[draw.choice(TEXTS)] = table.pop(key)
            continue
        pool = TEXTS if isinstance(table[key], str) else NUMBERS
        table[key] = copy.deepcopy(draw.choice(OTHERS if draw.random() < 0.1 else pool))
    return content


def _place(content: Any, draw: random.Random) -> tuple[Any, Any]:
    """A value somewhere, found from the top downwards."""
    key = draw.choice(list(content) if isinstance(content, dict) else range(len(content)))
    inside = content[key]
    return _place(inside, draw) if isinstance(inside, dict | list) and inside else (content, key)


def json_bytes(content: Any, draw: random.Random) -> bytes:
    """Text of a JSON file; seldom with a key twice, a byte-order mark or cut short."""
    text = json.dumps(content, ensure_ascii=draw.random() < 0.5).encode("utf-8", "surrogatepass")
    chance = draw.random()
    if chance < 0.05:
        return text.replace(b"{", b'{"name": "twice", "name": "again", ', 1)
    if chance < 0.1:
        return draw.choice((b"\xef\xbb\xbf", b"\xff\xfe", b"\0")) + text
    return text[: draw.randrange(len(text))] if chance < 0.15 else text


def table_bytes(data: bytes, draw: random.Random) -> bytes:
    """Text of a table with hostile names, cells or lengths."""
    lines = data.decode().splitlines()
    names = lines[0].split(",")
    for _ in range(draw.choice((0, 1, 2))):
        names[draw.randrange(len(names))] = draw.choice(TEXTS)
    lines[0] = ",".join(names)
    for _ in range(draw.choice((0, 1, 3))):
        cells = lines[k := draw.randrange(1, len(lines))].split(",")
        cells[draw.randrange(len(cells))] = str(draw.choice((*NUMBERS, *TEXTS)))[:500]
        lines[k] = ",".join(cells)
    return "\n".join(lines[: draw.choice((1, 3, *[len(lines)] * 6))]).encode("utf-8", "surrogatepass")


def case(draw: random.Random, seeds: Seeds, folder: Path) -> int:
    """Alter a file, give it a name, and let a command read it; FindingError for what must not happen."""
    work = folder / "around" / "work"
    shutil.rmtree(work.parent, ignore_errors=True)
    work.mkdir(parents=True)
    (work.parent / "mine.txt").write_text("mine")
    (work / "path.csv").write_bytes(seeds.path)
    (work / "good.json").write_bytes(json.dumps(seeds.models[2]).encode())
    kind = draw.choice(list(KINDS))
    line = KINDS[kind](draw, seeds, work)
    if line[0] in ("run", "check", "sweep", "show") and campaign.is_long(work / line[1]):
        return -1
    mine = {path: path.read_bytes() for path in work.parent.rglob("*") if path.is_file()}
    with contextlib.chdir(work):
        outcome = campaign.call(*line)
    _examine(line, outcome, work, mine)
    return outcome[0]


def _examine(line: Any, outcome: tuple[int, str, str], work: Path, mine: dict[Path, bytes]) -> None:
    """Look at what was said and at every file that was written."""
    for text in outcome[1:]:
        if clean(text) != text:
            raise FindingError(f"{line}: control character: {clean(text)[:500]}")
    if "--json" not in line and INFINITE.search(outcome[2]) and not outcome[0]:
        raise FindingError(f"{line}: nonsense number: {outcome[2][:800]}")
    for path in work.parent.rglob("*"):
        if path in mine and path.is_file() and path.read_bytes() != mine[path]:
            if path.parent.name != "code":
                raise FindingError(f"{line}: file of a person replaced: {path}")
        elif path.is_file() and path not in mine:
            if work not in path.parents:
                raise FindingError(f"{line}: file outside the folder: {path}")
            if path.stat().st_size < LARGEST:
                _read(line, path)


def _read(line: Any, path: Path) -> None:
    if path.suffix in (".json", ".csv"):
        campaign.refuse_not_finite(path)
    if path.suffix not in (".md", ".html", ".xml", ".svg", ".c", ".h", ".csv"):
        return
    text = path.read_bytes().decode("utf-8")
    if clean(text) != text and path.suffix != ".html":
        raise FindingError(f"{line}: control character in {path.name}")
    if path.suffix in (".xml", ".svg"):
        ElementTree.fromstring(text)
    raw = {
        ".md": _markdown,
        ".html": _html,
        ".c": _c,
        ".h": _c,
        ".csv": lambda text: re.search(rf"(?m)(^|,)\"?={MARK}", text) is not None,
    }.get(path.suffix)
    if raw is not None and raw(text):
        raise FindingError(f"{line}: raw markup in {path.name}")
    if path.suffix == ".md" and INFINITE.search(_without_words(text)):
        raise FindingError(f"{line}: nonsense number in {path.name}: {INFINITE.search(text)}")


def _without_words(text: str) -> str:
    """Text without names of ours, and without the word that a person may type or has typed."""
    return re.sub(rf"\S*{MARK}\S*|or inf,|, not [-+]?(nan|inf)\b", "", text)


def _markdown(text: str) -> bool:
    tokens = MarkdownIt("commonmark", {"html": True}).enable("table").parse(text)
    every = [part for token in tokens for part in (token, *(token.children or ()))]
    linked = [part for part in every if MARK in str(part.attrs)]
    raw = [part.content for part in every if part.type in ("html_inline", "html_block")]
    return bool(linked) or any(MARK in text or "<" in OWN_HTML.sub("", text) for text in raw)


class _Tags(HTMLParser):
    found = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found |= MARK in tag or any(MARK in name for name, _ in attrs)
        self.found |= any(name in ("href", "src") and (value or "").startswith(MARK) for name, value in attrs)


def _html(text: str) -> bool:
    tags = _Tags()
    tags.feed(text)
    return tags.found or f"<script>{MARK}" in text


def _c(text: str) -> bool:
    return re.search(rf"\b{MARK}\b(?!_)", re.sub(r"/\*.*?\*/", "", text, flags=re.S)) is not None


# ---- one file and a command line for each kind ----


def _named(draw: random.Random, ending: str) -> str:
    return draw.choice(NAMES) + ending


def _model(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    name = _named(draw, ".json")
    (work / name).write_bytes(json_bytes(altered(draw.choice(seeds.models), draw), draw))
    law = draw.choice(("none", "exact_inverse", "model", "inverse_multiplicative"))
    (work / "volts.csv").write_bytes(seeds.path.replace(b"x,y", b"u_x,u_y"))
    return draw.choice(
        [
            ["show", name, *draw.choice(([], ["--json"]))],
            ["compensate", name, "path.csv", "--law", "exact_inverse", "--out", _named(draw, ".csv")],
            ["play", name, "volts.csv", "--out", _named(draw, "_.csv")],
            ["export", name, "--law", law, "--out", draw.choice(NAMES[:10]), "--sample-time", "5e-5"],
        ]
    )


def _scenario(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    name = _named(draw, ".toml")
    content = draw.choice([s for s in seeds.scenarios if "identification" not in json.dumps(s)])
    content = altered(content, draw)
    if draw.random() < 0.3:
        model = _named(draw, ".json")
        (work / model).write_bytes(json_bytes(altered(draw.choice(seeds.models), draw), draw))
        content["actuator"] = model
    text = campaign.toml(content).encode("utf-8", "surrogatepass")
    (work / name).write_bytes(text if draw.random() < 0.9 else draw.choice((b"", b"\xef\xbb\xbf" + text)))
    return draw.choice(
        [
            ["run", name, "--no-figures", "--jobs", 1, "--out", "o", "--page", "p", "--traces", "csv"],
            ["show", name],
            ["check", name, "--baseline", "b", "--markdown", "s.md", "--junit", "j.xml", "--jobs", 1],
            ["sweep", name, "--out", "rows.csv"],
        ]
    )


def _record(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    name, data, columns = draw.choice(seeds.records)
    name = _named(draw, Path(name).suffix)
    if name.endswith((".csv", ".txt")):
        data = table_bytes(seeds.records[0][1], draw)
    elif name.endswith(".mat") and draw.random() < 0.7:
        data = data[:126] + draw.choice(ORDERS) + campaign.mutated(data[128:], draw)
    else:
        data = campaign.mutated(data, draw)
    if draw.random() < 0.1:
        name, data = name + ".gz", data if draw.random() < 0.3 else gzip.compress(data, 1)
        data = data if draw.random() < 0.5 else campaign.mutated(data, draw)
    (work / name).write_bytes(data if draw.random() < 0.95 else b"")
    given = ["--inputs", draw.choice((columns[0], "1")), "--outputs", draw.choice((columns[1], *TEXTS[:8]))]
    given = [word.replace("\0", "") for word in given]
    rate = ["--rate", draw.choice((1000, "1e308", "5e-324", 1000))]
    quick = ["--no-figures", "--operators", 3, "--dynamics", "none", "--out", _named(draw, "_.json")]
    if draw.random() < 0.05:
        return ["compare", name, *given, *rate, *quick[:-1], _named(draw, "_"), "--jobs", 1]
    return draw.choice(
        [["show", name], ["loops", name, *given, *rate], ["identify", name, *given, *rate, *quick]]
    )


def _path(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    name = _named(draw, ".csv")
    (work / name).write_bytes(table_bytes(seeds.path, draw))
    out = ["--out", _named(draw, "_.csv")]
    return draw.choice([["compensate", "good.json", name, *out], ["play", "good.json", name, *out]])


def _export(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    (work / "code").mkdir()
    damaged = draw.choice(("export.json", "export.json", "model.json"))
    for name, data in seeds.export.items():
        content = json_bytes(altered(json.loads(data), draw), draw) if name == damaged else data
        (work / "code" / name).write_bytes(content)
    if draw.random() < 0.3:
        content = json.loads(seeds.export["export.json"])
        table = content["request"] if draw.random() < 0.7 else content
        table.pop(draw.choice(list(table)))
        (work / "code" / "export.json").write_text(json.dumps(content))
    return ["export", "--check", "code"]


def _result(draw: random.Random, seeds: Seeds, work: Path) -> list[Any]:
    name = _named(draw, ".json")
    (work / name).write_bytes(json_bytes(altered(json.loads(seeds.report), draw), draw))
    return ["show", name]


Kind = Callable[[random.Random, Seeds, Path], list[Any]]
KINDS: dict[str, Kind] = {
    "model": _model, "scenario": _scenario, "record": _record, "path": _path, "export": _export,
    "result": _result,
}  # fmt: skip

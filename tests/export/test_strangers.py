"""Texts of a stranger reach pages, tables, figures and the terminal as text."""

import ast
import csv
import dataclasses
import io
import json
import re
import sys
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import jinja2
import numpy as np
import pandas as pd
import pytest
from jinja2 import nodes
from markdown_it import MarkdownIt
from markupsafe import Markup

import hammerstein
from hammerstein.commands.cli import main
from hammerstein.errors import InputError, Notice
from hammerstein.escaping import C, Markdown, cell, clean, markdown, templates_of
from hammerstein.export.code import CCode, MeasuredCode
from hammerstein.export.folder import files_of
from hammerstein.export.request import Request
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

EVIL = "=HYPERLINK(1)<script>alert(1)</script>|`x`[a](http://b)&lt;\x1b[31m*_"
SCENARIO = f"""
question = {json.dumps(EVIL)}
actuator = "evil.json"
[reference]
kind = "sine"
amplitude_um = 15
frequency_hz = 50
[[compensators]]
label = {json.dumps(EVIL[:55])}
law = "none"
model = "evil.json"
[assessment]
kind = "paper"
[[assessment.claims]]
id = {json.dumps(EVIL)}
statement = {json.dumps(EVIL)}
paper = 1.0
quote = {json.dumps(EVIL)}
unit = {json.dumps("<b>")}
quantity = {{ metric = "rms_um", measured_axis = "=x<b>" }}
agreement = {{ within = 2.0 }}
note = {json.dumps(EVIL)}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    content |= {"name": clean(EVIL), "inputs": ["=u<script>", "v"], "outputs": ["=x<b>", "y`[5m"]}
    (tmp_path / "evil.json").write_text(json.dumps(content))
    (tmp_path / "odd.toml").write_text(SCENARIO)
    return tmp_path


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return caught.value.code or 0


def active(text):
    """What a renderer of Markdown would not show as text: tags and links that stand free."""
    outside = re.sub(r"`[^`\n]*`", "", text)
    own = r"\w[\w%.-]*\.(?:png|svg)\)|paper|readings/README.md\)"
    return re.findall(rf"(?<!\\)<[a-zA-Z/!]|(?<!\\)\]\((?!{own})|(?<!\\)&\w", outside)


@pytest.mark.full
def test_pages_tables_and_figures_of_a_hostile_scenario(folder, capsys):
    assert call("run", "odd.toml", "--page", "page", "--traces", "csv") == 0
    output = capsys.readouterr()
    report = folder / "reports/odd"
    for page in (report / "report.md", folder / "page/README.md"):
        text = page.read_text()
        assert "alert" in text
        assert active(text) == []
        assert "\x1b" not in text
    for table in (report / "rms.csv", folder / "reports/claims.csv", *report.glob("traces/*.csv")):
        text = table.read_text()
        cells = [c for line in csv.reader(io.StringIO(text)) for c in line]
        assert not [c for c in cells if re.match(r"[=+@\t\r]|-(?![\d.])", c)]
        assert "\x1b" not in text
    frame = pd.read_csv(report / "rms.csv")
    assert frame["rms_um"].dtype == np.float64
    assert frame["compensator"][0].startswith("'=HYPERLINK(1)")
    for figure in report.glob("*.svg"):
        tree = ElementTree.parse(figure)
        assert not [node for node in tree.iter() if node.tag.endswith("script")]
    assert "\x1b" not in output.out + output.err


def test_the_fit_report_of_a_hostile_record(folder, capsys):
    t = np.arange(2000) / 20e3
    u = 10.0 * np.sin(2 * np.pi * 50.0 * t)
    name = "=x<script>alert(1)</script>"
    x = HammersteinModel.load("duo_bimorph_static").hysteresis.respond(np.vstack([u, 0 * u]))[0][0]
    pd.DataFrame({"t": t, "=u<b>": u, name: x}).to_csv("r.csv", index=False)
    columns = ("--inputs", "=u<b>", "--outputs", name, "--time", "t")
    assert call("identify", "r.csv", *columns, "--dynamics", "none", "--no-figures") == 0
    assert active((folder / "model_fit/report.md").read_text()) == []
    assert call("loops", "r.csv", *columns) == 0
    (folder / "path.csv").write_text("time_s,x\n0,0\n0.01,5\n0.02,0\n")
    assert call("compensate", "model.json", "path.csv", "--law", "exact_inverse") == 0
    with open("drive.csv") as file:
        assert all(not c.startswith(("=", "+", "@")) for line in csv.reader(file) for c in line)


def test_the_summary_of_a_check_of_a_hostile_scenario(folder, capsys):
    (folder / "a`b&c_.toml").write_text(SCENARIO)
    call("check", "a`b&c_.toml", "--markdown", "s.md", "--junit", "j.xml")
    assert active(re.sub(r"(?s)```.*?```", "", (folder / "s.md").read_text())) == []
    assert "\x1b" not in (folder / "s.md").read_text()
    ElementTree.parse(folder / "j.xml")


@pytest.mark.parametrize("text", ["plain", "x_reference_um", "50 Hz, 10 V", "3 < 4 & 5", "[um]", "a: b"])
def test_escaped_text_is_read_as_it_was(text):
    assert re.sub(r"\\([!-/:-@[-`{-~])", r"\1", str(markdown(text))) == text
    assert cell(text) == clean(text) == text


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@a", "\tx"])
def test_no_cell_of_words_is_a_formula(text):
    assert cell(text).startswith("'")


@pytest.mark.parametrize(("name", "text"), [("m.json", "[" * 5000), ("s.toml", f"a = {'[' * 5000}")])
def test_brackets_without_end_are_refused(folder, capsys, name, text):
    (folder / name).write_text(text)
    arguments = ("run", name) if name == "s.toml" else ("compensate", name, "path.csv")
    assert call(*arguments) == 2
    assert f"{name}: has more than 100 nested brackets" in capsys.readouterr().err


def test_brackets_in_quotes_are_no_brackets(folder):
    (folder / "odd.toml").write_text(SCENARIO.replace("question =", f"question = '{'[' * 300}' #", 1))
    assert call("run", "odd.toml", "--no-figures") == 0


def test_a_file_larger_than_its_limit_and_one_that_never_ends_are_refused(folder, capsys):
    with open("big.json", "wb") as file:
        file.truncate(10**8)
    assert call("run", "odd.toml", "--no-figures") == 0
    (folder / "big.toml").write_text(SCENARIO.replace("evil.json", "big.json"))
    assert call("run", "big.toml") == 2
    assert "100 MB, too large" in capsys.readouterr().err
    if sys.platform != "win32":
        import os

        os.mkfifo("pipe.json")
        (folder / "pipe.toml").write_text(SCENARIO.replace("evil.json", "pipe.json"))
        assert call("run", "pipe.toml") == 2
        assert "not a regular file" in capsys.readouterr().err


NO_NAMES = ["", "x" * 101, "a\x1b[31m", "a\nb", "a\u202eb", "a\u2066b", "a\ufffe", "a\u200b", "a\0"]


@pytest.mark.parametrize("name", NO_NAMES, ids=ascii)
def test_names_have_one_type_where_they_are_read(folder, capsys, name):
    known = json.loads((folder / "evil.json").read_text())
    for key, value in (("name", name), ("inputs", [name, "v"]), ("outputs", ["x", name])):
        (folder / "named.json").write_text(json.dumps(known | {key: value}))
        assert call("show", "named.json") == 2
        said = capsys.readouterr().err
        assert re.match(rf"named.json: 1 mistake\n  {key}", said)
        assert said.strip() == clean(said).strip()


@pytest.mark.parametrize("name", NO_NAMES[1:], ids=ascii)
def test_so_have_those_of_columns_and_of_models_in_python(name):
    model = HammersteinModel.load("duo_bimorph_static")
    with pytest.raises(InputError, match="name"):
        dataclasses.replace(model, name=name)
    t = np.linspace(0.0, 0.1, 500)
    with pytest.raises(InputError, match="rename it"):
        Record(np.sin([300.0 * t]), np.sin([300.0 * t]), 2e-4, outputs=(name,))


PAYLOADS = [
    "x */ int injected; /*",
    "x *\\/ *??/ injected \\",
    '*/#include "injected.h"',
    "<script>injected()</script>",
    "[a](http://injected)",
    "![injected](//b) <b>",
    '&injected; "quoted" \' ]]> -->',
    "| injected | `x` ~~y~~",
]


def exported(text, form):
    """Name of a law and the files of an export, with a text in every place of its model that takes one."""
    known = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    said = {"flagged": True, "statements": [f"{text}\n\u2028 {text}"], "sentence": text}
    known |= {"name": text, "inputs": [text, "v"], "outputs": [text, "y"], "verdict": said}
    model = HammersteinModel.from_json(json.dumps(known))
    request = Request(
        source=f"{text}.json", law="exact_inverse", sample_time_s=5e-5, form=form, accept_flagged=True
    )
    code = CCode(request, model, request.block(model))
    return code.name, files_of(code, MeasuredCode())


def without_comments(name, text):
    """C without its comments and strings, and with another name of the law."""
    text = text.replace(name, "LAW").replace(name.upper(), "LAW")
    return re.sub(r'/\*.*?\*/|"[0-9a-f]{32}"', "", text, flags=re.S)


@pytest.mark.parametrize("form", ["c", pytest.param("fmu", marks=pytest.mark.full)])
@pytest.mark.full
def test_no_text_of_a_model_is_code_in_an_export(form):
    own, plain = exported("plain", form)
    for payload in PAYLOADS:
        law, files = exported(payload, form)
        for name, text in files.items():
            assert clean(text) == text, name
            if name.endswith((".c", ".h")):
                assert "??" not in text
                assert "\\\n" not in text
                assert without_comments(law, text) == without_comments(own, plain[name.replace(law, own)])
            if name.endswith(".xml"):
                found = list(ElementTree.fromstring(text).iter())
                assert not [node for node in found if node.tag in ("script", "b")]
            if name.endswith(".md"):
                tokens = MarkdownIt("gfm-like", {"html": True, "linkify": False}).parse(text)
                inner = [child.type for token in tokens for child in (token, *(token.children or ()))]
                assert not {"html_inline", "html_block", "link_open", "image", "s_open"} & set(inner)


PACKAGE = Path(hammerstein.__file__).parent


def test_every_template_escapes_every_value():
    """One place makes environments; no template switches its escape off or glues texts before it."""
    made = [path.name for path in PACKAGE.rglob("*.py") if re.search(r"\bEnvironment\(", path.read_text())]
    assert made == ["escaping.py"]
    templates = list(PACKAGE.rglob("*.jinja"))
    assert len(templates) > 20
    for path in templates:
        tree = jinja2.Environment(extensions=["jinja2.ext.do"]).parse(path.read_text())
        forbidden = (nodes.Concat, nodes.MarkSafe, nodes.MarkSafeIfAutoescape, nodes.EvalContextModifier)
        assert not list(tree.find_all(forbidden)), path
        assert not {found.name for found in tree.find_all(nodes.Filter)} & {"safe", "forceescape", "e"}, path


@pytest.mark.parametrize("target", [C, Markdown, Markup])
def test_a_value_of_a_template_is_escaped_by_default(target):
    found = templates_of("hammerstein", target)
    source = "{% macro m() %}{{ evil }}{% endmacro %}{{ evil }}{{ m() }}{{ [evil, 1]|join('') }}"
    for payload in PAYLOADS:
        if target is C:
            with pytest.raises(TypeError):
                found.from_string(source).render(evil=payload)
            continue
        once = str(target.escape(payload))
        assert found.from_string(source).render(evil=payload) == 3 * once + "1"
        other = Markup if target is Markdown else Markdown
        if target is Markup:
            assert found.from_string("{{ evil }}").render(evil=other(payload)) == once


@pytest.mark.full
def test_what_is_taken_for_text_of_a_target_is_a_literal():
    """``Markdown(...)`` and its like hold words of ours alone: what comes from elsewhere is formatted in."""
    for path in PACKAGE.rglob("*.py"):
        if path.name in ("escaping.py", "literals.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            named = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            if named and node.func.id in ("Markdown", "Markup", "C") and node.args:
                first = node.args[0]
                glued = isinstance(first, ast.JoinedStr) or (
                    isinstance(first, ast.BinOp) and isinstance(first.op, ast.Add)
                )
                assert not glued, f"{path}:{node.lineno}"


@pytest.mark.parametrize("line", [["run", "a\x1b[31m", "--bogus"], ["show", "a", "b\u202e"], ["\x1b[31m"],
                                  ["show", "a\x1b\u202e\nb"], ["run", "--jobs", "\x1b"]],
                         ids=ascii)  # fmt: skip
def test_the_parser_and_names_of_files_reach_the_terminal_escaped(tmp_path, monkeypatch, capsys, line):
    monkeypatch.chdir(tmp_path)
    assert call(*line) == 2
    said = capsys.readouterr().err
    assert said
    assert clean(said) == said
    assert "a\x1b\u202e\nb" not in said


def test_a_table_shows_the_name_of_its_file_escaped(folder, capsys):
    odd = folder / "a\x1b[31m\u202e\nb.json"
    odd.write_bytes((folder / "evil.json").read_bytes())
    assert call("show", odd) == 0
    out = capsys.readouterr().out
    assert clean(out) == out
    assert "\\x1b[31m\\u202e" in out.replace("\n", "")


def test_warnings_of_libraries_are_for_programmers(capsys):
    from hammerstein.errors import tell_notices

    with warnings.catch_warnings():
        tell_notices()
        warnings.simplefilter("always")
        warnings.showwarning("overflow", RuntimeWarning, "numpy.py", 1)
        warnings.showwarning("a notice", Notice, "hammerstein.py", 1)
    assert capsys.readouterr().err == "a notice\n"

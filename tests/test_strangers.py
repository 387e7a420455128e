"""Texts of a stranger reach pages, tables, figures and the terminal as text."""

import csv
import io
import json
import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main
from hammerstein.escaping import cell, clean, markdown
from hammerstein.model import HammersteinModel

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
unit = {json.dumps("<b>")}
quantity = {{ metric = "rms_um", measured_axis = "=x<b>" }}
agreement = {{ within = 2.0 }}
note = {json.dumps(EVIL)}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    content |= {"name": EVIL, "inputs": ["=u<script>", "v"], "outputs": ["=x<b>", "y`[5m"]}
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
    assert call("identify", "r.csv", *columns, "--no-figures") == 0
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
    assert re.sub(r"\\([!-/:-@[-`{-~])", r"\1", markdown(text)) == text
    assert cell(text) == clean(text) == text


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@a", "\tx"])
def test_no_cell_of_words_is_a_formula(text):
    assert cell(text).startswith("'")


@pytest.mark.parametrize(("name", "text"), [("m.json", "[" * 5000), ("s.toml", f"a = {'[' * 5000}")])
def test_brackets_without_end_are_refused(folder, capsys, name, text):
    (folder / name).write_text(text)
    arguments = ("run", name) if name == "s.toml" else ("compensate", name, "path.csv")
    assert call(*arguments) == 2
    assert f"{name}: has brackets in more than 100 others" in capsys.readouterr().err


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
        assert "no ordinary file" in capsys.readouterr().err

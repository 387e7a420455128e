"""Every command, scenario and line of Python in the guide works as it stands; its numbers are measured."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path

import matplotlib as mpl
import pytest
from kinds_figures import FREQUENCIES_HZ, METRIC, printed

from hammerstein.commands.cli import main
from hammerstein.commands.start import guide_pages
from hammerstein.experiment.plan import plan_of
from hammerstein.scenario import Scenario

TOP = Path(__file__).parents[2]
PAGES = guide_pages()
WITH_RECORDS = ("kinds",)
"""Pages whose commands need a record that init does not make: their Python alone is run."""
BEGIN = "hammerstein init my_stage"
LENGTHY = "hammerstein compare record_x.csv"
"""It takes two minutes, and what comes after it on a page does without it: run once, and only once a week."""
BASELINES = TOP / "reports/baseline"


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


def blocks(page: Path, language: str) -> list[str]:
    """Contents of the fenced blocks of a language; one fence after another, for their ends look alike."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return [content for name, content in found if name == language]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the guide is typed, by the command of its first page."""
    here = tmp_path_factory.mktemp("guide")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        assert call(*shlex.split(BEGIN)[1:]) == 0
    return here / "my_stage"


@pytest.mark.parametrize(
    "name", [name for name in PAGES if name != "deploy"]
)  # tests/export/test_export_targets.py runs it
@pytest.mark.full
def test_a_page_does_what_it_says(
    name: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands first, then scenarios, then Python, in a folder that init has made."""
    folder = tmp_path / "here"
    shutil.copytree(made, folder)
    monkeypatch.chdir(folder)
    page = PAGES[name]
    lines = [line for block in blocks(page, "") for line in block.splitlines()]
    commands = [] if name in WITH_RECORDS else [line for line in lines if line.startswith("hammerstein ")]
    assert (BEGIN in commands) == (name == "start")
    commands = [line for line in commands if line != BEGIN and not line.startswith(LENGTHY)]
    for command in commands:
        assert call(*shlex.split(command)[1:]) == 0, (command, capsys.readouterr().err)
    for block in map(tomllib.loads, blocks(page, "toml")):
        if "question" in block:  # the others show a part of a scenario
            plan_of(Scenario.model_validate(block))
    names: dict[str, object] = {}
    with mpl.rc_context({"backend": "agg"}):
        for number, block in enumerate(blocks(page, "python"), start=1):
            exec(compile(block, f"{name}, block {number}", "exec", dont_inherit=True), names)
    if name == "control":  # its loop has a limit cycle that starts run away from, and one that they end in
        assert capsys.readouterr().out.count("LimitCycle(amplitude_v=") == 2


@pytest.mark.long
@pytest.mark.full
def test_the_comparison_of_the_guide_runs(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shutil.copytree(made, tmp_path / "here"))
    lines = {line for page in PAGES.values() for line in page.read_text().splitlines()}
    (command,) = [line for line in lines if line.startswith(LENGTHY)]
    assert call(*shlex.split(command)[1:]) == 0


def test_the_guide_has_what_a_person_needs_and_every_page_opens(capsys: pytest.CaptureFixture[str]) -> None:
    wanted = {
        "start",
        "record",
        "identify",
        "compensators",
        "theory",
        "effects",
        "guard",
        "control",
        "blocks",
    }
    assert wanted | {"glossary"} <= set(PAGES)
    assert call("guide") == 0
    listed = capsys.readouterr().out
    for name, page in PAGES.items():
        assert name in listed
        assert call("guide", name) == 0
        assert capsys.readouterr().out.startswith(page.read_text().partition("\n")[0])
    assert call("guide", "nothing") == 2
    assert "pages are start, record" in capsys.readouterr().err


@pytest.mark.parametrize("page", [*PAGES.values(), TOP / "README.md"], ids=lambda page: page.stem)
def test_every_link_leads_to_a_file(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", re.sub(r"(?s)```.*?```", "", page.read_text()))
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_readme_names_every_page() -> None:
    text = (TOP / "README.md").read_text()
    assert [name for name in PAGES if f"(hammerstein/guide/{name}.md)" not in text] == []


def rows(scenario: str, metric: str, frequencies: tuple[float, ...]) -> list[str]:
    """Lines of a table: each compensator's figure on the first axis, from the accepted numbers."""
    found: dict[str, dict[float, float]] = {}
    for row in json.loads((BASELINES / f"{scenario}.json").read_text())["rows"]:
        key = row["key"]
        if "claim" not in key and key["measured_axis"] == "x" and key["excited_axis"] in ("x", "all"):
            found.setdefault(key["compensator"], {})[key["frequency_hz"]] = row["numbers"][metric]
    return [
        f"| {label} | {' | '.join(f'{values[f]:.3g}' for f in frequencies)} |"
        for label, values in found.items()
    ]


def test_the_accepted_numbers_of_kinds_lie_in_the_printed_ranges() -> None:
    """Its table is that of ten seeds (`python tests/kinds_figures.py`); a baseline holds one."""
    found = printed(PAGES["kinds"].read_text(encoding="utf-8"))
    for row in rows("kinds_circle", METRIC, FREQUENCIES_HZ):
        label, *cells = (cell.strip() for cell in row.strip("|").split("|"))
        for value, (median, low, high) in zip(map(float, cells), found[label], strict=True):
            assert 0.99 * low <= value <= 1.01 * high
            assert low <= median <= high

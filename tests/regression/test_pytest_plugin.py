"""Scenario files as tests: collected when named, and silent otherwise."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hammerstein.regression.result import check_files

pytest_plugins = ["pytester"]

LOOP = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = {amplitude}
frequency_hz = 50
"""


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with two scenarios and their baselines, an ordinary test, and a TOML file of its own.

    Making it imports what a run needs: ``pytester``, set up afterwards, unloads what comes later.
    """
    root = tmp_path_factory.mktemp("project")
    settings = "[tool.pytest.ini_options]\nfilterwarnings = ['error:::hammerstein']\n"
    (root / "pyproject.toml").write_text(settings)
    (root / "test_ordinary.py").write_text("def test_nothing():\n    assert True\n")
    for folder in ("scenarios", "settings"):
        (root / folder).mkdir()
    (root / "settings/other.toml").write_text("answer = 42\n")
    (root / "beside_the_settings.toml").write_text(LOOP.format(amplitude=10))
    for name, amplitude in (("large", 10), ("small", 5)):
        (root / f"scenarios/{name}.toml").write_text(LOOP.format(amplitude=amplitude))
    assert check_files([root / "scenarios"], root / "reports/baseline", update=True).exit_code == 0
    return root


@pytest.fixture
def project(template: Path, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    """A copy of the project, where pytest runs, without plugins that are slow to load."""
    shutil.copytree(template, pytester.path, dirs_exist_ok=True)
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:hypothesispytest -p no:benchmark")
    return pytester


def test_a_folder_of_scenarios_is_collected(project: pytest.Pytester) -> None:
    result = project.runpytest("-v", "scenarios")
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(
        ["scenarios/large.toml::large PASSED*", "scenarios/small.toml::small PASSED*"]
    )


@pytest.mark.parametrize("name", ["scenarios/large.toml", "scenarios/large.toml::large"])
def test_a_named_scenario_is_collected(project: pytest.Pytester, name: str) -> None:
    project.runpytest(name).assert_outcomes(passed=1)


@pytest.mark.parametrize("arguments", [[], ["."], ["test_ordinary.py", "settings"]])
def test_nothing_is_collected_that_was_not_named(project: pytest.Pytester, arguments: list[str]) -> None:
    project.runpytest(*arguments).assert_outcomes(passed=1)


def test_folders_in_the_settings_of_a_project_name_nothing(project: pytest.Pytester) -> None:
    project.makepyprojecttoml("[tool.pytest.ini_options]\ntestpaths = ['test_ordinary.py', 'scenarios']\n")
    project.runpytest().assert_outcomes(passed=1)


def test_a_file_of_another_kind_fails_where_it_is_named(project: pytest.Pytester) -> None:
    result = project.runpytest("settings/other.toml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*settings/other.toml: * mistakes", "*answer*unknown key*"])


def test_a_scenario_that_cannot_be_read_is_not_passed_over(project: pytest.Pytester) -> None:
    (project.path / "scenarios/broken.toml").write_text("question = ")
    result = project.runpytest("scenarios")
    result.assert_outcomes(passed=2, failed=1)
    result.stdout.fnmatch_lines(["scenarios/broken.toml: is not TOML: *"])


def test_a_failure_shows_the_table_without_a_traceback(project: pytest.Pytester) -> None:
    baseline = project.path / "reports/baseline/large.json"
    baseline.write_text(baseline.read_text().replace('"gain": ', '"gain": 1'))
    result = project.runpytest("scenarios")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "large: 4 of * numbers left their tolerance",
            "  frequency_hz  amplitude_v  axis    metric  baseline  now  *",
            "If you intended this change: hammerstein check scenarios/large.toml --update-baseline",
            "FAILED scenarios/large.toml::large - *large: 4 of *",
        ]
    )
    result.stdout.no_fnmatch_line("*Traceback*")
    result.stdout.no_fnmatch_line("*pytest_plugin.py*")


def test_a_missing_baseline_fails(project: pytest.Pytester) -> None:
    (project.path / "reports/baseline/small.json").unlink()
    result = project.runpytest("scenarios/small.toml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["small: has no baseline", "  looked for reports/baseline/small.json"])


def test_the_folder_of_baselines_can_be_chosen(project: pytest.Pytester) -> None:
    (project.path / "reports").rename(project.path / "kept")
    project.runpytest("scenarios").assert_outcomes(failed=2)
    result = project.runpytest("scenarios", "--hammerstein-baseline", "kept/baseline")
    result.assert_outcomes(passed=2)


def test_a_check_in_pytest_writes_no_baseline(project: pytest.Pytester) -> None:
    (project.path / "scenarios/new.toml").write_text(LOOP.format(amplitude=7))
    project.runpytest("scenarios").assert_outcomes(passed=2, failed=1)
    names = [path.name for path in sorted((project.path / "reports").rglob("*.json"))]
    assert names == ["large.json", "small.json"]


def test_the_plugin_loads_nothing_but_itself() -> None:
    code = (
        "import pytest, sys; before = set(sys.modules); import hammerstein.pytest_plugin; "
        "print(*sorted(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {
        "hammerstein",
        "hammerstein.pytest_plugin",
        "hammerstein.notebook_repr",  # no import of its own
        "lazy_loader",  # finds the public names; no library of ours
        *("tomllib", "tomllib._parser", "tomllib._re", "tomllib._types"),
    }

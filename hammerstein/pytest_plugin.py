"""Collect scenario files as tests, each checked against its baseline.

Only what is named on the command line is collected: ``pytest scenarios/circles.toml``, or, for a folder of
scenarios, ``pytest scenarios``. Every pytest of an environment that holds the package loads this module; it
must cost nothing there, so that all else is imported when a scenario runs.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

OPTION = "--hammerstein-baseline"
BASELINE = "reports/baseline"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that says where the baselines are."""
    group = parser.getgroup("hammerstein", "scenarios of hammerstein")
    group.addoption(
        OPTION,
        metavar="DIR",
        help=f"baselines of the scenarios named on the command line (default: {BASELINE} in the root folder)",
    )


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> ScenarioFile | None:
    """Collect a scenario that is named on the command line, or whose folder is."""
    if file_path.suffix != ".toml" or parent.config.args_source is not pytest.Config.ArgsSource.ARGS:
        return None
    start = parent.config.invocation_params.dir
    named = {Path(os.path.abspath(start / arg.split("::")[0])) for arg in parent.config.args}
    wanted = file_path in named or (file_path.parent in named and _holds_scenarios(file_path.parent))
    return ScenarioFile.from_parent(parent, path=file_path) if wanted else None


class ScenarioFile(pytest.File):
    """A scenario file: one test."""

    def collect(self) -> Iterator[ScenarioItem]:
        """Return its only test."""
        yield ScenarioItem.from_parent(self, name=self.path.stem)


class ScenarioItem(pytest.Item):
    """A scenario that is run and compared with its baseline."""

    def runtest(self) -> None:
        """Run and compare; fail with the table of what differs, or with what is wrong in the file."""
        from hammerstein.errors import HammersteinError
        from hammerstein.regression.result import check_files

        try:
            result = check_files([_shortest(self.path, self.config)], _baseline_folder(self.config))
            text = result.text() if result.exit_code else ""
        except HammersteinError as error:
            text = str(error)
        if text:
            pytest.fail(text, pytrace=False)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Where the test is and what it is called in reports."""
        return self.path, None, f"scenario {self.name}"


def _holds_scenarios(folder: Path) -> bool:
    """Whether a folder is one of scenarios: one of its TOML files is, and it is not the root of a project."""
    return not (folder / "pyproject.toml").exists() and any(map(_is_scenario, folder.glob("*.toml")))


def _is_scenario(path: Path) -> bool:
    """Whether a file asks the question that every scenario opens with."""
    try:
        return "question" in tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return False


def _baseline_folder(config: pytest.Config) -> Path:
    given = config.getoption(OPTION)
    folder = config.rootpath / BASELINE if given is None else config.invocation_params.dir / str(given)
    return _shortest(folder, config)


def _shortest(path: Path, config: pytest.Config) -> Path:
    """Path as one would type it in the folder where pytest was started."""
    folder = config.invocation_params.dir
    return path.relative_to(folder) if path.is_relative_to(folder) else path

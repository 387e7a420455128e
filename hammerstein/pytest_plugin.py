"""Collect scenario files as tests, each checked against its baseline.

Only what is named on the command line is collected: ``pytest scenarios/circles.toml``, or ``pytest scenarios``
for a folder of scenarios. This module is loaded by every pytest of an environment that holds the package; it
must cost nothing there, so that all else is imported when a scenario runs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from _pytest._code.code import TerminalRepr

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
    named = _named_paths(parent.config)
    wanted = file_path in named or (file_path.parent in named and _holds_scenarios(file_path.parent))
    return ScenarioFile.from_parent(parent, path=file_path) if wanted else None


class ScenarioFile(pytest.File):
    """A scenario file: one test."""

    def collect(self) -> Iterator[ScenarioItem]:
        """Give its only test."""
        yield ScenarioItem.from_parent(self, name=self.path.stem)


class ScenarioItem(pytest.Item):
    """A scenario that is run and compared with its baseline."""

    def runtest(self) -> None:
        """Run and compare; ToleranceError with the table of what differs."""
        from hammerstein.errors import ToleranceError
        from hammerstein.regression import check_files

        result = check_files([_shortest(self.path, self.config)], _baseline_folder(self.config))
        for check in result.checks:
            if check.error is not None:
                raise check.error
        if result.findings:
            raise ToleranceError(result.text())

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], *args: Any, **kwargs: Any
    ) -> str | TerminalRepr:
        """Show what differs, or what is wrong with the file; a traceback only for a fault of the program."""
        from hammerstein.errors import HammersteinError

        if isinstance(excinfo.value, HammersteinError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, *args, **kwargs)

    def reportinfo(self) -> tuple[Path, int | None, str]:
        """Where the test is and what it is called in reports."""
        return self.path, None, f"scenario {self.name}"


def _named_paths(config: pytest.Config) -> set[Path]:
    """Files and folders named on the command line."""
    return {(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args}


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

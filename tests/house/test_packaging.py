"""What is shipped: packages, data files, dependencies, and the commands of the README."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "hammerstein"
# what is imported under another name than it is installed, or belongs to another package
NAMES = {
    "PIL": "pillow",
    "lazy_loader": "lazy-loader",
    "markdown_it": "markdown-it-py",
    "pydantic_core": "pydantic",
}


@pytest.fixture(scope="module")
def settings() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def modules() -> list[Path]:
    return [path for path in PACKAGE.rglob("*.py") if "__pycache__" not in path.parts]


def test_every_file_of_the_package_is_shipped_and_the_scenarios_with_their_numbers(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        shipped = {name for name in archive.namelist() if ".dist-info/" not in name}
    files = [path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    wanted = {path.relative_to(ROOT).as_posix() for path in files}
    for folder, pattern in (("scenarios", "*.toml"), ("reports/baseline", "*.json")):
        beside = [path.name for path in (ROOT / folder).glob(pattern)]
        assert len(beside) > 20
        wanted |= {f"hammerstein/paper/shipped/{Path(folder).name}/{name}" for name in beside}
    assert {"hammerstein/py.typed", "hammerstein/__init__.pyi"} <= shipped
    assert shipped == wanted


def test_nothing_else_is_kept_at_the_top() -> None:
    """A program that was tried there leaves its picture behind."""
    if not shutil.which("git"):
        pytest.skip("no git")
    found = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if found.returncode != 0:
        pytest.skip("no clone of the repository")
    top = {name.split("/")[0] for name in found.stdout.splitlines()}
    folders = {".ci", ".github", "hammerstein", "reports", "scenarios", "tests"}
    assert top == folders | {".gitignore", ".importlinter", "LICENSE", "README.md", "pyproject.toml"}


@pytest.mark.full
def test_every_import_is_a_dependency(settings: dict[str, Any]) -> None:
    project = settings["project"]
    extras = [
        project["optional-dependencies"][name]
        for name in ("cluster", "excel", "interactive", "matlab", "parquet", "tdms")
    ]
    lines = [line for group in (project["dependencies"], *extras) for line in group]
    declared = {re.split(r"[^\w-]", line)[0].lower() for line in lines}
    used = {name for path in modules() for name in imported(ast.parse(path.read_text(encoding="utf-8")))}
    foreign = used - sys.stdlib_module_names - {"hammerstein", "__future__"}
    named = {NAMES.get(name, name) for name in foreign}
    assert named - {"pytest"} == declared  # pytest_plugin is only loaded by pytest


def imported(tree: ast.Module) -> set[str]:
    """Top-level names of the modules that a module imports anywhere."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.add(node.module.split(".")[0])
    return names


def test_the_commands_that_are_installed_exist() -> None:
    points = metadata.distribution("hammerstein-control").entry_points
    names = {(point.group, point.name) for point in points}
    assert {("console_scripts", "hammerstein"), ("pytest11", "hammerstein")} <= names
    assert all(point.load() is not None for point in points)


@pytest.mark.parametrize(
    "command",
    [
        "python -m pip install . && hammerstein run scenarios",
        "python -m pip install '.[test]' && python -m pytest",
    ],
)
def test_the_readme_gives_the_commands_on_lines_of_their_own(command: str) -> None:
    lines = [line.strip() for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines()]
    assert lines.count(command) >= 1  # .ci/run reads them there


ELSEWHERE = """
import os, pkgutil, importlib, signal, sys
import asyncio, control, h5py, matplotlib.pyplot, multiprocessing.connection, multiprocessing.forkserver
import numba, pandas, scipy.signal, typer  # load what is of this system
for name in ("fcntl", "grp", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
for name in ("fork", "getloadavg", "geteuid", "getuid", "killpg", "mkfifo", "statvfs", "sysconf",
             "O_NOFOLLOW", "O_NONBLOCK"):
    delattr(os, name)
for name in ("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1"):
    delattr(signal, name)
import hammerstein
for found in pkgutil.walk_packages(hammerstein.__path__, "hammerstein."):
    if not found.name.startswith("hammerstein.examples."):
        importlib.import_module(found.name)
from hammerstein.commands.cli import main
main(["run", "s.toml", "--dry-run"])
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="there every other test shows it")
def test_nothing_of_posix_is_needed(tmp_path: Path) -> None:
    scenario = ['question = "?"', "[drive]", 'kind = "sine"', "amplitude_v = 5", "frequency_hz = 50"]
    (tmp_path / "s.toml").write_text("\n".join(scenario))
    found = subprocess.run(
        [sys.executable, "-c", ELSEWHERE], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr
    assert "runs of up to" in found.stdout

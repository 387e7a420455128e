"""Every example runs, prints what it found, and draws a figure."""

from __future__ import annotations

import importlib
import shutil
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure

import hammerstein.examples
from hammerstein.commands.working_folder import own_folder

ALL = sorted(Path(hammerstein.examples.__path__[0]).glob("[a-z]*.py"))
NAMES = [path.stem for path in ALL if path.stem != "stream"]  # which prints times, and runs in real time
WANTED = {"first_loop", "circle", "identify_csv", "in_python_control", "own_compensator", "limit_cycle"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("examples") / "made"
    own_folder(folder, lambda _: None)
    return folder


def test_what_was_promised_is_there() -> None:
    assert WANTED | {"monte_carlo", "raster_scan"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_an_example_runs_and_draws(
    name: str,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(made, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    module = importlib.import_module(f"hammerstein.examples.{name}")
    with mpl.rc_context({"backend": "agg"}):
        figure = module.main()
    assert isinstance(figure, Figure)
    assert any(axes.lines for axes in figure.axes)
    assert capsys.readouterr().out.strip()

"""Every example runs, prints what it found, and draws a figure."""

from __future__ import annotations

import importlib
import shutil
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib.figure import Figure

import hammerstein.examples
from hammerstein.commands.start import STARTER

pytestmark = pytest.mark.full

ALL = sorted(Path(hammerstein.examples.__path__[0]).glob("[a-z]*.py"))
NAMES = [path.stem for path in ALL if path.stem != "stream"]  # which prints times, and runs in real time
WANTED = {"first_loop", "circle", "identify_csv", "in_python_control", "own_compensator", "limit_cycle"}


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A folder with the records that ``hammerstein init`` copies: all that an example reads."""
    for axis in "xy":
        shutil.copy(STARTER / f"record_{axis}.csv", tmp_path)
    return tmp_path


def test_what_was_promised_is_there() -> None:
    assert WANTED | {"monte_carlo", "raster_scan"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_an_example_runs_and_draws(
    name: str,
    made: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(made)
    module = importlib.import_module(f"hammerstein.examples.{name}")
    with mpl.rc_context({"backend": "agg"}):
        figure = module.main()
    assert isinstance(figure, Figure)
    assert any(axes.lines for axes in figure.axes)
    assert capsys.readouterr().out.strip()

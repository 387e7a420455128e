"""A short campaign of faults; the long one is run by command: ``python tests/faults/campaign.py``."""

import runpy
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.full


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="signals of this kind are POSIX")
def test_a_kill_and_a_full_disk(capsys):
    runpy.run_path(str(Path(__file__).parents[1] / "faults/campaign.py"))["run"](1, 1, seed=3, figures=False)
    assert "no file lost" in capsys.readouterr().out

"""After installation one scenario waits for the loops that it needs, and is told so once."""

import os
import subprocess
import sys
from pathlib import Path

from hammerstein.commands.warm_up import TAKES

SCENARIO = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
"""
MOST_LOOPS = 8
"""Of about forty."""


def test_one_scenario_compiles_what_it_needs_and_the_next_run_nothing(tmp_path):
    (tmp_path / "one.toml").write_text(SCENARIO)
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops"), "HAMMERSTEIN_CACHE": ""}
    command = [sys.executable, "-m", "hammerstein", "run", "one.toml", "--no-figures", "--jobs", "2"]
    told = []
    for _ in range(2):
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0
        told.append(done.stderr)
    assert told == [f"compiling time loops that are needed for the first time, {TAKES}\n", ""]
    assert 1 <= len(list((tmp_path / "loops").rglob("*.nbi"))) <= MOST_LOOPS


def test_how_long_that_takes_is_said_in_one_way():
    readme = (Path(__file__).resolve().parents[1] / "README.md").read_text()
    assert TAKES in " ".join(readme.split())

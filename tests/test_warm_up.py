"""After installation one scenario waits for the loops that it needs, and is told so once."""

import os
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest

from hammerstein import compiled
from hammerstein.commands import warm_up
from hammerstein.commands.warm_up import TAKES, compiled_beside
from hammerstein.experiment.plan import plan_of
from hammerstein.scenario import scenario_of

SCENARIO = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
"""
LAWS = """
question = "How round?"
reference = { kind = "circle", radius_um = 10, frequency_hz = 50 }
compensators = [{ label = "a", law = "exact_inverse", identification = {} }]
"""
MOST_LOOPS = 8
"""Of about forty."""


@pytest.mark.parametrize(
    ("scenario", "most"), [(SCENARIO, MOST_LOOPS), pytest.param(LAWS, 25, marks=pytest.mark.long)]
)
def test_one_scenario_compiles_what_it_needs_and_the_next_run_nothing(tmp_path, scenario, most):
    (tmp_path / "one.toml").write_text(scenario)
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops"), "HAMMERSTEIN_CACHE": ""}
    command = [sys.executable, "-m", "hammerstein", "run", "one.toml", "--no-figures", "--jobs", "2"]
    told = []
    for _ in range(2):
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0
        told.append(done.stderr)
    assert told == [f"compiling time loops that are needed for the first time, up to {TAKES}\n", ""]
    assert 1 <= len(list((tmp_path / "loops").rglob("*.nbi"))) <= most


class Beside:
    """Stands for a process beside this one; knows what it was told."""

    told: ClassVar[list] = []

    def __init__(self, *_):
        self.told.append("begun")

    def submit(self, task, *given):
        self.told.append((task.__name__, *given))

    def shutdown(self, cancel_futures=False):
        self.told.append("ended" if cancel_futures else "waited for")


def _scenario(**values):
    return scenario_of(
        {
            "question": "How round?",
            "reference": {"kind": "circle", "radius_um": 10.0, "frequency_hz": 50.0},
            "compensators": [{"label": "a", "law": "exact_inverse", "identification": {}}],
        }
        | values
    )[1]


@pytest.mark.parametrize(
    ("jobs", "processors", "free", "helped"),
    [(2, 2, 1e9, True), (1, 2, 1e9, False), (2, 1, 1e9, False), (2, 2, 1.5, False), (2, 2, 0.5, False)],
)
def test_a_process_beside_begins_with_the_first_loop_and_ends_with_the_block(
    monkeypatch, jobs, processors, free, helped
):
    """Where there are two jobs, two processors, and room for the run twice."""
    monkeypatch.setattr(warm_up, "Processes", Beside)
    monkeypatch.setattr(Beside, "told", [])
    monkeypatch.setattr(warm_up, "processors", lambda: processors)
    monkeypatch.setattr(warm_up, "begin_loading", lambda *_: None)
    said, scenario = [], _scenario()
    needed = plan_of(scenario).bytes
    monkeypatch.setattr("hammerstein.experiment.plan.free_bytes", lambda: free * needed)
    with compiled_beside(said.append, scenario, jobs):
        assert (said, Beside.told) == ([], [])
        compiled._waiting.pop()()  # as before a loop is compiled
        assert len(said) == 1
        assert Beside.told == (["begun", ("_use_laws", scenario)] if helped else [])
    assert Beside.told[2:] == (["ended"] if helped else [])
    with compiled_beside(said.append, scenario, jobs):
        pass
    assert not compiled._waiting
    assert len(said) == 1


def test_what_cannot_be_used_beside_does_not_stop_the_others(monkeypatch):
    """Its own run says why."""
    used = []
    monkeypatch.setattr("hammerstein.experiment.measure.rows_of", lambda _, case: used.append(case.label))
    laws = [("a", "exact_inverse", {}), ("b", "hammerstein_inverse", {"filter_hz": 1e6}), ("c", "none", {})]
    compensators = [
        {"label": label, "law": law, "identification": {}, **options} for label, law, options in laws
    ]
    warm_up._use_laws(_scenario(compensators=compensators))
    assert used == ["c", "a"]  # the filter of b is beyond what a sample time allows


def test_how_long_that_takes_is_said_in_one_way():
    readme = (Path(__file__).resolve().parents[1] / "README.md").read_text()
    assert TAKES in " ".join(readme.split())

"""The guide's page on the architecture: its rooms are those of the import contract, its recipes work."""

import configparser
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.full

TOP = Path(__file__).parents[2]
PAGE = (TOP / "hammerstein/guide/architecture.md").read_text(encoding="utf-8")
SCENARIO = {
    "question": "Does it plug in?",
    "actuator": "duo_bimorph_static",
    "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 20.0},
    "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
}


def recipe(heading):
    """Code of a recipe."""
    part = PAGE.partition(f"### {heading}\n")[2]
    return re.search(r"^```py\n(.*?)^```$", part, flags=re.M | re.S)[1]


@pytest.fixture
def installed(tmp_path):
    """Install a module as another package and run lines of Python beside it, in a process of their own."""

    def run(code, lines):
        there = tmp_path / "site"
        (there / "outside-1.0.dist-info").mkdir(parents=True)
        (there / "outside.py").write_text(code)
        (there / "outside-1.0.dist-info/METADATA").write_text("Name: outside\nVersion: 1.0\n")
        (there / "outside-1.0.dist-info/entry_points.txt").write_text(
            "[hammerstein.blocks]\noutside = outside\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", f"import hammerstein\nscenario = {SCENARIO!r}\n{lines}"],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([str(there), str(TOP)])},
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return [float(word) for word in done.stdout.split()]

    return run


def test_the_page_names_every_room_and_its_floor():
    read = configparser.ConfigParser()
    read.read(TOP / ".importlinter")
    lines = [line for line in read["importlinter:contract:layers"]["layers"].split("\n") if line]
    wanted = {
        (len(lines) - number, room.strip())
        for number, line in enumerate(lines)
        for room in re.split("[|:]", line)
    }
    found = re.findall(r"^\| (\d+) \| `(\w+)` \| \w.* \|$", PAGE, flags=re.M)
    assert {(int(floor), room) for floor, room in found} == wanted
    assert len(found) == len(wanted)


def test_the_files_that_the_page_names_are_there():
    named = re.findall(r"`(\w+/\w+\.py)`", PAGE)
    assert len(named) > 10
    upper = re.compile(r"/[A-Z]+(_kernels)?\.py")
    assert [n for n in named if not upper.search(n) and not (TOP / "hammerstein" / n).exists()] == []


def test_a_kind_of_hysteresis_is_found_by_its_name(installed, tmp_path):
    """A ramp of 1 V a sample lags by its share of one step, in a process that imports no plug-in."""
    (tmp_path / "make.py").write_text(
        "from dataclasses import replace\nimport hammerstein\nfrom outside import Relaxing\n"
        "model = hammerstein.HammersteinModel.load('duo_bimorph_static')\n"
        "replace(model, hysteresis=Relaxing((5.0, 4.0), 0.25)).save('relaxing.json')\n"
    )
    lines = """
import subprocess, sys
import numpy as np
subprocess.run([sys.executable, "make.py"], check=True)
assert "outside" not in sys.modules
model = hammerstein.HammersteinModel.load("relaxing.json")
response = model.simulate(np.array([np.arange(5.0), np.zeros(5)]), 1e-3)
print(*response.position_um[0])
"""
    found = installed(recipe("A kind of hysteresis"), lines)
    assert found == pytest.approx([0.0, *(5.0 * (k - 0.25) for k in range(1, 5))], abs=1e-9)


def test_a_compensator(installed):
    """Weights that are all 5 % too large: the inverse sends for r what is needed for r / 1.05."""
    lines = """
scenario["compensators"][0] |= {"law": "scaled_inverse", "factor": 1.05}
frame = hammerstein.run(scenario).to_frame()
print(frame["max_true_um"].max())
"""
    assert installed(recipe("A compensator"), lines) == pytest.approx([20.0 * (1.0 - 1.0 / 1.05)], abs=0.01)


def test_a_signal(installed):
    """The exact inverse of a static actuator leaves half a step of the converter, times the slope."""
    lines = """
scenario["reference"]["kind"] = "plateau"
frame = hammerstein.run(scenario).to_frame()
print(frame["max_true_um"].max(), hammerstein.simulate(scenario).position_um.max())
"""
    worst_um, end_um = installed(recipe("A signal"), lines)
    assert worst_um < 0.01
    assert end_um == pytest.approx(20.0, abs=0.01)


def test_a_figure_of_merit(installed):
    """A sine of 20 um spans 40 um, and the noise at its ends comes on top: at most five sigma at each."""
    lines = """
sensor = hammerstein.HammersteinModel.load(scenario["actuator"]).instruments.sensor
print(sensor.noise_um)
frame = hammerstein.run(scenario).to_frame()
print(*frame.loc[frame["excited_axis"] == frame["measured_axis"], "span_um"])
"""
    noise_um, *found = installed(recipe("A figure of merit"), lines)
    assert len(found) == 2
    assert 40.0 - noise_um < min(found)
    assert max(found) < 40.0 + 10.0 * noise_um

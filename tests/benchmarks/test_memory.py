"""Peak memory against the arrays that are kept, each run in a process of its own."""

import subprocess
import sys
from pathlib import Path

import pytest
from ratios import Row

GROUP = "Peak memory of a run (ratio: times the arrays kept)"

START = """
import re, sys
from pathlib import Path
import numpy as np, psutil
from hammerstein.model import HammersteinModel
samples = int(sys.argv[1])
t = np.arange(1000) * 5e-5
def sines(samples):
    u = np.empty((2, samples))
    u.reshape(2, -1, 1000)[:] = (10 * np.sin(2 * np.pi * 50 * t + np.arange(2)[:, None]))[:, None]
    return u
"""

WHOLE = """
model = HammersteinModel.load("duo_bimorph_static").hysteresis
model.respond(sines(1000))
before = psutil.Process().memory_info().rss
u = sines(samples)
v, _ = model.respond(u)
kept = u.nbytes + v.nbytes
"""

BLOCKS = """
model = HammersteinModel.load("duo_bimorph_static").hysteresis
model.respond(sines(1000))
before = psutil.Process().memory_info().rss
u, state = sines(1_000_000), None
for _ in range(samples // 1_000_000):
    v, state = model.respond(u, state)
kept = u.nbytes + v.nbytes
"""

EXPERIMENT = """
from hammerstein.scenario import Scenario
from hammerstein.experiment.set_up import set_up
def scenario(cycles):
    law = {"label": "paper", "law": "inverse_multiplicative", "identification": {"frequency_hz": 50.0}}
    return Scenario.model_validate({
        "question": "How much memory?", "actuator": "duo_bimorph", "compensators": [law],
        "reference": {"kind": "circle", "radius_um": 40.0, "frequency_hz": 50.0},
        "measure": {"settle_cycles": 1, "measured_cycles": cycles - 1}})
def run(cycles):
    setup = set_up(scenario(cycles))
    return setup.simulate(next(setup.cases()))
run(5)
before = psutil.Process().memory_info().rss
r = run(samples // 400)
wires = (r.reference_um, r.requested_v, r.drive_v, r.hysteresis_um, r.position_um, r.reading_um, r.saturated)
kept = sum(wire.nbytes for wire in wires)
"""

EXPERIMENT_IN_BLOCKS = (
    EXPERIMENT.split("def run")[0]
    + """
from hammerstein import simulate_in_blocks
kept = 0
def run(cycles):
    global kept
    for r in simulate_in_blocks(scenario(cycles), 1_000_000):
        names = "reference_um requested_v drive_v hysteresis_um position_um reading_um saturated"
        kept = max(kept, sum(getattr(r, name).nbytes for name in names.split()))
        del r
run(5)
before = psutil.Process().memory_info().rss
run(samples // 400)
"""
)

END = r"""
status = Path("/proc/self/status").read_text()
peak = 1024 * int(re.search(r"VmHWM:\s*(\d+) kB", status)[1])
print(peak - before, kept)
"""


@pytest.mark.parametrize(
    ("what", "program", "samples", "required"),
    [
        ("hysteresis, 2 x 2, in one piece", WHOLE, 5_000_000, 3.0),
        ("the same in blocks of a million samples", BLOCKS, 100_000_000, 3.0),
        ("whole experiment, every wire kept", EXPERIMENT, 2_000_000, 3.0),
        ("whole experiment, a million samples at a time", EXPERIMENT_IN_BLOCKS, 100_000_000, 3.0),
    ],
)
def test_memory(bench, what, program, samples, required):
    if not Path("/proc/self/status").exists():
        pytest.skip("the peak of a process's memory is read from /proc, which only Linux has")
    samples = min(samples // 5, 5_000_000) if bench.short else samples
    command = [sys.executable, "-c", START + program + END, str(samples)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    peak, kept = (int(number) for number in answer.stdout.split())
    names = (GROUP, f"{what}, {samples:,} samples", "arrays kept")
    row = Row(*names, peak / 1e6, kept / 1e6, "MB", peak / kept, "<=", required)
    bench.table.add(row)
    assert row.acceptable, f"{what}: {row.ratio:.3g} times the arrays kept"

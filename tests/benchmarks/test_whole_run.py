"""What a person waits for: all shipped scenarios, the first run after installation, an identification."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from cases import SAMPLE_TIME_S, sines
from ratios import Row

from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

ROOT = Path(__file__).resolve().parents[2]
RUN = "Waiting time on the wall (ratio: part of what is allowed)"
A_SCENARIO_S = 0.9
BUSY = 2.0  # times the limit before a benchmark fails: time on the wall is what else the machine does
SPENT = "Processor time of what a person waits for (ratio: part of the time on the wall)"
PARTS = "Where the time of all shipped scenarios goes, in one process (ratio: part of the whole)"

SPLIT = """
import os, time
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")
begin = time.process_time()
import importlib
from pathlib import Path
from hammerstein.runtime.parallel_tasks import LOADED_ONCE
for name in LOADED_ONCE:
    importlib.import_module(name)
spent = {"loading the libraries": time.process_time()}

def clocked(module, name, what):
    function = getattr(module, name)
    def timed(*arguments, **options):
        start = time.process_time()
        try:
            return function(*arguments, **options)
        finally:
            spent[what] = spent.get(what, 0.0) + time.process_time() - start
    setattr(module, name, timed)

from hammerstein.experiment import run as experiment
from hammerstein.reporting import folder
from hammerstein.reporting.figures import choice, write
clocked(experiment, "set_up", "models, kept from the run before, and laws")
clocked(experiment, "run", "run")
clocked(choice, "figures_of", "building the figures")
clocked(write, "svg_of", "drawing them")
clocked(folder.Writer, "__call__", "write")
import sys
loaded = experiment.load_all([Path(sys.argv[1])])
for outcome in experiment.run_all(loaded, folder.Writer(Path(sys.argv[2])), 1):
    assert outcome.error is None, outcome.error
figures = [what for what in spent if what.startswith(("building", "drawing"))]
run, wrote = spent.pop("run"), spent.pop("write")
spent["simulation and figures of merit"] = run - spent["models, kept from the run before, and laws"]
spent["pages and tables"] = wrote - sum(spent[what] for what in figures)
for what, seconds in spent.items():
    print(f"{seconds:.6f} {what}")
"""


DRAWS = """
import time
from hammerstein.experiment.run import run
scenario = {{
    "question": "How far apart are they?",
    "actuator": "duo_bimorph",
    "reference": {{"kind": "circle", "radius_um": 40.0, "frequency_hz": 50.0}},
    "compensators": [{{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}}],
}}
for draws in (25, 25, 25 + {more}):
    scenario["uncertainty"] = {{"weights": 0.05, "resonance": 0.02, "draws": draws}}
    before, start = locals().get("seconds"), time.process_time()
    run(scenario)
    seconds = time.process_time() - start
print(before, seconds)
"""


class Ran(NamedTuple):
    """Time on the wall and of all processors [s], and the output, of a Python of its own."""

    wall_s: float
    spent_s: float
    out: str


def python(*arguments, **environment):
    """What Python takes with its bytecode kept, as after an installation, whatever this machine sets."""
    kept = {"PYTHONPYCACHEPREFIX": os.path.join(tempfile.gettempdir(), "hammerstein-bytecode")}
    own = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start, before = time.perf_counter(), os.times()
    answer = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env=own | kept | environment,
    )
    wall, after = time.perf_counter() - start, os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return Ran(wall, spent, answer.stdout)


def waited(bench, what, ran, allowed):
    """Ratio of a waiting time to what is allowed, in the table, with the time of the processors."""
    bench.table.add(Row(SPENT, what, "on the wall", ran.spent_s, ran.wall_s, "s", ran.spent_s / ran.wall_s))
    row = Row(RUN, what, "limit", ran.wall_s, allowed, "s", ran.wall_s / allowed, "<=", 1.0)
    return bench.table.add(row).ratio


def test_help_comes_at_once(bench):
    """Against a Python that loads one library, for a busy machine slows both."""
    helped, numpy_alone = ("-m", "hammerstein", "--help"), ("-c", "import numpy")
    pairs = [(python(*helped), python(*numpy_alone)) for _ in range(6)][1:]
    quickest, other = (min(ran) for ran in zip(*pairs, strict=True))
    waited(bench, "hammerstein --help", quickest, 0.3)
    ours, other = quickest.wall_s, other.wall_s
    row = Row(
        RUN, "hammerstein --help", "python -c 'import numpy'", ours, other, "s", ours / other, "<=", 2.0
    )
    assert bench.table.add(row).acceptable


def test_all_shipped_scenarios(bench, tmp_path):
    if bench.short:
        pytest.skip("the full form times all scenarios")
    command = ("-m", "hammerstein", "run", "scenarios", "--jobs", "2", "--out", tmp_path / "reports")
    own = {"HAMMERSTEIN_CACHE": str(tmp_path / "cache"), "HAMMERSTEIN_CACHE_MB": "1000"}
    python(*command, **own)  # compiles what is not compiled yet
    count = len(list((ROOT / "scenarios").glob("*.toml")))
    fresh, again = python(*command, "--fresh", **own), python(*command, **own)
    what = f"all scenarios, {count}, with figures, two jobs"
    assert waited(bench, what, fresh, A_SCENARIO_S * count) <= BUSY
    assert waited(bench, "the same again, nothing changed", again, 0.1 * fresh.wall_s) <= BUSY
    printed = python("-c", SPLIT, "scenarios", tmp_path / "reports", **own).out
    parts = [(float(line.split(" ", 1)[0]), line.split(" ", 1)[1]) for line in printed.splitlines()]
    whole = sum(seconds for seconds, _ in parts)
    for seconds, what in sorted(parts, reverse=True):
        bench.table.add(Row(PARTS, what, "the whole", seconds, whole, "s", seconds / whole))


def test_ten_thousand_drawn_actuators(bench):
    """On one processor, from the time of fewer draws."""
    more = bench.fewer(2000)
    answer = python("-c", DRAWS.format(more=more), OPENBLAS_NUM_THREADS="1")  # as the command line has it
    once, with_more = map(float, answer.out.split())
    spent = once + 10_000 * (with_more - once) / more
    what = "10 000 draws of a 50 Hz circle on one processor, from the time of fewer"
    assert waited(bench, what, Ran(spent, spent, ""), 60.0) <= BUSY


def test_first_run_after_installation(bench, tmp_path):
    if bench.short:
        pytest.skip("the full form compiles everything anew")
    scenario = ROOT / "scenarios" / "beyond_circles.toml"
    command = ("-m", "hammerstein", "run", scenario, "--no-figures", "--out", tmp_path / "reports")
    caches = {"NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    first, later = (python(*command, **caches) for _ in range(2))
    more = Ran(first.wall_s - later.wall_s, first.spent_s - later.spent_s, "")
    assert waited(bench, "first run after installation, more than later", more, 20.0) <= BUSY


def test_least_squares_on_a_long_record(bench, published):
    u = sines(bench.samples) * np.array([[1.0], [0.9]])
    u[1] = np.roll(u[1], 77) * np.sin(2.0 * np.pi * 1.3 * SAMPLE_TIME_S * np.arange(bench.samples))
    noise = 0.04 * np.random.default_rng(0).standard_normal(u.shape)
    record = Record(u, published.hysteresis.respond(u)[0] + noise, SAMPLE_TIME_S)
    settings = Settings(operators=15, partition="time", dynamics="none", creep_modes=0, error_curve=False)
    identify([record.part(0, 20_000)], settings)
    start, begun = time.process_time(), time.perf_counter()
    _, fit = identify([record], settings)
    ran = Ran(time.perf_counter() - begun, time.process_time() - start, "")
    assert max(fit.fit["static_hysteresis"].rms_um) < 0.08
    assert waited(bench, f"identify, 2 x 2, 15 operators, {bench.samples:,} samples", ran, 5.0) <= BUSY

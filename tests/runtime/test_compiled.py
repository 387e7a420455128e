"""Loops as machine code: what is compiled, what is kept on the disk, what is said of it."""

import ast
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from types import FunctionType

import filelock
import numpy as np
import pytest

import hammerstein
from hammerstein.compiled import _kept_in, compiled, config, helper

pytestmark = pytest.mark.full


def test_a_helper_is_compiled_as_a_part_of_its_loop():
    @helper(error_model="numpy")
    def over(value):
        return 1.0 / value

    @compiled()
    def all_over(values):
        for i in range(len(values)):
            values[i] = over(values[i])

    values = np.array([2.0, 0.0])
    all_over(values)
    np.testing.assert_array_equal(values, [0.5, np.inf])
    assert over(2.0) == 0.5
    assert isinstance(over, FunctionType)  # there is nothing of its own to compile or to keep


PACKAGE = Path(hammerstein.__file__).parent


def _is_kernel(path):
    return "kernel" in path.stem or path.stem == "compiled"


def _names_a_kernel(module):
    return module == "hammerstein.compiled" or "kernel" in module.rpartition(".")[2]


def test_every_loop_stands_in_a_kernel_and_takes_nothing_from_elsewhere():
    """The folder of the kept loops is named by the sources of the kernels: nothing else may decide them."""
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text())
        found = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        taken = {name.name for node in found if node.module == "hammerstein.compiled" for name in node.names}
        if taken & {"compiled", "helper"}:
            assert _is_kernel(path), path
        if _is_kernel(path) and path.stem != "compiled":
            ours = [node.module for node in found if (node.module or "").startswith("hammerstein")]
            assert all(map(_names_a_kernel, ours)), path


CALLER = "from hammerstein.compiled import compiled\nfrom hammerstein.some_kernel import part\n\n"
CALLER += "@compiled()\ndef whole(x):\n    return part(x)\n\n"
CALLER += "print(whole(1.0), sum(whole.stats.cache_hits.values()))\n"
PART = "from hammerstein.compiled import helper\n\n@helper()\ndef part(x):\n    return {} * x\n"


def test_a_changed_helper_in_another_file_counts_in_a_loop_that_was_kept(tmp_path):
    shutil.copytree(PACKAGE, tmp_path / "hammerstein", ignore=shutil.ignore_patterns("__pycache__"))
    caller, part = tmp_path / "hammerstein/other_kernel.py", tmp_path / "hammerstein/some_kernel.py"
    caller.write_text(CALLER)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops"), "PYTHONPATH": str(tmp_path)}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"  # Python itself knows a source by its second and its size

    def run(factor):
        part.write_text(PART.format(factor))
        return subprocess.run(
            [sys.executable, "-c", "import hammerstein.other_kernel"],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
            timeout=100,
        ).stdout.split()

    assert [run(2.0), run(2.0), run(3.0), run(3.0)] == [
        ["2.0", "0"],
        ["2.0", "1"],
        ["3.0", "0"],
        ["3.0", "1"],
    ]


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


ONCE = """
import numpy as np
from hammerstein.compensators.attempt import compensator_of
from hammerstein.compensators.exact.inverse_kernel import respond_exact
from hammerstein.hysteresis.play_kernels import respond_turning_points
from hammerstein.model import HammersteinModel
model, path = HammersteinModel.load("duo_bimorph"), np.zeros((2, 20))
kept = path.copy()
kept.flags.writeable = False
for name in ("exact_inverse", "hammerstein_inverse", "decoupled_inverse"):
    law = compensator_of(name, {}).design(model, 10.0, 50e-6)
    for signal in (path, kept):
        law.respond(signal)
        model.hysteresis.respond(signal)
    law.step(path[:, 0], law.rest())
print(len(respond_exact.signatures), len(respond_turning_points.signatures))
"""


def test_a_loop_is_compiled_once_for_signals_steps_and_arrays_that_nobody_may_write_to():
    found = subprocess.run([sys.executable, "-c", ONCE], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["1", "1"]


@pytest.mark.parametrize(
    ("scenario", "most"), [(SCENARIO, MOST_LOOPS), pytest.param(LAWS, 25, marks=pytest.mark.long)]
)
def test_one_scenario_compiles_what_it_needs_and_the_next_run_nothing(tmp_path, scenario, most):
    (tmp_path / "one.toml").write_text(scenario)
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops"), "HAMMERSTEIN_CACHE": ""}
    command = [sys.executable, "-m", "hammerstein", "run", "one.toml", "--no-figures", "--jobs", "2"]

    def told():
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0
        return done.stderr

    first = told()
    assert first.startswith("compiling ")
    assert first.endswith(" and other loops to machine code; needed once after installation\n")
    assert told() == ""
    (folder,) = (tmp_path / "loops").glob("loops-*")
    assert 1 <= len(list(folder.rglob("*.nbi"))) <= most
    seconds = float((tmp_path / "loops/compiled_s.txt").read_text())
    assert seconds > 0.1
    shutil.rmtree(folder)
    assert f"last time this took {seconds:.0f} s" in told()


LOOP = """
import os
from hammerstein.compiled import compiled

@compiled()
def double(x):
    return 2.0 * x

if __name__ == "__main__":
    import pathlib, sys, time
    from hammerstein.errors import tell_notices
    tell_notices()
    for place in sys.argv[1:2]:
        pathlib.Path(place).touch()
    while not all(map(os.path.exists, sys.argv[2:])):
        time.sleep(0.001)
    print(double(21.0), sum(double.stats.cache_hits.values()))
"""


@pytest.fixture
def loop(tmp_path):
    """Run a compiled loop in a process of its own: what it prints, and what it says but that it compiles."""
    (tmp_path / "loop.py").write_text(LOOP)

    def run(**environment):
        command = [sys.executable, str(tmp_path / "loop.py")]
        env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops")} | environment
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=env, timeout=200)
        assert done.returncode == 0, done.stderr
        told = done.stderr.splitlines(keepends=True)
        return done.stdout.split(), "".join(line for line in told if not line.startswith("compiling "))

    return run


def _truncate(path):
    os.truncate(path, path.stat().st_size // 2)


def _empty(path):
    os.truncate(path, 0)


def _make_a_folder(path):
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("kind", ["nbc", "nbi"])
@pytest.mark.parametrize(
    "spoil", [_truncate, *(pytest.param(how, marks=pytest.mark.long) for how in (_empty, _make_a_folder))]
)
def test_a_spoilt_compiled_loop_is_compiled_again(loop, tmp_path, kind, spoil):
    """As where the power failed, or the disk was full."""
    assert [loop(), loop()] == [(["42.0", "0"], ""), (["42.0", "1"], "")]
    (path,) = (tmp_path / "loops").rglob(f"*.{kind}")
    spoil(path)
    assert loop()[0] == ["42.0", "0"]
    if (spoil, kind) != (_make_a_folder, "nbc"):  # that cannot be replaced, and is told
        assert loop() == (["42.0", "1"], "")


def test_of_processes_that_need_a_loop_one_compiles_it(tmp_path):
    (tmp_path / "loop.py").write_text(LOOP)
    ready = [str(tmp_path / name) for name in "abc"]
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "loops")}
    command = [sys.executable, str(tmp_path / "loop.py")]
    begun = [
        subprocess.Popen([*command, own, *ready], stdout=subprocess.PIPE, text=True, env=env) for own in ready
    ]
    assert sorted(process.communicate(timeout=200)[0] for process in begun) == ["42.0 0\n", *2 * ["42.0 1\n"]]


def test_a_halted_process_that_compiles_stops_no_other(loop, tmp_path):
    assert loop()[0] == ["42.0", "0"]
    (folder,) = (tmp_path / "loops").glob("loops-*")
    with filelock.FileLock(folder / "__main__.double.lock"):
        hurried = "import os, hammerstein.compiled; hammerstein.compiled.LOCK_TIMEOUT_S = 0.1"
        (tmp_path / "loop.py").write_text(LOOP.replace("import os", hurried, 1))
        assert loop() == (["42.0", "0"], "")


@pytest.mark.parametrize("place", ["file/loops", "file"])
def test_where_nothing_can_be_written_loops_are_compiled_each_time(loop, tmp_path, place):
    (tmp_path / "file").write_text("no folder")
    out, error = loop(NUMBA_CACHE_DIR=str(tmp_path / place))
    assert out == ["42.0", "0"]
    assert error.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in error


def test_a_disk_that_is_full_keeps_no_loop_and_stops_no_run(loop, tmp_path):
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (50, resource.RLIM_INFINITY))\n"
    (tmp_path / "loop.py").write_text(limit + LOOP)
    out, error = loop()
    assert out == ["42.0", "0"]
    assert error.count("\n") == 1
    assert "are not cached" in error


def test_threads_that_decorate_at_once_do_not_take_the_folder_from_each_other(tmp_path):
    """One left an empty folder of numba's in the working folder."""
    entered = threading.Event()

    def other():
        with _kept_in(tmp_path / "b"):
            entered.set()

    before, thread = config.CACHE_DIR, threading.Thread(target=other)
    with _kept_in(tmp_path / "a"):
        thread.start()
        assert not entered.wait(0.2)
        assert str(tmp_path / "a") == config.CACHE_DIR
    thread.join(5.0)
    assert entered.is_set()
    assert before == config.CACHE_DIR

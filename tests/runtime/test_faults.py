"""Processes that are ended from outside: nothing stays behind, and what can go on goes on."""

import contextlib
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import psutil
import pytest

from hammerstein.errors import LostProcessError
from hammerstein.runtime import parallel_tasks as workers
from hammerstein.runtime.parallel_tasks import (
    Processes,
    ProcessesAndThis,
    _imports_from_where_this_does,
    in_order,
    loaded_beforehand,
    signal_name,
)

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(sys.platform == "win32", reason="signals of this kind are POSIX"),
]

SMALL = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
"""


def swept(values):
    return SMALL + f"[sweep]\nfrequency_hz = {[5 + 0.01 * k for k in range(values)]}\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").mkdir()
    for name in ("a", "b"):
        (tmp_path / f"scenarios/{name}.toml").write_text(SMALL)
    for name in ("slow1", "slow2"):
        (tmp_path / f"scenarios/{name}.toml").write_text(swept(4000))
    return tmp_path


ENDED = "interrupted; finished files are kept, and nothing is half-written"


class Run:
    """The command line in a process of its own, and everything that it starts."""

    def __init__(self, *arguments, **more):
        command = [sys.executable, "-m", "hammerstein", *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(command, **pipes, start_new_session=True, **more)
        self.seen = []
        self.top = psutil.Process(self.process.pid)

    def wait_for(self, path, seconds=60):
        until = time.monotonic() + seconds
        while not path.exists() and time.monotonic() < until and self.process.poll() is None:
            time.sleep(0.02)
        assert path.exists()

    def family(self):
        self.seen = self.top.children(recursive=True)
        return self.seen

    def workers(self):
        """Processes that do the work: forked by the server, which has the libraries loaded."""
        return [p for p in self.family() if p.ppid() != self.process.pid]

    def end(self, timeout=60):
        out, error = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, error


@pytest.fixture
def started():
    """Start the command line; whatever it leaves behind is ended with the test."""
    runs = []

    def start(*arguments, **more):
        runs.append(Run(*arguments, **more))
        return runs[-1]

    yield start
    for run in runs:
        for process in [*run.seen, *([run.top] if run.process.poll() is None else [])]:
            if process.is_running():
                process.kill()
        run.process.communicate()


def assert_gone(family, seconds=5.0):
    _, alive = psutil.wait_procs(family, timeout=seconds)
    names = [(p.pid, p.status(), p.cmdline()) for p in alive]
    for process in alive:
        process.kill()
    assert not names


@pytest.mark.parametrize(
    "number",
    [signal.SIGKILL, *(pytest.param(n, marks=pytest.mark.long) for n in (signal.SIGTERM, signal.SIGHUP))],
)
def test_nothing_stays_behind_when_the_parent_is_ended(folder, started, number):
    run = started("run", "scenarios", "--jobs", "3", "--no-figures", "--out", "r")
    run.wait_for(folder / "r/a/report.json")
    family = run.family()
    assert len(family) >= 3
    os.kill(run.process.pid, number)
    code, _, error = run.end(10)
    assert_gone(family)
    if number != signal.SIGKILL:
        assert code == 130
        assert error.splitlines()[-1] == ENDED
    assert json.loads((folder / "r/a/report.json").read_text())["name"] == "a"
    kept = {".hammerstein.json"}
    if number == signal.SIGKILL:  # nobody can clear a report that is just being written; the next run does
        kept.add(".hammerstein-new")
    assert not [p for p in (folder / "r").rglob(".*") if p.name not in kept]


def test_sigterm_ends_a_single_scenario_like_ctrl_c(folder, started):
    run = started("run", "scenarios/slow1.toml", "--no-figures", "--out", "r")
    time.sleep(3.0)
    os.kill(run.process.pid, signal.SIGTERM)
    code, _, error = run.end(10)
    assert code == 130
    assert error.splitlines()[-1] == ENDED  # a busy machine may have said before how long the run takes


def test_what_nohup_ignores_stays_ignored(folder, started):
    run = started("run", "scenarios/a.toml", "--no-figures", "--out", "r", preexec_fn=ignore_hang_up)
    time.sleep(1.0)
    os.kill(run.process.pid, signal.SIGHUP)
    assert run.end()[0] == 0


def ignore_hang_up():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


def test_a_killed_worker_s_scenario_is_run_again(folder, started):
    for name in ("slow1", "slow2"):
        (folder / f"scenarios/{name}.toml").write_text(swept(60))
    run = started("run", "scenarios", "--jobs", "3", "--no-figures", "--out", "r")
    run.wait_for(folder / "r/a/report.json")
    run.family()
    seen = [p for p in run.seen if p.ppid() != run.process.pid]
    assert len(seen) == 3
    for worker in seen[1:]:
        worker.kill()
    code, out, error = run.end()
    assert (code, error) == (0, "")
    assert "4 of 4 reports" in out
    assert_gone(seen)


def ended_by(number, name, log):
    with log.open("a") as file:
        file.write(name)
    if number:
        os.kill(os.getpid(), number)
    return name


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_task_that_ends_its_process_is_tried_twice_and_does_not_stop_the_others(tmp_path, number):
    log = tmp_path / "log"
    tasks = [partial(ended_by, number if name == "c" else 0, name, log) for name in "abcdefg"]
    with Processes(2) as processes:
        futures = [processes.submit(task) for task in tasks]
    with pytest.raises(LostProcessError, match=f"was ended by {signal.Signals(number).name}, twice"):
        futures.pop(2).result()
    assert [future.result() for future in futures] == [*"abdefg"]
    assert sorted(log.read_text()) == sorted("abccdefg")


@pytest.mark.parametrize(
    ("error", "times", "told"),
    [
        (EOFError, 1, (None, None)),
        (ConnectionRefusedError, 2, (LostProcessError, None)),
        (RuntimeError, 1, (RuntimeError, None)),
    ],
)
def test_a_process_that_cannot_begin_is_tried_twice_and_nobody_waits_for_ever(
    monkeypatch, error, times, told
):
    """As where the server that begins the processes is killed while it loads the libraries."""
    left = [error()] * times

    class Worker(workers._Worker):
        def __init__(self, loads):
            if left:
                raise left.pop()
            super().__init__(loads)

    monkeypatch.setattr(workers, "_Worker", Worker)
    with Processes(1) as processes:
        futures = [processes.submit(size_of_a_result) for _ in told]
        found = [future.exception(timeout=20.0) for future in futures]
    assert tuple(error and type(error) for error in found) == told
    assert all("could not start, twice" in str(e) for e in found if isinstance(e, LostProcessError))


def test_a_signal_without_a_name_is_told_by_its_number():
    assert (signal_name(signal.SIGKILL), signal_name(1000)) == ("SIGKILL", "signal 1000")


ELSEWHERE = """
from hammerstein.runtime.parallel_tasks import Processes, begin_loading

if __name__ == "__main__":
    begin_loading()
    with Processes(1) as processes:
        print(processes.submit(abs, -3).result())
"""


@pytest.mark.parametrize("name", ["control", "hammerstein", "socket"])
def test_processes_take_no_module_from_the_working_folder(tmp_path, name):
    """As the command itself takes none: it is begun from the folder it is installed in."""
    script, here = tmp_path / "bin" / "command.py", tmp_path / "here"
    script.parent.mkdir()
    here.mkdir()
    script.write_text(ELSEWHERE)
    (here / f"{name}.py").write_text("open('loaded', 'w').close()\nraise ImportError\n")
    found = subprocess.run([sys.executable, script], cwd=here, capture_output=True, text=True, check=False)
    assert (found.stdout, found.returncode) == ("3\n", 0), found.stderr
    assert not (here / "loaded").exists()


def test_the_environment_is_what_it_was_when_the_processes_have_begun(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "somewhere")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    before = dict(os.environ)
    with _imports_from_where_this_does():
        assert os.environ["PYTHONPATH"] == os.pathsep.join(sys.path)
    assert dict(os.environ) == before


def test_threads_that_begin_processes_at_once_leave_the_environment_as_it_was(monkeypatch):
    """A notebook may have put a Path on the path, which Python passes by."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    monkeypatch.setattr("sys.path", [*sys.path, Path("notebook")])
    before, interval = dict(os.environ), sys.getswitchinterval()

    def enter_often():
        for _ in range(1000):
            with _imports_from_where_this_does():
                pass

    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(4) as threads:
            for done in [threads.submit(enter_often) for _ in range(4)]:
                done.result()
    finally:
        sys.setswitchinterval(interval)
    assert dict(os.environ) == before


def test_nothing_that_does_not_survive_a_fork_is_loaded_before_one(monkeypatch):
    """On macOS NumPy tries the system's linear algebra when it is loaded; a fork loses its threads."""
    assert "scipy.signal" in loaded_beforehand()
    monkeypatch.setattr("sys.platform", "darwin")
    assert loaded_beforehand() == []


@pytest.mark.long
def test_a_scenario_whose_process_dies_twice_is_reported_and_the_rest_goes_on(folder, started):
    (folder / "sitecustomize.py").write_text(
        "import os, signal, hammerstein.experiment.run as e\n"
        "real = e.run\n"
        "def run(scenario, name='scenario', *more):\n"
        "    if name == 'a': os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return real(scenario, name, *more)\n"
        "e.run = run\n"
    )
    for name in ("slow1", "slow2"):
        (folder / f"scenarios/{name}.toml").write_text(SMALL)
    run = started(
        *("run", "scenarios", "--jobs", "3", "--no-figures", "--out", "r"),
        env=os.environ | {"PYTHONPATH": str(folder)},
    )
    code, out, error = run.end()
    assert code == 70
    assert "a: its process was ended by SIGKILL, twice" in error
    assert "Traceback" not in error
    assert "3 of 4 reports" in out
    assert not (folder / "r/a").exists()


def fails(kind):
    raise kind("in a worker")


def test_an_error_of_a_task_comes_back_with_its_place():
    with pytest.raises(ZeroDivisionError, match="in a worker") as caught, Processes(2) as processes:
        processes.submit(fails, ZeroDivisionError).result()
    assert "in fails" in "".join(caught.value.__notes__)


def size_of_a_result():
    return b"x" * 5_000_000


def test_large_results_come_back_from_more_tasks_than_processes():
    with Processes(3) as processes:
        found = list(in_order([size_of_a_result] * 9, processes))
    assert [len(data) for data in found] == [5_000_000] * 9


def test_leaving_early_ends_the_workers():
    before = psutil.Process().children(recursive=True)
    processes = Processes(2)
    assert processes.submit(time.sleep, 0.0).result() is None
    long = processes.submit(time.sleep, 60.0)
    never = [processes.submit(time.sleep, 60.0) for _ in range(3)]
    time.sleep(1.0)
    with contextlib.suppress(KeyboardInterrupt), processes:
        raise KeyboardInterrupt
    assert all(future.cancelled() for future in never[1:])
    assert isinstance(long.exception(), LostProcessError)
    after = [p for p in psutil.Process().children(recursive=True) if p not in before]
    assert_gone([p for p in after if "resource_tracker" not in "".join(p.cmdline())][1:], 2.0)


def slow_number():
    time.sleep(0.05)
    return os.getpid()


def test_this_process_is_a_worker_beside_the_others_and_begins_before_them():
    with ProcessesAndThis(2) as processes:
        futures = [processes.submit(slow_number) for _ in range(100)]
        pids = [future.result() for future in futures]
    assert pids[0] == os.getpid()
    assert len(set(pids)) == 2


def test_nobody_waits_for_the_worker_that_is_this_process():
    start = time.monotonic()
    with contextlib.suppress(KeyboardInterrupt), ProcessesAndThis(1) as processes:
        processes.submit(time.sleep, 30.0)
        raise KeyboardInterrupt
    assert time.monotonic() - start < 20.0


def test_a_task_that_cannot_be_sent_is_told_and_the_next_is_done():
    with Processes(1) as processes:
        bad, good = processes.submit(lambda: 1), processes.submit(size_of_a_result)
    assert isinstance(bad.exception(), (AttributeError, pickle.PicklingError))
    assert len(good.result()) == 5_000_000

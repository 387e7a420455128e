"""Ctrl-C is answered in time while a compiled loop runs for minutes."""

import builtins
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

import hammerstein
from hammerstein.arrays import spans
from hammerstein.dynamics import discretise
from hammerstein.runtime import signals

pytestmark = pytest.mark.full

SLOW = """
question = "?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[[compensators]]
label = "a"
law = "inverse_multiplicative"
iterations = 10000000
model = "duo_bimorph"
"""


T = 50e-6
LAWS = {
    "inverse_multiplicative": hammerstein.InverseMultiplicative(iterations=2),
    "decoupled_inverse": hammerstein.DecoupledInverse(),
    "exact_inverse": hammerstein.ExactInverse(),
    "hammerstein_inverse": hammerstein.HammersteinInverse(filter_hz=2000.0),
}


def _wave(samples):
    time_s = T * np.arange(samples)
    return 8.0 * np.stack([np.sin(300.0 * time_s), np.cos(500.0 * time_s) * np.sin(40.0 * time_s)])


def _all_numbers(model, path):
    """What every long compiled loop gives for a signal."""
    found = {
        "hysteresis": model.hysteresis.respond(path)[0],
        "play": hammerstein.play(path[0], [0.0, 0.7, 2.0]),
    }
    found["linear"] = discretise(model.dynamics, T).respond(path)[0]
    for name, law in LAWS.items():
        found[name] = law.design(model, range_v=10.0, sample_time_s=T).drive_for(path)
    scenario = {
        "question": "?",
        "reference": {"kind": "circle", "radius_um": 10.0, "frequency_hz": 50.0},
        "compensators": [{"label": "a", "law": "feedback", "model": "duo_bimorph"}],
    }
    found["feedback"] = hammerstein.simulate(scenario).position_um
    return found


def test_a_signal_in_parts_gives_the_same_bits(monkeypatch):
    """Between the parts Ctrl-C is answered; nobody may see them in the numbers."""
    model, path = hammerstein.HammersteinModel.load("duo_bimorph"), _wave(5000)
    whole = _all_numbers(model, path)
    monkeypatch.setattr("hammerstein.arrays.SPAN", 32 * 700)
    assert list(spans(1500)) == [(0, 700), (700, 1400), (1400, 1500)]
    assert list(spans(400, 64 * 700)) == [(k, k + 1) for k in range(400)]
    parts = _all_numbers(model, path)
    for name, values in whole.items():
        np.testing.assert_array_equal(parts[name], values, err_msg=name)


def test_a_voltage_that_is_not_finite_is_found_in_a_later_part(monkeypatch):
    monkeypatch.setattr("hammerstein.arrays.SPAN", 32 * 700)
    path = _wave(5000)
    path[1, 3456] = np.nan
    with pytest.raises(hammerstein.SimulationError, match="input 2 is not finite at sample 3456"):
        hammerstein.HammersteinModel.load("duo_bimorph").hysteresis.respond(path)


@pytest.mark.skipif(os.name == "nt", reason="no process can send itself Ctrl-C alone")
def test_python_answers_ctrl_c_within_a_compiled_loop():
    model = hammerstein.HammersteinModel.load("duo_bimorph")
    law = hammerstein.InverseMultiplicative(iterations=2000).design(model, range_v=10.0, sample_time_s=T)
    law.respond(_wave(10))  # compiled
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the command line has its own
    try:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        begun = time.process_time()
        with pytest.raises(KeyboardInterrupt):
            law.respond(_wave(200_000))  # half a minute
    finally:
        signal.signal(signal.SIGINT, before)
    assert time.process_time() - begun < 3.0


SWALLOWED = """
import signal, sys, time
import hammerstein.experiment.run as batch

class Last:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def run(*_):
    Last()
    time.sleep(60.0)

batch.run = run
sys.argv = ["hammerstein", "run", "slow.toml", "--no-figures", "--yes"]
from hammerstein.__main__ import main
main()
"""


def test_ctrl_c_in_a_destructor_is_answered_like_any_other(tmp_path):
    """Python drops what is raised in a destructor or a callback, of which imports have many, and tells it."""
    (tmp_path / "slow.toml").write_text(SLOW)
    options = {"capture_output": True, "text": True, "cwd": tmp_path, "timeout": 60, "check": False}
    run = subprocess.run([sys.executable, "-c", SWALLOWED], **options)
    told = [line for line in run.stderr.splitlines() if not line.startswith("this takes about")]
    assert (run.returncode, told) == (
        130,
        ["interrupted; finished files are kept, and nothing is half-written"],
    )


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("jobs", "files", "busy_s"),
    [("1", 1, 4.0), ("2", 1, 4.0), pytest.param("2", 2, 14.0, marks=pytest.mark.long)],
)
def test_a_compiled_loop_ends_in_time(tmp_path, jobs, files, busy_s):
    for k in range(files):
        (tmp_path / f"slow{k}.toml").write_text(SLOW)
    command = [sys.executable, "-m", "hammerstein", "run", str(tmp_path), "--jobs", jobs, "--out", "r"]
    options = {"stderr": subprocess.PIPE, "text": True, "start_new_session": True, "cwd": tmp_path}
    with subprocess.Popen(command, **options) as process:
        assert process.stderr.readline().startswith("this takes about")
        _wait_until_busy(process, busy_s)
        start = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        crowd = []
        while process.poll() is None and time.monotonic() < start + 60.0:
            crowd.append(_crowd())
            time.sleep(0.02)
        taken = time.monotonic() - start
        _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error.count("interrupted") == 1
    assert "Traceback" not in error
    assert taken < 2.0 * max(1.0, sum(crowd) / len(crowd))


def _wait_until_busy(process, seconds):
    """Wait until a run has had so much of the processor that everything is loaded and its loop runs."""
    top, until = psutil.Process(process.pid), time.monotonic() + 120.0
    while process.poll() is None and time.monotonic() < until:
        times = [p.cpu_times() for p in [top, *top.children(recursive=True)]]
        if sum(t.user + t.system for t in times) > seconds:
            break
        time.sleep(0.1)
    assert process.poll() is None


def _crowd():
    """How many want each processor: now where the system tells it, in the last minute elsewhere."""
    try:
        running = int(Path("/proc/loadavg").read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        running = os.getloadavg()[0]
    return running / (os.cpu_count() or 1)


def test_who_waits_for_a_signal_imports_nothing(monkeypatch):
    """Two threads that import at once may wait for each other for ever."""
    asked, left, real = [], [], builtins.__import__

    def noted(name, *rest, **more):
        asked.append((threading.current_thread().name, name))
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", noted)
    monkeypatch.setattr(os, "write", lambda _, text: left.append(text))
    monkeypatch.setattr(os, "_exit", left.append)
    reader, writer = socket.socketpair()
    with reader, writer:
        waits = threading.Thread(target=signals._wait, args=(reader, writer, [signal.SIGINT]), name="waits")
        waits.start()
        writer.send(bytes([signal.SIGCHLD, signal.SIGINT]))
        waits.join(10.0)
    assert left[0].endswith(signals.TOLD)
    assert left[1:] == [signals.INTERRUPTED]
    assert [name for thread, name in asked if thread == "waits"] == []


def test_the_end_waits_for_what_must_not_be_left_in_the_middle(tmp_path):
    code = """
import os, signal, sys, time
from hammerstein.runtime import signals
signals.end_when_asked()
with signals.uninterrupted:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.5)
    open(sys.argv[1], "w").write("whole")
time.sleep(60.0)
"""
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "file"], timeout=30, check=False)
    assert done.returncode == signals.INTERRUPTED
    assert (tmp_path / "file").read_text() == "whole"


WORKER_WRITES = """
import sys, time
from pathlib import Path
from hammerstein.files import register_cleanup
from hammerstein.runtime.signals import end_when_asked
from hammerstein.runtime.parallel_tasks import Processes

def half_written(place):
    register_cleanup(place, place.unlink)
    place.write_text("half")
    time.sleep(60.0)

if __name__ == "__main__":
    end_when_asked()
    with Processes(1, ["hammerstein.files"]) as processes:
        processes.submit(half_written, Path(sys.argv[1])).result()
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupt_leaves_no_file_that_a_worker_has_half_written(tmp_path):
    script, place = tmp_path / "script.py", tmp_path / "half"
    script.write_text(WORKER_WRITES)
    with subprocess.Popen([sys.executable, script, place], start_new_session=True) as process:
        until = time.monotonic() + 60.0
        while not place.exists() and time.monotonic() < until:
            time.sleep(0.02)
        time.sleep(0.2)
        workers = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(10.0) == signals.INTERRUPTED
    assert not psutil.wait_procs(workers, timeout=5.0)[1]
    assert not place.exists()


LAPACK = """
import numpy as np
from hammerstein.runtime.signals import end_when_asked
end_when_asked()
a = np.random.default_rng(0).normal(size=(6000, 6000))
print("begun", flush=True)
np.linalg.svd(a)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupt_within_lapack_is_answered_at_once():
    with subprocess.Popen([sys.executable, "-c", LAPACK], stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert process.wait(10.0) == signals.INTERRUPTED


@pytest.mark.skipif(sys.platform != "linux", reason="no other system enforces a limit on addresses")
def test_a_limit_below_what_the_libraries_need_is_told_before_they_load(tmp_path):
    """Under 500 MB OpenBLAS spins in its loader, deaf to SIGTERM."""
    import resource

    def limited():
        resource.setrlimit(resource.RLIMIT_AS, (500_000_000, 500_000_000))

    command = [
        sys.executable,
        "-X",
        "importtime",
        "-m",
        "hammerstein",
        "compensate",
        "duo_bimorph",
        "path.csv",
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, preexec_fn=limited, timeout=60
    )
    assert done.returncode == 3
    assert "memory is limited to 500 MB (ulimit -v)" in done.stderr
    assert " numpy" not in done.stderr
    assert "Traceback" not in done.stderr

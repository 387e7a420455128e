"""Ctrl-C is answered in time while a compiled loop runs for minutes."""

import os
import signal
import subprocess
import sys
import time

import pytest

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


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(("jobs", "files", "wait_s"), [("1", 1, 4.0), ("2", 1, 4.0), ("2", 2, 12.0)])
def test_a_compiled_loop_ends_in_time(tmp_path, jobs, files, wait_s):
    for k in range(files):
        (tmp_path / f"slow{k}.toml").write_text(SLOW)
    command = [sys.executable, "-m", "hammerstein", "run", str(tmp_path), "--jobs", jobs, "--out", "r"]
    options = {"stderr": subprocess.PIPE, "text": True, "start_new_session": True, "cwd": tmp_path}
    with subprocess.Popen(command, **options) as process:
        assert process.stderr.readline().startswith("this takes about")
        time.sleep(wait_s)  # the loop runs
        assert process.poll() is None
        start = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=60)
    taken = time.monotonic() - start
    assert process.returncode == 130
    assert error.count("interrupted") == 1
    assert "Traceback" not in error
    assert taken < 2.0 * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))

"""An exchange of files that is stopped anywhere is finished or undone by the next one."""

import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import pytest

from hammerstein.errors import InputError
from hammerstein.runtime import staging
from hammerstein.runtime.staging import MANIFEST, ROOM, Owner, prepare, staged

OWNER = Owner("report")
STEPS = 12  # at least; the rest is how the system's own library removes a folder
FORKS = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
OLD = {"a.txt": "old a", "b.txt": "old b", "traces/c.txt": "old c"}
NEW = {"a.txt": "new a", "d.txt": "new d", "traces/e.txt": "new e"}


def write(folder, files):
    with staged(folder, OWNER) as stage:
        for name, text in files.items():
            stage.write(name, text)
    return stage


def read(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_text()
        for p in folder.rglob("*")
        if p.is_file() and p.name != MANIFEST
    }


def change(number, answer, monkeypatch):
    """Let the n-th step that changes a name be answered differently; give the count of steps."""
    count = [0]
    for name in ("replace", "rename", "unlink", "rmdir"):
        real = getattr(os, name)

        def step(*arguments, _real=real, **more):
            count[0] += 1
            return answer() if count[0] == number else _real(*arguments, **more)

        monkeypatch.setattr(os, name, step)
    return count


def write_and_die(folder, files, number, monkeypatch):
    """Write in a process that is killed at the n-th step; tell whether it came so far."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # other threads of the tests are of no concern to the child
        child = os.fork()
    if child == 0:
        change(number, lambda: os.kill(os.getpid(), signal.SIGKILL), monkeypatch)
        write(folder, files)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


def refused():
    raise PermissionError(13, "Permission denied")


def test_old_files_go_new_ones_come_and_others_stay(tmp_path):
    folder = tmp_path / "r"
    write(folder, OLD)
    (folder / "mine.txt").write_text("mine")
    (folder / "traces" / "mine.txt").write_text("mine")
    stage = write(folder, NEW)
    assert read(folder) == NEW | {"mine.txt": "mine", "traces/mine.txt": "mine"}
    assert stage.names == ["a.txt", "d.txt", "traces/e.txt"]
    assert not (folder / ROOM).exists()


@FORKS
@pytest.mark.parametrize("number", range(1, 25))
def test_a_kill_at_any_step_is_mended_by_the_next_run(tmp_path, monkeypatch, number):
    folder = tmp_path / "r"
    write(folder, OLD)
    (folder / "mine.txt").write_text("mine")
    reached = write_and_die(folder, NEW, number, monkeypatch)
    assert reached or number > STEPS
    prepare(folder, OWNER, [])
    assert read(folder) in (OLD | {"mine.txt": "mine"}, NEW | {"mine.txt": "mine"})
    assert not (folder / ROOM).exists()
    write(folder, NEW)
    assert read(folder) == NEW | {"mine.txt": "mine"}


@pytest.mark.parametrize("number", range(1, 12))
def test_an_error_at_any_step_leaves_the_old_files_or_the_new(tmp_path, monkeypatch, number):
    folder = tmp_path / "r"
    write(folder, OLD)
    with monkeypatch.context() as patch:
        change(number, refused, patch)
        failed = ""
        try:
            write(folder, NEW)
        except InputError as error:
            failed = str(error)
    assert not failed or "permission denied" in failed
    assert read(folder) == (OLD if failed else NEW)


@FORKS
def test_an_interrupted_exchange_whose_new_files_are_spoilt_is_undone(tmp_path, monkeypatch):
    folder = tmp_path / "r"
    write(folder, OLD)
    assert write_and_die(folder, NEW, 5, monkeypatch)
    (folder / ROOM / "new" / "d.txt").write_text("spoilt by the fault")
    prepare(folder, OWNER, [])
    assert read(folder) == OLD


@FORKS
def test_what_came_between_a_kill_and_the_next_run_is_kept(tmp_path, monkeypatch):
    folder = tmp_path / "r"
    write(folder, OLD)
    assert write_and_die(folder, NEW, 5, monkeypatch)
    (folder / "d.txt").write_text("mine")
    prepare(folder, OWNER, [])
    assert read(folder) == NEW | {"d.txt.edited": "mine"}


def test_two_writers_take_turns(tmp_path):
    folder = tmp_path / "r"
    threads = [
        threading.Thread(target=write, args=(folder, {"a.txt": str(n), f"{n}.txt": ""})) for n in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    texts = read(folder)
    assert texts.keys() == {"a.txt", f"{texts['a.txt']}.txt"}
    assert not (folder / ROOM).exists()


def test_a_writer_that_hangs_is_told_and_one_that_died_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(staging, "PATIENCE_S", 0.3)
    folder = tmp_path / "r"
    code = """
import sys, time
from hammerstein.runtime.staging import Owner
from hammerstein.runtime.staging import staged
from pathlib import Path
with staged(Path(sys.argv[1]), Owner("x")) as stage:
    stage.write("half.txt", "half")
    print("ready", flush=True)
    time.sleep(60)
"""
    with subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        with pytest.raises(InputError, match="another run is writing there"):
            write(folder, NEW)
        other.kill()
        other.wait()
    monkeypatch.setattr(staging, "PATIENCE_S", 60.0)
    begun = time.monotonic()
    write(folder, NEW)
    assert time.monotonic() - begun < 30.0
    assert read(folder) == NEW

import os
import subprocess
import sys
from importlib import metadata

import pytest

from hammerstein.errors import Notice
from hammerstein.runtime import cache


def kept(function, *arguments):
    """What a caller does: nothing twice."""
    found = cache.known(function, *arguments)
    if found is None:
        found = function(*arguments)
        cache.keep(found, function, *arguments)
    return found


def test_a_result_is_kept_and_counts_for_its_arguments_only(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    calls = []

    def work(text, number):
        calls.append((text, number))
        return f"{text} {number}"

    assert [kept(work, "a", 1) for _ in range(3)] == ["a 1"] * 3
    assert kept(work, "a", 2) == "a 2"
    assert calls == [("a", 1), ("a", 2)]


def test_a_command_that_passes_by_what_was_kept_knows_what_it_has_worked_out_itself(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    cache.keep("before", str, "a")
    assert cache.known(str, "a", fresh="first") is None
    cache.keep("anew", str, "a", fresh="first")
    assert cache.known(str, "a", fresh="first") == "anew"
    assert cache.known(str, "a", fresh="second") is None
    assert cache.known(str, "a") == "anew"
    for number in range(2 * cache.MOST_MADE):
        cache.keep("x", str, number, fresh="first")
    assert cache.known(str, "a", fresh="first") is None


@pytest.mark.parametrize("what", ["numpy", "numba", "python"])
def test_a_result_of_other_versions_does_not_count(tmp_path, monkeypatch, what):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    calls = []

    def work(text):
        calls.append(text)
        return text

    kept(work, "a")
    if what == "python":
        monkeypatch.setattr(sys, "version", "3.99.0")
    else:
        real = metadata.version
        monkeypatch.setattr(metadata, "version", lambda name: "99" if name == what else real(name))
    cache._code.cache_clear()
    kept(work, "a")
    assert calls == ["a", "a"]
    monkeypatch.undo()
    cache._code.cache_clear()


def test_it_can_be_switched_off(monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    calls = []
    for _ in range(2):
        kept(lambda: calls.append(1) or "x")
    assert len(calls) == 2


def test_a_folder_that_cannot_be_written_is_no_mistake(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "file"))
    assert kept(lambda: "x") == "x"


def spoilt(path, how):
    """Spoil a file as faults do."""
    data = path.read_bytes()
    if how == "truncated":
        path.write_bytes(data[: len(data) // 2])
    elif how == "emptied":
        path.write_bytes(b"")
    elif how == "flipped":
        path.write_bytes(data[:-3] + bytes([data[-3] ^ 1]) + data[-2:])
    elif how == "pipe":
        path.unlink()
        os.mkfifo(path)
    else:
        path.unlink()
        path.mkdir()


FAULTS = ["truncated", "emptied", "flipped", "folder"]
PIPE = pytest.param(
    "pipe", marks=pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes")
)


@pytest.mark.parametrize("how", [*FAULTS, PIPE])
def test_a_spoilt_result_is_told_and_worked_out_again(tmp_path, monkeypatch, how):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path))
    assert kept(lambda text: text * 3, "abc") == "abcabcabc"
    (path,) = tmp_path.iterdir()
    spoilt(path, how)
    with pytest.warns(Notice, match="again") as told:
        assert kept(lambda text: text * 3, "abc") == "abcabcabc"
    assert str(path) in str(told[0].message)
    if how not in ("folder", "pipe"):
        assert kept(lambda text: "not asked", "abc") == "abcabcabc"


LOOP = """
import os
from hammerstein.compiled import compiled

@compiled()
def double(x):
    return 2.0 * x

if __name__ == "__main__":
    import pathlib, sys, time
    from hammerstein.runtime.notices import tell_notices
    tell_notices()
    for place in sys.argv[1:2]:
        pathlib.Path(place).touch()
    while not all(map(os.path.exists, sys.argv[2:])):
        time.sleep(0.001)
    print(double(21.0), sum(double.stats.cache_hits.values()))
"""


@pytest.fixture
def loop(tmp_path):
    """Run a compiled loop in a process of its own: what it prints, and what it says."""
    (tmp_path / "loop.py").write_text(LOOP)

    own = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}

    def run(**environment):
        command = [sys.executable, str(tmp_path / "loop.py")]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env=own | environment, timeout=100
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split(), done.stderr

    return run


@pytest.mark.parametrize("kind", ["nbc", pytest.param("nbi", marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "how", ["flipped", *(pytest.param(h, marks=pytest.mark.long) for h in FAULTS if h != "flipped")]
)
def test_a_spoilt_compiled_loop_is_told_and_compiled_again(loop, tmp_path, kind, how):
    assert loop() == (["42.0", "0"], "")
    assert loop() == (["42.0", "1"], "")
    (path,) = (tmp_path / "__pycache__").glob(f"*.{kind}")
    spoilt(path, how)
    out, error = loop()
    assert out == ["42.0", "0"]
    assert error.count("\n") == (2 if how == "folder" else 1)  # what is there cannot be replaced
    assert str(tmp_path / "__pycache__") in error
    if how != "folder":
        assert loop() == (["42.0", "1"], "")


def test_of_processes_that_need_a_loop_one_compiles_it(tmp_path):
    (tmp_path / "loop.py").write_text(LOOP)
    ready = [str(tmp_path / name) for name in "abc"]
    begun = [
        subprocess.Popen(
            [sys.executable, str(tmp_path / "loop.py"), own, *ready], stdout=subprocess.PIPE, text=True
        )
        for own in ready
    ]
    assert sorted(process.communicate(timeout=100)[0] for process in begun) == ["42.0 0\n", *2 * ["42.0 1\n"]]


def test_a_halted_process_that_compiles_stops_no_other(loop, tmp_path):
    fcntl = pytest.importorskip("fcntl")
    assert loop()[0] == ["42.0", "0"]
    (path,) = (tmp_path / "__pycache__").glob("*.lock")
    with path.open("r+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        # on one line, for the names of the files hold the number of that of the loop
        hurried = "import os, hammerstein.compiled; hammerstein.compiled.LONGEST_WAIT_S = 0.1"
        (tmp_path / "loop.py").write_text(LOOP.replace("import os", hurried, 1))
        assert loop() == (["42.0", "0"], "")


def test_where_nothing_can_be_written_loops_are_compiled_each_time(loop, tmp_path):
    (tmp_path / "__pycache__").write_text("no folder")
    out, error = loop(HOME="/dev/null", XDG_CACHE_HOME="/dev/null/x", NUMBA_CACHE_DIR="")
    assert out == ["42.0", "0"]
    assert error.count("\n") == 1
    assert "NUMBA_CACHE_DIR" in error


def test_a_disk_that_is_full_keeps_no_loop_and_stops_no_run(loop, tmp_path):
    (tmp_path / "loop.py").write_text(
        "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (50, resource.RLIM_INFINITY))\n" + LOOP
    )
    out, error = loop()
    assert out == ["42.0", "0"]
    assert error.count("\n") == 1
    assert "cannot be kept" in error


def test_a_user_without_a_home_has_no_kept_results(monkeypatch):
    monkeypatch.delenv("HAMMERSTEIN_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.Path, "home", homeless)
    assert cache.folder() is None


def homeless():
    raise RuntimeError("Could not determine home directory.")

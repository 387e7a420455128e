"""One change under trial: do the tests that touch it notice, and if not, do the scenarios?"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from .changes import Change
from .recording import Recording

LIBRARIES = (
    "control", "h5py", "hypothesis", "jinja2", "matplotlib.pyplot", "numba", "numpy", "pandas",
    "PIL.Image", "pydantic", "pytest", "rich.console", "scipy.linalg", "scipy.optimize", "scipy.signal",
    "typer.testing",
)  # fmt: skip
"""Loaded once, before a process forks for each change."""
PATIENCE = 4.0
"""Times as long as the tests took before: what lasts longer hangs."""
UNFINISHED = "unfinished.json"
FIRST = 2
"""Test files that are tried before all others: they end most trials."""
START_S = 60.0
"""Time of a trial beside its tests, such as that to compile loops."""


def load_libraries() -> None:
    """Load what every trial needs, but not the package itself."""
    import importlib

    for name in LIBRARIES:
        importlib.import_module(name)


def outcome(
    kept: Path, recording: Recording, change: Change, most_s: tuple[float, float], killers: dict[str, str]
) -> str:
    """What notices a change: ``tests``, ``check``, ``time`` (it hangs), or nothing: ``survived``.

    Parameters
    ----------
    kept : folder that holds the recording and the tree it was made in
    most_s : most time of tests, and of scenarios [s]
    killers : the test file that last noticed a change, by changed file; brought up to date
    """
    touching = recording.tests_of(kept / "tree", change.path, change.line)
    seconds = recording.seconds
    scenarios = [name for name in touching if name.split("::")[0].endswith(".toml")]
    tests_s, check_s = most_s
    scenarios.sort(key=lambda name: (seconds[name], name))  # the first that fails ends it
    spent = itertools.accumulate(seconds[name] for name in scenarios)
    scenarios = [name for name, so_far in zip(scenarios, spent, strict=True) if so_far <= check_s]
    tests = {name: focus for name, focus in touching.items() if not name.split("::")[0].endswith(".toml")}
    files = _chosen(tests, seconds, tests_s, killers.get(change.path))
    groups = [("tests", files[:FIRST]), ("tests", files[FIRST:]), ("check", [scenarios])]
    with _changed(kept, change) as loops:
        for kind, group in groups:
            names = [name for own in group for name in own]
            if not names:
                continue
            limit = START_S + PATIENCE * sum(seconds[name] for name in names)
            code = _forked(kept / "tree", names, limit, loops)
            if code != 0:
                killers[change.path] = names[0].split("::")[0]
                return "time" if code is None else kind
    return "survived" if touching else "untouched"


def _chosen(
    focus: dict[str, float], seconds: dict[str, float], most_s: float, killer: str | None
) -> list[list[str]]:
    """Tests file by file: the file that noticed the last change of a module, then those most about it."""
    files: dict[str, list[str]] = {}
    for name in sorted(focus, key=lambda n: (-focus[n], n)):
        files.setdefault(name.split("::")[0], []).append(name)
    chosen, spent = [], 0.0
    for file in sorted(files, key=lambda f: f != killer):  # the rest stays in its order
        own = []
        for name in files[file]:
            if spent + seconds[name] <= most_s:
                own.append(name)
                spent += seconds[name]
        chosen += [own] if own else []
    return chosen


def restore(kept: Path) -> None:
    """Take out a change that a run which was ended from outside has left in the tree."""
    unfinished = kept / UNFINISHED
    if unfinished.exists():
        left = json.loads(unfinished.read_text())
        (kept / "tree" / left["path"]).write_text(left["source"])
        unfinished.unlink()


@contextlib.contextmanager
def _changed(kept: Path, change: Change) -> Iterator[str | None]:
    """Put a change into the tree and take it out again; gives a fresh folder for loops, where some change."""
    path = kept / "tree" / change.path
    source, times = path.read_text(), path.stat()
    (kept / UNFINISHED).write_text(json.dumps({"path": change.path, "source": source}))
    try:
        path.write_text(change.applied(source))
        now = time.time()
        os.utime(path, (now, now + 1.0))  # no compiled file is as old
        if "@compiled" not in source:
            yield None
            return
        with tempfile.TemporaryDirectory() as folder:
            yield folder
    finally:
        restore(kept)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def _forked(tree: Path, names: Sequence[str], limit_s: float, loops: str | None) -> int | None:
    """Exit code of pytest in a process of its own; None if it took too long."""
    child = os.fork()
    if child == 0:
        code = 70
        try:
            os.setsid()
            code = _pytest(tree, names, loops)
        finally:
            os._exit(code)
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            _end(child)
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    _end(child)
    os.waitpid(child, 0)
    return None


def _end(group: int) -> None:
    """End what a trial has left behind."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _pytest(tree: Path, names: Sequence[str], loops: str | None) -> int:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    sys.dont_write_bytecode = True
    os.environ |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    if loops is not None:
        import numba

        os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = loops
    import pytest

    with tempfile.TemporaryDirectory() as cache:
        os.environ["HAMMERSTEIN_CACHE"] = cache
        options = ["-n0", "-x", "-q", "-p", "no:cacheprovider", "--tb=no", f"--basetemp={cache}/t"]
        options += ["--full"] * any(name.startswith("tests/") for name in names)  # who else does not know it
        return int(pytest.main([*options, *names]))

"""Which tests touch which line: recorded once, by running all of them under coverage."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
ALL = ("tests", "hammerstein", "scenarios")
BESIDE = (
    "commands", "faults", "fuzz", "house", "mutation", "reporting", "runtime",
    "export/test_export_targets.py", "export/test_fmu.py", "export/test_strangers.py",
    "hysteresis/test_parallel.py", "records/test_damaged_files.py", "regression/test_pytest_plugin.py",
)  # fmt: skip
"""Tests of files, pages, processes and terminals, half of the time of all: they reach numbers on their way to
something else, so that they are not recorded unless they are named."""
SETUP = "|setup"
"""At the end of a context: what a fixture does for the first of its tests, it does for all of its file."""


def copied(tree: Path, patterns: Sequence[str] = ()) -> None:
    """Copy the files of the project, with their times, to a tree that may be spoilt."""
    wanted = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *patterns]
    listed = subprocess.run(wanted, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)


class Recorder:
    """A plugin of pytest that tells coverage which test runs, and notes how long those that passed took."""

    def __init__(self, coverage: Any):
        self.coverage = coverage
        self.seconds: dict[str, float] = defaultdict(float)
        self.failed: set[str] = set()

    def pytest_runtest_setup(self, item: Any) -> None:
        """Begin a test."""
        self.coverage.switch_context(item.nodeid + SETUP)

    def pytest_runtest_call(self, item: Any) -> None:
        """Begin its own part."""
        self.coverage.switch_context(item.nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Note what came of a part."""
        self.seconds[report.nodeid] += report.duration
        if not report.passed:
            self.failed.add(report.nodeid)


def asked_of_pytest(paths: Sequence[str]) -> list[str]:
    """Paths that are recorded: those that are named, or all but those beside the numbers."""
    return [*paths] if paths else [*ALL, *(f"--ignore=tests/{name}" for name in BESIDE)]


def record(kept: Path, paths: Sequence[str]) -> int:
    """Run tests of the tree in ``kept`` under coverage and write what they touch; in a process of its own.

    paths : of tests; all but those beside the numbers where none is given
    """
    import os

    import coverage
    import pytest

    tree = kept / "tree"
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    begun = time.monotonic()
    watch = coverage.Coverage(source=["hammerstein"], data_file=None, config_file=False)
    recorder = Recorder(watch)
    watch.start()
    pytest.main(
        ["-n0", "-q", "--full", "-p", "no:cacheprovider", "--tb=short", *asked_of_pytest(paths)],
        plugins=[recorder],
    )
    watch.stop()
    touched = _touched(watch.get_data(), tree, recorder.failed)
    seconds = {name: s for name, s in recorder.seconds.items() if name not in recorder.failed}
    Recording.read(kept).joined(touched, seconds).write(kept)
    print(f"{len(seconds)} tests recorded in {time.monotonic() - begun:.0f} s")
    print("\n".join(f"left out, as it did not pass: {name}" for name in sorted(recorder.failed)))
    return len(seconds)


def _touched(data: Any, tree: Path, failed: set[str]) -> dict[str, dict[str, list[int]]]:
    """Lines of each file by the tests that touch them."""
    found: dict[str, dict[str, list[int]]] = {}
    for path in data.measured_files():
        lines: dict[str, list[int]] = defaultdict(list)
        for line, contexts in data.contexts_by_lineno(path).items():
            for context in contexts:
                if context and context.removesuffix(SETUP) not in failed:
                    lines[context].append(line)
        found[Path(path).relative_to(tree).as_posix()] = lines
    return found


class Recording:
    """Lines that tests touch, file by file, and the time that each test takes."""

    def __init__(self, touched: dict[str, dict[str, list[int]]], seconds: dict[str, float]):
        self.touched, self.seconds = touched, seconds
        self._sizes: dict[str, int] = {}

    @classmethod
    def read(cls, kept: Path) -> Recording:
        """What was written; nothing where nothing was."""
        path = kept / "recording.json"
        return cls(**json.loads(path.read_text())) if path.exists() else cls({}, {})

    def write(self, kept: Path) -> None:
        """Keep it."""
        text = json.dumps({"touched": self.touched, "seconds": self.seconds})
        (kept / "recording.json").write_text(text)

    def joined(self, touched: dict[str, dict[str, list[int]]], seconds: dict[str, float]) -> Recording:
        """Put other tests beside these, or in their place."""
        both = {path: dict(lines) for path, lines in self.touched.items()}
        for path, lines in touched.items():
            both.setdefault(path, {}).update(lines)
        return Recording(both, self.seconds | seconds)

    def tests_of(self, tree: Path, path: str, line: int) -> dict[str, float]:
        """Tests and scenarios that touch a line, and how much of what each touches is the file's.

        What a function begins with, such as a default, is touched by whoever runs it; a line that runs at
        import by whoever touches a line that names what it makes; a compiled loop, which coverage does not
        see into, by whoever calls it.
        """
        found = {name for row in _run_with(tree / path, line) for name in self._direct(path, row)}
        about = {path}
        if not found or _is_compiled(tree / path, line):  # whose lines only tests without compiling touch
            places = [
                (file, row)
                for name in _made_by(tree / path, line)
                for file, row in _named_at(tree, name, path)
                if _within_function(tree / file, row)
            ]
            found |= {name for place in places for name in self._direct(*place)}
            about |= {file for file, _ in places}
        found = found or {name for context in self.touched.get(path, ()) for name in self._of(context)}
        return {name: self._focus(name, about) for name in found}

    def _focus(self, name: str, about: set[str]) -> float:
        """Part that files have of all lines that a test touches."""
        if not self._sizes:
            for lines in self.touched.values():
                for context, own in lines.items():
                    self._sizes[context] = self._sizes.get(context, 0) + len(own)
        own = sum(len(self.touched.get(file, {}).get(name, ())) for file in about)
        return own / max(self._sizes.get(name, 0), 1)

    def _direct(self, path: str, line: int) -> set[str]:
        lines = self.touched.get(path, {})
        return {name for context, own in lines.items() if line in own for name in self._of(context)}

    def _of(self, context: str) -> Iterable[str]:
        if not context.endswith(SETUP):
            return [context]
        file = context.split("::")[0]
        return [name for name in self.seconds if name.split("::")[0] == file]


def _within_function(path: Path, line: int) -> bool:
    """Whether a line runs when a function does, not when its module is loaded, by whichever test that is."""
    import ast

    bodies = (n.body for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef))
    return any(body[0].lineno <= line <= (body[-1].end_lineno or 0) for body in bodies)


def _decorated(node: Any) -> bool:
    """Whether a function is machine code when it runs, by itself or within another one."""
    import ast

    words = [ast.dump(one) for one in node.decorator_list]
    return any("compiled" in word or "helper" in word for word in words)


def _is_compiled(path: Path, line: int) -> bool:
    """Whether a line is of such a function."""
    import ast

    functions = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]
    return any(_decorated(n) and n.lineno <= line <= (n.end_lineno or 0) for n in functions)


def _run_with(path: Path, line: int) -> Iterable[int]:
    """Lines of a function that run when a line of it counts: all of them for one of its signature."""
    import ast

    functions = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)]
    for node in functions:
        if node.lineno <= line < node.body[0].lineno:
            return range(node.body[0].lineno, (node.end_lineno or 0) + 1)
    return [line] if _within_function(path, line) else []


def _made_by(path: Path, line: int) -> list[str]:
    """Names that a line of a module gives a value to, or the loops that use the function around it."""
    import ast

    for node in ast.parse(path.read_text()).body:
        if not node.lineno <= line <= (node.end_lineno or 0):
            continue
        if isinstance(node, ast.FunctionDef):
            return [node.name]
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            return [name.id for t in targets for name in ast.walk(t) if isinstance(name, ast.Name)]
    return []


def _named_at(
    tree: Path, name: str, owner: str, seen: frozenset[str] = frozenset()
) -> Iterator[tuple[str, int]]:
    """Places of the package that name something of a file; compiled loops give those that name them.

    A private name is named in its own file alone.
    """
    import ast

    if name in seen:
        return
    word = re.compile(rf"\b{re.escape(name)}\b")
    files = [tree / owner] if name.startswith("_") else sorted((tree / "hammerstein").rglob("*.py"))
    for file in files:
        text = file.read_text()
        if not word.search(text):
            continue
        path = file.relative_to(tree).as_posix()
        compiled = [
            node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef) and _decorated(node)
        ]
        for number, row in enumerate(text.split("\n"), start=1):
            if not word.search(row):
                continue
            loops = [node.name for node in compiled if node.lineno <= number <= (node.end_lineno or 0)]
            for loop in loops:
                yield from _named_at(tree, loop, path, seen | {name})
            if not loops:
                yield path, number

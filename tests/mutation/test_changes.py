"""Changes are what they are said to be, and those that once went unnoticed can still be made."""

import ast
import shutil

import pytest

from .__main__ import known, sample
from .changes import changes_of, in_source
from .recording import BESIDE, ROOT, Recording, asked_of_pytest


@pytest.mark.parametrize(
    ("line", "changed"),
    [
        ("y = 2 * a", {"y = 4 * a", "y = 2 / a"}),
        ("y = a < b", {"y = a <= b"}),
        ("y = f(a, b)", {"y = f(b, a)"}),
        ("y = max(a, b)", {"y = min(a, b)"}),  # whose arguments may change places
        ("y -= a[0]", {"y += a[0]", "y -= a[1]"}),
        ("y = -a", {"y = a"}),
        ("y = not (a)", {"y = (a)"}),
        ('raise Mistake("1 + 1")', set()),
        ("y: Annotated[int, 3] = 1", {"y: Annotated[int, 3] = 2"}),
    ],
)
def test_a_line_is_changed_in_every_way(line, changed):
    assert {change.applied(line) for change in in_source("a.py", line)} == changed


def test_the_sign_of_what_is_returned():
    source = "def f(a: int = 3):\n    '''Twice 1.'''\n    return a"
    assert {change.applied(source).split("\n")[-1] for change in in_source("a.py", source)} == {
        "    return -(a)",
        "    return a",  # the default
    }


@pytest.mark.full
def test_every_change_leaves_a_program():
    changes = changes_of(ROOT)
    assert len(changes) > 5000
    for change in changes[::97]:
        source = (ROOT / change.path).read_text()
        assert change.applied(source) != source
        ast.parse(change.applied(source))


def test_a_larger_sample_holds_the_smaller_one(tmp_path):
    room = "hammerstein/dynamics"
    shutil.copytree(ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("__pycache__"))
    few, many = (sample(number, 3, tmp_path) for number in (5, 20))
    assert many[:5] == few
    assert len({(change.path, change.line) for change in many}) == 20
    assert sample(5, 4, tmp_path) != few


def test_known_survivors_still_stand_in_their_files():
    changes = known(ROOT)
    assert len(changes) > 30
    assert [test for test in changes.values() if test and not (ROOT / test).exists()] == []


def test_what_is_beside_the_numbers_is_recorded_only_where_it_is_named():
    assert [name for name in BESIDE if not (ROOT / "tests" / name).exists()] == []
    assert "--ignore=tests/commands" in asked_of_pytest([])
    assert asked_of_pytest(["tests/commands/test_cli.py"]) == ["tests/commands/test_cli.py"]


def test_lines_are_touched_by_tests_by_fixtures_of_their_file_and_through_names(tmp_path):
    package = tmp_path / "hammerstein"
    package.mkdir()
    (package / "kernel.py").write_text("@compiled()\ndef loop(x):\n    return x + SIZE\n\n\nSIZE = 2.0\n")
    (package / "user.py").write_text("def use(x):\n    return loop(x)\n\n\ndef other(x): return x\n")
    loaded = {"c.py::first": [1, 6]}  # whichever test comes first loads a module
    touched = {
        "hammerstein/kernel.py": loaded,
        "hammerstein/user.py": {"a.py::one": [2], "b.py::two|setup": [5]},
    }
    recording = Recording(
        touched, {"a.py::one": 1.0, "c.py::first": 1.0, "b.py::two": 1.0, "b.py::three": 1.0}
    )

    def tests_of(path, line):
        return set(recording.tests_of(tmp_path, f"hammerstein/{path}", line))

    assert tests_of("user.py", 1) == tests_of("user.py", 2) == {"a.py::one"}
    assert tests_of("user.py", 5) == {"b.py::two", "b.py::three"}
    assert tests_of("kernel.py", 3) == {"a.py::one"}
    assert tests_of("kernel.py", 6) == {"a.py::one"}

"""How many rooms a scenario passes on its way to a report, and how often it turns back upwards."""

import ast
import configparser
import re
import sys
from pathlib import Path

import pytest

import hammerstein
from hammerstein.model.model import packaged_actuators
from hammerstein.reporting.folder import write_report

PACKAGE = Path(hammerstein.__file__).parent
SCENARIO = {
    "question": "How round is a circle?",
    "actuator": "duo_bimorph_static",
    "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 50.0},
    "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
}


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    """Pairs (caller, called) of files of the package in a run to its report."""
    folder = tmp_path_factory.mktemp("reports")

    def to_a_report(name):
        write_report(hammerstein.run(SCENARIO), folder / name, figures=False)

    found = set()

    def note(frame, event, argument):
        called = frame.f_code.co_filename
        if event != "call" or not called.startswith(f"{PACKAGE}/"):
            return
        caller = frame.f_back
        while caller is not None and not caller.f_code.co_filename.startswith(f"{PACKAGE}/"):
            caller = caller.f_back
        if caller is not None:
            found.add((Path(caller.f_code.co_filename), Path(called)))

    to_a_report("first")  # what is imported on the way is no step of it
    sys.setprofile(note)
    try:
        to_a_report("second")
    finally:
        sys.setprofile(None)
    return found


def room_of(file):
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def contract(key):
    """Lines of the contract of layers in .importlinter, without comments."""
    read = configparser.ConfigParser()
    read.read(Path(__file__).parents[1] / ".importlinter")
    lines = read["importlinter:contract:layers"][key].split("\n")
    return [line for line in lines if line and not line.startswith("#")]


def floors():
    """Floor of each room, the highest first, as .importlinter has them."""
    return {room.strip(): i for i, line in enumerate(contract("layers")) for room in re.split("[|:]", line)}


def test_there_are_at_most_thirty_rooms_on_ten_floors_and_one_import_climbs():
    assert len(floors()) <= 30
    assert len(contract("layers")) <= 10
    assert len(contract("ignore_imports")) <= 1


def test_a_run_to_its_report_enters_nine_rooms(calls):
    """Those above the two floors on which all others stand."""
    floor = floors()
    rooms = {room_of(called) for _, called in calls}
    assert {room for room in rooms if floor.get(room, 99) < len(contract("layers")) - 2} <= {
        *("scenario", "experiment", "compensators", "hysteresis", "dynamics", "model", "reporting"),
        "signals",
    }


def imported_rooms(file):
    """Rooms of the package that a file imports from, wherever it does."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update({node.module, *(f"{node.module}.{alias.name}" for alias in node.names)})
    return {name.split(".")[1] for name in names if name.startswith("hammerstein.")}


def test_a_run_to_its_report_never_climbs(calls):
    """What was handed down may be called: a task, a block behind its protocol. What is fetched lies below."""
    floor = floors()
    climbs = {
        (str(caller.relative_to(PACKAGE)), room_of(called))
        for caller, called in calls
        if floor.get(room_of(called), 99) < floor.get(room_of(caller), 0)
        and room_of(called) in imported_rooms(caller)
    }
    assert not climbs
    assert {"experiment", "reporting", "hysteresis"} <= floor.keys()
    assert any(floor.get(room_of(a), 99) < floor.get(room_of(b), 0) for a, b in calls)  # it comes down


def test_a_class_name_stands_for_one_thing():
    """A private one may repeat that of another file; a public one is met outside its file."""
    places = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(file.relative_to(PACKAGE)))
    assert len(places) > 200
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_plain_words_are_used():
    """A set-up is no bench, a block of a signal no stretch; a model improves and responds."""
    other = re.compile(r"\b(bench|benches|stretch|stretches|earns|hears?|heard)\b", re.IGNORECASE)
    kinds = (".py", ".pyi", ".md", ".jinja", ".toml", ".html", ".json")
    files = [file for file in PACKAGE.rglob("*") if file.suffix in kinds]
    assert len(files) > 350
    found = {}
    for file in [*files, PACKAGE.parent / "README.md"]:
        if words := other.findall(file.read_text(encoding="utf-8").replace("_", " ")):
            found[file.name] = words
    assert found.pop("plots.py", []) == ["stretch"] * 5  # Bokeh's stretch_width
    assert found == {}


def test_the_core_knows_no_actuator():
    """Which packaged one stands where none is named is said among the data; docstrings may show one."""
    names = set(packaged_actuators())
    found = set()
    for file in PACKAGE.rglob("*.py"):
        room = file.relative_to(PACKAGE).parts[0]
        text = file.read_text(encoding="utf-8")
        values = (node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant))
        if room not in ("paper", "examples") and names & {v for v in values if isinstance(v, str)}:
            found.add(room)
    assert found == {"actuators"}

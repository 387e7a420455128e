"""How many rooms a scenario passes on its way to a report, and how often it turns back upwards."""

import ast
import configparser
import re
import sys
import tokenize
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hammerstein
from hammerstein.commands.cli import app
from hammerstein.model.model import packaged_actuators
from hammerstein.reporting.folder import Writer

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
    folder, run = tmp_path_factory.mktemp("reports"), hammerstein.run  # to look it up is no step of a run

    def to_a_report(name):
        Writer(folder / name, figures=False)(run(SCENARIO))

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
    read.read(Path(__file__).parents[2] / ".importlinter")
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


MODULES_OF_A_RUN, MODULES_OF_IDENTIFY = 40, 69
"""Ceilings of what is entered, to be lowered with the code: the goals are 40 and 45."""


def entered(work):
    """Files of the package that a function enters, once what it imports has been imported."""
    found = set()

    def note(frame, event, argument):
        file = frame.f_code.co_filename
        if file.startswith(f"{PACKAGE}/") and file.endswith(".py"):  # templates are no modules
            found.add(file)

    work()
    before = sys.gettrace()
    sys.settrace(note)  # told of Python's functions alone, unlike a profiler
    try:
        work()
    finally:
        sys.settrace(before)
    return found


def test_a_run_to_its_report_enters_few_modules(calls):
    files = {called for _, called in calls} | {caller for caller, _ in calls}
    modules = {file for file in files if file.suffix == ".py"}  # templates are no modules
    assert 20 < len(modules) <= MODULES_OF_A_RUN


@pytest.mark.full
def test_the_command_identify_enters_few_modules(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    model = hammerstein.HammersteinModel.load("duo_bimorph")
    time_s, files = np.arange(1500) * 100e-6, ["0.csv", "1.csv"]
    for k, name in enumerate(files):
        u_v = np.zeros((2, len(time_s)))
        u_v[k] = 8.0 * np.sin(2.0 * np.pi * 40.0 * time_s) * np.linspace(1.0, 0.5, len(time_s))
        response = model.simulate(u_v, 100e-6, instruments=model.instruments, seed=k)
        table = np.vstack([time_s, response.drive_v, response.reading_um]).T
        np.savetxt(name, table, delimiter=",", header="t [s],Vx [V],Vy [V],x [um],y [um]", comments="")

    def identify():
        result = CliRunner().invoke(app, ["identify", *files, "--out", "model.json"])
        assert result.exit_code == 0, f"{result.output}{result.exception}"

    assert 20 < len(entered(identify)) <= MODULES_OF_IDENTIFY


CODE_LINES, MODULES = 34_800, 222
"""Ceilings of the house, to be lowered with the code: the goals are 26,500 and 260."""

CODE = {tokenize.NAME, tokenize.NUMBER, tokenize.STRING, tokenize.OP}


def code_lines(file):
    """Number of lines of a file that are neither blank nor a comment nor a docstring."""
    documented = ast.Module | ast.ClassDef | ast.FunctionDef
    tree = ast.parse(file.read_text(encoding="utf-8"))
    told = [
        node.body[0] for node in ast.walk(tree) if isinstance(node, documented) and ast.get_docstring(node)
    ]
    docstrings = {line for node in told for line in range(node.lineno, node.end_lineno + 1)}
    with file.open("rb") as text:
        spans = [(t.start[0], t.end[0]) for t in tokenize.tokenize(text.readline) if t.type in CODE]
    return len({line for first, last in spans for line in range(first, last + 1)} - docstrings)


@pytest.mark.full
def test_the_house_does_not_grow():
    counts = [code_lines(file) for file in PACKAGE.rglob("*.py")]
    assert 20_000 < sum(counts) <= CODE_LINES
    assert 200 < len(counts) <= MODULES


def imported(file):
    """Names that a file imports, wherever it does: inside functions and for types alone, too."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.update({node.module, *(f"{node.module}.{alias.name}" for alias in node.names)})
    return names


def imported_rooms(file):
    """Rooms of the package that a file imports from."""
    return {name.split(".")[1] for name in imported(file) if name.startswith("hammerstein.")}


OF_THE_MODEL = {"hammerstein.compensators.drive_file", "hammerstein.model.simulation"}
"""What a model does when a person asks it by a method: it stands on the model."""


@pytest.mark.full
def test_no_module_imports_what_stands_on_it():
    places = {}
    for file in PACKAGE.rglob("*.py"):
        parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
        places[".".join(parts[: -1 if parts[-1] == "__init__" else None])] = file
    below = {name: imported(file) & places.keys() - {name} for name, file in places.items()}
    assert below["hammerstein.model.model"] >= OF_THE_MODEL
    below["hammerstein.model.model"] -= OF_THE_MODEL
    assert len(list(TopologicalSorter(below).static_order())) > 200  # CycleError names the modules


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


@pytest.mark.full
def test_a_class_name_stands_for_one_thing():
    """A private one may repeat that of another file; a public one is met outside its file."""
    places = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(file.relative_to(PACKAGE)))
    assert len(places) > 200
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


@pytest.mark.full
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

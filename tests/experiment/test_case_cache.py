"""Nothing is done twice: what was worked out is kept, and counts for the very same contents alone."""

import importlib
import json
import os
import signal
import stat
import subprocess
import sys
import types
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hammerstein import plugins
from hammerstein.commands.cli import main
from hammerstein.compensators import COMPENSATORS
from hammerstein.errors import Notice
from hammerstein.experiment import case_cache, simulated_identification
from hammerstein.experiment.run import run
from hammerstein.files import UNFINISHED
from hammerstein.model import HammersteinModel
from hammerstein.runtime import store as kept_results
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario.variation import Uncertainty

SCENARIO = {
    "question": "?",
    "actuator": "duo_bimorph",
    "seed": 3,
    "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 100.0, "axis": "each"},
    "sweep": {"frequency_hz": [100.0, 200.0]},
    "compensators": [{"label": "none", "law": "none", "model": "duo_bimorph"}],
}
CASES = 4
EXACT = {"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}
FILE = """
question = "?"
actuator = "duo_bimorph"
[reference]
kind = "sine"
amplitude_um = 10.0
frequency_hz = 100.0
axis = 1
[sweep]
frequency_hz = [100.0, 200.0]
[[compensators]]
label = "none"
law = "none"
model = "duo_bimorph"
"""


@pytest.fixture
def store(tmp_path):
    folder = tmp_path / "kept"
    folder.mkdir(mode=0o700)
    return Store(folder)


@pytest.fixture
def worked_out(monkeypatch):
    """Cases that are worked out from now on."""
    cases, real = [], case_cache.rows_of

    def counted(setup, case):
        cases.append(case)
        return real(setup, case)

    monkeypatch.setattr(case_cache, "rows_of", counted)
    return cases


@pytest.fixture
def place(tmp_path, monkeypatch):
    """Where the command line keeps results, in this test alone."""
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", "100")
    return tmp_path / "cache" / "kept"


def called(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code or 0


def content(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def entries(folder):
    found = (path for path in folder.glob("??/*") if path.is_file())
    return sorted(path for path in found if not path.name.endswith(UNFINISHED))


def test_a_second_run_works_out_nothing_and_finds_the_same(store, worked_out):
    first = run(SCENARIO, store=store)
    assert len(worked_out) == CASES
    again = run(SCENARIO, store=store)
    assert len(worked_out) == CASES
    assert again.to_json() == first.to_json() == run(SCENARIO).to_json()
    for one, other in zip(first.traces, again.traces, strict=True):
        for name, column in one.response.columns().items():
            np.testing.assert_array_equal(column, other.response.columns()[name])
        np.testing.assert_array_equal(one.time_s, other.time_s)
        np.testing.assert_array_equal(one.response.saturated, other.response.saturated)


def test_a_run_in_volts_keeps_what_its_models_predict(store, worked_out):
    scenario = {
        "question": "?",
        "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 100.0, "axis": 1},
        "models": [
            {"label": "itself", "model": "duo_bimorph"},
            {"label": "k", "model": "duo_bimorph_creep"},
        ],
    }
    first, again = run(scenario, store=store), run(scenario, store=store)
    assert len(worked_out) == 1
    assert again.to_json() == first.to_json()
    for one, other in zip(first.traces[0].predictions, again.traces[0].predictions, strict=True):
        assert one.label == other.label
        np.testing.assert_array_equal(one.position_um, other.position_um)
        np.testing.assert_array_equal(one.reading_um, other.reading_um)


def test_a_new_compensator_costs_its_own_cases_alone(store, worked_out):
    run(SCENARIO, store=store)
    worked_out.clear()
    both = SCENARIO | {"compensators": [*SCENARIO["compensators"], EXACT]}
    assert run(both, store=store).to_json() == run(both).to_json()
    assert [case.label for case in worked_out[: CASES + 1]] == ["exact"] * CASES + ["none"]


def test_words_cost_nothing(store, worked_out):
    run(SCENARIO, store=store)
    report = run(
        SCENARIO | {"question": "another?", "tolerances": {"rms_um": {"relative": 0.1}}}, store=store
    )
    assert len(worked_out) == CASES
    assert report.scenario.question == "another?"


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 4},
        {"actuator": "duo_bimorph_creep"},
        {"measure": {"measured_cycles": 3}},
        {"instruments": {"sensor": {"noise_um": 0.5}}},
        {"instruments": {"drive": {"resolution_v": 0.5}}},
        {"sweep": {"frequency_hz": [101.0, 201.0]}},
        {"compensators": [{"label": "none", "law": "none", "model": "duo_bimorph_creep"}]},
        {"compensators": [{"label": "none", "law": "exact_inverse", "model": "duo_bimorph"}]},
    ],
)
def test_whatever_changes_a_number_is_worked_out(store, worked_out, change):
    run(SCENARIO, store=store)
    worked_out.clear()
    changed = run(SCENARIO | change, store=store)
    assert len(worked_out) == CASES
    assert changed.to_json() == run(SCENARIO | change).to_json()


def test_what_a_file_holds_counts_and_not_its_name(store, worked_out, tmp_path):
    model = HammersteinModel.load("duo_bimorph")
    places = [tmp_path / name for name in ("a.json", "b.json")]
    for path in places:
        model.save(path)
    scenario = SCENARIO | {"sweep": {}}
    run(scenario | {"actuator": str(places[0])}, store=store)
    run(scenario | {"actuator": str(places[1])}, store=store)
    assert len(worked_out) == 2
    HammersteinModel.load("duo_bimorph_creep").save(places[1])
    run(scenario | {"actuator": str(places[1])}, store=store)
    assert len(worked_out) == 4


def test_a_path_of_a_file_counts_by_its_rows(store, worked_out, tmp_path):
    path = tmp_path / "path.csv"
    scenario = SCENARIO | {"reference": {"kind": "file", "path": str(path)}, "sweep": {}}
    for last in (1.0, 1.0, 2.0):
        path.write_text(f"time_s,x,y\n0,0,0\n0.01,{last},1\n")
        report = run(scenario, store=store)
        assert report.traces[0].response.reference_um.max() == last
    assert len(worked_out) == 2


def test_other_sources_or_libraries_find_nothing(store, worked_out, monkeypatch):
    run(SCENARIO, store=store)
    monkeypatch.setattr(kept_results, "computed_by", lambda: "other versions")
    run(SCENARIO, store=store)
    assert len(worked_out) == 2 * CASES


def test_draws_are_kept_in_pieces_whatever_their_number(store, monkeypatch):
    drawn, real = [], Uncertainty.draw

    def counted(self, model, instruments, number):
        drawn.append(number)
        return real(self, model, instruments, number)

    monkeypatch.setattr(Uncertainty, "draw", counted)
    scenario = SCENARIO | {"sweep": {}, "uncertainty": {"draws": 50, "weights": 0.02, "noise": 0.3}}
    first = run(scenario, store=store)
    assert sorted(drawn) == list(range(50))
    assert run(scenario, store=store).to_json() == first.to_json() == run(scenario).to_json()
    assert len(drawn) == 100  # the run without a store
    drawn.clear()
    scenario["uncertainty"] = scenario["uncertainty"] | {"draws": 75}
    more = run(scenario, jobs=2, store=store)
    assert sorted(drawn) == list(range(50, 75))
    assert more.to_json() == run(scenario).to_json()


FAULTS = ["truncated", "emptied", "flipped", "another's", "pickle", "folder", "pipe"]


def spoil(path, how, other):
    data = path.read_bytes()
    if how in ("folder", "pipe"):
        path.unlink()
        path.mkdir() if how == "folder" else os.mkfifo(path)
    elif how == "another's":
        path.write_bytes(other.read_bytes())
    elif how == "pickle":
        import pickle

        path.write_bytes(pickle.dumps(_Executes()))
    else:
        middle = len(data) // 2
        flipped = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
        path.write_bytes({"truncated": data[:middle], "emptied": b"", "flipped": flipped}[how])


class _Executes:
    def __reduce__(self):
        return os._exit, (99,)


@pytest.mark.parametrize("how", FAULTS)
def test_an_entry_that_is_not_what_was_written_is_told_and_worked_out(store, worked_out, how):
    if how == "pipe" and not hasattr(os, "mkfifo"):
        pytest.skip("this system has no pipes")
    first = run(SCENARIO, store=store)
    one, other, *_ = entries(store.folder)
    spoil(one, how, other)
    worked_out.clear()
    with pytest.warns(Notice, match="damaged and is computed again") as told:
        again = run(SCENARIO, store=store)
    assert [str(one) in str(warning.message) for warning in told] == [True]
    assert len(worked_out) == 1
    assert again.to_json() == first.to_json()


def test_numbers_alone_are_kept_and_read(store):
    dtypes = ("<f8", "<i8", "|b1", "|u1")
    key, arrays = "b" * 64, {f"{dtype} {n}": np.ones(n, dtype) for dtype in dtypes for n in (0, 3)}
    store.write(key, Kept({"a": [1, None, float("inf")]}, arrays))
    found = store.read(key)
    assert found.document == {"a": [1, None, float("inf")]}
    for name, array in arrays.items():
        np.testing.assert_array_equal(found.arrays[name], array, strict=True)
    store.write(key, Kept(None, {"objects": np.array([_Executes()])}))
    with pytest.warns(Notice, match="damaged"):
        assert store.read(key) is None


def test_what_was_used_longest_ago_goes(tmp_path):
    store = Store(tmp_path, limit_bytes=100_000)
    keys = [key_of("test", number) for number in range(30)]
    for number, key in enumerate(keys):
        store.write(key, Kept(None, {"a": np.zeros(1000)}))
        os.utime(store._path(key), (number, number))
        assert sum(path.stat().st_size for path in entries(tmp_path)) <= 1.2 * store.limit_bytes
        store.read(keys[0])
    assert store.read(keys[0]) is not None
    assert store.read(keys[1]) is None
    assert store.read(keys[-1]) is not None
    store.write("c" * 64, Kept(None, {"a": np.zeros(5000)}))
    assert store.read("c" * 64) is None  # too large for a place of this size


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
def test_it_belongs_to_the_user_alone(place, tmp_path, capsys):
    (tmp_path / "s.toml").write_text(FILE)
    arguments = ("run", tmp_path / "s.toml", "--out", tmp_path / "r", "--no-figures")
    assert called(*arguments) == 0
    assert stat.S_IMODE(place.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in entries(place)} == {0o600}
    place.chmod(0o777)
    before = content(place)
    capsys.readouterr()
    assert called(*arguments) == 0
    assert capsys.readouterr().err.count("others may write there") == 1
    assert content(place) == before


@pytest.mark.full
@pytest.mark.parametrize(
    "how",
    [
        "disk full",
        pytest.param("no folder", marks=pytest.mark.long),
        pytest.param("no home", marks=pytest.mark.long),
    ],
)
def test_where_nothing_can_be_kept_the_run_goes_on_and_says_so_once(tmp_path, how):
    for name in "ab":
        (tmp_path / f"{name}.toml").write_text(FILE)
    environment = os.environ | {"HAMMERSTEIN_CACHE_MB": "100"}
    (tmp_path / "file").write_text("")
    environment["HAMMERSTEIN_CACHE"] = str(tmp_path / ("file/x" if how == "no folder" else "cache"))
    start = "from hammerstein.__main__ import main; main()"
    if how == "disk full":
        start = (
            "import errno\nfrom hammerstein.runtime import store\n"
            "def full(*a, **k): raise OSError(errno.ENOSPC, 'No space left on device')\n"
            f"store.write_atomic = full\n{start}"
        )
    if how == "no home":
        for name in ("HAMMERSTEIN_CACHE", "XDG_CACHE_HOME"):
            environment.pop(name, None)
        start = f"from pathlib import Path\ndef no(): raise RuntimeError\nPath.home = no\n{start}"
    command = [sys.executable, "-c", start, "run", tmp_path, "--out", tmp_path / "r", "--no-figures"]
    done = subprocess.run(
        [*map(str, command), "--jobs", "1"], capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("results are not cached") == 1
    assert (tmp_path / "r" / "a" / "report.json").is_file()
    assert (tmp_path / "r" / "b" / "report.json").is_file()


def test_the_command_line_runs_only_what_changed(place, tmp_path, worked_out, monkeypatch):
    (tmp_path / "s.toml").write_text(FILE)
    arguments = ("run", tmp_path / "s.toml", "--jobs", "1", "--out")
    assert called(*arguments, tmp_path / "1") == 0
    assert len(worked_out) == 2
    drawn, real = [], sys.modules["hammerstein.reporting.figures.write"].svg_of
    monkeypatch.setattr(
        "hammerstein.reporting.figures.write.svg_of", lambda figure: drawn.append(figure) or real(figure)
    )
    assert called(*arguments, tmp_path / "2") == 0
    (tmp_path / "s.toml").write_text(FILE.replace('"?"', '"Really?"'))
    assert called(*arguments, tmp_path / "3") == 0
    assert (len(worked_out), drawn) == (2, [])
    assert content(tmp_path / "1") == content(tmp_path / "2")
    assert b"Really?" in (tmp_path / "3" / "s" / "report.md").read_bytes()
    assert called(*arguments, tmp_path / "4", "--fresh") == 0
    assert len(worked_out) == 4
    assert len(drawn) == 2
    assert content(tmp_path / "3") == content(tmp_path / "4")
    assert called(*arguments, tmp_path / "5", "--traces", "csv") == 0
    assert len(worked_out) == 4
    assert (tmp_path / "5" / "s" / "traces").is_dir()


@pytest.mark.full
def test_figures_that_were_drawn_are_not_drawn_again(place, tmp_path, monkeypatch):
    """Killed behind the figures, the next run draws none."""
    (tmp_path / "s.toml").write_text(FILE)
    arguments = ("run", tmp_path / "s.toml", "--jobs", "1", "--out")
    from hammerstein.reporting import run_page
    from hammerstein.reporting.figures import write

    def fails(*_):
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(run_page, "run_page", fails)
        assert called(*arguments, tmp_path / "1") == 70
    drawn, real = [], write.svg_of
    monkeypatch.setattr(write, "svg_of", lambda figure: drawn.append(figure) or real(figure))
    assert called(*arguments, tmp_path / "1") == 0
    assert drawn == []
    assert called(*arguments, tmp_path / "2", "--fresh") == 0
    assert len(drawn) == 2
    assert content(tmp_path / "1") == content(tmp_path / "2")


@pytest.mark.full
def test_figures_follow_what_the_assessment_is_about(place, tmp_path):
    """The paper's are of the reading, others of the true position."""
    asked = f'{FILE}\n[assessment]\nkind = "paper"\n'
    for folder, text in enumerate((FILE, asked)):
        (tmp_path / "s.toml").write_text(text)
        assert called("run", tmp_path / "s.toml", "--jobs", "1", "--out", tmp_path / str(folder)) == 0
    drawn = [sorted((tmp_path / name / "s").glob("*.svg")) for name in "01"]
    assert [file.name for file in drawn[0]] == [file.name for file in drawn[1]] != []
    assert [file.read_bytes() for file in drawn[0]] != [file.read_bytes() for file in drawn[1]]


def test_a_check_reads_nothing_that_was_kept(place, tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(FILE)
    check = ("check", tmp_path / "s.toml", "--baseline", tmp_path / "b", "--jobs", "1")
    assert called("run", tmp_path / "s.toml", "--out", tmp_path / "r", "--no-figures") == 0

    def never(*_):
        raise AssertionError

    monkeypatch.setattr(Store, "read", never)
    assert called(*check, "--update-baseline") == 0
    assert called(*check) == 0


@pytest.mark.parametrize(("size", "code", "said"), [("0", 0, ""), ("all", 2, "'all' is not a number of")])
def test_how_much_is_kept_can_be_said(place, tmp_path, monkeypatch, capsys, size, code, said):
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", size)
    (tmp_path / "s.toml").write_text(FILE)
    assert called("run", tmp_path / "s.toml", "--out", tmp_path / "r", "--no-figures") == code
    assert said in capsys.readouterr().err
    assert not place.exists()


def test_help_names_the_place():
    code = "from hammerstein.__main__ import main; main()"
    environment = os.environ | {"HAMMERSTEIN_CACHE": "/a/place", "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-c", code, "run", "-h"], capture_output=True, text=True, env=environment, check=True
    )
    assert str(Path("/a/place/kept")) in done.stdout


TEN = FILE.replace("[100.0, 200.0]", str([100.0 + k for k in range(10)]))
SLOW = TEN.replace('law = "none"', 'law = "inverse_multiplicative"') + "iterations = 30\n"
KILLED_WHILE_IT_KEEPS_THE_SIXTH = """
import os, signal
from hammerstein import files
from hammerstein.__main__ import main
def killed(*_): os.kill(os.getpid(), signal.SIGKILL)
kept, write = [], files.os.replace
def counted(source, target):
    if "kept" in str(target):
        kept.append(target)
    killed() if len(kept) > 5 else write(source, target)
files.os.replace = counted
main()
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.full
def test_killed_at_half_at_most_half_is_left(place, tmp_path, worked_out):
    (tmp_path / "s.toml").write_text(TEN)
    arguments = ["run", str(tmp_path / "s.toml"), "--jobs", "1", "--no-figures", "--out"]
    command = [sys.executable, "-c", KILLED_WHILE_IT_KEEPS_THE_SIXTH, *arguments, str(tmp_path / "1")]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    finished = len(entries(place))
    assert finished == 5
    assert not (tmp_path / "1" / "s").exists()
    assert called(*arguments, tmp_path / "1") == 0
    assert len(worked_out) == 10 - finished
    assert called(*arguments, tmp_path / "2", "--fresh") == 0
    assert content(tmp_path / "1") == content(tmp_path / "2")


@pytest.mark.long
def test_two_runs_at_once_share_the_place(place, tmp_path):
    (tmp_path / "s.toml").write_text(SLOW)
    command = [sys.executable, "-m", "hammerstein", "run", str(tmp_path / "s.toml"), "--jobs", "1"]
    both = [
        subprocess.Popen([*command, "--no-figures", "--out", str(tmp_path / name)], stdout=subprocess.DEVNULL)
        for name in "12"
    ]
    assert [process.wait() for process in both] == [0, 0]
    assert content(tmp_path / "1") == content(tmp_path / "2")
    assert all(Store(place).read("".join(path.parts[-2:])) is not None for path in entries(place))


@pytest.mark.full
def test_the_report_that_is_kept_is_the_report(place, tmp_path, capsys):
    text = FILE + '[assessment]\nkind = "paper"\n[[assessment.claims]]\nid = "a"\nstatement = "s"\n'
    text += 'paper = 1.0\nquote = "It is one."\nquantity = { metric = "rms_um" }\n'
    (tmp_path / "s.toml").write_text(text + "agreement = { within = 0.1 }\n")
    said = []
    for name in "12":
        folders = ("--out", tmp_path / name, "--page", tmp_path / f"page{name}")
        assert called("run", tmp_path / "s.toml", "--jobs", "1", *folders, "--json") == 0
        said.append(json.loads(capsys.readouterr().out))
    assert said[0] == said[1]
    assert content(tmp_path / "1") == content(tmp_path / "2")
    assert content(tmp_path / "page1") == content(tmp_path / "page2")


def test_a_store_that_passes_by_what_was_there_knows_what_it_has_kept_itself(tmp_path):
    key = key_of("test", 1)
    Store(tmp_path).write(key, Kept("before"))
    fresh = Store(tmp_path, fresh=True)
    assert fresh.read(key) is None
    fresh.write(key, Kept("anew"))
    assert fresh.read(key).document == "anew"
    assert Store(tmp_path, fresh=True).read(key) is None
    assert Store(tmp_path).read(key).document == "anew"


IDENTIFIED = {
    "question": "?",
    "actuator": "duo_bimorph_static",
    "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 100.0, "axis": 1},
    "compensators": [
        {"label": "a", "law": "exact_inverse", "identification": {"method": "closed_form", "operators": 3}}
    ],
}


@pytest.fixture
def identified(place, monkeypatch):
    """Identifications that are worked out from now on."""
    done, real = [], simulated_identification._identified

    def counted(*arguments):
        done.append(arguments)
        return real(*arguments)

    monkeypatch.setattr(simulated_identification, "_identified", counted)
    return done


def test_an_identification_is_kept_and_told_where_it_was_spoilt(place, identified):
    first = run(IDENTIFIED)
    assert run(IDENTIFIED).to_json() == first.to_json()
    assert len(identified) == 1
    (entry,) = entries(place)
    spoil(entry, "flipped", entry)
    with pytest.warns(Notice, match="damaged and is computed again"):
        assert run(IDENTIFIED).to_json() == first.to_json()
    assert len(identified) == 2


@pytest.mark.skipif(os.name == "nt", reason="permissions of POSIX")
@pytest.mark.parametrize("who", ["others", "off"])
def test_no_model_comes_from_a_folder_that_others_may_write_to(place, identified, monkeypatch, who):
    run(IDENTIFIED)
    if who == "others":
        place.chmod(0o777)
    else:
        monkeypatch.setenv("HAMMERSTEIN_CACHE", "")
    for count in (2, 3):
        run(IDENTIFIED)
        assert len(identified) == count


def test_an_entry_that_names_a_file_elsewhere_writes_nothing_there(place, tmp_path, monkeypatch):
    """A report in the store with a file of such a name, and a right checksum."""
    (tmp_path / "s.toml").write_text(FILE)
    arguments = ("run", tmp_path / "s.toml", "--jobs", "1", "--no-figures", "--out", tmp_path / "r")
    assert called(*arguments) == 0
    real = Store.read

    def foreign(self, key):
        entry = real(self, key)
        if entry is None or "report.md" not in entry.arrays:
            return entry
        return Kept(entry.document, {**entry.arrays, "../../../elsewhere.txt": np.zeros(3, np.uint8)})

    monkeypatch.setattr(Store, "read", foreign)
    assert called(*arguments) == 0
    assert not list(tmp_path.rglob("elsewhere.txt"))
    assert not list(tmp_path.parent.glob("elsewhere.txt"))


LAW = """
from typing import Literal
from hammerstein.compensators import Compensator
class Own(Compensator):
    law: Literal["own"]
    def design(self, model, drive, sample_time_s): return {factor}
"""


def test_a_kind_of_this_process_counts_with_its_source(tmp_path, monkeypatch):
    """A plug-in that changed finds nothing of what the other one gave; without a source nothing at all."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before, keys = key_of("case", 1), []
    for factor in (1, 2, 2):
        (tmp_path / "own_law.py").write_text(LAW.format(factor=factor))
        sys.modules.pop("own_law", None)
        importlib.invalidate_caches()
        kind = importlib.import_module("own_law").Own
        plugins.register(kind)
        keys.append(key_of("case", 1))
        COMPENSATORS.remove(kind)
    monkeypatch.setitem(sys.modules, "nowhere", types.ModuleType("nowhere"))  # of no file
    made = type("Made", (kind,), {"__annotations__": {"law": Literal["made"]}, "__module__": "nowhere"})
    for _ in range(2):
        plugins.register(made)
        keys.append(key_of("case", 1))
        COMPENSATORS.remove(made)
        kept_results._computed_by.cache_clear()
    assert keys[1] == keys[2]
    assert len({before, *keys}) == 5
    assert key_of("case", 1) == before


def test_what_a_package_only_ships_is_no_source(tmp_path, monkeypatch):
    (tmp_path / "law.py").write_text("x = 1\n")
    monkeypatch.setattr(kept_results, "PACKAGE", tmp_path)
    before = kept_results.sources.__wrapped__()
    (tmp_path / "paper" / "shipped" / "baseline").mkdir(parents=True)
    (tmp_path / "paper" / "shipped" / "baseline" / "circles.json").write_text("{}")
    assert kept_results.sources.__wrapped__() == before
    (tmp_path / "law.json").write_text("{}")
    assert kept_results.sources.__wrapped__() != before

"""What a person keeps beside our files, and an earlier report, outlive every run."""

import hashlib
import json
import os
import shutil
from contextlib import contextmanager

import pytest

from hammerstein.commands.cli import main

SMALL = """
question = "How large is a loop?"
actuator = "duo_bimorph_static"
[drive]
kind = "sine"
amplitude_v = 10
frequency_hz = 50
[measure]
settle_s = 0
settle_cycles = 1
measured_cycles = 1
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "work"
    place.mkdir()
    monkeypatch.chdir(place)
    (place / "small.toml").write_text(SMALL)
    return place


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return caught.value.code or 0


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Report of a run; nothing changes it."""
    place = tmp_path_factory.mktemp("report")
    (place / "small.toml").write_text(SMALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert call("run", "small.toml") == 0
    return place / "reports"


@pytest.fixture
def ran(folder, report):
    """The folder after a run."""
    shutil.copytree(report, folder / "reports")
    return folder


def contents(place):
    """Bytes of every file below a folder."""
    return {p.relative_to(place).as_posix(): p.read_bytes() for p in place.rglob("*") if p.is_file()}


def hidden(place):
    return [p for p in place.rglob(".*") if p.name != ".hammerstein.json"]


def test_photographs_in_a_folder_named_like_a_scenario_stay(folder, capsys):
    (folder / "small").mkdir()
    for name in ("beach.png", "sketch.svg", "rms.csv.bak"):
        (folder / "small" / name).write_text("mine")
    (folder / "small" / "traces").mkdir()
    (folder / "small" / "traces" / "notes.txt").write_text("mine")
    mine = contents(folder / "small")
    for figures in ("--figures", "--no-figures"):
        assert call("run", "small.toml", "--out", ".", figures) == 0
        now = contents(folder / "small")
        assert {name: now[name] for name in mine} == mine
        assert "report.md" in now


def test_a_file_that_is_not_ours_is_never_overwritten(folder, capsys):
    (folder / "small").mkdir()
    (folder / "small" / "report.md").write_text("my thesis")
    before = contents(folder)
    assert call("run", "small.toml", "--out", ".", "--no-figures") == 2
    error = capsys.readouterr().err
    assert "report.md" in error
    assert "this command did not write; move it away" in error
    assert contents(folder) == before


def test_a_picture_that_is_not_ours_is_never_overwritten(folder, capsys):
    (folder / "small").mkdir()
    (folder / "small" / "loops.svg").write_text("a sketch of the set-up")
    before = contents(folder)
    assert call("run", "small.toml", "--out", ".") == 2
    assert "loops.svg" in capsys.readouterr().err
    assert contents(folder) == before


@pytest.mark.parametrize(
    "name", ["...toml", "con.toml", "lpt1.toml", "a\nb.toml", "a\x1b[31m.toml", "a\\b.toml"]
)
def test_a_scenario_whose_name_is_no_name_for_a_folder_is_refused(folder, capsys, name):
    (folder / "scenarios").mkdir()
    (folder / "beach.png").write_text("mine")
    (folder / "report.md").write_text("mine")
    (folder / "scenarios" / name).write_text(SMALL)
    before = contents(folder)
    assert call("run", "scenarios", "--out", "reports", "--no-figures") == 2
    error = capsys.readouterr().err
    assert "cannot be the name of a folder" in error
    assert "\x1b" not in error
    assert contents(folder) == before


def test_a_linked_report_folder_is_not_followed(folder, tmp_path, capsys):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "beach.png").write_text("mine")
    (folder / "reports").mkdir()
    (folder / "reports" / "small").symlink_to(elsewhere)
    assert call("run", "small.toml") == 2
    assert "link" in capsys.readouterr().err
    assert contents(elsewhere) == {"beach.png": b"mine"}


def test_a_link_to_nothing_is_named(folder, tmp_path, capsys):
    (folder / "reports").symlink_to(tmp_path / "nowhere")
    assert call("run", "small.toml") == 2
    assert "reports is a link to nothing" in capsys.readouterr().err
    assert not (tmp_path / "nowhere").exists()


def test_a_linked_file_or_subfolder_is_not_followed(folder, tmp_path, capsys):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "report.md").write_text("mine")
    (folder / "reports/small").mkdir(parents=True)
    (folder / "reports/small/report.md").symlink_to(elsewhere / "report.md")
    assert call("run", "small.toml", "--no-figures") == 2
    (folder / "reports/small/report.md").unlink()
    (folder / "reports/small/traces").symlink_to(elsewhere)
    assert call("run", "small.toml", "--no-figures", "--traces", "csv") == 2
    assert contents(elsewhere) == {"report.md": b"mine"}


def test_what_a_person_has_edited_is_kept_aside_and_told(folder, capsys):
    assert call("run", "small.toml", "--no-figures") == 0
    page = folder / "reports/small/report.md"
    fresh = page.read_bytes()
    page.write_bytes(fresh + b"\nmy remark\n")
    capsys.readouterr()
    assert call("run", "small.toml", "--no-figures") == 0
    assert page.read_bytes() == fresh
    assert (folder / "reports/small/report.md.edited").read_bytes() == fresh + b"\nmy remark\n"
    assert "report.md.edited" in capsys.readouterr().err
    page.write_bytes(b"again")
    assert call("run", "small.toml", "--no-figures") == 0
    assert (folder / "reports/small/report.md.edited-2").read_bytes() == b"again"


def test_figures_of_an_earlier_run_go_and_edited_ones_stay(folder):
    assert call("run", "small.toml", "--traces", "csv") == 0
    report = folder / "reports/small"
    (report / "loops.svg").write_bytes(b"edited in a drawing program")
    assert call("run", "small.toml", "--no-figures") == 0
    pages = {"report.html", "report.md", "report.json", "rms.csv"}
    assert set(contents(report)) == {*pages, ".hammerstein.json", "loops.svg"}
    assert not (report / "traces").exists()


def test_a_report_without_a_manifest_is_replaced_where_that_is_wanted_and_nothing_else_is_touched(
    ran, capsys
):
    report = ran / "reports/small"
    (report / ".hammerstein.json").unlink(missing_ok=True)
    (report / "old-figure.png").write_text("of an earlier version, or a photograph")
    (report / "report.md").write_text("of an earlier version")
    before = contents(report)
    assert call("run", "small.toml") == 2
    assert "--overwrite" in capsys.readouterr().err
    assert contents(report) == before
    assert call("run", "small.toml", "--overwrite") == 0
    assert not (report / "report.md.edited").exists()
    assert b"How large" in (report / "report.md").read_bytes()
    assert (report / "old-figure.png").exists()


def test_a_manifest_cannot_name_a_file_elsewhere(folder, capsys):
    assert call("run", "small.toml", "--no-figures") == 0
    (folder / "precious.txt").write_text("mine")
    manifest = folder / "reports/small/.hammerstein.json"
    content = json.loads(manifest.read_text())
    entry = next(iter(content["files"].values()))
    digest = hashlib.sha256(b"mine").hexdigest()
    content["files"] = {"../../precious.txt": entry | {"sha256": digest}}
    manifest.write_text(json.dumps(content))
    assert call("run", "small.toml", "--no-figures") == 2
    assert call("run", "small.toml", "--no-figures", "--overwrite") == 0
    assert (folder / "precious.txt").read_text() == "mine"


def test_two_runs_give_the_same_bytes_manifest_included(folder, report):
    for _ in range(2):
        assert call("run", "small.toml", "--out", "a") == 0
        assert contents(folder / "a") == contents(report)
    assert not hidden(folder)


@contextmanager
def no_room_beyond(size):
    """Let the system refuse to make a file any larger."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    "size", [300, *(pytest.param(n, marks=pytest.mark.full) for n in (100, 5_000, 30_000))]
)
def test_a_full_disk_leaves_the_old_report(ran, capsys, size):
    folder = ran
    before = contents(folder)
    (folder / "small.toml").write_text(SMALL.replace("= 10\n", "= 9\n"))
    with no_room_beyond(size):
        assert call("run", "small.toml") == 2
    error = capsys.readouterr().err
    assert "reports/small: cannot be written (file too large)" in error
    assert contents(folder / "reports") == {
        name.removeprefix("reports/"): data for name, data in before.items() if name.startswith("reports/")
    }
    assert not hidden(folder)


def test_a_full_disk_leaves_no_folder_where_there_was_none(folder):
    with no_room_beyond(100):
        assert call("run", "small.toml") == 2
    assert not (folder / "reports").exists()


def test_a_failing_run_leaves_the_old_report(ran):
    folder = ran
    before = contents(folder / "reports")
    (folder / "small.toml").write_text(SMALL.replace("duo_bimorph_static", "gone.json"))
    assert call("run", "small.toml") == 2
    assert contents(folder / "reports") == before


@pytest.mark.full
def test_plot_replaces_figures_only(folder):
    assert call("run", "small.toml", "--no-figures") == 0
    before = contents(folder / "reports/small")
    (folder / "reports/small/mine.png").write_text("mine")
    assert call("plot", "small.toml") == 0
    (folder / "reports/small/loops.png").write_text("a photograph")
    assert call("plot", "small.toml") == 0
    now = contents(folder / "reports/small")
    assert {"loops.svg", "loops.png", "mine.png"} < set(now)
    assert {k: v for k, v in now.items() if k in before and k != ".hammerstein.json"} == {
        k: v for k, v in before.items() if k != ".hammerstein.json"
    }
    assert (folder / "reports/small/loops.png.edited").read_text() == "a photograph"


OF_THE_PAPER = '\n[assessment]\nkind = "paper"\nfigure = "Fig. 5"\n'


@pytest.mark.full
def test_a_page_beside_a_person_s_files(folder, capsys):
    page = folder / "site"
    page.mkdir()
    assert call("run", "small.toml", "--page", "site") == 2
    assert "no scenario has an [assessment]" in capsys.readouterr().err
    (folder / "small.toml").write_text(SMALL + OF_THE_PAPER)
    (page / "small-beach.png").write_text("mine")
    assert call("run", "small.toml", "--page", "site") == 0
    (folder / "reports/small/photo.png").write_text("mine, and not of the report")
    assert call("run", "small.toml", "--page", "site") == 0
    assert (page / "small-beach.png").read_text() == "mine"
    assert (page / "small-loops.png").exists()
    assert not (page / "small-photo.png").exists()
    other = folder / "other"
    other.mkdir()
    (other / "README.md").write_text("the README of my project")
    capsys.readouterr()
    assert call("run", "small.toml", "--page", "other") == 2
    assert "README.md" in capsys.readouterr().err
    assert contents(other) == {"README.md": b"the README of my project"}


@pytest.mark.full
def test_a_page_is_not_replaced_by_one_that_lacks_what_failed(folder, capsys):
    (folder / "s").mkdir()
    (folder / "s" / "small.toml").write_text(SMALL + OF_THE_PAPER)
    (folder / "s" / "far.toml").write_text(SMALL + OF_THE_PAPER)
    assert call("run", "s", "--page", "site", "--jobs", "1") == 0
    before = contents(folder / "site")
    (folder / "s" / "far.toml").write_text(
        SMALL.replace("[drive]", "[reference]").replace("amplitude_v = 10", "amplitude_um = 70")
        + '[[compensators]]\nlabel = "a"\nlaw = "exact_inverse"\nmodel = "duo_bimorph_static"\n'
    )
    assert call("run", "s", "--page", "site", "--jobs", "1") == 3
    assert contents(folder / "site") == before
    assert "did not write the overview pages" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "small.toml", "--junit", "notes.txt"),
        ("check", "small.toml", "--markdown", "notes.txt"),
        ("compensate", "duo_bimorph", "path.csv", "--out", "notes.txt"),
        ("identify", "r.csv", "--inputs", "u", "--outputs", "x", "--time", "t", "--out", "notes.txt"),
    ],
)
def test_a_file_named_as_an_output_that_is_not_ours_stays(folder, capsys, arguments):
    (folder / "notes.txt").write_text("mine")
    assert call(*arguments) == 2
    assert "notes.txt" in capsys.readouterr().err
    assert (folder / "notes.txt").read_text() == "mine"


def test_no_device_is_replaced_by_a_file(folder, capsys):
    os.mkfifo(folder / "pipe")
    for option in ("--junit", "--markdown"):
        assert call("check", "small.toml", option, "pipe") == 2
    assert (folder / "pipe").is_fifo()


def test_a_baseline_never_overwrites_a_file_that_is_none(folder, capsys):
    (folder / "small.json").write_text('{"name": "my settings"}')
    assert call("check", "small.toml", "--baseline", ".", "--update-baseline") == 2
    assert "not a baseline" in capsys.readouterr().out
    assert (folder / "small.json").read_text() == '{"name": "my settings"}'


PATH = "time_s,x,y\n0,0,0\n0.01,1,0\n0.02,2,1\n0.03,1,1\n"
COMPENSATE = ("compensate", "duo_bimorph_static", "path.csv", "--law", "exact_inverse")
RECORD = ("--inputs", "u", "--outputs", "x", "--time", "t", "--dynamics", "none", "--no-figures")
STUDY = SMALL + '[study]\nhow = "product"\nvalues = { "drive.amplitude_v" = [5, 10] }\n'


@pytest.fixture
def outputs(folder):
    """Inputs of every command that writes one file."""
    import numpy as np
    import pandas as pd

    t = np.arange(2000) / 20e3
    u = 10.0 * np.sin(2 * np.pi * 50.0 * t)
    pd.DataFrame({"t": t, "u": u, "x": 2.0 * u + np.random.default_rng(1).normal(0.0, 0.01, len(u))}).to_csv(
        folder / "r.csv", index=False
    )
    (folder / "path.csv").write_text(PATH)
    (folder / "study.toml").write_text(STUDY)
    (folder / "volts.csv").write_text("time_s,x,y\n0,0,0\n0.01,1,0\n0.02,2,1\n")
    assert call("check", "small.toml", "--update-baseline") == 0
    return folder


WRITERS = [
    pytest.param(COMPENSATE, "--out", "time_s,drive_x_v,measured_um\n0,1,2\n", id="compensate"),
    pytest.param(
        (*COMPENSATE, "--table", "csv", "--table-scale", "1"),
        "--out",
        "# Number in the table, by hand\n1\n",
        id="wave table",
    ),
    pytest.param(
        ("play", "duo_bimorph_static", "volts.csv"), "--out", "time_s,played_x_v\n# each by hand\n", id="play"
    ),
    pytest.param(("identify", "r.csv", *RECORD), "--out", '{"format": "hammerstein-model/2"}', id="identify"),
    pytest.param(("sweep", "study.toml"), "--out", "sample,voltage,position\n1,2,3\n", id="sweep"),
    pytest.param(("check", "small.toml"), "--junit", '<a name="hammerstein check"/>', id="junit"),
    pytest.param(
        ("check", "small.toml"), "--markdown", "# Scenarios and their baselines\nmine", id="summary"
    ),
    pytest.param(
        ("check", "small.toml"), "--html", '<meta content="hammerstein check">mine', id="check page"
    ),
]


LATE = [pytest.param(*one.values, id=one.id, marks=pytest.mark.full) for one in WRITERS[4:]]


@pytest.mark.parametrize(("command", "option", "mine"), [*WRITERS[:4], *LATE])
def test_a_file_is_replaced_only_as_it_was_written(outputs, capsys, command, option, mine):
    """What looks like ours is refused, what was edited is kept, and --overwrite replaces both."""
    out = outputs / "out.csv"
    out.write_text(mine)
    before = contents(outputs)
    assert call(*command, option, "out.csv") == 2
    assert "out.csv is a file that this command did not write" in capsys.readouterr().err
    assert contents(outputs) == before
    assert call(*command, option, "out.csv", "--overwrite") == 0
    written = out.read_bytes()
    assert written != mine.encode()
    assert call(*command, option, "out.csv") == 0
    assert out.read_bytes() == written
    out.write_bytes(written + b"my remark\n")
    capsys.readouterr()
    assert call(*command, option, "out.csv") == 0
    assert out.read_bytes() == written
    assert (outputs / "out.csv.edited").read_bytes() == written + b"my remark\n"
    assert "out.csv.edited" in capsys.readouterr().err
    out.write_bytes(b"edited")
    assert call(*command, option, "out.csv", "--overwrite") == 0
    assert out.read_bytes() == written
    assert not list(outputs.glob("*.edited-2"))
    assert not hidden(outputs)


@pytest.mark.parametrize(("command", "option", "mine"), WRITERS)
def test_no_link_is_followed_on_the_way_to_a_file(outputs, tmp_path, capsys, command, option, mine):
    """Neither one with the name of a part, nor one in the folder where parts are made."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "out.csv").write_text("mine")
    for name in (".out.csv.hammerstein-part", ".out.csv.lock"):
        (outputs / name).symlink_to(elsewhere / "out.csv")
    (outputs / ".hammerstein-new").mkdir()
    (outputs / ".hammerstein-new/new").symlink_to(elsewhere)
    (outputs / ".hammerstein-new/journal.part").symlink_to(elsewhere / "out.csv")
    call(*command, option, "out.csv")
    assert contents(elsewhere) == {"out.csv": b"mine"}


def test_a_journal_of_a_stranger_moves_nothing_outside_its_folder(folder, tmp_path, capsys):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    report = folder / "reports/small"
    (report / ".hammerstein-new/new/sub").mkdir(parents=True)
    (report / ".hammerstein-new/new/sub/keys").write_text("theirs")
    (report / "sub").symlink_to(elsewhere)
    coming = {"sub/keys": hashlib.sha256(b"theirs").hexdigest()}
    (report / ".hammerstein-new/journal.json").write_text(json.dumps({"leaving": {}, "coming": coming}))
    assert call("run", "small.toml", "--no-figures") == 2
    assert "through a link" in capsys.readouterr().err
    assert contents(elsewhere) == {}


def test_a_baseline_edited_by_hand_is_kept(folder, capsys):
    check = ("check", "small.toml", "--update-baseline")
    assert call(*check) == 0
    baseline = folder / "reports/baseline/small.json"
    written = baseline.read_text()
    edited = written.replace('_um": ', '_um": 1', 1)
    assert edited != written
    baseline.write_text(edited)
    capsys.readouterr()
    assert call(*check) == 0
    assert baseline.read_text() == written
    assert (folder / "reports/baseline/small.json.edited").read_text() == edited
    assert "small.json.edited" in capsys.readouterr().out
    baseline.write_text(edited)
    assert call(*check, "--overwrite") == 0
    assert len(list(baseline.parent.iterdir())) == 2


def test_an_empty_file_is_written(outputs):
    (outputs / "out.csv").touch()
    assert call(*COMPENSATE, "--out", "out.csv") == 0
    assert not list(outputs.glob("*.edited"))


def test_files_of_one_command_lie_side_by_side(outputs):
    for name in ("a.csv", "b.csv"):
        assert call(*COMPENSATE, "--out", name) == 0
    assert (outputs / "a.csv").read_bytes() == (outputs / "b.csv").read_bytes()


@pytest.mark.parametrize("name", [".hammerstein.json", "a\nb.csv"])
def test_a_name_that_no_file_may_have_is_refused(outputs, capsys, name):
    assert call(*COMPENSATE, "--out", name) == 2
    assert "is not possible as a file name" in capsys.readouterr().err

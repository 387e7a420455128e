"""Exported C gives the numbers of Python's own step, at a cost that is proved."""

import json
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from export_cases import CASES, NAMES, case, marked
from hypothesis import HealthCheck, given, settings, strategies as st, target

from hammerstein.commands.cli import main
from hammerstein.dynamics.linear_block import LinearBlock
from hammerstein.errors import InputError, InternalError, SimulationError, ToleranceError
from hammerstein.export.code import CCode
from hammerstein.export.folder import REQUEST_FILE, check_export, files_of, write_export
from hammerstein.export.operations import Code
from hammerstein.export.request import request_of
from hammerstein.export.trial import FLAGS, build, compiler, worst_case_step
from hammerstein.hysteresis import Preisach
from hammerstein.hysteresis.play_kernels import WINDOW
from hammerstein.model import HammersteinModel

MILLION = 1_000_000

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


WITH_FULL = [marked(name) for name in NAMES]


@cache
def compiled(name):
    """A case and its code, compiled once."""
    code = case(name).code()
    return code, code.library()


def _same_bits(a, b):
    return a.shape == b.shape and (a.view(np.int64) == b.view(np.int64)).all()


@needs_compiler
@pytest.mark.parametrize("name", WITH_FULL)
def test_every_bit_is_that_of_python(name):
    code, library = compiled(name)
    signal = code.adverse(6_000)
    assert _same_bits(library.respond(signal)[0], code.block.respond(signal)[0])


@needs_compiler
@pytest.mark.parametrize("name", ["model", "three inputs model", "decoupled_inverse"])
def test_code_that_turns_all_the_time_and_then_does_not_keeps_every_bit(name):
    """Two samples of three turn, then none for a while: to the form of ``play_kernels`` and back."""
    code, library = compiled(name)
    slow = np.sin(np.arange(3 * WINDOW) / 150.0) * np.ones((code.adverse(1).shape[0], 1))
    loud = np.random.default_rng(4).uniform(-1.0, 1.0, slow.shape)
    signal = 5.0 * np.hstack([slow, loud, slow, loud, slow])
    assert _same_bits(library.respond(signal)[0], code.block.respond(signal)[0])


def test_a_sample_of_a_plane_of_relays_costs_the_same_whatever_its_grid():
    """Operations of a step at most, as they are counted in its C code."""
    export = case("preisach model")
    costs = []
    for cells in (5, 40):
        triangle = np.tril(np.ones((cells, cells)))
        block = Preisach([0.0, 0.0], [100.0, 100.0], [[triangle] * 2] * 2)
        costs.append(replace(export, model=replace(export.model, hysteresis=block)).code().cost.operations)
    assert costs[0] == costs[1]


@needs_compiler
@pytest.mark.parametrize("name", ["preisach model", "preisach exact_inverse"])
@pytest.mark.full
def test_a_staircase_of_more_turns_than_it_holds_keeps_every_bit(name):
    """A ring-down of 400 cycles, then a way through all that it left."""
    code, library = compiled(name)
    ring = np.linspace(1.0, 0.0, 800) * np.where(np.arange(800) % 2, -1.0, 1.0)
    signal = np.append(ring, np.linspace(0.0, 1.0, 200)) * np.ones((2, 1))
    middle, reach = (60.0, 40.0) if name.endswith("model") else (0.0, 5.0)
    signal = middle + reach * signal
    assert _same_bits(library.respond(signal)[0], code.block.respond(signal)[0])


@needs_compiler
@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("exact_inverse", 30_000),
        ("flattening exact_inverse", 10_000),
        ("preisach exact_inverse", 3_000),
        pytest.param("exact_inverse", MILLION, marks=pytest.mark.long),
        pytest.param("hammerstein_inverse", 100_000, marks=pytest.mark.long),
        pytest.param("parallel model", 100_000, marks=pytest.mark.long),
    ],
)
@pytest.mark.full
def test_every_optimisation_of_every_compiler_gives_the_same_bits(name, samples):
    found = [command for command in ("gcc", "clang") if shutil.which(command)]
    if not found:
        pytest.skip("neither gcc nor clang is here")
    code = case(name).code()
    signal = code.adverse(samples)
    wanted = code.block.respond(signal)[0]
    for command in found:
        for level in ("-O0", "-O1", "-O2", "-O3"):
            flags = ("-std=c99", level, "-ffp-contract=off")
            with code.library(command=command, flags=flags) as library:
                assert _same_bits(library.respond(signal)[0], wanted), (command, level)


@needs_compiler
def test_the_comparison_notices_another_number():
    """Code for another range."""
    code, _ = compiled("exact_inverse")
    signal = code.adverse(4000)
    wanted = code.block.respond(signal)[0]
    other = case("exact_inverse").code(range_v=(-9.0, 10.0))
    with other.library() as library:
        assert not _same_bits(library.respond(signal)[0], wanted)


@needs_compiler
def test_a_run_in_pieces_is_a_run():
    """The structure holds all memory: steps from where it stands give the numbers of one go."""
    code, library = compiled("filtered")
    signal = code.adverse(4000)
    law = library.rest()
    parts = [library.respond(part, law)[0] for part in np.array_split(signal, 7, axis=1)]
    assert _same_bits(np.hstack(parts), library.respond(signal)[0])


@needs_compiler
@pytest.mark.parametrize("name", [marked(export.name) for export in CASES if export.law != "model"])
def test_the_voltages_stay_in_the_range(name):
    code, library = compiled(name)
    limits = code.block.range
    wild = 1e3 * code.adverse(4000)
    drive = library.respond(wild)[0]
    assert (drive >= limits.low_v[:, None]).all()
    assert (drive <= limits.high_v[:, None]).all()


@needs_compiler
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2e9])
def test_a_number_that_is_none_changes_nothing(bad):
    code, library = compiled("exact_inverse")
    signal = code.adverse(300)
    spoilt = np.insert(signal, 150, [bad, 1.0], axis=1)
    plain, with_bad = library.respond(signal)[0], library.respond(spoilt)[0]
    assert _same_bits(np.delete(with_bad, 150, axis=1), plain)
    assert (with_bad[:, 150] == with_bad[:, 149]).all()


# ---- what a step costs ----


@needs_compiler
@pytest.mark.parametrize(
    "name",
    [
        *("exact_inverse", "inverse_multiplicative", "three inputs exact_inverse", "model"),
        *("asymmetric model", "asymmetric exact_inverse", "rate-dependent model"),
        *("flattening exact_inverse", "bouc-wen passes", "parallel model"),
    ],
)
@pytest.mark.full
def test_no_signal_costs_more_than_the_bound(name, record_property):
    """Adverse signals, looked for by their cost."""
    code = case(name).code()
    scale = np.abs(code.adverse(2000)).max(axis=1)
    worst = [0]
    with code.library(counting=True) as library:
        # no database: to keep its best examples in order takes three times as long as to look for them
        @settings(max_examples=150, suppress_health_check=list(HealthCheck), database=None)
        @given(st.lists(st.tuples(*[st.integers(-50, 50)] * len(scale)), min_size=1, max_size=60))
        def search(levels):
            signal = scale[:, None] * np.array(levels, dtype=float).T / 40.0
            operations = library.respond(signal)[1]
            target(float(operations))
            worst[0] = max(worst[0], operations)
            assert operations <= code.cost.operations

        search()
        told, _ = worst_case_step(lambda signal: library.respond(signal)[1], scale)
    record_property("worst step", worst[0])
    assert 0.9 * worst[0] < told <= code.cost.operations  # what an export reports is no smaller story


@needs_compiler
def test_counting_changes_no_number():
    code, plain = compiled("exact_inverse")
    signal = code.adverse(4000)
    with code.library(counting=True) as counting:
        drive, operations = counting.respond(signal)
        assert _same_bits(drive, plain.respond(signal)[0])
    assert 100 < operations <= code.cost.operations


def test_operations_are_counted_as_they_are_written():
    """A step of three turns of two operations, and a branch of which the dearer one counts."""
    header = "typedef struct { double a; int32_t n; } law;"
    step = """
    void law_step(law *l, double x)
    {
      for (int32_t i = 0; i < 3; i++) { l->a = l->a + x; }
      if (x > 0.0) { l->a = x; } else { l->a = x * x; }
    }"""
    # declaration 1, comparison 4, counter 3 x 2, body 3 x 2, comparison 1, dearer branch 2
    cost = Code("law", header, step).cost()
    assert (cost.operations, cost.state_bytes) == (1 + 4 + 6 + 6 + 1 + 2, 16)


@pytest.mark.parametrize(
    ("body", "word"),
    [
        ("while (x > 0.0) { x = x - 1.0; }", "While"),
        ("law_step(l, x);", "calls itself"),
        ("x = sin(x);", "sin is not in the file"),
        ("for (int32_t i = 0; i < l->n; i++) { x = 1.0; }", "end is not a constant"),
        ("for (int32_t i = 0; i < 3; i++) { i = 0; }", "no bound"),
    ],
)
def test_code_without_a_bound_is_refused(body, word):
    header = "typedef struct { double a; int32_t n; } law;"
    with pytest.raises(InternalError, match=word):
        Code("law", header, f"void law_step(law *l, double x) {{ {body} }}").cost()


@needs_compiler
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.full
def test_the_bytes_are_those_of_the_compiler(name):
    """Numbers of every size are aligned as the compiler does it."""
    code, library = compiled(name)
    assert library.state_bytes == code.cost.state_bytes


# ---- the folder ----


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """An export; nothing changes it."""
    export, out = case("exact_inverse"), tmp_path_factory.mktemp("export") / "out"
    write_export(export.request(), export.model, out)
    return out


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


@pytest.mark.full
@needs_compiler
def test_the_folder_tests_itself(folder):
    done = subprocess.run(["make", "check"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "warning" not in done.stderr
    golden = (folder / "golden.csv").read_text()
    assert len(golden.splitlines()) == 1 + 2000  # as the guide says
    last = golden.rstrip().rpartition(",")
    (folder / "golden.csv").write_text(f"{last[0]},{float(last[2]) + 1e-12!r}\n")
    assert subprocess.run(["make", "check"], cwd=folder, capture_output=True, check=False).returncode != 0


def test_the_makefile_has_five_lines_and_the_readme_one_screen(written):
    assert len((written / "Makefile").read_text().splitlines()) == 5
    assert len((written / "README.md").read_text().splitlines()) < 50


def test_no_allocation_and_no_mathematical_library(written):
    source = (written / "duo_bimorph_exact_inverse.c").read_text()
    assert set(re.findall(r"#include (\S+)", source)) == {'"duo_bimorph_exact_inverse.h"'}
    assert set(re.findall(r"#include (\S+)", (written / "duo_bimorph_exact_inverse.h").read_text())) == {
        "<stdint.h>"
    }
    assert not re.search(r"malloc|calloc|free\(|goto|while", re.sub(r"/\*.*?\*/", "", source, flags=re.S))


def test_an_export_is_made_again_and_compared(folder):
    assert len(check_export(folder)) == 8
    source = folder / "duo_bimorph_exact_inverse.c"
    source.write_text(source.read_text().replace("threshold[2][15]", "threshold[2][16]"))
    with pytest.raises(ToleranceError, match=r"duo_bimorph_exact_inverse.c differs from line \d+ on"):
        check_export(folder)
    source.unlink()
    with pytest.raises(ToleranceError, match="is missing"):
        check_export(folder)


def test_an_export_of_a_changed_model_differs(folder):
    model = json.loads((folder / "model.json").read_text())
    model["hysteresis"]["pairs"][0][0]["weights_um_per_v"][0] *= 1.0 + 1e-9
    (folder / "model.json").write_text(json.dumps(model))
    with pytest.raises(ToleranceError, match=r"golden\.csv"):
        check_export(folder)


@needs_compiler
def test_single_precision_says_what_it_loses(tmp_path):
    export = case("exact_inverse")
    write_export(export.request(float32=True), export.model, tmp_path)
    source = (tmp_path / "duo_bimorph_exact_inverse.c").read_text()
    code = re.sub(r"/\*.*?\*/", "", source, flags=re.S)
    constants = list(re.finditer(r"\d+\.\d*(?:e[-+]?\d+)?|\d+e[-+]?\d+", code))
    assert constants
    assert all(code[found.end()] == "f" for found in constants)  # none in double precision is left
    measured = json.loads((tmp_path / REQUEST_FILE).read_text())["measured"]
    assert 1e-8 < measured["loss_rms"] <= measured["loss_max"] < 1e-3
    assert f"{measured['loss_max']:.2g} V at most" in " ".join(source.split())
    golden = tmp_path / "golden.csv"
    rows = golden.read_text().splitlines()
    for text, code in ((rows, 0), ([*rows[:-1], re.sub(r"[^,]+$", "50.0", rows[-1])], 2)):  # the last drive
        golden.write_text("\n".join(text) + "\n")
        done = subprocess.run(["make", "check"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stdout + done.stderr


def test_single_precision_without_a_compiler_is_refused(monkeypatch):
    monkeypatch.setattr("hammerstein.export.folder.compiler", lambda: None)
    with pytest.raises(InputError, match="needs a C compiler"):
        files_of(case("none").code(float32=True))
    said = files_of(case("none").code())["duo_bimorph_none.c"]
    assert "there was no C compiler" in said


def test_what_cannot_be_exported_is_refused():
    export = case("exact_inverse")
    for law, word in (("feedback", "readings"), ("nonesuch", "nonesuch")):
        with pytest.raises(InputError, match=word):
            export.request().model_copy(update={"law": law}).block(export.model)
    with pytest.raises(InputError, match="takes no options"):
        export.request(options={"softening_v": 1.0}).model_copy(update={"law": "model"}).block(export.model)
    request = export.request(options={"gain": "identity"}).model_copy(
        update={"law": "inverse_multiplicative"}
    )
    with pytest.raises(SimulationError, match="does not converge"):
        request.block(export.model)


def test_a_kind_of_hysteresis_without_code_is_refused_by_name():
    from hammerstein.export import c_block_of

    class Bouc:
        kind = "bouc_wen"

    with pytest.raises(InputError, match="bouc_wen"):
        c_block_of(Bouc(), None)


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    return caught.value.code or 0


def test_the_command(tmp_path, capsys):
    out = str(tmp_path / "out")
    law = ("--law", "hammerstein_inverse", "--preview-s", "0", "--range=-9,9", "--sample-time", "1e-4")
    assert _call("export", "duo_bimorph", *law, "--out", out) == 0
    assert "sample time 100 us" in capsys.readouterr().out
    assert _call("export", "--check", out) == 0
    (tmp_path / "out" / "README.md").write_text("other\n")
    assert _call("export", "--check", out) == 1
    assert "README.md" in capsys.readouterr().err
    for wrong in (["export"], ["export", "duo_bimorph"], ["export", "--check", str(tmp_path / "nowhere")]):
        assert _call(*wrong) == 2
    assert _call("export", "duo_bimorph", "--format", "rust", "--out", out) == 2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sample-time", "nan"], "--sample-time  must be 1e-9 to 10000"),
        (["--range", "nan"], "--range  must be -1e6 to 1e6"),
        (["--start", "1e9"], "--start  must be -1e6 to 1e6"),
        (["--law", "nonsense"], "--law  'nonsense' is not one of"),
    ],
)
def test_a_refused_option_is_named(tmp_path, capsys, options, said):
    assert _call("export", "duo_bimorph", "--out", str(tmp_path / "out"), *options) == 2
    assert said in capsys.readouterr().err


def test_the_preview_has_one_name(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("hammerstein.export.folder.compiler", lambda: None)  # no search for the dearest step
    given = ("export", "duo_bimorph", "--law", "hammerstein_inverse", "--out", str(tmp_path / "out"))
    assert _call(*given) == 0
    said = capsys.readouterr().out
    assert "the reference of sample k - 1: call step once" in said
    assert _call(*given, "--preview-s", "0.0") == 0
    assert "the reference of sample k" not in capsys.readouterr().out
    for command in ("export", "compensate"):
        assert _call(command, "--help") == 0
        said = capsys.readouterr().out
        assert "--preview-s" in said
        assert "--preview " not in said


def test_flags_say_no_fused_multiply_adds():
    assert "-ffp-contract=off" in FLAGS


@pytest.mark.parametrize(
    ("law", "model", "told"),
    [
        ("exact_inverse", "duo_bimorph", True),
        ("inverse_multiplicative", "duo_bimorph", True),
        ("exact_inverse", "duo_bimorph_static", False),
        ("hammerstein_inverse", "duo_bimorph", False),
    ],
)
def test_a_law_that_takes_the_dynamics_for_none_says_what_that_leaves(law, model, told):
    request, loaded = request_of(model, law, None)
    said = [
        text
        for text in CCode(request, loaded, request.block(loaded)).statements()
        if "ignores the dynamics" in text
    ]
    assert len(said) == told
    for text in said:
        first, second = (float(hertz) for hertz in re.findall(r"from ([\d.e+]+) Hz on", text))
        for share, hertz in ((0.01, first), (0.1, second)):
            r, zeta = hertz / 280.0, loaded.dynamics.axes[0].damping_ratio
            lag = abs(np.exp(-0.5j * 2 * np.pi * hertz * 50e-6) / (1.0 - r**2 + 2j * zeta * r) - 1.0)
            assert lag == pytest.approx(share, rel=0.3)


def test_a_full_temporary_folder_is_no_fault_of_the_code(tmp_path, monkeypatch, capsys):
    """A compiler that says what gcc says on a full disk; its words do not depend on the language."""
    full = tmp_path / "cc"
    full.write_text('#!/bin/sh\necho "law.c: fatal error: $LC_ALL: No space left on device" >&2\nexit 1\n')
    full.chmod(0o755)
    monkeypatch.setenv("CC", str(full))
    monkeypatch.setenv("LC_ALL", "de_DE")
    with pytest.raises(SystemExit) as ended:
        main(["export", "duo_bimorph_static", "--law", "exact_inverse", "--out", str(tmp_path / "code")])
    assert ended.value.code == 2
    assert "is full" in capsys.readouterr().err
    assert not (tmp_path / "code").exists()


def test_the_compiler_works_in_the_temporary_folder_that_is_there(tmp_path, monkeypatch):
    """A folder that cannot be used is passed by, and the one that is told as full is the one that was."""
    seen = tmp_path / "seen"
    cc = tmp_path / "cc"
    cc.write_text(f'#!/bin/sh\necho "$TMPDIR" > {seen}\n')
    cc.chmod(0o755)
    monkeypatch.setenv("TMPDIR", str(tmp_path / "nowhere"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    build([], command=str(cc))
    assert seen.read_text().strip() == tempfile.gettempdir() != str(tmp_path / "nowhere")


def test_axes_whose_names_are_one_word_have_columns_of_their_own(tmp_path):
    """Blanks become underscores in a file: two variables of an FMU would have one name."""
    content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    content |= {"inputs": ["a b", "a_b"], "outputs": ["c,", "c"]}
    (tmp_path / "m.json").write_text(json.dumps(content))
    model = HammersteinModel.load(tmp_path / "m.json")
    assert (model.inputs, model.outputs) == (("a b", "a_b_2"), ("c,", "c_2"))
    assert HammersteinModel.from_json(model.to_json()).inputs == model.inputs
    line = ["export", str(tmp_path / "m.json"), "--law", "exact_inverse", "--sample-time", "1e-4"]
    with pytest.raises(SystemExit) as ended:
        main([*line, "--format", "fmu", "--out", str(tmp_path / "unit")])
    assert not ended.value.code
    text = (tmp_path / "unit" / "modelDescription.xml").read_text()
    variables = ElementTree.fromstring(text).iterfind("ModelVariables/*")
    names = [variable.get("name") for variable in variables]
    assert len(set(names)) == len(names) >= 4
    head = (tmp_path / "unit" / "golden.csv").read_text().partition("\n")[0].split(",")
    assert len(set(head)) == 4


def test_an_export_that_says_nothing_of_what_single_precision_loses_is_refused(tmp_path, capsys):
    request, model = request_of("duo_bimorph_static", "exact_inverse", 5e-5)
    write_export(request, model, tmp_path / "code")
    place = tmp_path / "code" / REQUEST_FILE
    content = json.loads(place.read_text())
    content["request"]["float32"] = True
    place.write_text(json.dumps(content))
    with pytest.raises(SystemExit) as ended:
        main(["export", "--check", str(tmp_path / "code")])
    assert ended.value.code == 2
    assert "float32" in capsys.readouterr().err


def test_dynamics_without_a_gain_at_rest_lag_without_bound():
    """A washout passes no constant voltage: G(1) has no inverse."""
    washout = LinearBlock([[0.9]], [[1.0]], [[-0.1]], [[1.0]], 5e-5)  # G(z) = (z - 1) / (z - 0.9)
    assert washout.response([0.0])[0, 0, 0] == pytest.approx(0.0, abs=1e-12)
    assert np.isinf(washout.lag([10.0, 100.0])).all()

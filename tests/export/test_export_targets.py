"""Exported C on other processors, under the sanitizers and before a checker, where each is installed."""

import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pytest
from export_cases import case

from hammerstein.export.code import MeasuredCode
from hammerstein.export.folder import files_of

pytestmark = pytest.mark.full

BOARD = Path(__file__).parents[1] / "cortex_m4"
EXPORTS = (
    *("filtered", "decoupled_inverse", "started exact_inverse", "asymmetric exact_inverse"),
    *("flattening hammerstein_inverse", "bouc-wen passes", "parallel model"),
    *("saturating exact_inverse", "preisach exact_inverse", "loop model", "curved loop model"),
    *("preisach in a loop", "bouc_wen twice in a loop"),
)
REPEATED = ("inverse_multiplicative", "model", "asymmetric model behind plays")
"""Their code stands in that of the passes and of the model of all kinds, too."""
FUSED = ("filtered", "bouc-wen passes", "parallel model")
LEFT = {
    "2.4": "constants are anonymous enumerations, which have no tag to use",
    "8.7": "functions of the interface need external linkage",
    "8.9": "tables are grouped at the top with their meaning",
    "10.6": "a comparison selects an integer 0, 1 or 2; the checker takes this for a composite expression",
    "14.1": "loops with a constant bound may end earlier by a comparison",
}
"""Rules of MISRA C:2012 that the code does not keep by the checker's reading, each with its reason."""


def needs(*programs):
    missing = [program for program in programs if shutil.which(program) is None]
    return pytest.mark.skipif(bool(missing), reason=f"not installed: {', '.join(missing)}")


@pytest.fixture(
    scope="module", params=[*EXPORTS, *(pytest.param(name, marks=pytest.mark.long) for name in REPEATED)]
)
def folder(request, tmp_path_factory):
    """All files of an export; nothing is measured for the words about its cost."""
    place = tmp_path_factory.mktemp("export")
    for name, content in files_of(case(request.param).code(), MeasuredCode()).items():
        (place / name).write_text(content)
    return place


def _law(folder):
    return next(path for path in folder.glob("*.c") if path.name != "selftest.c")


def _run(*command, folder, timeout=300):
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


@needs("aarch64-linux-gnu-gcc", "qemu-aarch64")
def test_every_bit_agrees_on_aarch64(folder):
    flags = ("-std=gnu99", "-O2", "-static", "-ffp-contract=off")
    _run("aarch64-linux-gnu-gcc", *flags, "-o", "arm64", "selftest.c", _law(folder).name, folder=folder)
    assert " 0 numbers differ" in _run("qemu-aarch64", "./arm64", folder=folder).stdout


@needs("aarch64-linux-gnu-gcc", "qemu-aarch64")
@pytest.mark.parametrize("folder", FUSED, indirect=True)
def test_fused_multiply_adds_are_noticed(folder):
    """Without the flag that the Makefile sets, a processor that fuses gives other bits."""
    flags = ("-std=gnu99", "-O2", "-static", "-ffp-contract=fast")
    _run("aarch64-linux-gnu-gcc", *flags, "-o", "fused", "selftest.c", _law(folder).name, folder=folder)
    done = subprocess.run(
        ["qemu-aarch64", "./fused"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stdout


@needs("arm-none-eabi-gcc", "qemu-system-arm")
def test_every_bit_agrees_on_a_cortex_m4_without_floating_point(folder):
    core = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=soft")
    asked = ("arm-none-eabi-gcc", *core, "-print-file-name=rdimon-crt0.o")
    begin = _run(*asked, folder=folder).stdout.strip()
    if not Path(begin).exists():
        pytest.skip("newlib for arm-none-eabi is not installed")
    flags = ("-std=c99", "-O2", "-ffp-contract=off", "--specs=rdimon.specs", "-nostartfiles")
    linked = ("-T", str(BOARD / "board.ld"), str(BOARD / "start.c"), "selftest.c", _law(folder).name, begin)
    _run("arm-none-eabi-gcc", *core, *flags, "-o", "m4.elf", *linked, folder=folder)
    host = "enable=on,target=native,arg=selftest,arg=golden.csv"
    board = ("-M", "mps2-an386", "-nographic", "-semihosting-config", host, "-kernel", "m4.elf")
    assert " 0 numbers differ" in _run("qemu-system-arm", *board, folder=folder).stdout


@needs("gcc")
def test_no_access_outside_and_nothing_undefined(folder):
    flags = ("-std=c99", "-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    done = subprocess.run(
        ["gcc", *flags, "-ffp-contract=off", "-o", "sane", "selftest.c", _law(folder).name],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "cannot find" in done.stderr:
        pytest.skip("the sanitizers are not installed")
    assert done.returncode == 0, done.stderr
    _run("./sane", folder=folder)


@needs("gcc")
def test_no_compiler_warns(folder):
    flags = ("-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror")
    for command in filter(shutil.which, ("gcc", "clang")):
        _run(command, "-std=c99", *flags, "-c", _law(folder).name, "-o", "law.o", folder=folder)


@needs("cppcheck")
def test_what_the_checker_finds_has_a_reason(folder):
    options = ("--std=c99", "--enable=warning,portability,performance", "--addon=misra", "--quiet")
    told = ("--suppress=missingIncludeSystem", "--template={id}:{line}")
    done = subprocess.run(
        ["cppcheck", *options, *told, _law(folder).name],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if "Did not find addon" in done.stdout + done.stderr:
        pytest.skip("cppcheck has no MISRA add-on here")
    found = Counter(line.partition(":")[0] for line in done.stderr.splitlines() if ":" in line)
    assert {name for name in found if not name.startswith("misra-c2012-")} == set()
    assert {name.removeprefix("misra-c2012-") for name in found} <= set(LEFT)


def test_the_guide_gives_the_reasons():
    guide = (Path(__file__).parents[2] / "hammerstein" / "guide" / "deploy.md").read_text(encoding="utf-8")
    assert all(re.search(rf"\| {re.escape(rule)} \| {reason} \|", guide) for rule, reason in LEFT.items())

"""What is printed, on any terminal, into any file, and to nobody."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from hammerstein.commands.terminal import Spinner, hush

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="closed and full files are made by a shell")

ODD = """
question = "円は [bold]丸い[/bold] か?"
actuator = "duo_bimorph_static"
[reference]
kind = "sine"
amplitude_um = 15
frequency_hz = 50
[[compensators]]
label = "逆 [red]a[/red] \\u001b[31m \\u202e"
law = "exact_inverse"
model = "duo_bimorph_static"
"""
RUN = ("run", "odd.toml", "--no-figures")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.toml").write_text(ODD, encoding="utf-8")
    return tmp_path


def shell(redirection, *arguments, **environment):
    command = f'exec "{sys.executable}" -m hammerstein "$@" {redirection}'
    done = subprocess.run(
        ["bash", "-c", command, "bash", *arguments],
        capture_output=True,
        env=os.environ | environment,
        check=False,
        timeout=100,
    )
    lines = done.stderr.splitlines(keepends=True)
    done.stderr = b"".join(line for line in lines if not line.startswith(b"compiling "))  # the first time
    return done


@pytest.mark.full
@pytest.mark.parametrize(
    "encoding", ["cp1252", *(pytest.param(e, marks=pytest.mark.long) for e in ("ascii", "utf-8"))]
)
def test_characters_that_a_terminal_lacks(folder, encoding):
    done = shell("", *RUN, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"1 of 1 reports" in done.stdout
    assert b"[red]a[/red]" in done.stdout
    assert b"\x1b" not in done.stdout
    assert ("逆" in done.stdout.decode(encoding)) == (encoding == "utf-8")


def test_an_error_message_gives_the_terminal_no_orders(folder):
    (folder / "\x1b[31mred.toml").write_text("", encoding="utf-8")
    done = shell("", "run", "\x1b[31mred.toml")
    assert done.returncode == 2
    assert b"\x1b" not in done.stderr
    assert rb"\x1b[31mred" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [RUN, ("actuators",), ("schema",), ("--help",), pytest.param((*RUN, "--json"), marks=pytest.mark.long)],
)
@pytest.mark.full
def test_output_that_cannot_be_written_is_one_message(folder, arguments):
    done = shell("> /dev/full", *arguments)
    assert done.returncode == 2
    assert done.stderr == b"the output cannot be written (no space left on device)\n"


@pytest.mark.parametrize(
    "redirection",
    [
        "2>/dev/full",
        "<&- >&- 2>&-",
        *(pytest.param(r, marks=pytest.mark.long) for r in ("2>&-", ">&-", ">&- 2>&-")),
    ],
)
@pytest.mark.full
def test_streams_that_nobody_reads_change_nothing(folder, redirection):
    assert shell(redirection, *RUN).returncode == 0
    assert json.loads((folder / "reports/odd/report.json").read_text())["name"] == "odd"
    assert shell(redirection, "run", "missing.toml").returncode == 2


@pytest.mark.full
def test_a_reader_who_has_seen_enough_is_no_mistake(folder):
    done = shell("| true; exit ${PIPESTATUS[0]}".replace("exec", ""), "schema")
    assert done.returncode in (0, 2)
    assert b"Traceback" not in done.stderr
    reading, writing = os.pipe()
    os.close(reading)
    with subprocess.Popen(
        [sys.executable, "-m", "hammerstein", "schema"], stdout=writing, stderr=subprocess.PIPE
    ) as process:
        os.close(writing)
        assert process.communicate()[1] == b""
    assert process.returncode == 0


# What the interpreter does before our first line, loading it included, answers a signal in its own way. On a
# busy machine that line may come late: it says itself when it is done.
OURS = """
import sys
from hammerstein import __main__ as ours

def begin(first=ours.end_when_asked):
    first()
    print(file=sys.stderr, flush=True)

sys.argv[0], ours.end_when_asked = "hammerstein", begin
ours.main()
"""


@pytest.mark.parametrize(
    ("number", "wait_s"),
    [
        *((signal.SIGINT, wait_s) for wait_s in (0.015, 0.06, 0.2, 0.8)),
        *(pytest.param(signal.SIGINT, wait_s, marks=pytest.mark.full) for wait_s in (0.03, 0.1, 0.4)),
        *((signal.SIGTERM, wait_s) for wait_s in (0.03, 0.4)),  # the same handler
        *(
            pytest.param(signal.SIGTERM, wait_s, marks=pytest.mark.long)
            for wait_s in (0.015, 0.06, 0.1, 0.2, 0.8)
        ),
    ],
)
def test_ctrl_c_is_one_line_from_our_first_line_on(folder, number, wait_s):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", OURS, *RUN], **pipes) as process:
        process.stderr.readline()
        time.sleep(wait_s)
        process.send_signal(number)
        _, error = process.communicate(timeout=60)
    if process.returncode != 0:  # it may have been quicker
        assert error == "interrupted; finished files are kept, and nothing is half-written\n"
        assert process.returncode == 130


def test_what_a_library_makes_of_ctrl_c_is_ctrl_c_still():
    """An extension that is being imported turns it into an ImportError."""
    code = """
import signal, time
from hammerstein.__main__ import main
from hammerstein.commands import cli

def imported(*_, **__):
    try:
        signal.raise_signal(signal.SIGINT)
        time.sleep(60.0)
    except BaseException as error:
        raise ImportError("initialization failed") from error

cli.built = lambda words: imported
main()
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert found.returncode == 130
    assert found.stderr == "interrupted; finished files are kept, and nothing is half-written\n"


def test_a_file_is_told_once_a_minute_what_is_done(capsys, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    with Spinner("comparing") as spinner:
        spinner.tell("a")
        now[0] += 61.0
        spinner.tell("b")
        spinner.tell("c")
    assert capsys.readouterr().err == "comparing\nb\n"
    with Spinner():
        pass
    hush(True)
    try:
        with Spinner("comparing"):
            pass
    finally:
        hush(False)
    assert capsys.readouterr().err == ""

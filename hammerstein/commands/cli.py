"""The command line. Its output goes through ``terminal``."""

from __future__ import annotations

import io
import json
import os
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands import (
    comparing,
    degaussing,
    export as export_command,
    records as record_commands,
    scenarios,
    start,
    study as study_commands,
    terminal,
)
from hammerstein.commands.record_options import AsJson
from hammerstein.commands.terminal import complain, show, tell, tell_json
from hammerstein.errors import SimulationError

if TYPE_CHECKING:
    from typer.models import CommandInfo


SMALLEST_BYTES = 1e9
"""Addresses that a command takes: with 0.7 GB `compensate` and `identify` fail in a library, with this
they run."""


def refuse_small_limit() -> None:
    """Refuse to start under a limit on addresses (``ulimit -v``) in which the libraries cannot load.

    OpenBLAS would spin inside its own loader, where no signal reaches Python.

    Raises SimulationError with the limit and the least one that works.
    """
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:
        return  # Windows has no such limit
    limit = getrlimit(RLIMIT_AS)[0]
    if limit != RLIM_INFINITY and limit < SMALLEST_BYTES:
        raise SimulationError(
            f"memory is limited to {limit / 1e6:.0f} MB (ulimit -v), and the numeric libraries need "
            f"{SMALLEST_BYTES / 1e6:.0f} MB; raise the limit"
        )


app = typer.Typer(
    name="hammerstein",
    help="Simulate, identify and compensate multi-axis actuators with hysteresis.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _example(command: str) -> str:
    """Text below the options of a command: an example that works in a folder made by ``init``."""
    return f"\b\nExample: hammerstein {command}"  # \b: not to be broken into several lines


COLUMNS = "--inputs u_x,u_y --outputs x,y --time time_s"
SHORT = {
    "init": "Create a working folder with an example.",
    "guide": "Read the guide.",
    "show": "Print the content of a file.",
    "loops": "Measure hysteresis loops in records.",
    "identify": "Identify a model from records and report its errors.",
    "compare": "Fit every kind of model to records and recommend one.",
    "compensate": "Compute the voltages that follow a path.",
    "play": "Simulate a model's response to voltages.",
    "degauss": "Write a drive that erases an actuator's history.",
    "export": "Export a law or a model as C code or as an FMU.",
    "run": "Run scenarios and write their reports.",
    "sweep": "Run a scenario for many values of its keys.",
    "check": "Compare scenarios with their accepted numbers.",
    "plot": "Draw the figures of one scenario.",
    "actuators": "List the packaged actuators.",
    "schema": "Print the JSON Schema of scenario files.",
}
"""Every command in a line, in the order of a person's work."""
USAGE: Any = typer.BadParameter.__base__
"""What a command line that is no command line raises; Typer has it from click, or has click inside."""
PRINTED = ("schema", "actuators", "show", "guide")
"""Commands that are asked for what they print, however quiet they are to be."""


def _say_version(wanted: bool) -> None:
    if wanted:
        import hammerstein

        tell(f"hammerstein {hammerstein.__version__}")
        raise typer.Exit


@app.callback()
def _before(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_say_version, help="Print the version.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only errors, warnings and --json output.")
    ] = False,
) -> None:
    """Options before a command."""
    terminal.hush(quiet and context.invoked_subcommand not in PRINTED)
    refuse_small_limit()


def _register() -> None:
    """Register every command, in the order of a person's work."""
    app.command(epilog=_example("run circle.toml"))(scenarios.run)
    app.command(epilog=_example("check . --html check.html"))(scenarios.check)
    app.command(epilog=_example("schema > scenario.schema.json"))(schema)
    app.command(epilog=_example("actuators"))(actuators)
    app.command(epilog=_example("plot circle.toml"))(scenarios.plot)
    records = f"record_x.csv record_y.csv {COLUMNS}"
    app.command(epilog=_example(f"loops {records}"))(record_commands.loops)
    app.command(epilog=_example(f"identify {records} --out own.json"))(record_commands.identify)
    quick = "--operators 8 --dynamics second_order"
    app.command(epilog=_example(f"compare {records} {quick}"))(comparing.compare)
    app.command(epilog=_example("compensate stage.json path.csv --out drive.csv"))(record_commands.compensate)
    app.command(epilog=_example("export stage.json --law exact_inverse --out c_code"))(export_command.export)
    app.command(epilog=_example("sweep circle.toml --out rows.csv"))(study_commands.sweep)
    app.command(epilog=_example("play stage.json drive.csv --out played.csv"))(start.play)
    app.command(epilog=_example("degauss stage.json --out degauss.csv"))(degaussing.degauss)
    app.command(epilog=_example("init my_stage"))(start.init)
    app.command(epilog=_example("show stage.json"))(start.show)
    app.command(epilog=_example("guide start"))(start.guide)
    for command in app.registered_commands:
        command.short_help = SHORT[_name(command)]
    app.registered_commands.sort(key=lambda command: list(SHORT).index(_name(command)))


def _name(command: CommandInfo) -> str:
    assert command.callback is not None
    return command.name or command.callback.__name__


def _one_thread_a_job() -> None:
    """Let the jobs be the parallelism: the linear algebra is small, and its sums then depend on nothing."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read when numpy is imported, which it is not yet


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; a mistake of the user is one message and an exit code, never a traceback."""
    terminal.make_ready()
    _one_thread_a_job()
    sys.exit(_exit_code(arguments))


def _exit_code(arguments: list[str] | None) -> int | str | None:
    """Exit code of the command; its mistake has been told."""
    code: int | str | None = 0
    try:
        try:
            code = app(arguments, standalone_mode=False) or 0
        except SystemExit as end:
            code = end.code
        except USAGE as mistake:
            code = mistake.exit_code
            complain(_message_of(mistake))
        except OSError as error:
            if error.filename is not None:
                raise
            terminal.nobody_listens(error)  # a library has printed: our own files are opened by name
        terminal.settle()
    except Exception as error:
        from hammerstein.runtime.faults import as_error

        told = as_error(error)
        complain(str(told))
        return told.exit_code
    return code


def _message_of(mistake: Any) -> str:
    """Message of the parser about a command line, made safe to print."""
    said = io.StringIO()
    mistake.show(file=said)
    return said.getvalue().rstrip()


def schema() -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from hammerstein.plugins import load_plugins
    from hammerstein.scenario import Scenario

    load_plugins()
    tell_json(Scenario.model_json_schema(), indent=1, sort_keys=True)


def actuators(as_json: AsJson = False) -> None:
    """List the packaged actuators."""
    from hammerstein.commands.terminal_tables import actuator_table
    from hammerstein.model import HammersteinModel, packaged_actuators

    models = [HammersteinModel.load(name) for name in packaged_actuators()]
    if as_json:
        tell_json([json.loads(model.to_json()) for model in models])
    else:
        show(actuator_table(models))


_register()

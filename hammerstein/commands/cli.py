"""The command line. Its output goes through ``terminal``."""

import io
import json
import os
import sys
from collections.abc import Callable, Collection
from typing import Annotated, Any

import typer

from hammerstein.commands import driving, records as record_commands, scenarios, start, terminal
from hammerstein.commands.options import AsJson, grouped
from hammerstein.commands.terminal import complain, show, tell, tell_json
from hammerstein.errors import SimulationError
from hammerstein.runtime.resources import keep_freed_memory

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


COLUMNS = "--inputs u_x,u_y --outputs x,y --time time_s"
USAGE: Any = typer.BadParameter.__base__
"""Errors of a wrong command line; Typer takes them from click, or has click inside."""
COMPLETION = "_HAMMERSTEIN_COMPLETE"
"""Variable in which a shell asks for completions."""
PRINTED = ("schema", "actuators", "show", "guide")
"""Commands whose purpose is their output, even with --quiet."""


def _say_version(wanted: bool) -> None:
    if wanted:
        import hammerstein

        tell(f"hammerstein {hammerstein.__version__}")
        raise typer.Exit


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


def _named(command: Callable[..., None]) -> Callable[..., None]:
    """Name and help of a command that is not called; to make its options would take longer than all else."""

    def alone() -> None: ...

    alone.__name__, alone.__doc__ = command.__name__, command.__doc__
    return alone


def built(words: Collection[str] | None = None) -> typer.Typer:
    """Every command with an example, in the order of a person's work.

    words : of a command line; only commands among them get their options
    """
    app = typer.Typer(
        name="hammerstein",
        help="Simulate, identify and compensate multi-axis actuators with hysteresis.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
        callback=_before,
    )
    records = f"record_x.csv record_y.csv {COLUMNS}"
    for command, example in (
        (start.init, "init my_stage"),
        (start.guide, "guide start"),
        (start.show, "show stage.json"),
        (record_commands.loops, f"loops {records}"),
        (record_commands.identify, f"identify {records} --out own.json"),
        (record_commands.compare, f"compare {records} --operators 8 --dynamics second_order"),
        (driving.compensate, "compensate stage.json path.csv --out drive.csv"),
        (driving.play, "play stage.json drive.csv --out played.csv"),
        (driving.degauss, "degauss stage.json --out degauss.csv"),
        (driving.export, "export stage.json --law exact_inverse --out c_code"),
        (scenarios.run, "run circle.toml"),
        (scenarios.sweep, "sweep circle.toml --out rows.csv"),
        (scenarios.check, "check . --html check.html"),
        (scenarios.plot, "plot circle.toml"),
        (actuators, "actuators"),
        (schema, "schema > scenario.schema.json"),
    ):
        wanted = words is None or command.__name__ in words
        # \b: not to be broken into several lines
        app.command(epilog=f"\b\nExample: hammerstein {example}")((grouped if wanted else _named)(command))
    return app


def __getattr__(name: str) -> typer.Typer:
    """The application ``app`` with all its options, where somebody asks for it."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return built()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; a mistake of the user is one message and an exit code, never a traceback."""
    terminal.make_ready()
    # The jobs are the parallelism: the linear algebra is small, and its sums then depend on nothing.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read when numpy is imported, which it is not yet
    keep_freed_memory()
    sys.exit(_exit_code(arguments))


def _exit_code(arguments: list[str] | None) -> int | str | None:
    """Exit code of the command; its mistake has been told."""
    code: int | str | None = 0
    try:
        try:
            words = sys.argv[1:] if arguments is None else arguments
            completed = COMPLETION in os.environ  # its words are not among the arguments
            code = built(None if completed else words)(arguments, standalone_mode=False) or 0
        except SystemExit as end:
            code = end.code
        except USAGE as mistake:
            code = mistake.exit_code
            said = io.StringIO()
            mistake.show(file=said)
            complain(said.getvalue().rstrip())
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


def schema() -> None:
    """Print the JSON Schema of scenario files.

    Editors complete and check scenarios with it.
    """
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

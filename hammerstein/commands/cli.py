"""The command line. Only this module prints and exits."""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hammerstein.commands import records as record_commands
from hammerstein.errors import HammersteinError

if TYPE_CHECKING:
    from hammerstein.experiment.batch import Outcome
    from hammerstein.experiment.prepare import Progress

app = typer.Typer(
    name="hammerstein",
    help="Simulate, identify and compensate multi-axis actuators with hysteresis.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(record_commands.loops)
app.command()(record_commands.identify)
app.command()(record_commands.compensate)

Paths = Annotated[list[Path], typer.Argument(metavar="PATH...", help="Scenario files, or folders of them.")]
Jobs = Annotated[
    int, typer.Option(min=1, help="Runs side by side.", show_default="the processors of this machine")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]
INTERRUPTED = 130
PROCESSORS = os.cpu_count() or 1


def _say_version(wanted: bool) -> None:
    if wanted:
        import hammerstein

        typer.echo(f"hammerstein {hammerstein.__version__}")
        raise typer.Exit


@app.callback()
def _before(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_say_version, help="Print the version.")
    ] = False,
) -> None:
    """What stands before a command."""


class _Interrupted(BaseException):
    """Ctrl-C. Not KeyboardInterrupt, which Typer would answer itself."""


def _interrupt(*_: object) -> None:
    raise _Interrupted


def _one_thread_a_job() -> None:
    """Let the jobs be the parallelism: the linear algebra is small, and its sums then depend on nothing."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read when numpy is imported, which it is not yet


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; a mistake of the user is one message and an exit code, never a traceback."""
    signal.signal(signal.SIGINT, _interrupt)
    _one_thread_a_job()
    try:
        app(arguments)
    except HammersteinError as error:
        _complain(str(error))
        sys.exit(error.exit_code)
    except _Interrupted:
        _complain("interrupted; what was finished is written, and nothing else")
        sys.exit(INTERRUPTED)


@app.command()
def run(
    paths: Paths,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the reports go.")] = Path("reports"),
    jobs: Jobs = PROCESSORS,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    traces: Annotated[
        str | None, typer.Option(metavar="csv|mat", help="Write every wire of every case.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write all claims and figures on one page there.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Run scenarios and write a report for each: numbers, a page, figures."""
    from hammerstein.runtime.processes import begin_loading

    if jobs > 1 and (len(paths) > 1 or paths[0].is_dir()):
        begin_loading()  # before this process loads what it needs itself
    from hammerstein.commands.tables import claims_table, result_table, show
    from hammerstein.commands.warm_up import compile_once
    from hammerstein.errors import InputError
    from hammerstein.experiment.batch import load_all, run_all
    from hammerstein.files import refuse_unwritable, write_atomic
    from hammerstein.reporting.claims_page import claims_csv, write_page
    from hammerstein.reporting.folder import Writer

    refuse_unwritable("--out", out)
    if page is not None:
        refuse_unwritable("--page", page)
    if traces not in (None, "csv", "mat"):
        raise InputError("--traces", f"{traces!r} is not one of csv, mat")
    scenarios = load_all(paths)
    compile_once(_complain)
    writer = Writer(out, figures, "mat" if traces == "mat" else "csv" if traces == "csv" else None)
    outcomes = []
    with _Watch(len(scenarios)) as watch:
        for outcome in run_all(scenarios, writer, jobs, watch.progress):
            watch.finished(outcome.name)
            outcomes.append(outcome)
    outcomes.sort(key=lambda outcome: outcome.name)
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    claimed = [report for report in reports if report.verdicts]
    if claimed:
        write_atomic(out / "claims.csv", claims_csv(claimed))
    if page is not None:
        write_page(reports, out, page)
    if as_json:
        errors = [str(outcome.error) for outcome in outcomes if outcome.error]
        contents = [json.loads(report.to_json()) for report in reports]
        typer.echo(json.dumps({"reports": contents, "errors": errors}))
    else:
        if reports:
            show(result_table(reports))
        if claimed:
            show(claims_table(claimed))
        if reports:
            typer.echo(f"{len(reports)} of {len(outcomes)} reports written in {out}")
    _fail_with(outcomes)


def _fail_with(outcomes: list[Outcome]) -> None:
    """Tell every error; exit with the code of the gravest."""
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    for error in errors:
        _complain(str(error))
    if errors:
        raise typer.Exit(max(error.exit_code for error in errors))


@app.command()
def check(
    paths: Paths,
    baseline: Annotated[Path, typer.Option(metavar="DIR", help="Where the baselines are.")] = Path(
        "reports/baseline"
    ),
    update_baseline: Annotated[
        bool, typer.Option("--update-baseline", help="Accept the numbers as the new baseline.")
    ] = False,
    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the result for CI.")] = None,
    markdown: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a summary page.")] = None,
    jobs: Jobs = PROCESSORS,
    as_json: AsJson = False,
) -> None:
    """Run scenarios again and compare every number with its baseline."""
    from hammerstein.commands.warm_up import compile_once
    from hammerstein.experiment.batch import find_scenarios
    from hammerstein.files import refuse_unwritable, write_atomic
    from hammerstein.regression.check import check_files

    for option, file in (("--junit", junit), ("--markdown", markdown)):
        if file is not None:
            refuse_unwritable(option, file.parent)
    compile_once(_complain)
    with _Watch(len(find_scenarios(paths))) as watch:
        result = check_files(paths, baseline, update_baseline, jobs, watch.progress, watch.finished)
    if junit is not None:
        write_atomic(junit, result.junit())
    if markdown is not None:
        write_atomic(markdown, result.markdown())
    typer.echo(json.dumps(result.as_dict()) if as_json else result.text())
    raise typer.Exit(result.exit_code)


@app.command()
def schema() -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from hammerstein.scenario import Scenario

    typer.echo(json.dumps(Scenario.model_json_schema(), indent=1, sort_keys=True))


@app.command()
def actuators(as_json: AsJson = False) -> None:
    """List the actuators that come with the package."""
    from hammerstein.commands.tables import actuator_table, show
    from hammerstein.model import HammersteinModel, packaged_actuators

    models = [HammersteinModel.load(name) for name in packaged_actuators()]
    if as_json:
        typer.echo(json.dumps([json.loads(model.to_json()) for model in models]))
    else:
        show(actuator_table(models))


@app.command()
def plot(
    path: Annotated[Path, typer.Argument(help="Scenario file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the figures go.")] = Path("reports"),
    jobs: Jobs = PROCESSORS,
) -> None:
    """Draw the figures of one scenario, and nothing else."""
    from hammerstein.commands.warm_up import compile_once
    from hammerstein.experiment.batch import load_all
    from hammerstein.experiment.run import run as run_scenario
    from hammerstein.reporting.figures import write_figures

    ((name, scenario),) = load_all([path]).items()
    compile_once(_complain)
    with _Watch(1) as watch:
        report = run_scenario(scenario, name, jobs, watch.progress)
    for figure in write_figures(report, out / name):
        typer.echo(str(figure))


class _Watch:
    """Progress with the remaining time on stderr, when a person watches."""

    def __init__(self, scenarios: int):
        self.scenarios = scenarios
        self.bar: Any = None

    def __enter__(self) -> _Watch:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
            self.bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self.bar.start()
            self.task = self.bar.add_task("running", total=self.scenarios)
            self.inner = self.bar.add_task("", total=1, visible=False)
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    @property
    def progress(self) -> Progress | None:
        """What a run calls while it works; None when nobody watches."""
        return None if self.bar is None else self._within

    def _within(self, what: str, done: int, total: int) -> None:
        self.bar.update(self.inner, description=what, completed=done, total=total, visible=True)

    def finished(self, name: str) -> None:
        """Count one more scenario."""
        if self.bar is not None:
            self.bar.update(self.task, advance=1, description=name)
            self.bar.update(self.inner, visible=False)


def _complain(message: str) -> None:
    typer.echo(message, err=True)

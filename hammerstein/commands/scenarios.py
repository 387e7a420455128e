"""Commands on scenarios: run them, once or for many values, check their numbers, draw their figures.

Their workers are threads and processes of this machine, or a cluster.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, cast

import typer

from hammerstein.commands.options import AsJson, Overwrite, refuse_output, with_help, write_output
from hammerstein.commands.terminal import Watch, complain, show, tell, tell_json, tell_kept
from hammerstein.errors import InputError
from hammerstein.escaping import cell
from hammerstein.files import reason_of, refuse_unwritable
from hammerstein.runtime.resources import cache_folder, folder_of_runs, processors

if TYPE_CHECKING:
    from hammerstein.experiment.report import Report
    from hammerstein.experiment.run import Outcome
    from hammerstein.experiment.study import Sampled
    from hammerstein.reporting.folder import TraceFormat, Writer
    from hammerstein.runtime import parallel_tasks
    from hammerstein.scenario import Scenario
    from hammerstein.scenario.assessment import Assessment

Paths = Annotated[
    list[Path], typer.Argument(metavar="PATH", help="Scenario files, or folders with scenario files.")
]
KEPT = f"in {place}" if (place := folder_of_runs()) else "(the cache is off)"
Address = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Run on this Dask scheduler, tcp://HOST:PORT."),
]
Jobs = Annotated[int, typer.Option(min=1, help="Parallel runs.", show_default="one for each processor")]
PROCESSORS = processors()
Yes = Annotated[bool, typer.Option("--yes", help="Start runs of more than ten minutes, too.")]
WORTH_PROCESSES_S = 4.0
"""Planned time of many short runs from which processes are worthwhile."""


def run(
    paths: Paths,
    out: Path | None = with_help(
        "Folder for the reports; default: reports beside the scenarios, or here.", metavar="DIR"
    ),
    jobs: Jobs = PROCESSORS,
    cluster: Address = None,
    figures: bool = with_help("Draw figures.", default=True),
    png: bool = with_help("Write figures as PNG, too.", default=False),
    traces: str | None = with_help("Write all signals of every case.", metavar="csv|mat"),
    page: Path | None = with_help("Write one page with all figures and judgements.", metavar="DIR"),
    interactive: bool = with_help("Add plots with zoom to each page.", default=False),
    open_: bool = with_help("Open the page in the browser.", "--open", default=False),
    fresh: bool = with_help(f"Ignore results of earlier runs {KEPT}.", default=False),
    dry_run: bool = with_help("Print memory and time of every part; run nothing.", default=False),
    yes: Yes = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Run scenarios and write their reports.

    A report has numbers, a page and figures. Results are cached and not computed twice.
    """
    from hammerstein.experiment.run import load_all
    from hammerstein.reporting.folder import Writer
    from hammerstein.reporting.interactive import refuse_without_library
    from hammerstein.reporting.overview import OVERVIEW, PAGE
    from hammerstein.runtime import store as kept_results
    from hammerstein.runtime.staging import prepare

    if dry_run:
        _show_plan(paths, jobs)
        return
    out = out or _reports_of(paths)
    refuse_unwritable("--out", out)
    if page is not None:
        refuse_unwritable("--page", page)
    if traces not in (None, "csv", "mat"):
        raise InputError("--traces", f"{traces!r} is not one of csv, mat")
    scenarios = load_all(paths)
    if interactive:
        refuse_without_library()
    store, useless = kept_results.opened(fresh)
    if useless:
        complain(useless)
    kind = cast("TraceFormat | None", traces)
    writer = Writer(out, figures, kind, interactive, store, overwrite, png=png or page is not None)
    writer.prepare(scenarios)
    if len(scenarios) > 1:
        prepare(out, OVERVIEW, [PAGE], overwrite)
    for assessed in _assessed(scenarios.values(), page):
        assessed.prepare(out, page, overwrite)
    outcomes = _run_what_changed(scenarios, writer, jobs, cluster, yes)
    for trouble in dict.fromkeys(outcome.unkept for outcome in outcomes if outcome.unkept):
        complain(trouble)
    outcomes.sort(key=lambda outcome: outcome.name)
    reports = _summed_up(outcomes, out, page, overwrite)
    _tell_reports(outcomes, reports, out, as_json)
    if open_ and reports:
        _open(_first_page(reports, out))
    errors = [outcome.error for outcome in outcomes if outcome.error is not None]
    for error in errors:
        complain(str(error))
    if errors:
        raise typer.Exit(max(error.exit_code for error in errors))


def _reports_of(paths: Sequence[Path]) -> Path:
    """Folder of reports beside all these scenarios, as `init` makes one; else that of the working folder."""
    beside = {(path if path.is_dir() else path.parent) / "reports" for path in paths}
    found = beside.pop()
    return found if not beside and found.is_dir() else Path("reports")


def _assessed(scenarios: Iterable[Scenario], page: Path | None) -> list[type[Assessment]]:
    """Kinds of assessment that some scenario has.

    Raises InputError where none could write the page that is wanted.
    """
    kinds = list(dict.fromkeys(type(s.assessment) for s in scenarios if s.assessment is not None))
    if page is not None and not kinds:
        raise InputError("--page", "no scenario has an [assessment], so the page would be empty")
    return kinds


def _summed_up(outcomes: Sequence[Outcome], out: Path, page: Path | None, overwrite: bool) -> list[Report]:
    """Write the pages over several reports: assessments and the overview."""
    from hammerstein.reporting.overview import write_overview

    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    kept = [place for outcome in outcomes for place in outcome.kept]
    kinds = _assessed((report.scenario for report in reports), None)
    if len(reports) < len(outcomes):
        if kinds:
            complain("did not write the overview pages, because some scenarios have no report")
    else:
        for kind in kinds:
            kept += kind.write(reports, out, page, overwrite)
    kept += write_overview(reports, out, overwrite) if len(reports) > 1 else ()
    tell_kept(kept)
    return reports


def _tell_reports(outcomes: Sequence[Outcome], reports: Sequence[Report], out: Path, as_json: bool) -> None:
    """Print the results, and where the reports are."""
    from hammerstein.commands.terminal_tables import judgement_table, result_table
    from hammerstein.reporting.overview import digest
    from hammerstein.reporting.summary import doubts, unsettled_runs

    if as_json:
        errors = [str(outcome.error) for outcome in outcomes if outcome.error]
        tell_json({"reports": [json.loads(report.to_json()) for report in reports], "errors": errors})
        return
    if len(reports) == 1:
        (report,) = reports
        show(result_table(report))
        if report.judgements and (asked := report.scenario.assessment):
            show(judgement_table(asked.title, report.judgements))
        if told := unsettled_runs(report):
            complain(f"{report.name}: {told}")
    for report in reports:
        for doubt in doubts(report):
            complain(f"{report.name}: {doubt}")
    if reports:
        tell(f"{len(reports)} of {len(outcomes)} reports written in {out}")
        for line in digest(reports, out) if len(reports) > 1 else [f"open {_first_page(reports, out)}"]:
            tell(line)


def _first_page(reports: Sequence[Report], out: Path) -> Path:
    """The page to look at first: the report if there is one, the overview if there are several."""
    return out / "index.html" if len(reports) > 1 else out / reports[0].name / "report.html"


def _open(page: Path) -> None:
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        complain(f"no browser could be started; open {page} yourself")


def _show_plan(paths: Sequence[Path], jobs: int) -> None:
    """Print what would be run."""
    from hammerstein.commands.terminal_tables import plan_table
    from hammerstein.experiment.plan import plan_of
    from hammerstein.experiment.run import load_all

    show(plan_table({name: plan_of(one, jobs) for name, one in load_all(paths).items()}, jobs))


def _run_what_changed(
    scenarios: dict[str, Scenario], writer: Writer, jobs: int, cluster: str | None, yes: bool
) -> list[Outcome]:
    """Write the reports that an earlier run has left in the store, and run the other scenarios."""
    from hammerstein.experiment.run import Outcome, run_all

    outcomes, left = [], {}
    for name, scenario in scenarios.items():
        if (known := writer.again(name, scenario)) is None:
            left[name] = scenario
        else:
            outcomes.append(Outcome(name, known[0], kept=known[1]))
    if not left:
        return outcomes
    from hammerstein.runtime.parallel_tasks import begin_loading

    if jobs > 1 and len(left) > 1 and cluster is None:
        begin_loading()
    with workers(jobs, cluster) as asked, _planned(left, asked, yes) as crew:
        there = writer.on(crew)
        with Watch(len(left)) as watch:
            for outcome in run_all(left, there, crew, watch.progress, there.store):
                watch.finished(outcome.name)
                outcomes.append(outcome)
    return outcomes


def _planned(
    scenarios: dict[str, Scenario], jobs: parallel_tasks.Jobs, yes: bool
) -> AbstractContextManager[parallel_tasks.Jobs]:
    """Return the number of jobs that fit into memory; announce long work, which needs ``--yes`` from a
    person.

    A single scenario with many draws uses processes; several scenarios use one each in any case.

    Raises InputError if a person watches and has not agreed.
    """
    from hammerstein.experiment.plan import jobs_that_fit, plans_of, together
    from hammerstein.runtime.parallel_tasks import workers_of

    plans = plans_of(scenarios).values()
    whole = together(plans)
    announce(*whole.announcement(workers_of(jobs)), yes)
    if isinstance(jobs, int):
        fitting = jobs_that_fit(plans, jobs)
        if fitting < jobs:
            complain(f"{jobs} parallel jobs do not fit into memory: running {fitting}")
        jobs = fitting
    drawn = len(scenarios) == 1 and all(one.uncertainty is not None for one in scenarios.values())
    return process_pool(jobs, whole.seconds if drawn else 0.0)


@contextmanager
def workers(jobs: int, cluster: str | None) -> Iterator[parallel_tasks.Jobs]:
    """Return the workers of a cluster, if there is one, or the jobs of this machine.

    Raises InputError where the cluster cannot be used.
    """
    if cluster is None:
        yield jobs
        return
    from hammerstein.runtime.cluster import joined

    with joined(cluster) as crew:
        complain(f"using {crew.workers} workers of {cluster}")
        yield crew


def process_pool(jobs: parallel_tasks.Jobs, seconds: float) -> AbstractContextManager[parallel_tasks.Jobs]:
    """Return processes for many short runs with this planned total time on one processor.

    Threads of one process share Python's interpreter, but begin at once.
    """
    from hammerstein.runtime.parallel_tasks import ProcessesAndThis

    if isinstance(jobs, int) and jobs > 1 and seconds > WORTH_PROCESSES_S:
        return ProcessesAndThis(jobs)
    return nullcontext(jobs)


def announce(text: str, seconds: float, yes: bool) -> None:
    """Announce work that takes long.

    Parameters
    ----------
    text : description of the work
    seconds : expected time
    yes : whether a person has agreed beforehand

    Raises InputError if it takes more than ten minutes, a person watches, and has not agreed.
    """
    from hammerstein.experiment.plan import LONG_S, TOLD_S

    if seconds <= TOLD_S:
        return
    if seconds > LONG_S and not yes and sys.stdin.isatty() and sys.stderr.isatty():
        raise InputError("plan", f"{text}. Or start it anyway with --yes")
    complain(text)


def check(
    paths: Paths,
    baseline: Path = with_help("Folder of the baselines.", default=Path("reports/baseline"), metavar="DIR"),
    update_baseline: bool = with_help("Accept the numbers as the new baseline.", default=False),
    junit: Path | None = with_help("Write a JUnit file for CI.", metavar="FILE"),
    markdown: Path | None = with_help("Write a summary in Markdown.", metavar="FILE"),
    html: Path | None = with_help("Write a page with old and new curves.", metavar="FILE"),
    jobs: Jobs = PROCESSORS,
    cluster: Address = None,
    yes: Yes = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Compare scenarios with their accepted numbers.

    They are run again, and every number is compared with its baseline.
    """
    from hammerstein.experiment.run import load_all
    from hammerstein.regression.result import JUNIT, SUMMARY, check_files
    from hammerstein.reporting.check_page import CHECK_PAGE, check_page
    from hammerstein.runtime.staging import prepare_file

    outputs = (("--junit", junit, JUNIT), ("--markdown", markdown, SUMMARY), ("--html", html, CHECK_PAGE))
    for option, file, owner in outputs:
        if file is not None:
            prepare_file(option, file, owner, overwrite)
    scenarios = load_all(paths)
    with (
        workers(jobs, cluster) as asked,
        _planned(scenarios, asked, yes) as crew,
        Watch(len(scenarios)) as watch,
    ):
        result = check_files(
            paths, baseline, update_baseline, crew, watch.progress, watch.finished, overwrite
        )
    texts: list[Callable[[], str]] = [result.junit, result.markdown, lambda: check_page(result)]
    for (_, file, owner), text in zip(outputs, texts, strict=True):
        if file is not None:
            write_output(file, text(), owner, overwrite)
    if as_json:
        tell_json(result.as_dict())
    else:
        tell(result.text())
    raise typer.Exit(result.exit_code)


def one_scenario(path: Path) -> tuple[str, Scenario]:
    """Name and scenario of a file; InputError for a folder."""
    from hammerstein.experiment.run import load_all

    if path.is_dir():
        raise InputError(str(path), "is a folder; give one scenario file")
    return load_all([path]).popitem()


def plot(
    path: Annotated[Path, typer.Argument(help="Scenario file.")],
    out: Path = with_help("Folder for the figures.", default=Path("reports"), metavar="DIR"),
    jobs: Jobs = PROCESSORS,
    yes: Yes = False,
    overwrite: Overwrite = False,
) -> None:
    """Draw the figures of one scenario."""
    from hammerstein.experiment.run import run as run_scenario
    from hammerstein.reporting.figures import figures_of, save_figures
    from hammerstein.reporting.figures.write import FIGURES
    from hammerstein.runtime.staging import prepare_folder

    name, scenario = one_scenario(path)
    _planned({name: scenario}, jobs, yes)
    prepare_folder("--out", out / name, FIGURES, (), overwrite)
    with Watch(1) as watch:
        report = run_scenario(scenario, name, jobs, watch.progress)
    for figure in save_figures(figures_of(report), out / name, overwrite=overwrite):
        tell(str(figure))


PARQUET = (".parquet", ".pq")
LINES_AT_ONCE = 1000  # of a Parquet file


def sweep(
    path: Annotated[Path, typer.Argument(help="Scenario file with a table [study].")],
    out: Path | None = with_help("File for the rows, .csv or .parquet.", metavar="FILE"),
    jobs: Jobs = PROCESSORS,
    cluster: Address = None,
    fresh: bool = with_help("Ignore results of earlier runs.", default=False),
    overwrite: Overwrite = False,
    dry_run: bool = with_help("Print the number of runs and the time; run nothing.", default=False),
    yes: Yes = False,
) -> None:
    """Run a scenario for many values of its keys.

    The values are lists or samples, and one table has all rows. They are written as soon as they are
    computed, so memory does not grow with their number. Results are cached, and an interrupted sweep
    continues where it stopped.
    """
    from hammerstein.experiment.study import sampled, study_of
    from hammerstein.runtime import store as kept_results
    from hammerstein.runtime.parallel_tasks import workers_of
    from hammerstein.runtime.staging import SWEEP

    if not dry_run:
        if out is None:
            raise InputError("--out", "is missing; give a file for the rows, .csv or .parquet")
        refuse_output(out, [], SWEEP, overwrite)
    _, scenario = one_scenario(path)
    study = study_of(scenario, str(path))
    if dry_run or out is None:
        complain(_announced(scenario, path, jobs)[0])
        return
    store, useless = kept_results.opened(fresh)
    if useless:
        complain(useless)
    failed = 0
    with workers(jobs, cluster) as asked, _written(out, overwrite) as table:
        told, seconds = _announced(scenario, path, workers_of(asked))
        announce(told, seconds, yes)
        if store is not None:
            store = store.computed(getattr(asked, "elsewhere", ""))
        with process_pool(asked, workers_of(asked) * seconds) as crew, Watch(1) as watch:
            for one in sampled(scenario, str(path), crew, watch.progress, store):
                failed += bool(one.error)
                table.add(one)
    if store is not None and store.problem:
        complain(store.problem)
    if failed:
        complain(f"{failed} of {study.count()} runs failed; see the column error")
    tell(f"{study.count()} runs written in {out}")


def _announced(scenario: Scenario, path: Path, jobs: int) -> tuple[str, float]:
    """How many runs there are and how long they take, in words and in seconds."""
    from hammerstein.experiment.study import plan_of_study
    from hammerstein.quantities import duration, size

    (part,) = plan_of_study(scenario, str(path)).parts
    seconds = part.seconds / jobs
    side = f" with {jobs} jobs" if jobs > 1 else ""
    return f"{part.what}, about {duration(seconds)}{side}, {size(jobs * part.bytes)} of memory", seconds


@contextmanager
def _written(out: Path, overwrite: bool) -> Iterator[_Csv | _Parquet]:
    """A table that takes its name when it is whole; until then its file has none, and ends with the process.

    Raises InputError where another sweep is writing it.
    """
    from hammerstein.runtime.staging import SWEEP

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with _alone(out), tempfile.TemporaryFile(dir=out.parent) as file:
            table = _Parquet(file) if out.suffix in PARQUET else _Csv(file)
            with contextlib.closing(table):
                yield table
            file.seek(0)
            write_output(out, file, SWEEP, overwrite)
    except OSError as error:
        what = f"cannot be written ({reason_of(error)}); choose another place"
        raise InputError(str(out), what) from None


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Let no other sweep of this user write the same file; InputError where one does.

    The lock lies in the user's cache folder, where a killed sweep leaves nothing beside the file. Where there
    is no such folder, the one that ends last has its rows in the file.
    """
    from hammerstein.runtime.staging import locked

    with contextlib.ExitStack() as held:
        if (place := cache_folder()) is not None:
            name = hashlib.sha256(os.fsencode(out.resolve())).hexdigest()
            with contextlib.suppress(OSError):
                (place / "locks").mkdir(mode=0o700, parents=True, exist_ok=True)
                held.enter_context(
                    locked(place / "locks" / name, 0.0, ("--out", f"another sweep is writing {out}"))
                )
        yield


def _lines(one: Sampled) -> Iterator[dict[str, Any]]:
    """One line a row, with the values of its run; a run without rows has one line."""
    from hammerstein.metrics import KEY, metrics_of

    run: Mapping[str, Any] = {"sample": one.number, **{key: float(v) for key, v in one.point.items()}}
    names = [metric.name for metric in metrics_of()]
    none = dict.fromkeys((*KEY, *names))
    for columns in [row.columns() for row in one.rows] or [none]:
        figures = {name: None if columns[name] is None else float(columns[name]) for name in names}
        yield {**run, **{name: columns[name] for name in KEY}, **figures, "error": one.error}


class _Csv:
    def __init__(self, file: BinaryIO) -> None:
        self._file = io.TextIOWrapper(file, newline="", encoding="utf-8")
        self._writer: Any = None

    def add(self, one: Sampled) -> None:

        for line in _lines(one):
            if self._writer is None:
                self._writer = csv.DictWriter(self._file, list(line), lineterminator="\n")
                self._writer.writeheader()
            self._writer.writerow({k: cell(v) if isinstance(v, str) else v for k, v in line.items()})

    def close(self) -> None:
        self._file.detach()  # what is left is written; the file itself stays open


class _Parquet:
    def __init__(self, file: BinaryIO) -> None:

        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            what = "Parquet needs pyarrow: pip install 'hammerstein-control[parquet]', or write .csv"
            raise InputError("--out", what) from None
        self._arrow, self._parquet, self._file = pyarrow, parquet, file
        self._lines: list[dict[str, Any]] = []
        self._writer: Any = None

    def add(self, one: Sampled) -> None:
        self._lines += _lines(one)
        if len(self._lines) >= LINES_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        if not self._lines:
            return
        texts = {"compensator", "excited_axis", "measured_axis", "error"}
        arrow = self._arrow
        types = {"sample": arrow.int64()} | dict.fromkeys(texts, arrow.string())
        schema = arrow.schema([(name, types.get(name, arrow.float64())) for name in self._lines[0]])
        if self._writer is None:
            self._writer = self._parquet.ParquetWriter(self._file, schema)
        self._writer.write_table(arrow.Table.from_pylist(self._lines, schema))
        self._lines = []

    def close(self) -> None:
        self._flush()
        if self._writer is not None:
            self._writer.close()

"""Commands on scenarios: run them, check their numbers, draw their figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from hammerstein.commands.jobs import PROCESSORS, Address, Jobs, Yes, announce, process_pool, workers
from hammerstein.commands.options import AsJson, Overwrite, with_help, write_output
from hammerstein.commands.terminal import Watch, complain, show, tell, tell_json, tell_kept
from hammerstein.errors import InputError
from hammerstein.files import refuse_unwritable
from hammerstein.runtime.resources import folder_of_runs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from contextlib import AbstractContextManager

    from hammerstein.experiment.report import Report
    from hammerstein.experiment.run import Outcome
    from hammerstein.reporting.folder import TraceFormat, Writer
    from hammerstein.runtime import parallel_tasks
    from hammerstein.scenario import Scenario
    from hammerstein.scenario.assessment import Assessment

Paths = Annotated[
    list[Path], typer.Argument(metavar="PATH", help="Scenario files, or folders with scenario files.")
]
KEPT = f"in {place}" if (place := folder_of_runs()) else "(the cache is off)"


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

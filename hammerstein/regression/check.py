"""Run scenarios again and compare them with the accepted numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hammerstein.errors import HammersteinError, InputError, Mistake
from hammerstein.experiment.report import Report
from hammerstein.experiment.run import Outcome, find_scenarios, load_all, run_all
from hammerstein.experiment.set_up import Progress
from hammerstein.regression.compare import Baseline, Finding, Kind, compare, new_columns, numbers_of
from hammerstein.regression.result import DEFAULT_FOLDER, CheckResult, ScenarioCheck
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.scenario import scenario_of
from hammerstein.scenario.scenario import ScenarioSource


def check_files(
    paths: Sequence[Path],
    baseline_folder: Path = DEFAULT_FOLDER,
    update: bool = False,
    jobs: Jobs = 1,
    progress: Progress | None = None,
    finished: Callable[[str], None] | None = None,
    overwrite: bool = False,
) -> CheckResult:
    """Run scenario files and compare each with ``<baseline_folder>/<scenario>.json``.

    A scenario without a baseline is a finding, and so is a baseline without a scenario if a whole folder is
    checked. A scenario that cannot be run does not stop the others.

    Parameters
    ----------
    paths : scenario files, or folders of them
    baseline_folder : where the baselines are
    update : write the baselines instead of comparing them; otherwise nothing is written
    jobs : number of parallel scenarios, or an executor for their cases; the numbers do not depend on it
    progress : called with the current step, the amount done, and the total
    finished : called with the name of each finished scenario
    overwrite : whether an update replaces baselines that a person changed; otherwise they are kept aside

    Raises
    ------
    InputError : a scenario file is wrong; every file is read before the first is run
    """
    scenarios = load_all(paths)
    files = {path.stem: path for path in find_scenarios(paths)}
    checks = {}
    for outcome in run_all(scenarios, _keep, jobs, progress):
        baseline = baseline_folder / f"{outcome.name}.json"
        checks[outcome.name] = _checked(outcome, files[outcome.name], baseline, update, overwrite)
        if finished is not None:
            finished(outcome.name)
    ordered = [checks[name] for name in files]
    return CheckResult((*ordered, *_orphans(paths, set(files), baseline_folder)), baseline_folder)


def check(
    scenario: ScenarioSource,
    baseline: str | Path | None = None,
    update: bool = False,
    jobs: Jobs = 1,
    progress: Progress | None = None,
) -> CheckResult:
    """Run one scenario, or every scenario of a folder, and compare the numbers with the accepted ones.

    Parameters
    ----------
    scenario : a scenario, its file, a folder of files, or a mapping with what a file would hold
    baseline : folder of the baselines; for a scenario without a file, the file of its baseline
    update : write the baselines instead of comparing them; otherwise nothing is written
    jobs, progress : as for ``check_files``

    Raises
    ------
    InputError : a scenario is wrong, or a scenario without a file has no file of its baseline
    """
    if isinstance(scenario, str | Path):
        folder = DEFAULT_FOLDER if baseline is None else Path(baseline)
        return check_files([Path(scenario)], folder, update, jobs, progress)
    if baseline is None:
        raise InputError("check", "a scenario without a file has no name: give the file of its baseline")
    file, validated = Path(baseline), scenario_of(scenario)[1]
    (outcome,) = run_all({file.stem: validated}, _keep, jobs, progress)
    return CheckResult((_checked(outcome, Path(file.stem), file, update),), file.parent)


def _keep(report: Report) -> tuple[Path, ...]:
    """Do nothing with a report but hand it back: a check writes no report."""
    return ()


def _checked(
    outcome: Outcome, path: Path, baseline: Path, update: bool, overwrite: bool = False
) -> ScenarioCheck:
    if outcome.report is None:
        return ScenarioCheck(outcome.name, path, error=outcome.error)
    try:
        report = outcome.report
        found = _update(report, baseline, overwrite) if update else _compare(report, baseline)
        now = numbers_of(outcome.report)
    except HammersteinError as error:
        return ScenarioCheck(outcome.name, path, error=error)
    return ScenarioCheck(outcome.name, path, sum(map(len, now.values())), now=now, **found)


def _compare(report: Report, baseline: Path) -> dict[str, Any]:
    """Differences from the baseline, and tolerances."""
    if not baseline.is_file():
        return {"findings": (Finding(Kind.NO_BASELINE),)}
    accepted, tolerances = _load(baseline), report.scenario.tolerances
    return {
        "findings": compare(report, accepted, tolerances),
        "new_columns": new_columns(report, accepted),
        "accepted": accepted.rows,
        "tolerances": tolerances,
    }


def _load(path: Path) -> Baseline:
    try:
        return Baseline.load(path)
    except InputError as error:
        advice = Mistake("", "restore the file, or write a new one with --update-baseline")
        raise InputError(str(path), [*error.mistakes, advice]) from None


def _update(report: Report, baseline: Path, overwrite: bool) -> dict[str, Any]:
    """Accept the numbers as a new baseline."""
    accepted = Baseline.of(report)
    compare(report, accepted, report.scenario.tolerances)  # refuses tolerances that no check could use
    return accepted.save(baseline, overwrite)._asdict()


def _orphans(paths: Sequence[Path], names: set[str], baseline_folder: Path) -> list[ScenarioCheck]:
    """Baselines without a scenario; of single files nobody can tell."""
    if not any(path.is_dir() for path in paths):
        return []
    return [
        ScenarioCheck(file.stem, file, findings=(Finding(Kind.ORPHAN),))
        for file in sorted(baseline_folder.glob("*.json"))
        if file.stem not in names
    ]

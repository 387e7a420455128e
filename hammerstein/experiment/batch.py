"""Run many scenario files: find them, load them all first, run them side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from hammerstein.errors import HammersteinError, InputError, LostProcessError, all_of, labelled
from hammerstein.experiment.plan import longest_first, plans_of
from hammerstein.experiment.report import Report
from hammerstein.experiment.run import run
from hammerstein.experiment.set_up import Progress
from hammerstein.runtime.faults import as_error
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.storage.manifest import refuse_name
from hammerstein.runtime.store import Store
from hammerstein.runtime.workers import Processes
from hammerstein.scenario import Scenario, load_scenario

Finish = Callable[[Report], tuple[Path, ...]]
"""What is done with each report; it gives the places of files that were kept under another name."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one scenario file: its report, or the error that stopped it.

    kept : files in its folder that a person had changed, under their new names
    unkept : why its results are not kept for the next run; empty if they are
    """

    name: str
    report: Report | None
    error: HammersteinError | None = None
    kept: tuple[Path, ...] = ()
    unkept: str = ""


def find_scenarios(paths: Sequence[Path]) -> list[Path]:
    """Scenario files named, or found in the folders named, in order of their names.

    Raises InputError where a path does not exist, a folder holds none, or two have one name.
    """
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.toml")) if path.is_dir() else [path]
        if not inside:
            raise InputError(str(path), "holds no scenario (*.toml)")
        if not inside[0].exists():
            raise InputError(str(path), "does not exist; give scenario files or folders")
        found += [file for file in inside if file not in found]
    for file in found:
        refuse_name(file)
    names = [file.stem.casefold() for file in found]  # many systems do not tell capital letters apart
    for file in found:
        if names.count(file.stem.casefold()) > 1:
            raise InputError(
                file.stem, "two scenarios have this name, and their reports would overwrite each other"
            )
    return found


def load_all(paths: Sequence[Path]) -> dict[str, Scenario]:
    """Scenarios by name; every file is checked before any is run, and all mistakes are told at once."""
    files = find_scenarios(paths)
    scenarios = all_of(load_scenario, files, "scenario files")
    return {file.stem: scenario for file, scenario in zip(files, scenarios, strict=True)}


def run_all(
    scenarios: dict[str, Scenario],
    finish: Finish,
    jobs: Jobs,
    progress: Progress | None = None,
    store: Store | None = None,
) -> Iterator[Outcome]:
    """Run scenarios and pass each report to ``finish`` as soon as it is complete.

    Results in the store are not computed again. With several scenarios and jobs, each scenario runs in a
    process of its own; a single one uses threads. If an executor is given, its workers take the cases of one
    scenario after the other. The numbers do not depend on any of this. Outcomes come in the order in which
    the scenarios finish.
    """
    if not isinstance(jobs, int) or jobs == 1 or len(scenarios) == 1:
        for name, scenario in scenarios.items():
            yield _outcome(name, scenario, finish, jobs, progress, store)
        return
    planned = longest_first(plans_of(scenarios))
    order = [*planned, *(name for name in scenarios if name not in planned)]
    with Processes(min(jobs, len(scenarios))) as processes:
        under_way = {
            processes.submit(_outcome, name, scenarios[name], finish, 1, None, store): name for name in order
        }
        for future in as_completed(under_way):
            name = under_way.pop(future)
            try:
                yield future.result()
            except LostProcessError as error:
                yield Outcome(name, None, _of(name, error))


def _outcome(
    name: str,
    scenario: Scenario,
    finish: Finish,
    jobs: Jobs,
    progress: Progress | None,
    store: Store | None,
) -> Outcome:
    try:
        report = run(scenario, name, jobs, progress, store)
        kept = finish(report)
    except Exception as error:  # a fault in one scenario must not take the others with it
        return Outcome(name, None, _of(name, as_error(error)))
    return Outcome(name, report.without_traces(), kept=kept, unkept="" if store is None else store.problem)


def _of(name: str, error: HammersteinError) -> HammersteinError:
    """The error with the name of its scenario."""
    return error if str(error).startswith(name) else labelled(name, error)

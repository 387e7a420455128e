"""From a scenario to its report: simulate and measure every case, collect the rows.

reference -> compensator -> drive -> hysteresis -> dynamics -> sensor      = one Response, with all signals
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from hammerstein.errors import (
    HammersteinError,
    InputError,
    LostProcessError,
    SimulationError,
    all_of,
    labelled,
)
from hammerstein.experiment.case_cache import CaseCache
from hammerstein.experiment.draws import bands_of, sensitivities_of
from hammerstein.experiment.measure import Result, statements_of
from hammerstein.experiment.plan import Plan, identification_parts, longest_first, plan_of, plans_of
from hammerstein.experiment.report import Report
from hammerstein.experiment.set_up import Case, Progress, SetUp, plant_of, set_up
from hammerstein.metrics import Row
from hammerstein.model.simulation import Response
from hammerstein.runtime.faults import as_error
from hammerstein.runtime.parallel_tasks import Jobs, Processes
from hammerstein.runtime.resources import one_blas_thread
from hammerstein.runtime.staging import refuse_name
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario, load_scenario, scenario_of
from hammerstein.scenario.scenario import ScenarioSource


def simulate(
    scenario: ScenarioSource,
    compensator: str | None = None,
    excited_axis: str | None = None,
    **values: float,
) -> Response:
    """Simulate one case of a scenario and return all signals.

    Parameters
    ----------
    scenario : what to run: a scenario, its file, or a mapping with what a file would hold
    compensator : label of the compensator; the first one if not given
    excited_axis : name of the driven axis, if each is driven in turn; the first one if not given
    values : values of the sweep, such as ``frequency_hz=50.0``; the first ones if not given

    Returns
    -------
    the response, from rest, settling included

    Raises
    ------
    InputError : no such case, or a mistake in the scenario

    Examples
    --------
    >>> response = simulate({
    ...     "question": "How large is a loop?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}})
    >>> response.position_um.shape
    (2, 2000)
    """
    setup, case = _chosen(scenario, compensator, excited_axis, values)
    return setup.simulate(case)


def simulate_in_blocks(
    scenario: ScenarioSource,
    samples: int = 1_000_000,
    compensator: str | None = None,
    excited_axis: str | None = None,
    **values: float,
) -> Iterator[Response]:
    """Simulate one case of a scenario block by block, for runs that do not fit into memory.

    The state continues from block to block, so the numbers equal those of ``simulate`` to the last bit. Drop
    each response before the next, and the memory stays that of one block.

    Parameters
    ----------
    scenario, compensator, excited_axis, values : as for ``simulate``
    samples : length of a block

    Raises
    ------
    InputError : no such case, or a law that needs the whole path in advance or reads the sensor

    Examples
    --------
    >>> scenario = {
    ...     "question": "How far does it get?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}}
    >>> parts = simulate_in_blocks(scenario, 600)
    >>> round(max(float(abs(part.position_um).max()) for part in parts), 2)
    58.4
    """
    setup, case = _chosen(scenario, compensator, excited_axis, values)
    return setup.blocks(case, samples)


def _chosen(
    source: ScenarioSource, compensator: str | None, excited_axis: str | None, values: Mapping[str, float]
) -> tuple[SetUp, Case]:
    _, scenario = scenario_of(source)
    swept = {key: (value,) for key, value in values.items()}
    if scenario.sweep.combine == "zip":  # a value brings those of the other keys with it
        found = next((one for one in scenario.sweep.combinations() if values.items() <= one.items()), None)
        if found is None:
            raise InputError("simulate", f"the scenario has no case with {dict(values)}")
        swept = {key: (value,) for key, value in found.items()}
    chosen = scenario.model_copy(update={"sweep": scenario.sweep.model_copy(update=swept)})
    Plan(tuple(identification_parts(chosen, plant_of(chosen)))).refuse_too_large()
    setup = set_up(chosen)
    for case in setup.cases():
        right_axis = excited_axis is None or setup.excited_axis(case) in ("all", excited_axis)
        if right_axis and (compensator is None or case.label == compensator):
            return setup, replace(case, position=(scenario.positions().get(case.signal, 1), case.position[1]))
    raise InputError("simulate", f"the scenario has no case {compensator!r} on axis {excited_axis!r}")


@one_blas_thread()
def run(
    scenario: ScenarioSource,
    name: str | None = None,
    jobs: Jobs = 1,
    progress: Progress | None = None,
    store: Store | None = None,
) -> Report:
    """Run every case of a scenario and measure it.

    Parameters
    ----------
    scenario : what to run: a scenario, its file, or a mapping with what a file would hold
    name : name of the report; the name of the file, or "scenario", if not given
    jobs : threads, or an executor of ``concurrent.futures``; the numbers do not depend on it
    progress : called with the current step, its progress and its total
    store : cache of results; without it, everything is computed

    Returns
    -------
    the report, with one row for each case and measured axis

    Raises
    ------
    the errors of ``set_up``, and SimulationError if a run diverges
    """
    own_name, scenario = scenario_of(scenario)
    name = name or own_name
    kept, cases, results = _worked_out(scenario, name, jobs, progress, store)
    setup, rows = kept.setup, _rows_in(results)
    asked = scenario.assessment
    report = Report(
        name=name,
        scenario=scenario,
        actuator=setup.plant.model.name,
        digest=scenario.digest(),
        model_digest=setup.plant.model.digest(),
        instruments=setup.plant.instruments,
        inputs=setup.plant.model.inputs,
        axes=setup.plant.model.outputs,
        rows=rows,
        statements=statements_of(setup, results),
        judgements=() if asked is None else asked.judge(scenario, name, setup.plant.model, rows, store),
        traces=tuple(result.trace for result in results),
    )
    if scenario.uncertainty is None:
        return report
    drawn = (scenario.uncertainty, kept, cases)
    return replace(report, bands=bands_of(*drawn), sensitivities=sensitivities_of(*drawn))


@one_blas_thread()
def rows_alone(scenario: Scenario, name: str) -> tuple[Row, ...]:
    """Rows of a run, one for each case and measured axis, without statements.

    Raises as ``run`` does.
    """
    return _rows_in(_worked_out(scenario, name)[2])


def _worked_out(
    scenario: Scenario,
    name: str,
    jobs: Jobs = 1,
    progress: Progress | None = None,
    store: Store | None = None,
) -> tuple[CaseCache, list[Case], list[Result]]:
    """Every case of a scenario and what came out."""
    plan_of(scenario, jobs if isinstance(jobs, int) else 1, timed=False).refuse_too_large()
    setup = set_up(scenario, name, progress, store=store, jobs=jobs)
    cases, kept = list(setup.cases()), CaseCache(setup, store, jobs, progress)
    return kept, cases, kept.results(cases)


def _rows_in(results: Iterable[Result]) -> tuple[Row, ...]:
    """All rows; raises an error if a figure is infinite or NaN."""
    rows = tuple(row for result in results for row in result.rows)
    for row in rows:
        if figure := row.not_finite():
            raise SimulationError(
                f"{figure} of {row.measured_axis} is {getattr(row, figure)}{row.at} with "
                f"{row.compensator or 'this drive'}, which is not finite. Use another amplitude or "
                "frequency"
            )
    return rows


Finish = Callable[[Report], tuple[Path, ...]]
"""Function that receives each report; returns places of files that were kept under another name."""


class Outcome(NamedTuple):
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
    """Scenario files from given files and folders, in order of their names.

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
    """Scenarios by name; all files are checked before a run, and all mistakes are reported together."""
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

"""From a scenario to its report: simulate every case, measure it, gather the rows.

reference -> compensator -> drive -> hysteresis -> dynamics -> sensor      = one Response, with all signals
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.case_cache import CaseCache
from hammerstein.experiment.draws import bands_of
from hammerstein.experiment.measure import Result, statements_of
from hammerstein.experiment.plan import Plan, identification_parts, plan_of
from hammerstein.experiment.report import Report
from hammerstein.experiment.sensitivity import sensitivities_of
from hammerstein.experiment.set_up import Case, Progress, SetUp, plant_of, set_up
from hammerstein.metrics import Row
from hammerstein.model.simulation import Response
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.resources import one_blas_thread
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario, scenario_of
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
    if scenario.sweep.is_zip:  # a value brings those of the other keys with it
        for found in scenario.sweep.combinations():
            if all(found.get(key) == value for key, value in values.items()):
                swept = {key: (value,) for key, value in found.items()}
                break
        else:
            raise InputError("simulate", f"the scenario has no case with {dict(values)}")
    chosen = scenario.model_copy(update={"sweep": scenario.sweep.model_copy(update=swept)})
    Plan(tuple(identification_parts(chosen, plant_of(chosen)))).refuse_too_large()
    setup = set_up(chosen)
    for case in setup.cases():
        right_axis = excited_axis is None or setup.excited_axis(case) in ("all", excited_axis)
        if right_axis and (compensator is None or case.label == compensator):
            here = scenario.positions().get(case.signal, 1), case.position[1]
            return setup, replace(case, position=here)
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
    traces = tuple(result.trace for result in results)
    return Report(
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
        bands=bands_of(kept, cases, jobs, progress),
        sensitivities=sensitivities_of(kept, cases, jobs, progress),
        traces=traces,
    )


@one_blas_thread()
def rows_alone(scenario: Scenario, name: str) -> tuple[Row, ...]:
    """Rows of a run, one for each case and measured axis, without what its report says about them.

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
    cases, kept = list(setup.cases()), CaseCache(setup, store)
    return kept, cases, kept.results(cases, jobs, progress)


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

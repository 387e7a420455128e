"""A scenario run with many values of its keys; rows are streamed."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from functools import partial
from typing import Any, NamedTuple

from pydantic import ValidationError

from hammerstein.errors import HammersteinError, InputError, Mistake, refuse
from hammerstein.experiment.case_cache import rows_from
from hammerstein.experiment.plan import Part, Plan, experiments_of, plan_of
from hammerstein.experiment.run import rows_alone
from hammerstein.experiment.set_up import Progress
from hammerstein.metrics import Row
from hammerstein.runtime.parallel_tasks import Jobs, completed, in_order, on_workers
from hammerstein.runtime.resources import one_blas_thread
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.scenario import Scenario
from hammerstein.scenario.variation import Study
from hammerstein.validation import mistakes_of

_STEP = re.compile(r"([A-Za-z_]\w*)(?:\[([1-9]\d*)\])?")
LOOKED_AT = 100
"""Most runs whose plans are averaged."""


class Sampled(NamedTuple):
    """One run of a study.

    number : from 1; point : values of the keys; rows : figures; error : why there are none
    """

    number: int
    point: Mapping[str, float]
    rows: tuple[Row, ...]
    error: str = ""


def sampled(
    scenario: Scenario,
    name: str,
    jobs: Jobs = 1,
    progress: Progress | None = None,
    store: Store | None = None,
) -> Iterator[Sampled]:
    """Every run of the study of a scenario, in order; memory does not grow with their number.

    A value that cannot be simulated is a run with an error; the others go on.

    Parameters
    ----------
    scenario, name : scenario, and its name in messages
    jobs : threads, or an executor of ``concurrent.futures``; the numbers do not depend on it
    progress : called with the current step, the amount done, and the total
    store : store for rows; without it, all are computed

    Raises
    ------
    InputError : there is no study, or a key is no number of the scenario
    """
    study = study_of(scenario, name)
    whole = _whole_keys(scenario, study, name)
    if study.samples is None:
        _refuse_fractions(study, whole, name)
    count, keys = study.count(), dict[int, str]()

    def begun(number: int, values: Mapping[str, float]) -> Callable[[], Sampled] | Future[Sampled]:
        try:
            here = varied(scenario, values, name)
            key = key_of("sampled", here.content())
        except HammersteinError as error:
            return completed(Sampled(number, values, (), str(error)))
        entry = None if store is None else store.read(key)
        if entry is not None:
            return completed(Sampled(number, values, rows_from(entry.document)))
        keys[number] = key
        return partial(_one, here, name, number, values)

    def finished(index: int, one: Sampled) -> None:
        key = keys.pop(index + 1, "")
        if store is not None and key and not one.error:
            store.write(key, Kept([asdict(row) for row in one.rows]))

    tasks = (begun(i, _rounded(values, whole)) for i, values in enumerate(study.points(), start=1))
    with one_blas_thread():  # for all: each run asks for it, and only the first has to look for it
        for one in in_order(tasks, jobs, finished):
            if progress:
                progress(f"sampling{on_workers(jobs)}", one.number, count)
            yield one


def study_of(scenario: Scenario, name: str) -> Study:
    """Return the study of a scenario; InputError if there is none."""
    if scenario.study is None:
        raise InputError(name, "has no table [study] with the values to run")
    return scenario.study


def plan_of_study(scenario: Scenario, name: str) -> Plan:
    """Cost of the runs of a study: total time, and memory of the largest run.

    If there are many runs, the estimate uses some of them, and those in which a key has its least or largest
    value. Runs with equal identifications share one.

    Raises
    ------
    InputError : there is no study, or a key is no number of the scenario
    """
    study = study_of(scenario, name)
    whole = _whole_keys(scenario, study, name)

    def needs(values: Mapping[str, float]) -> tuple[float, float, float]:
        try:
            plan = plan_of(varied(scenario, _rounded(values, whole), name))
        except HammersteinError:
            return 0.0, 0.0, 0.0  # such a run is a row with an error
        once_s = sum(part.seconds for part in plan.parts if part.once is not None)
        return plan.seconds - once_s, once_s, plan.bytes

    count, identified = study.count(), _identified(scenario, study, whole, name)
    some = [needs(values) for values in study.some(LOOKED_AT)]
    ends = [needs(values) for values in study.ends()] if count > LOOKED_AT else []
    run_s, once_s, _ = (sum(numbers) / len(some) for numbers in zip(*some, strict=True))
    longest_s = max(run + once for run, once, _ in (*some, *ends))
    largest = max(held for *_, held in (*some, *ends))
    seconds = max(count * run_s + identified * once_s, longest_s)
    return Plan((Part(f"{count} runs of {study.how} values", largest, seconds, "the values in [study]"),))


def _identified(scenario: Scenario, study: Study, whole: set[str], name: str) -> int:
    """In how many of the runs models are identified; the others share their experiment and find them kept."""

    def moves(key: str) -> bool:
        """Whether a key changes what is identified."""
        ends = [_rounded({key: end}, whole) for end in (min(study.values[key]), max(study.values[key]))]
        try:
            low, high = (experiments_of(varied(scenario, end, name)) for end in ends)
        except HammersteinError:
            return True  # such a run is a row with an error: nothing is known of the others
        return low != high

    moving = [key for key in study.values if moves(key)]
    if not moving:
        return 1
    return len({tuple(_rounded(point, whole)[key] for key in moving) for point in study.points()})


def _whole_keys(scenario: Scenario, study: Study, name: str) -> set[str]:
    return {key for key, values in study.values.items() if _is_whole(scenario, name, key, values[0])}


def _refuse_fractions(study: Study, whole: set[str], name: str) -> None:
    """Refuse listed values that a key would round; those between two limits are drawn, and rounded."""
    mistakes = [
        Mistake(f"study.values: {key}", f"takes whole numbers only, not {found[0]:g}")
        for key, values in study.values.items()
        if key in whole and (found := [v for v in values if v != round(v)])
    ]
    refuse(name, mistakes)


def _rounded(values: Mapping[str, float], whole: set[str]) -> dict[str, float]:
    return {key: round(value) if key in whole else value for key, value in values.items()}


def _is_whole(scenario: Scenario, name: str, key: str, value: float) -> bool:
    """Whether a key only takes integers; InputError if it takes no number."""
    try:
        varied(scenario, {key: round(value) + 0.5}, name)
    except InputError as error:
        if any("whole number" in mistake.what for mistake in error.mistakes):
            varied(scenario, {key: round(value)}, name)
            return True
        varied(scenario, {key: value}, name)  # 0.5 more may be out of its range
    return False


def _one(scenario: Scenario, name: str, number: int, values: Mapping[str, float]) -> Sampled:
    try:
        return Sampled(number, values, rows_alone(scenario, name))
    except HammersteinError as error:
        return Sampled(number, values, (), str(error))


def varied(scenario: Scenario, values: Mapping[str, float], name: str = "scenario") -> Scenario:
    """The scenario with other values of some keys, without the parts that a study does not use.

    Raises InputError if a key is not a number of the scenario, or if its value is not allowed.

    Examples
    --------
    >>> scenario = Scenario.model_validate({"question": "?", "drive": {
    ...     "kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}})
    >>> varied(scenario, {"drive.amplitude_v": 5.0}).signal.model_dump()["amplitude_v"]
    5.0
    """
    unused = {"study", "uncertainty", "assessment", "tolerances"}
    content = scenario.model_dump(exclude_unset=True, exclude=unused)
    content = json.loads(json.dumps(content))
    for key, value in values.items():
        _put(content, key, value, name)
    try:
        return Scenario.model_validate_json(json.dumps(content), strict=True)
    except ValidationError as error:
        told = [Mistake(f"study.values: {m.where}", m.what) for m in mistakes_of(error, Scenario)]
        raise InputError(name, told) from None


def _put(content: Any, key: str, value: float, name: str) -> None:
    """Put a value where a key such as ``compensators[1].gain`` says, counted from 1."""
    *steps, last = key.split(".")
    place = content
    try:
        for step in steps:
            found = _STEP.fullmatch(step)
            if found is None:
                raise KeyError(step)
            place = place.setdefault(found[1], {}) if found[2] is None else place[found[1]][int(found[2]) - 1]
        if not last.isidentifier() or isinstance(place.get(last), str | list | dict | bool):
            raise KeyError(last)
        place[last] = value
    except (KeyError, IndexError, TypeError, AttributeError):
        what = 'is not a number of this scenario; write a key like "compensators[1].gain"'
        raise InputError(name, [Mistake(f"study.values: {key}", what)]) from None

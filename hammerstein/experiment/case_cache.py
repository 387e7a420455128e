"""Cache of cases: results are stored under a key of everything that they depend on."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from hammerstein.experiment.measure import Result, rows_of, trace_of
from hammerstein.experiment.report import Target
from hammerstein.experiment.set_up import Case, Progress, SetUp
from hammerstein.files import digest_of, digest_of_file
from hammerstein.metrics import Row
from hammerstein.model.simulation import WIRES, Response
from hammerstein.runtime.parallel_tasks import Jobs, in_order, on_workers
from hammerstein.runtime.store import Kept, Store, key_of
from hammerstein.signals import FromFile

NUMBERS_NOT = {"label", "identification", "model", "only_at_hz"}
"""Options of a compensator that only select or name its model; the key contains the model itself."""


class CaseCache:
    """Results of the cases of one set-up, from the store if present.

    setup : what is run
    store : where results are kept; None where nothing is
    jobs : who works out what is not there
    progress : told of it
    """

    def __init__(
        self, setup: SetUp, store: Store | None, jobs: Jobs = 1, progress: Progress | None = None
    ) -> None:
        self.setup, self.store, self.jobs, self.progress = setup, store, jobs, progress

    def results(self, cases: Sequence[Case]) -> list[Result]:
        """Rows and traces of cases. Missing cases are computed in parallel and stored immediately."""
        kept = {i: entry for i, case in enumerate(cases) if (entry := self.read(case, "case")) is not None}
        found = {i: _restored(self.setup, cases[i], entry) for i, entry in kept.items()}
        left = [i for i in range(len(cases)) if i not in found]

        def finished(number: int, result: Result) -> None:
            i = left[number]
            found[i] = result
            self.write(_packed(result), cases[i], "case")
            if self.progress:
                self.progress(f"simulating{on_workers(self.jobs)}", len(found), len(cases))

        for _ in in_order((partial(rows_of, self.setup, cases[i]) for i in left), self.jobs, finished):
            pass
        return [found[i] for i in range(len(cases))]

    def read(self, case: Case, kind: str, more: Any = None) -> Kept | None:
        """Stored result that depends on a case and on ``more``, if there is one."""
        return None if self.store is None else self.store.read(self._key(case, kind, more))

    def write(self, entry: Kept, case: Case, kind: str, more: Any = None) -> None:
        """Store such a result, if there is a store."""
        if self.store is not None:
            self.store.write(self._key(case, kind, more), entry)

    def _key(self, case: Case, kind: str, more: Any) -> str:
        setup, signal = self.setup, case.signal
        labels = [case.label] if case.label else list(setup.models)
        file = [digest_of_file(Path(signal.path))] if isinstance(signal, FromFile) else []
        content = {
            "common": self._common,
            "signal": [signal.model_dump_json(exclude={"path"} if file else None), *file],
            "noise": case.seed(setup.scenario.seed),
            "axis": case.axis,
            "trial": case.trial,
            "tested": {label: self._tested[label] for label in labels},
            "more": more,
        }
        return key_of(kind, content)

    @cached_property
    def _common(self) -> str:
        """Digest of what all cases depend on."""
        setup, scenario = self.setup, self.setup.scenario
        content = {
            "actuator": setup.plant.model.to_json(),
            "instruments": setup.plant.instruments.model_dump_json(),
            "volts": scenario.drive is not None,
            "measure": scenario.measure.model_dump_json(),
            "metrics": [metric.name for metric in scenario.metrics()],
        }
        return digest_of(content)

    @cached_property
    def _tested(self) -> Mapping[str, str]:
        """Digest of options and model of everything that is tested, by label."""
        scenario, models = self.setup.scenario, self.setup.models
        options = {c.label: c.model_dump_json(exclude=NUMBERS_NOT) for c in scenario.compensators}
        limits = {source.label: source.only_at_hz for source in scenario.models}
        return {
            label: digest_of([options.get(label), limits.get(label), model.to_json()])
            for label, model in models.items()
        }


def _packed(result: Result) -> Kept:
    trace = result.trace
    response = trace.response
    arrays = response.wires()
    for number, prediction in enumerate(trace.predictions):
        arrays[f"reading_{number}"] = prediction.reading_um
        arrays[f"position_{number}"] = prediction.position_um
    document = {
        "rows": [asdict(row) for row in result.rows],
        "unsettled": result.unsettled,
        "clipped": result.clipped,
        "first_sample": trace.first_sample,
        "sample_time_s": response.sample_time_s,
        "predictions": [prediction.label for prediction in trace.predictions],
    }
    return Kept(document, arrays)


def _restored(setup: SetUp, case: Case, entry: Kept) -> Result:
    found, arrays, model = entry.document, entry.arrays, setup.plant.model
    wires: dict[str, Any] = {name: arrays.get(name) for name in (*WIRES, "saturated")}
    response = Response(
        sample_time_s=found["sample_time_s"], inputs=model.inputs, outputs=model.outputs, **wires
    )
    predictions = tuple(
        Target(label, arrays[f"reading_{number}"], arrays[f"position_{number}"])
        for number, label in enumerate(found["predictions"])
    )
    trace = trace_of(setup, case, response, found["first_sample"], predictions)
    return Result(rows_from(found["rows"]), trace, found["unsettled"], found["clipped"])


def rows_from(listed: Sequence[Mapping[str, Any]]) -> tuple[Row, ...]:
    """Rows from the result of ``asdict``."""
    return tuple(Row(**row) for row in listed)

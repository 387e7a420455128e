"""Recording of a case: the response, and its reference or prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import StaticDynamics, on_grid
from hammerstein.experiment.report import Target
from hammerstein.experiment.set_up import Case, SetUp
from hammerstein.hysteresis import Memory
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Response, refuse_unbounded

RECORDED_BLOCK = 100_000  # samples that are simulated at once where not all are recorded; they fit the cache


class PredictionState(NamedTuple):
    """Memory of a model's plays, and state (n,) of its linear block; None for a static model."""

    plays: Memory | None = None
    linear: Array | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """A response and its targets, on the samples that the scenario records.

    targets : a single None where there is nothing to compare with
    """

    response: Response
    targets: Sequence[Target | None]


def recorded(setup: SetUp, case: Case) -> Recording:
    """Simulate a case and keep one of ``measure.record_every`` samples.

    The models predict from every sample. A case that can be is simulated part by part.
    """
    every = setup.scenario.measure.record_every or 1
    long = every > 1 and setup.runs_on(case)
    block, recorded_part = max(RECORDED_BLOCK // every, 1) * every, slice(None, None, every)
    parts, targets = [], []
    memory: Mapping[str, PredictionState] = {}
    for part in setup.blocks(case, block) if long else [setup.simulate(case)]:
        found, memory = targets_of(setup, case, part, memory)
        parts.append(part.every(every))
        targets.append([None if target is None else target.part(recorded_part) for target in found])
    return Recording(Response.joined(parts), [_joined(same) for same in zip(*targets, strict=True)])


def targets_of(
    setup: SetUp, case: Case, response: Response, start: Mapping[str, PredictionState] | None = None
) -> tuple[Sequence[Target | None], Mapping[str, PredictionState]]:
    """What a response is compared with, and the memory of the models after it."""
    if response.reference_um is not None:
        return [Target(case.label, response.reference_um, response.reference_um)], {}
    found: list[Target] = []
    memory = {}
    for source in setup.scenario.models:
        if source.is_tested_at(case.signal.highest_frequency_hz):
            before = (start or {}).get(source.label, PredictionState())
            model = setup.models[source.label]
            reading, position, memory[source.label] = _prediction(setup, model, response.drive_v, before)
            found.append(Target(source.label, reading, position))
    return found or [None], memory


def _prediction(
    setup: SetUp, model: HammersteinModel, drive_v: Array, start: PredictionState
) -> tuple[Array, Array, PredictionState]:
    """What a model predicts that the sensor reads, and where the actuator is."""
    model = model.on_grid(setup.plant.sample_time_s)
    v, plays = model.static_response(drive_v, start.plays)
    refuse_unbounded(f"prediction of {model.name}_um", v, setup.plant.sample_time_s)
    if isinstance(model.dynamics, StaticDynamics):
        return v, v, PredictionState(plays)  # found from readings: it stands for both
    plant = setup.plant
    block = on_grid(model.dynamics, plant.sample_time_s, plant.instruments.sensor.bandwidth_hz)
    both, linear = block.respond(v, start.linear)
    refuse_unbounded(f"prediction of {model.name}_um", both, plant.sample_time_s)
    position, reading = np.split(both, 2)
    return reading, position, PredictionState(plays, linear)


def _joined(parts: Sequence[Target | None]) -> Target | None:
    """Put the parts of one target together."""
    known = [part for part in parts if part is not None]
    if not known:
        return None
    reading, position = (
        np.concatenate([getattr(part, name) for part in known], axis=1)
        if len(known) > 1
        else getattr(known[0], name)
        for name in ("reading_um", "position_um")
    )
    return Target(known[0].label, reading, position)

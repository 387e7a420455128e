"""Recording of a case: the response, its reference or prediction, and whether its cycles had settled."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.dynamics import AxesDynamics, StaticDynamics, on_grid
from hammerstein.errors import HammersteinError
from hammerstein.experiment.report import Target
from hammerstein.experiment.set_up import Case, SetUp, Window
from hammerstein.hysteresis import Memory
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Response, refuse_unbounded
from hammerstein.signals import OneFrequency

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


SETTLED_FRACTION = 1e-3  # cycles may differ by this part of the range, beside the sensor's noise
LONGER = (2, 20)  # times the cycles before the measurement that are tried
WHOLE = 1e-6  # part of a sample by which a whole number of them may miss
END_SHARE = 0.1  # of a cycle: a law that looks further ahead sees the end of the path from the last one
MOST_SAMPLES = 4_000_000  # a longer run is not tried


def settled(setup: SetUp, case: Case, response: Response) -> bool:
    """Whether the last measured cycle of the true position repeats an earlier one.

    The earlier one is the first measured cycle. If its samples have other phases, it is the latest cycle with
    the same phases, because the response between two samples differs from cycle to cycle without being
    unsettled.
    """
    cycles = setup.scenario.measure.measured_cycles
    if not isinstance(case.signal, OneFrequency) or not case.signal.repeats or cycles < 2:
        return True
    samples = case.signal.period_s / response.sample_time_s
    last = Window.of(setup.scenario, case.signal, response.sample_time_s).first + round(
        (cycles - 1) * samples
    )
    alike = _cycles_of_whole_samples(samples, int(last / samples))
    back = {cycles - 1, alike * math.ceil((cycles - 1) / alike)} if alike else {cycles - 1}
    return any(_repeats(response.position_um, last, some, samples) for some in back if some * samples <= last)


def _cycles_of_whole_samples(samples: float, most: int) -> int:
    """Fewest cycles, of so many samples each, that have a whole number of them; 0 if more than ``most``.

    >>> _cycles_of_whole_samples(2000 / 7, 10), _cycles_of_whole_samples(2000 / 7, 6)
    (7, 0)
    """
    cycles = Fraction(samples).limit_denominator(max(most, 1)).denominator
    return cycles if abs(cycles * samples - round(cycles * samples)) < WHOLE else 0


def _repeats(position: Array, start: int, cycles: int, samples: float) -> bool:
    """Whether the cycle that starts at a sample agrees with that so many cycles before it."""
    lag = round(cycles * samples)
    now = position[:, start : start + int(samples)]
    then = position[:, start - lag :][:, : now.shape[1]]
    fraction = abs(lag / samples - cycles)
    allowed = (SETTLED_FRACTION + 2.0 * np.pi * fraction) * float(np.ptp(position))
    return float(np.abs(then - now).max()) <= allowed + 1e-9


def advice(setup: SetUp, case: Case) -> str:
    """Advice for a run that has not settled: a longer wait, or the reason why it does not help.

    The run is done again with 2 and with 20 times as many cycles before the measurement.
    """
    cycles = max(1, Window.of(setup.scenario, case.signal, setup.plant.sample_time_s).settle_cycles)
    for factor in LONGER:
        measure = setup.scenario.measure.model_copy(update={"settle_cycles": factor * cycles})
        longer = replace(setup, scenario=setup.scenario.model_copy(update={"measure": measure}))
        if Window.of(longer.scenario, case.signal, setup.plant.sample_time_s).total > MOST_SAMPLES:
            return "the run is too long to try more cycles"
        try:
            if settled(longer, case, longer.simulate(case)):
                return f"it settles with measure.settle_cycles = {factor * cycles}"
        except HammersteinError:
            return "it diverges in a longer run"
    return f"it does not settle in {LONGER[-1]} times as many cycles either: {_why(setup, case)}"


def _why(setup: SetUp, case: Case) -> str:
    law, dynamics = setup.laws.get(case.label), setup.plant.model.dynamics
    ahead_s = getattr(law, "preview_samples", 0) * setup.plant.sample_time_s
    if isinstance(law, InverseMultiplicativeLaw) and not law.convergence.converges:
        return "the iteration of the law does not converge"
    if isinstance(dynamics, AxesDynamics) and any(axis.creep for axis in dynamics.axes):
        slowest = max(mode.time_constant_s for axis in dynamics.axes for mode in axis.creep)
        return f"the actuator creeps, with time constants up to {slowest:g} s"
    if ahead_s > END_SHARE * case.signal.period_s:
        return f"the law looks {ahead_s:.3g} s ahead, so the last cycle responds to the end of the path"
    return "the cycles keep changing"

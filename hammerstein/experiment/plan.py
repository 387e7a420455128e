"""Memory and time of each part of a scenario, estimated before it starts."""

from __future__ import annotations

import contextlib
import itertools
import math
import time
import timeit
from collections.abc import Hashable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hammerstein.blocks import Controller, Learner
from hammerstein.compensators import (
    ExactInverse,
    Feedback,
    HammersteinInverse,
    InverseMultiplicative,
)
from hammerstein.compensators.feedback.pid import closed_loop
from hammerstein.compensators.learning import Learned
from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.draws import evaluations
from hammerstein.experiment.measure import RECORDED_BLOCK
from hammerstein.experiment.set_up import Window, driven_axes, law_of, loaded, plant_of, scenario_axes
from hammerstein.experiment.simulated_identification import SETTLING
from hammerstein.hysteresis import PrandtlIshlinskii, RateDependent
from hammerstein.model.simulation import Plant
from hammerstein.quantities import duration, size
from hammerstein.runtime.resources import COPIES, free_bytes, run_bytes
from hammerstein.scenario import Scenario
from hammerstein.scenario.source import ClosedFormSpec, LoopFitSpec, TestedCompensator
from hammerstein.scenario.variation import Uncertainty

# Of a two-axis actuator, on a processor that takes REFERENCE_S for what ``slowness`` lets it do.
REFERENCE_S = 6.3e-4
SECONDS_A_SAMPLE = 8e-8
SECONDS_A_PREDICTED_SAMPLE = 3e-8
SECONDS_A_CASE = 1e-3
SECONDS_A_SET_UP = 4e-3  # to read the models and to design the laws
SECONDS_A_PASS = 4e-8
SECONDS_A_STEPPED_PASS = 2e-5  # around a block that is not of plays alone, which is stepped in Python
SECONDS_A_RATE_DEPENDENT_SAMPLE = 9e-7  # of the exact inverse of such a block
SECONDS_A_TAP = 2e-10
SECONDS_A_LOOKED_AHEAD_SAMPLE = 5e-8
SECONDS_A_FED_BACK_SAMPLE = 3.5e-7
SECONDS_A_LEARNT_SAMPLE = 3e-6
SECONDS_OF_A_FIT, SECONDS_A_FITTED_SAMPLE = 1.5, 4e-5
SECONDS_A_SEARCHED_SAMPLE = 1.3e-3  # of hysteresis in the loop
# Of a random actuator: to make it, and each run, whose voltages are known
SECONDS_A_DRAW, SECONDS_A_DRAWN_CASE, SECONDS_A_DRAWN_SAMPLE = 5e-4, 1.3e-4, 4.3e-8
BYTES_A_ROW = 3_000
BYTES_OF_DRAWN_FIGURES = 200
RESAMPLED_BYTES = 50_000
TRIED_OPERATORS = 60  # where their number is found
BYTES_A_FITTED_SAMPLE, BYTES_A_REGRESSOR = 200, 24
TRIED_SAMPLES = 2000  # of a law that plugs in; a call takes as long as hundreds of them
TAPS = 13.5  # of a reference filter of half the sample rate
TOLD_S = 60.0
LONG_S = 600.0
"""Duration from which an interactive run asks for confirmation [s]."""


@dataclass(frozen=True)
class Part:
    """One part of a plan: description, memory and time, and the keys that reduce them.

    once : key of a result that is stored and computed once for all runs; else None
    """

    what: str
    bytes: float
    seconds: float
    keys: str
    once: Hashable = None


@dataclass(frozen=True)
class Plan:
    """Plan of a scenario."""

    parts: tuple[Part, ...]

    @property
    def bytes(self) -> float:
        """Memory at the peak."""
        return sum(part.bytes for part in self.parts)

    @property
    def seconds(self) -> float:
        """Time on one processor."""
        return sum(part.seconds for part in self.parts)

    @property
    def kept(self) -> set[Hashable]:
        """Results that are stored."""
        return {part.once for part in self.parts} - {None}

    def without(self, kept: Set[Hashable]) -> Plan:
        """Remaining work if these results are provided."""
        return Plan(tuple(part for part in self.parts if part.once not in kept))

    def refuse_too_large(self) -> None:
        """Raise SimulationError, with the largest part and a remedy, if the plan needs more memory than is
        free.
        """
        free = free_bytes()
        if self.bytes <= free:
            return
        largest = max(self.parts, key=lambda part: part.bytes)
        raise SimulationError(
            f"this run needs about {size(self.bytes)} of memory, but {size(free)} are free. The "
            f"largest part is {largest.what}, with {size(largest.bytes)}. Lower {largest.keys}"
        )

    def announcement(self, jobs: int) -> tuple[str, float]:
        """State how long it takes, in words and in seconds, and how to shorten it."""
        seconds = self.seconds / max(jobs, 1)
        longest = max(self.parts, key=lambda part: part.seconds, default=Part("nothing", 0.0, 0.0, "nothing"))
        return (
            f"this takes about {duration(seconds)}; the longest part is {longest.what} "
            f"({duration(longest.seconds)} on one processor). To shorten it, lower {longest.keys}",
            seconds,
        )


def plans_of(scenarios: Mapping[str, Scenario]) -> dict[str, Plan]:
    """Plans of the scenarios that can be run; errors of the others are reported when they are run."""
    plans, free = {}, free_bytes()
    for name, scenario in scenarios.items():
        with contextlib.suppress(InputError, SimulationError):
            plans[name] = plan_of(scenario)
    return {name: plan for name, plan in plans.items() if plan.bytes <= free}


def longest_first(plans: Mapping[str, Plan]) -> list[str]:
    """Names of plans, longest first, so that no long one runs alone at the end.

    An identification that several plans share counts for the first of them, so that it is not done twice in
    parallel.
    """
    kept, order, left = set[Hashable](), list[str](), dict(plans)
    while left:
        order.append(max(left, key=lambda name: left[name].without(kept).seconds))
        kept |= left.pop(order[-1]).kept
    return order


def together(plans: Iterable[Plan]) -> Plan:
    """All parts of several plans; the first one that needs a stored result computes it."""
    parts, kept = list[Part](), set[Hashable]()
    for plan in plans:
        parts += plan.without(kept).parts
        kept |= plan.kept
    return Plan(tuple(parts))


def jobs_that_fit(plans: Iterable[Plan], jobs: int) -> int:
    """Number of plans that fit the memory in parallel, at least 1, at most the number of jobs."""
    free = free_bytes()
    sizes = list(itertools.accumulate(sorted((plan.bytes for plan in plans), reverse=True)))
    return max(1, jobs - sum(size > free for size in sizes[:jobs]))


def plan_of(scenario: Scenario, jobs: int = 1, timed: bool = True) -> Plan:
    """Memory and time of a run of a scenario; InputError if its files are wrong.

    timed : whether its time is wanted, too: a law that plugs in is tried for that
    """
    plant, factor = plant_of(scenario), slowness()
    identified = list(identification_parts(scenario, plant))
    parts = [*identified, *_runs(scenario, plant, jobs, timed)]
    if identified and scenario.assessment is not None and scenario.assessment.runs:
        seconds = scenario.assessment.runs * sum(part.seconds for part in identified)
        words = "the identification of the other actuators in [assessment]"
        parts.append(Part(words, 0.0, seconds, "the number of actuators in [assessment]"))
    return Plan(tuple(replace(part, seconds=factor * part.seconds) for part in parts))


@cache
def slowness() -> float:
    """Run time relative to the processor of the times above, by a quick trial."""

    def work() -> int:
        """Python's own, in which all short runs spend most of their time."""
        return sum(i * i for i in range(20_000))

    return min(timeit.repeat(work, timer=time.process_time, repeat=3, number=1)) / REFERENCE_S


def experiments_of(scenario: Scenario) -> set[Hashable]:
    """Identification experiments of a scenario; equal ones are done once and stored."""
    return {part.once for part in identification_parts(scenario, plant_of(scenario))}


def identification_parts(scenario: Scenario, plant: Plant) -> Iterator[Part]:
    """One part for each identification experiment."""
    m, p = plant.model.hysteresis.n_inputs, plant.model.hysteresis.n_outputs
    sources = (*scenario.compensators, *scenario.models)
    for spec, position in scenario.experiments().items():
        label = next(source.label for source in sources if source.identification == spec)
        once = plant.model.digest(), plant.instruments, scenario.seed, position, spec
        step = spec.sample_time_s or plant.sample_time_s
        if isinstance(spec, ClosedFormSpec):
            cycles = max(spec.settle_cycles, math.ceil(0.05 * spec.frequency_hz)) + spec.measured_cycles
            samples = cycles / (spec.frequency_hz * step)
            words = f"the identification of {label!r}, a run of {samples:.3g} samples for each input"
            needed, seconds = COPIES * run_bytes(samples, m, p), m * samples * SECONDS_A_SAMPLE
            keys = "its measured_cycles or settle_cycles, or raise frequency_hz"
        elif isinstance(spec, LoopFitSpec):
            samples = len(spec.levels) * spec.experiments * spec.record_s / step
            words = f"the identification of {label!r} from {samples:.3g} samples"
            longest = (SETTLING[-1] + 2) * spec.record_s / step
            needed = COPIES * run_bytes(max(2.0 * samples, longest), m, p)
            seconds = min(60.0 * spec.minutes, p * samples * SECONDS_A_SEARCHED_SAMPLE)
            keys = "its record_s, levels or experiments"
        else:
            samples = m * (len(spec.frequencies_hz) + 1) * spec.record_s / step
            operators = TRIED_OPERATORS if spec.operators == "auto" else int(np.max(spec.operators))
            fitted = samples * (BYTES_A_FITTED_SAMPLE + BYTES_A_REGRESSOR * operators)
            words = f"the identification of {label!r} from {samples:.3g} samples"
            needed = COPIES * run_bytes(samples, m, p) + fitted
            seconds = SECONDS_OF_A_FIT + samples * SECONDS_A_FITTED_SAMPLE * operators / 15.0
            keys = "its record_s or the number of frequencies_hz, or raise sample_time_s"
        yield Part(words, needed, seconds, keys, once)


def _runs(scenario: Scenario, plant: Plant, jobs: int, timed: bool) -> Iterator[Part]:
    """The cases, and their repetition on random actuators."""
    m, p = plant.model.hysteresis.n_inputs, plant.model.hysteresis.n_outputs
    axes = len(driven_axes(scenario, len(scenario_axes(scenario, plant.model))))
    others = scenario.sweep.others("frequency_hz")
    cases = samples = work = reading = longest = 0.0
    a_sample = {c.label: _work(c, plant) if timed else 0.0 for c in scenario.compensators}
    for signal in scenario.signals(only="frequency_hz"):
        total = float(Window.of(scenario, signal, plant.sample_time_s).total)
        tested = [c for c in scenario.compensators if c.is_tested_at(signal.highest_frequency_hz)]
        runs = others * axes * (1 if scenario.drive is not None else len(tested))
        cases, samples, longest = cases + runs, samples + runs * total, max(longest, total)
        done = [(c, others * axes * total * a_sample[c.label]) for c in tested]
        work += sum(seconds for _, seconds in done)
        reading += sum(seconds for c, seconds in done if isinstance(c, Feedback | Learned))
    models = len(scenario.models)
    seconds = samples * (SECONDS_A_SAMPLE + models * SECONDS_A_PREDICTED_SAMPLE)
    seconds += SECONDS_A_SET_UP + cases * SECONDS_A_CASE + work
    seconds *= 1 + (0 if scenario.assessment is None else scenario.assessment.runs)
    every = scenario.measure.record_every or 1
    whole = any(isinstance(c, HammersteinInverse | Feedback | Learned) for c in scenario.compensators)
    at_once = longest if every == 1 or whole else min(longest, RECORDED_BLOCK)
    kept = run_bytes(samples / every, m, p + 2 * models)
    kept += COPIES * jobs * run_bytes(at_once, m, p + 2 * models)
    keys = (
        "the values in [sweep], measure.measured_cycles, measure.settle_cycles or measure.settle_s, or raise "
        "instruments.drive.sample_time_s, the frequency or measure.record_every"
    )
    if any(isinstance(c, InverseMultiplicative) and c.iterations > 1 for c in scenario.compensators):
        keys += ", or lower iterations"
    words = f"{cases:.3g} runs of up to {longest:.3g} samples"
    yield Part(words, kept + cases * p * BYTES_A_ROW, seconds, keys)
    rows = cases * p * max(1, models)
    if scenario.uncertainty is not None:
        one = SECONDS_A_DRAW + cases * SECONDS_A_DRAWN_CASE
        one += samples * (SECONDS_A_DRAWN_SAMPLE + models * SECONDS_A_PREDICTED_SAMPLE)
        yield from _on_drawn(scenario.uncertainty, plant, rows, cases, one + reading)


def _on_drawn(
    uncertainty: Uncertainty, plant: Plant, rows: float, cases: float, seconds: float
) -> Iterator[Part]:
    """All runs once more on every random actuator; of those only the figures stay.

    seconds : of all runs on one of them
    """
    draws = uncertainty.draws
    yield Part(
        f"{draws:.3g} random actuators in {cases:.3g} runs each",
        draws * rows * BYTES_OF_DRAWN_FIGURES,
        draws * seconds,
        "uncertainty.draws",
    )
    if uncertainty.sensitivity is not None:
        parameters = sum(parameter.varies for parameter in uncertainty.parameters(plant.model))
        count = evaluations(uncertainty.sensitivity, parameters)
        yield Part(
            f"{count} random actuators, ({parameters} + 2) x {uncertainty.sensitivity}, in {cases:.3g} runs "
            f"each, for the sensitivities to {parameters} parameters",
            (RESAMPLED_BYTES + count) * rows * BYTES_OF_DRAWN_FIGURES,
            count * seconds,
            "uncertainty.sensitivity",
        )


def _work(compensator: TestedCompensator, plant: Plant) -> float:
    """Time [s] a sample of a law that works more on each than others."""
    spec = compensator.identification  # the requested kind of hysteresis if it is not yet identified
    kind = getattr(spec, "hysteresis", None) or PrandtlIshlinskii.kind
    if spec is None:
        kind = loaded(str(compensator.model)).hysteresis.kind
    if isinstance(compensator, InverseMultiplicative):
        a_pass = SECONDS_A_PASS if kind == PrandtlIshlinskii.kind else SECONDS_A_STEPPED_PASS
        return a_pass * compensator.iterations
    if isinstance(compensator, ExactInverse) and kind == RateDependent.kind:
        return SECONDS_A_RATE_DEPENDENT_SAMPLE
    if isinstance(compensator, HammersteinInverse):
        taps = TAPS * 0.5 / (plant.sample_time_s * compensator.filter_hz) if compensator.filter_hz else 0.0
        return SECONDS_A_LOOKED_AHEAD_SAMPLE + SECONDS_A_TAP * taps
    if isinstance(compensator, Feedback):
        return SECONDS_A_FED_BACK_SAMPLE
    if isinstance(compensator, Learned):
        return SECONDS_A_LEARNT_SAMPLE
    if type(compensator).__module__.partition(".")[0] != __name__.partition(".")[0]:
        options = compensator.model_dump_json(exclude={"label"})
        key = (type(compensator), options, plant.model.digest(), plant.sample_time_s)
        if key not in _tried:  # twice, as it may have to be compiled
            _tried[key] = min(_trial_of(compensator, plant) for _ in range(2))
        return _tried[key] / TRIED_SAMPLES / slowness()
    return 0.0


_tried: dict[Hashable, float] = {}


def _trial_of(compensator: TestedCompensator, plant: Plant) -> float:
    """Time [s] of some samples of a law of which nothing is known, designed for the actuator itself."""
    begun = time.perf_counter()
    with contextlib.suppress(Exception):  # what is wrong with it is told when it runs
        law = law_of(compensator, plant.model, plant)
        path_um = np.zeros((law.n_outputs, TRIED_SAMPLES))
        if isinstance(law, Controller):
            closed_loop(law, plant, path_um, [0])
        elif isinstance(law, Learner):
            law.following(path_um, law.first(path_um), path_um)
        else:
            law.drive_for(path_um)
    return time.perf_counter() - begun

"""Set-up of the cases of a scenario: actuator, identified models, laws and signals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, allocate_wires
from hammerstein.blocks import Controller, Law, Learner
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Instruments
from hammerstein.compensators.feedback.pid import closed_loop
from hammerstein.errors import IdentificationError, InputError, Mistake, SimulationError, labelled, refuse
from hammerstein.experiment.simulated_identification import IlcRun, IlcRuns, identify_each, whole_period
from hammerstein.model import HammersteinModel, model_text
from hammerstein.model.simulation import BLOCK, AppliedDrive, Plant, Response
from hammerstein.runtime.parallel_tasks import Jobs, on_workers
from hammerstein.runtime.resources import refuse_too_long
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario
from hammerstein.scenario.source import ModelSource, TestedCompensator
from hammerstein.signals import Excitation, FromFile, OnAxes, Reference
from hammerstein.signals.signal_files import chosen
from hammerstein.signals.units import Kind

AnyLaw = Law[Any] | Controller[Any] | Learner
Progress = Callable[[str, int, int], None]
Experiment = Callable[[Plant, int], Response]
"""Function from an actuator and a seed to its response, from rest."""

LAW_BLOCK = 8 * BLOCK  # a law works more on a sample than memory does, and has more to do for each part
REACH_POINTS = 5000  # enough to find the largest value of a path


@dataclass(frozen=True, eq=False)
class Case:
    """One run of a scenario: a signal, its axis (None: all), and the label of the tested source.

    trial : trial of a compensator that learns; None: the one in its options
    position : of the signal and of the compensator in the scenario, counted from 1
    """

    signal: Reference | Excitation
    axis: int | None
    label: str
    trial: int | None = None
    position: tuple[int, int] = (1, 1)

    def seed(self, scenario_seed: int) -> list[int]:
        """Seed of the sensor's noise, from the scenario's seed and the position of the case.

        It is the same for all trials, and no name is a part of it.
        """
        return [scenario_seed, *self.position, 0 if self.axis is None else self.axis + 1]


class Window(NamedTuple):
    """Samples of a run; measurement begins at ``first``."""

    first: int
    total: int
    settle_cycles: int

    @classmethod
    def of(cls, scenario: Scenario, signal: Reference | Excitation, sample_time_s: float) -> Window:
        """Whole cycles before the measurement, then the measured ones."""
        measure, period = scenario.measure, signal.period_s
        if not signal.periodic:
            return cls(0, round(period / sample_time_s) + 1, 0)
        waited = max(measure.settle_cycles * period, measure.settle_s, signal.smooth_start_s)
        settle = math.ceil(waited / period - 1e-9)
        total = math.ceil((settle + measure.measured_cycles) * period / sample_time_s - 1e-9)
        return cls(math.ceil(settle * period / sample_time_s - 1e-9), total, settle)


@dataclass(frozen=True, eq=False)
class SetUp:
    """Actuator, models and laws of a scenario."""

    scenario: Scenario
    plant: Plant
    models: dict[str, HammersteinModel]
    laws: dict[str, AnyLaw]

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that the scenario's signal has."""
        return scenario_axes(self.scenario, self.plant.model)

    def excited_axis(self, case: Case) -> str:
        """Name of the axis that a case excites; ``all`` if they are driven together."""
        return "all" if case.axis is None else self.axes[case.axis]

    def cases(self) -> Iterator[Case]:
        """Every case, in the order of the report."""
        scenario = self.scenario
        axes, positions = driven_axes(scenario, len(self.axes)), scenario.positions()
        numbered = list(enumerate(scenario.compensators, start=1))
        for signal, trial in scenario.runs():
            frequency_hz = signal.highest_frequency_hz
            tested = [(i, c.label) for i, c in numbered if c.is_tested_at(frequency_hz)]
            for i, label in [(1, "")] if scenario.drive is not None else tested:
                for axis in axes:
                    yield Case(signal, axis, label, trial, (positions[signal], i))

    @cached_property
    def ilc_runs(self) -> IlcRuns:
        """Completed trials of learning compensators; each continues the previous one."""
        return IlcRuns()

    def simulate(self, case: Case) -> Response:
        """Response of one case.

        Raises SimulationError where it does not fit the memory.
        """
        return self.experiment(case)(self.plant, self.scenario.seed)

    def experiment(self, case: Case) -> Experiment:
        """Experiment of one case on an actuator.

        The voltages of a law without feedback are worked out once, for any number of actuators.
        """
        scenario, plant = self.scenario, self.plant
        window = Window.of(scenario, case.signal, plant.sample_time_s)
        m, p = plant.model.hysteresis.n_inputs, plant.model.hysteresis.n_outputs
        refuse_too_long(window.total, m, p)
        law = self.laws.get(case.label)
        wires = allocate_wires(2 * m + p * (law is not None), window.total)
        drive_v, asked_v, path_um = np.split(wires, [m, 2 * m])
        if law is None:
            self._sample(case, asked_v)
            return _following(plant, plant.driven(asked_v, False, out=drive_v), None, case)
        self._sample(case, path_um)
        if isinstance(law, Controller):
            return lambda tested, seed: closed_loop(law, tested, path_um, case.seed(seed))
        if isinstance(law, Learner):
            return self._learning(case, law, path_um, window)
        known_um, ahead = path_um, law.preview_samples
        if ahead and case.signal.periodic:  # the path goes on beyond the run
            known_um = np.hstack([path_um, self._values(case, window.total, window.total + ahead)])
        asked_v = _asked_for(law, known_um, asked_v)[:, : window.total]
        return _following(plant, plant.driven(asked_v, True, out=drive_v), path_um, case)

    def _sample(self, case: Case, values: Array) -> None:
        """Put the signal of a case into an array (axis, sample), piece by piece, which stay in the cache."""
        samples = values.shape[1]
        length = BLOCK if case.signal.pointwise else max(samples, 1)
        for first in range(0, samples, length):
            stop = min(first + length, samples)
            values[:, first:stop] = self._values(case, first, stop)

    def _learning(self, case: Case, law: Learner, values: Array, window: Window) -> Experiment:
        """Do a trial on an actuator, after those before it."""
        samples = case.signal.period_s / self.plant.sample_time_s
        period = whole_period(samples if case.signal.repeats else math.inf, case.label)
        number = case.trial or law.trial

        def experiment(tested: Plant, seed: int) -> Response:
            own = case.seed(seed)
            key = (case.label, *own)
            ilc_run = self.ilc_runs.of(tested, key, lambda: IlcRun(law, values, window.first, period, own))
            return ilc_run.trial(tested, number)

        return experiment

    def runs_on(self, case: Case) -> bool:
        """Whether a case can be simulated in blocks: its law has no preview, feedback or learning."""
        law = self.laws.get(case.label)
        return law is None or (isinstance(law, Law) and not law.preview_samples)

    def blocks(self, case: Case, samples: int) -> Iterator[Response]:
        """Response of one case in blocks, for runs that do not fit the memory.

        Raises InputError where the law knows the reference ahead or reads the sensor.
        """
        scenario, plant = self.scenario, self.plant
        total = Window.of(scenario, case.signal, plant.sample_time_s).total
        law = self.laws.get(case.label)
        if not (law is None or isinstance(law, Law)) or not self.runs_on(case):
            raise InputError(
                f"compensator {case.label!r}",
                "works on the whole path, not on parts; use a law without preview, feedback or learning",
            )
        state, memory = plant.rest(case.seed(scenario.seed)), None if law is None else law.rest()
        for first in range(0, total, samples):
            values = self._values(case, first, min(first + samples, total))
            reference, voltages = (None, values) if law is None else (values, values)
            if law is not None:
                voltages, memory = law.respond(values, memory)
            response, state = plant.carry_on(voltages, state, reference)
            yield response
            del response, values, reference, voltages  # the next part needs the memory

    def _values(self, case: Case, first: int, stop: int) -> Array:
        """Values (axis, sample) of the signal of a case from one sample to before another."""
        time_s = self.plant.sample_time_s * np.arange(first, stop, dtype=np.float64)
        rest = 0.0 if self.scenario.drive is None else self.plant.range.working_point_v
        return values_of(case, time_s, len(self.axes), rest)


def _asked_for(law: Law[Any], path_um: Array, drive_v: Array) -> Array:
    """Drive (m, N) of a law for a whole path (p, N), in the array that is given where the law allows it."""
    samples = path_um.shape[1]
    if law.preview_samples or samples <= LAW_BLOCK:
        return law.drive_for(path_um)
    state = law.rest()
    for first in range(0, samples, LAW_BLOCK):
        here = slice(first, first + LAW_BLOCK)
        drive_v[:, here], state = law.respond(path_um[:, here], state)
    return drive_v


def _following(plant: Plant, driven: AppliedDrive, reference_um: Array | None, case: Case) -> Experiment:
    """Send what the drive makes of a voltage to an actuator."""

    def experiment(tested: Plant, seed: int) -> Response:
        if tested.instruments.drive != plant.instruments.drive:
            return tested.respond(driven.requested_v, case.seed(seed), reference_um)
        return tested.follow(driven, tested.rest(case.seed(seed)), reference_um)[0]

    return experiment


def scenario_axes(scenario: Scenario, model: HammersteinModel) -> tuple[str, ...]:
    """Names of the axes that the scenario's signal has."""
    return model.inputs if scenario.drive is not None else model.outputs


def driven_axes(scenario: Scenario, n_axes: int) -> Sequence[int | None]:
    """Axis of each case: every one in turn, a named one, or None for all together."""
    signal = scenario.signal
    if not isinstance(signal, OnAxes) or signal.axis == "all":
        return [None]
    return range(n_axes) if signal.axis == "each" else [signal.axis - 1]


def values_of(case: Case, time_s: Array, n_axes: int, rest: ArrayLike = 0.0) -> Array:
    """Values (axis, sample) of the case's signal."""
    signal = case.signal
    if case.axis is not None:
        signal = signal.model_copy(update={"axis": case.axis + 1})
    return signal.sample(time_s, n_axes, rest)


def set_up(
    scenario: Scenario,
    source: str = "scenario",
    progress: Progress | None = None,
    model: HammersteinModel | None = None,
    store: Store | None = None,
    jobs: Jobs = 1,
) -> SetUp:
    """Load the actuator, identify every model, build every law.

    ``model`` takes the place of the scenario's actuator, if given; ``store`` keeps
    identifications, that of the user if not given; ``jobs`` identify side by side, threads or the workers of
    an executor.

    Raises
    ------
    InputError : a file is wrong, or the signal does not fit the actuator or the sample time
    SimulationError : a reference is out of reach, or a law cannot converge
    IdentificationError : a model cannot be identified
    """
    plant = plant_of(scenario, model)
    _check_signal(scenario, plant, source)
    models = _models(scenario, plant, progress, store, jobs)
    laws = {c.label: law_of(c, models[c.label], plant) for c in scenario.compensators if c.is_tested}
    return SetUp(scenario, plant, models, laws)


def plant_of(scenario: Scenario, model: HammersteinModel | None = None) -> Plant:
    """Actuator of a scenario with its instruments; InputError if its file is wrong."""
    model = model or loaded(str(scenario.actuator))
    own = model.instruments.model_dump()
    given = scenario.instruments.model_dump(exclude_unset=True)
    merged = {name: {**own[name], **given.get(name, {})} for name in own}
    return Plant(model, Instruments.model_validate(merged))


def loaded(path: str) -> HammersteinModel:
    """Model from a file, or a packaged one; InputError if the file is wrong."""
    return _model_of(model_text(path), path)


_model_of = lru_cache(maxsize=16)(HammersteinModel.from_json)
"""Cached model from its text: the runs of a study read the same file thousands of times."""


def law_of(compensator: TestedCompensator, model: HammersteinModel, plant: Plant) -> AnyLaw:
    """Law for the instruments of the scenario, not for those of its model's identification.

    Raises InputError or SimulationError where the law does not fit the model or the sample time.
    """
    here = replace(model, instruments=plant.instruments)
    try:  # before the first sample, the actuator rests at its own working point
        limits_v = plant.instruments.drive.limits(plant.model.hysteresis.n_inputs).T
        range_v = DriveRange.of(limits_v, model, start_v=plant.model.recorded.working_point_v)
        return compensator.design(here, range_v, plant.sample_time_s)
    except (InputError, SimulationError) as error:
        raise labelled(f"compensator {compensator.label!r}", error) from None


def _models(
    scenario: Scenario, plant: Plant, progress: Progress | None, store: Store | None, jobs: Jobs
) -> dict[str, HammersteinModel]:
    """Models by label; one that several compensators share is identified once."""
    found: dict[Any, HammersteinModel] = {}
    models = {}
    sources: list[ModelSource] = [s for s in (*scenario.compensators, *scenario.models) if s.is_tested]
    asked = {source.identification for source in sources}
    experiments = {spec: i for spec, i in scenario.experiments().items() if spec in asked}
    done = identify_each(plant, experiments, scenario.seed, store, jobs) if experiments else iter(())
    for i, source in enumerate(sources):
        if progress:
            progress(f"identifying{on_workers(jobs)}", i, len(sources))
        spec = source.identification
        if spec is not None and spec not in found:
            try:
                found[spec] = next(done)
            except (InputError, SimulationError, IdentificationError) as error:
                raise labelled(f"identification of {source.label!r}", error) from None
        models[source.label] = loaded(str(source.model)) if spec is None else found[spec]
    return models


def _check_signal(scenario: Scenario, plant: Plant, source: str) -> None:
    """Refuse what no run could do: too fast for the sample time, wrong axes, out of reach."""
    n_axes = len(scenario_axes(scenario, plant.model))
    nyquist = 0.5 / plant.sample_time_s
    kind = "sweep" if scenario.sweep.frequency_hz else "drive" if scenario.reference is None else "reference"
    mistakes = []
    for signal in scenario.signals():
        if signal.highest_frequency_hz >= nyquist:
            message = f"{signal.highest_frequency_hz:g} Hz is not below half the sample rate, {nyquist:g} Hz"
            mistakes.append(Mistake(f"{kind}.frequency_hz", message))
        if isinstance(signal, OnAxes) and isinstance(signal.axis, int) and not 1 <= signal.axis <= n_axes:
            mistakes.append(Mistake("axis", f"{signal.axis} does not exist; the actuator has {n_axes}"))
        if isinstance(signal, FromFile):
            unit: Kind = "voltage" if scenario.reference is None else "displacement"
            _check_order(signal, scenario_axes(scenario, plant.model), unit)
    mistakes += _too_fast(scenario, plant)
    refuse(source, list(dict.fromkeys(mistakes)))
    if scenario.reference is not None:
        _check_reach(scenario, plant, source)


def _too_fast(scenario: Scenario, plant: Plant) -> Iterator[Mistake]:
    """Identification experiments with a sine that their own sample time would turn into another one."""
    for table, sources in (("compensators", scenario.compensators), ("models", scenario.models)):
        for i, one in enumerate(sources, start=1):
            if one.identification is None:
                continue
            nyquist = 0.5 / (one.identification.sample_time_s or plant.sample_time_s)
            if (highest := one.identification.highest_frequency_hz) >= nyquist:
                yield Mistake(
                    f"{table}[{i}].identification",
                    f"{highest:g} Hz is not below half the sample rate, {nyquist:g} Hz",
                )


def _check_order(signal: FromFile, axes: tuple[str, ...], kind: Kind) -> None:
    """Refuse a file whose columns are not the actuator's axes, in its order and in a unit of this kind."""
    names = signal.table()[2]
    word = "drive" if kind == "voltage" else "reference"
    if chosen(signal.path, names, axes, kind, word) != list(range(len(axes))):
        raise InputError(
            signal.path,
            f"has the columns {', '.join(names)}; give one for each of {', '.join(axes)}, in this order",
        )


def _check_reach(scenario: Scenario, plant: Plant, source: str) -> None:
    """Refuse a reference that no voltage within the drive's range could reach, whatever the phase."""
    model, limits = plant.model, plant.range
    if not np.isfinite(limits.span_v).all():
        return
    low_um, high_um = model.extremes(*limits.counted)
    volts = limits.words(model.inputs)
    for signal in scenario.signals():
        window = Window.of(scenario, signal, plant.sample_time_s)
        time_s = np.linspace(0.0, window.total * plant.sample_time_s, REACH_POINTS)
        for axis in driven_axes(scenario, len(low_um)):
            values = values_of(Case(signal, axis, ""), time_s, len(low_um))
            for name, path, low, high in zip(model.outputs, values, low_um, high_um, strict=True):
                if path.max() > high or path.min() < low:
                    wanted = path.max() if path.max() > high else path.min()
                    raise SimulationError(
                        f"{source}: the reference needs {wanted:.4g} um on {name}, but the actuator "
                        f"reaches {low:.4g} to {high:.4g} um with {volts}. Use a smaller reference, "
                        "another offset_um, or a larger drive range."
                    )

"""Identification experiments on a simulated actuator, as at a real set-up.

The model that comes out has seen the actuator only through its drive and its sensor.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import JsonValue, TypeAdapter
from scipy.linalg import block_diag

from hammerstein.arrays import Array
from hammerstein.blocks import Learner
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics
from hammerstein.errors import IdentificationError, InputError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.linear.creep import fit_creep
from hammerstein.identification.static.closed_form import closed_form
from hammerstein.metrics import settled_cycle
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant, Response
from hammerstein.records.record import Record
from hammerstein.runtime.parallel_tasks import Jobs, completed, in_order
from hammerstein.runtime.store import Kept, Store, key_of, opened
from hammerstein.scenario.source import ClosedFormSpec, IdentificationSpec, JointFitSpec, LoopFitSpec
from hammerstein.signals import MOST_LINES, Multisine, Sine, Triangle, smooth_step

WHOLE = 1e-6  # samples that a period may miss a whole number by


def whole_period(samples: float, label: str) -> int:
    """Samples of a period; InputError if they are no whole number, as a table needs."""
    where = f"compensator {label!r}"
    if not np.isfinite(samples):
        raise InputError(where, "learns from one period to the next, but this path does not repeat")
    found = round(samples)
    if abs(samples - found) > WHOLE or found < 2:
        raise InputError(
            where,
            f"needs a path whose period is a whole number of samples; it has {samples:.6g}. Choose "
            "another frequency or sample time",
        )
    return found


class IlcRun:
    """Trials of one learner on one actuator.

    Each trial repeats one period of voltages from rest, for as long as a run of the scenario. The next trial
    learns from the sensor's readings in the measured window.

    Parameters
    ----------
    law : learning law
    reference_um : (p, N) path of the whole run
    first : sample from which on a run is measured
    period : samples of a period
    seed : of the sensor's noise; each trial has its own
    """

    def __init__(
        self, law: Learner, reference_um: Array, first: int, period: int, seed: Sequence[int]
    ) -> None:
        self._law, self._whole, self._first = law, reference_um, first
        self._seed = list(seed)
        self._path = reference_um[:, first : first + period]
        self._drives: list[Array] = []
        self._before: tuple[Array, Array] | None = None  # drive and reading of the trial before the last
        self._ended = False  # a trial was worse than the one before, whose drive is kept from then on
        self._lock = threading.Lock()

    def trial(self, plant: Plant, number: int) -> Response:
        """Response of a trial, counted from 1; missing earlier trials are done first."""
        with self._lock:
            while len(self._drives) < number:
                self._drives.append(self._next(plant))
        return self._played(plant, number)

    def _next(self, plant: Plant) -> Array:
        done = len(self._drives)
        if not done:
            return self._law.first(self._path)
        if self._ended:
            return self._drives[-1]
        read = self._played(plant, done).reading_um[:, self._first :]
        following = self._law.following(self._path, self._drives[-1], read, self._before)
        self._ended = self._before is not None and following is self._before[0]
        self._before = (self._drives[-1], read)
        return following

    def _played(self, plant: Plant, number: int) -> Response:
        drive, samples = self._drives[number - 1], self._whole.shape[1]
        periods = -(-samples // drive.shape[1])
        requested = np.tile(drive, (1, periods))[:, :samples]
        return plant.respond(requested, [*self._seed, number], self._whole)


class IlcRuns:
    """Trials of learning by actuator, for the lifetime of the actuator."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._found: WeakKeyDictionary[Plant, dict[Hashable, IlcRun]] = WeakKeyDictionary()

    def __reduce__(self) -> tuple[type[IlcRuns], tuple[()]]:
        """Another process begins its own: the numbers are the same."""
        return IlcRuns, ()

    def of(self, plant: Plant, key: Hashable, new: Callable[[], IlcRun]) -> IlcRun:
        """Run of a key on an actuator; new if there is none."""
        with self._lock:
            ilc_runs = self._found.setdefault(plant, {})
            if key not in ilc_runs:
                ilc_runs[key] = new()
            return ilc_runs[key]


LOWEST_LINE_HZ = 5.0  # of the multisine
REST_SAMPLES = 20
"""Rest before each record, to detect a start from rest."""
CREEP_SAMPLES = 12_000
"""Samples of the slow record: creep is slower than a hundred of them."""
SETTLING, UNSETTLED = (3, 6, 12, 24, 48), 1e-3
"""Periods of a multisine before two that are recorded, until these differ by noise and such a part alone."""
CREEP_LEVELS = np.array([0.8, -0.6, 0.4, -0.2, 0.6, 0.0])
"""Slow steps of the creep record, in parts of the amplitude; each lasts a sixth of it."""


def identify_each(
    plant: Plant,
    experiments: Mapping[IdentificationSpec, int],
    seed: int,
    store: Store | None = None,
    jobs: Jobs = 1,
) -> Iterator[HammersteinModel]:
    """Models of a simulated actuator, identified by driving one input at a time (paper, section 3.3).

    The results are kept on disk: the same experiment on the same actuator is not done twice.

    Parameters
    ----------
    plant : the actuator in its set-up
    experiments : with their methods and their positions in the scenario, done side by side
    seed : of the sensor's noise; the position of the experiment is mixed in
    store : where the results are kept; that of the user if not given
    jobs : threads, or an executor of ``concurrent.futures``

    Raises
    ------
    IdentificationError : the data do not determine a model, or the drive cuts the voltage
    """
    actuator = replace(plant.model, instruments=plant.instruments).to_json()
    arguments = [(actuator, spec.model_dump_json(), seed, i) for spec, i in experiments.items()]
    store = store or opened()[0]
    keys = [key_of("identified", one) for one in arguments]
    kept = [None if store is None else store.read(key) for key in keys]

    def finished(number: int, text: str) -> None:
        if store is not None and kept[number] is None:
            store.write(keys[number], Kept(text))

    tasks = (
        partial(_identified, *one) if entry is None else completed(str(entry.document))
        for entry, one in zip(kept, arguments, strict=True)
    )
    yield from map(HammersteinModel.from_json, in_order(tasks, jobs, finished))


def _identified(actuator_json: str, spec_json: str, seed: int, position: int) -> str:
    """Text of the model file that comes out; texts in and out, so that it can be kept."""
    actuator = HammersteinModel.from_json(actuator_json)
    plant = Plant(actuator, actuator.instruments)
    spec: IdentificationSpec = TypeAdapter(IdentificationSpec).validate_json(spec_json)
    seeds = [seed, 0, position]  # a case has the number of its signal, from 1, where the 0 is
    if isinstance(spec, ClosedFormSpec):
        return _closed_form(plant, spec, seeds).to_json()
    setup = _at_sample_time(plant, spec.sample_time_s)
    fit = _joint_fit(setup, spec, seeds) if isinstance(spec, JointFitSpec) else _loop_fit(setup, spec, seeds)
    own, origin = plant.model, _provenance(plant, spec)
    return replace(fit, inputs=own.inputs, outputs=own.outputs, provenance=origin).to_json()


def _closed_form(plant: Plant, spec: ClosedFormSpec, seeds: list[int]) -> HammersteinModel:
    """Equations 14-17 on the settled loop of each input (steps 1-4 of section 3.3)."""
    setup = _at_sample_time(plant, spec.sample_time_s)
    drive = _Excursion.of(setup, spec.amplitude_v)
    loops = (_settled_loop(setup, spec, drive, k, seeds) for k in range(plant.model.hysteresis.n_inputs))
    rows = tuple(zip(*(closed_form(u, y, spec.operators) for u, y in loops), strict=True))
    return HammersteinModel(
        name=f"closed form at {spec.frequency_hz:g} Hz",
        hysteresis=PrandtlIshlinskii(rows),
        dynamics=StaticDynamics(n_outputs=len(rows)),
        amplitude_v=float(drive.amplitude_v.max()),
        inputs=plant.model.inputs,
        outputs=plant.model.outputs,
        instruments=plant.instruments,
        provenance=_provenance(plant, spec),
        voltages=drive.voltages(),
    )


def _joint_fit(plant: Plant, spec: JointFitSpec, seeds: list[int]) -> HammersteinModel:
    """Hysteresis and axes together, from sines and a multisine on each input in turn."""
    from hammerstein.identification.identify import identify

    drive = _Excursion.of(plant, spec.amplitude_v)
    # The creep comes from a slow record of its own.
    settings = spec.settings().changed(creep_modes=0, sensor_bandwidth_hz=_known_hz(plant))
    each = isinstance(spec.operators, tuple)
    name = "joint fit, operators of each pair" if each else f"joint fit, {spec.operators} operators"
    model, _ = identify(
        _records(plant, spec, drive, seeds), settings, name=name, instruments=plant.instruments
    )
    return _with_creep(plant, spec, drive, model, seeds) if spec.creep_modes else model


def _loop_fit(plant: Plant, spec: LoopFitSpec, seeds: list[int]) -> HammersteinModel:
    """Plays in the loop of a state space, from multisines at several levels on all inputs together."""
    from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop

    settings = LoopSettings(order=spec.order, minutes=spec.minutes, sensor_bandwidth_hz=_known_hz(plant))
    drive, name = _Excursion.of(plant, spec.amplitude_v), "hysteresis in the loop"
    records = list(_settled_records(plant, spec, drive, seeds))
    model, _ = identify_in_loop(records, settings, name=name, complete=True)
    ends = (drive.rest_v + end for end in (model.recorded.lowest_v, model.recorded.highest_v))
    return replace(model, instruments=plant.instruments, voltages=Voltages.of(drive.rest_v, *ends))


def _known_hz(plant: Plant) -> float | None:
    """Bandwidth of the sensor by its data sheet."""
    hz = plant.instruments.sensor.bandwidth_hz
    return hz if math.isfinite(hz) else None


def _provenance(plant: Plant, spec: IdentificationSpec) -> JsonValue:
    return {"actuator": plant.model.name, "identification": spec.model_dump(mode="json")}


def _with_creep(
    plant: Plant, spec: JointFitSpec, drive: _Excursion, model: HammersteinModel, seeds: list[int]
) -> HammersteinModel:
    """Add the creep of every axis, from one slow record of slow steps on all inputs.

    The resonances are far above the slow record's sample rate: the static block stands for them.
    """
    setup = _at_sample_time(plant, spec.creep_record_s / CREEP_SAMPLES)
    steps = np.repeat(CREEP_LEVELS, CREEP_SAMPLES // len(CREEP_LEVELS))
    m = plant.model.hysteresis.n_inputs
    levels = np.stack([np.roll(steps, k * len(steps) // (3 * m)) for k in range(m)])
    response = setup.respond(drive.centre_v[:, None] + drive.amplitude_v[:, None] * levels, [*seeds, m + 1])
    v, _ = model.static_response(response.drive_v)
    dynamics = model.dynamics
    if not isinstance(dynamics, AxesDynamics):  # none was found that is faster
        dynamics = AxesDynamics(axes=(Axis(),) * dynamics.n_outputs)
    axes = []
    for axis, said, read in zip(dynamics.axes, v, response.reading_um, strict=True):
        modes = fit_creep(said, read, setup.sample_time_s, spec.creep_modes)
        axes.append(axis.model_copy(update={"creep": modes}))
    slow = dynamics.model_copy(update={"axes": tuple(axes)})
    known = model.covariance and model.covariance.beside_creep(model.dynamics, slow)
    return replace(model, dynamics=slow, covariance=known)


def _records(plant: Plant, spec: JointFitSpec, drive: _Excursion, seeds: list[int]) -> list[Record]:
    """One record an input; the inputs are driven one after the other, and the actuator keeps its memory."""
    highest = max(spec.frequencies_hz)
    lowest = LOWEST_LINE_HZ if highest > 2.0 * LOWEST_LINE_HZ else 0.5 * highest
    lowest = max(lowest, highest / MOST_LINES)
    samples = round(spec.record_s / plant.sample_time_s)
    time_s = np.linspace(0.0, (samples - 1) * plant.sample_time_s, samples)
    blocks = []
    for k, amplitude_v in enumerate(drive.amplitude_v.tolist()):
        bursts = [
            Sine(amplitude=amplitude_v, frequency_hz=f, axis=1) for f in sorted(spec.frequencies_hz)
        ] + [Multisine(amplitude=amplitude_v, lowest_hz=lowest, highest_hz=highest, seed=seeds[0])]
        waves = np.concatenate([burst.sample(time_s, 1)[0] for burst in bursts])
        away = drive.centre_v[k] - drive.rest_v[k]
        ramp = smooth_step(np.arange(len(waves)) / samples)
        grown = ramp * waves if away else waves  # on the way to the middle, full waves would leave the range
        blocks.append(np.concatenate([np.zeros(REST_SAMPLES), grown + away * ramp]))
    one, m = blocks[0], len(blocks)
    response = plant.respond(drive.rest_v[:, None] + block_diag(*blocks), [*seeds, 1])
    parts = [slice(k * len(one) + REST_SAMPLES, (k + 1) * len(one)) for k in range(m)]
    return [
        Record(
            response.drive_v[:, part],
            response.reading_um[:, part],
            plant.sample_time_s,
            inputs=plant.model.inputs,
            outputs=plant.model.outputs,
            source=f"simulated, input {k + 1}",
        )
        for k, part in enumerate(parts)
    ]


def _settled_records(
    plant: Plant, spec: LoopFitSpec, drive: _Excursion, seeds: list[int]
) -> Iterator[Record]:
    """Two settled periods of a multisine at each level, from rest each time; voltages count from there."""
    n, m = round(spec.record_s / plant.sample_time_s), len(drive.amplitude_v)
    lowest, highest = 1.0 / (n * plant.sample_time_s), spec.highest_frequency_hz
    for i, level in enumerate(np.tile(spec.levels, spec.experiments).tolist(), start=1):
        wave = Multisine(amplitude=1.0, lowest_hz=lowest, highest_hz=highest, seed=seeds[0] + i)
        for before in SETTLING:
            time_s = plant.sample_time_s * np.arange((before + 2) * n, dtype=np.float64)
            about = (drive.centre_v - drive.rest_v)[:, None] + (
                level * drive.amplitude_v[:, None] * wave.sample(time_s, m)
            )
            grown = smooth_step(np.arange(len(time_s)) / n) * about
            response = plant.respond(drive.rest_v[:, None] + grown, [*seeds, i])
            u, y = response.drive_v[:, -2 * n :] - drive.rest_v[:, None], response.reading_um[:, -2 * n :]
            if _repeats(y, plant.instruments.sensor.noise_um):
                break
        yield Record(u, y, plant.sample_time_s, source=f"simulated, experiment {i}", period_samples=n)


def _repeats(y_um: Array, noise_um: float) -> bool:
    """Whether two periods (output, sample) are alike, but for a noise that is known."""
    one, other = np.split(y_um, 2, axis=1)
    moved = np.sqrt(np.mean((other - one) ** 2, axis=1))
    return bool((moved <= 2.0 * noise_um + UNSETTLED * other.std(axis=1)).all())


def _settled_loop(
    setup: Plant, spec: ClosedFormSpec, drive: _Excursion, k: int, seeds: list[int]
) -> tuple[Array, Array]:
    """Mean settled cycle of the voltage about its middle (phase,) and of the readings (output, phase)."""
    period = 1.0 / spec.frequency_hz
    settle = max(spec.settle_cycles, math.ceil(0.05 / period))
    samples = round((settle + spec.measured_cycles) * period / setup.sample_time_s)
    voltage = np.repeat(drive.rest_v[:, None], samples, axis=1)
    time_s = np.arange(samples, dtype=np.float64) * setup.sample_time_s
    shape = Triangle if spec.waveform == "triangle" else Sine
    wave = shape(amplitude=float(drive.amplitude_v[k]), frequency_hz=spec.frequency_hz, axis=1)
    voltage[k] = drive.centre_v[k] + wave.sample(time_s, 1)[0]
    response = setup.respond(voltage, [*seeds, k + 1])
    phases = 2 * max(1, round(0.5 * period / setup.sample_time_s))
    both = np.vstack([response.drive_v[k] - drive.centre_v[k], response.reading_um])
    cycle = settled_cycle(both, spec.frequency_hz, setup.sample_time_s, phases, skip_cycles=settle)
    return cycle[0], cycle[1:]


def _at_sample_time(plant: Plant, sample_time_s: float | None) -> Plant:
    if sample_time_s is None:
        return plant
    drive = plant.instruments.drive.model_copy(update={"sample_time_s": sample_time_s})
    return Plant(plant.model, plant.instruments.model_copy(update={"drive": drive}))


class _Excursion(NamedTuple):
    """Voltages of an experiment: from rest about the middle of the range that the actuator is known in.

    rest_v, centre_v, amplitude_v : (m,) [V]
    """

    rest_v: Array
    centre_v: Array
    amplitude_v: Array

    @classmethod
    def of(cls, plant: Plant, amplitude_v: float | None) -> _Excursion:
        """With an amplitude, or that of the actuator; IdentificationError where the drive would cut it."""
        known = plant.model.recorded
        low, high = np.array(known.lowest_v), np.array(known.highest_v)
        centre = 0.5 * (low + high)
        size = 0.5 * (high - low) if amplitude_v is None else np.full(len(low), amplitude_v)
        limits = plant.range
        if ((centre + size > limits.high_v) | (centre - size < limits.low_v)).any():
            about = ", ".join(
                dict.fromkeys(f"{a:g} V about {c:g} V" for a, c in zip(size, centre, strict=True))
            )
            raise IdentificationError(
                f"the identification needs {about}, but the drive gives "
                f"{limits.words(plant.model.inputs)}; lower amplitude_v"
            )
        return cls(np.array(known.working_point_v), centre, size)

    def voltages(self) -> Voltages:
        """Voltages for a model file."""
        return Voltages.of(self.rest_v, self.centre_v - self.amplitude_v, self.centre_v + self.amplitude_v)

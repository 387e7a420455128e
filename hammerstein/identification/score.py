"""Predictions of a model for a record, sensor included, and their errors."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.dynamics import (
    AxesDynamics,
    Dynamics,
    FeedbackBlock,
    LinearBlock,
    StateSpaceDynamics,
    StaticDynamics,
    discretise,
    on_grid,
    split_delay,
)
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Hysteresis
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.identification.options import InitialStateMode
from hammerstein.identification.static.initial_state import own_start
from hammerstein.identification.static.regressors import InitialState, Regressors
from hammerstein.identification.static.static_block import half_swing
from hammerstein.quantities import interval
from hammerstein.records.checks import FEWEST_SAMPLES
from hammerstein.records.record import Record

LOST = 1e-3
"""Smallest gain, in parts of the largest at low frequency, that can be inverted."""
LINES = 400
"""Frequencies up to Nyquist at which the gain is looked at."""
AT_REST = 0.01
"""Part of the swing by which a voltage may have moved while the actuator counts as at rest."""


@dataclass(frozen=True)
class SensorModel:
    """Sensor with known lag and delay.

    A reading that is late by so many samples and a part of one is that of voltages as late: whole samples are
    taken off a record before anything else is done with it, each by its own sample time, and the part that is
    left stands in the path from the voltages to the reading.

    Parameters
    ----------
    bandwidth_hz : of a first-order sensor [Hz]; None: unlimited
    delay_s : time by which its readings come late beside that [s]
    """

    bandwidth_hz: float | None = None
    delay_s: float = 0.0

    def part_s(self, sample_time_s: float) -> float:
        """Fraction of a sample of the delay [s]."""
        return split_delay(self.delay_s, sample_time_s)[1]

    def prompt(self, record: Record) -> Record:
        """The record without the whole samples of the delay; row numbers do not change.

        A period that is repeated goes on at its beginning; of any other record the last voltages go, whose
        readings are not known.

        Raises InputError for a record that is hardly longer than the delay.

        Examples
        --------
        >>> u = np.sin(np.linspace(0.0, 12.0, 300))
        >>> late = Record([u[2:]], [u[:-2]], 1e-3)
        >>> prompt = SensorModel(delay_s=2.3e-3).prompt(late)
        >>> prompt.samples, bool((prompt.u_v == prompt.y_um).all()), prompt.rows[:2]
        (296, True, array([3, 4]))
        """
        samples, _ = split_delay(self.delay_s, record.sample_time_s)
        if samples == 0:
            return record
        if record.samples - samples < FEWEST_SAMPLES:
            what = f"has {record.samples} samples, but the sensor delay is {samples} samples"
            raise InputError(
                record.source, f"{what} ({interval(self.delay_s)}); check this delay, or record longer"
            )
        if record.period_samples is not None and record.samples % record.period_samples == 0:
            return replace(record, y_um=np.roll(record.y_um, -samples, axis=1), verified=True)
        kept = record.part(samples, record.samples)
        return replace(kept, u_v=record.u_v[:, : kept.samples], verified=True)

    def freed(self, record: Record) -> Record:
        """The prompt record with readings of a sensor without lag or delay.

        Each line f of their spectrum is multiplied by (1 + j f / bandwidth) e^(j 2 pi f delay), and so is
        noise. Settled periods repeat; any other record goes on as its image in its last point, and back.

        Examples
        --------
        >>> angle = 2.0 * np.pi * np.arange(200) / 100
        >>> late = np.sqrt(0.5) * np.sin(angle - np.pi / 4)
        >>> sine = Record([np.sin(angle)], [late], 1e-3, period_samples=100)
        >>> bool(np.allclose(SensorModel(10.0).freed(sine).y_um, sine.u_v))
        True
        """
        part_s, read = self.part_s(record.sample_time_s), record.y_um
        if self.bandwidth_hz is None and not part_s:
            return record
        if record.period_samples is None or record.samples % record.period_samples:
            read = np.hstack([read, 2.0 * read[:, -1:] - read[:, -2::-1]])
            read = np.hstack([read, read[:, -2:0:-1]])
        hz = np.fft.rfftfreq(read.shape[1], record.sample_time_s)
        ahead = (1.0 + 1j * hz / (self.bandwidth_hz or np.inf)) * np.exp(2j * np.pi * hz * part_s)
        y = np.fft.irfft(ahead * np.fft.rfft(read), read.shape[1])[:, : record.samples]
        return replace(record, y_um=y, verified=True)

    def path(self, dynamics: Dynamics, sample_time_s: float) -> LinearBlock:
        """Discrete path from the static block to the reading of a prompt record, which is linear."""
        return discretise(self._late(dynamics, sample_time_s), sample_time_s, self.bandwidth_hz)

    def block(self, dynamics: Dynamics, sample_time_s: float) -> LinearBlock | FeedbackBlock:
        """Return the same path, or one with hysteresis in its loop."""
        return on_grid(self._late(dynamics, sample_time_s), sample_time_s, self.bandwidth_hz)

    def _late(self, dynamics: Dynamics, sample_time_s: float) -> Dynamics:
        late = {"input_delay_s": dynamics.input_delay_s + self.part_s(sample_time_s)}
        return dynamics.model_copy(update=late)

    def paths(self, dynamics: Dynamics, records: Sequence[Record]) -> list[LinearBlock]:
        """Path of each record; none without dynamics between static block and reading."""
        late = dynamics.input_delay_s or any(self.part_s(record.sample_time_s) for record in records)
        if isinstance(dynamics, StaticDynamics) and self.bandwidth_hz is None and not late:
            return []
        return [self.path(dynamics, record.sample_time_s) for record in records]


_block = lru_cache(maxsize=16)(SensorModel.block)
"""Many starts are tried with one and the same model."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Candidate model: static block, linear block and sensor.

    at_limit : whether one of its numbers ended at the limit of what the records can determine
    placed : whether the places of its hysteresis were fitted
    """

    hysteresis: Hysteresis[Any]
    dynamics: Dynamics
    sensor: SensorModel = field(default_factory=SensorModel)
    at_limit: bool = False
    placed: bool = False

    @property
    def settle_s(self) -> float:
        """Time in which its axes, without their creep, ring down to a thousandth [s]."""
        return self.dynamics.settle_s if isinstance(self.dynamics, AxesDynamics) else 0.0

    @property
    def slow_s(self) -> float:
        """Longest time constant of its creep [s]; 0 without creep."""
        axes = self.dynamics.axes if isinstance(self.dynamics, AxesDynamics) else ()
        return max((mode.time_constant_s for axis in axes for mode in axis.creep), default=0.0)

    def own_starts(
        self, records: Sequence[Record], starts: Sequence[InitialState], mode: InitialStateMode = "auto"
    ) -> tuple[InitialState, ...]:
        """Initial state of each record for this model, on the samples that count for all models."""
        if mode != "auto":
            return tuple(starts)
        each = zip(records, starts, strict=True)
        return tuple(own_start(record, start, self.predict, self.slow_s) for record, start in each)

    def predict(self, record: Record, start: InitialState) -> Array:
        """Predicted readings (output, sample) for the voltages of a record, without offset [um]."""
        block = _block(self.sensor, self.dynamics, record.sample_time_s)
        hysteresis = self.hysteresis.counted_from(record.rest_v).on_grid(record.sample_time_s)
        before = begun(hysteresis, record, start)
        v, memory = hysteresis.respond(record.u_v, before)
        if start.kind == "repeated":
            v, _ = hysteresis.respond(record.u_v, memory)
            y, state = block.respond(v)
        else:
            held, _ = hysteresis.respond(start.path_v(record.u_v)[:, -1:], before)
            state = block.settled(held[:, 0]) if isinstance(block, LinearBlock) else block.rest()
            if start.held:
                _, state = block.respond(np.repeat(v[:, :1], start.held, axis=1), state)
            y, state = block.respond(v, state)
        if start.kind == "repeated":
            y, _ = block.respond(v, state)
        return np.asarray(y[-len(record.y_um) :])

    def has_inverse(self, records: Sequence[Record]) -> bool:
        """Whether it has an inverse over the largest swing in the counted samples."""
        first, swing_v = records[0], float(half_swing(records).max())
        block = self.hysteresis.counted_from(first.rest_v)
        return invertibility_of(block, self.dynamics, swing_v, first.sample_time_s, first.inputs)[0]

    def residual(self, record: Record, start: InitialState) -> Array:
        """Reading minus prediction (output, sample) over the counted samples, about the mean [um]."""
        error = (record.y_um - self.predict(record, start))[:, start.first :]
        return np.asarray(error - error.mean(axis=1, keepdims=True))


def begun(hysteresis: Hysteresis[Any], record: Record, start: InitialState) -> Any:
    """Memory of a static block before a record."""
    if start.kind in ("rest", "repeated"):
        return hysteresis.rest()
    return hysteresis.after(start.path_v(record.u_v))


def columns_of(
    block: Hysteresis[Any] | Identifiable, record: Record, start: InitialState, o: int
) -> Regressors:
    """Response of output o to each of its weights alone, over a record, and before it."""
    here, driven = _driven(block, record, start)
    return Regressors(*here.columns(*driven[:2], o, driven[2]))


def bends_of(block: Identifiable, record: Record, start: InitialState) -> tuple[Array, Array]:
    """Derivatives (number, output, sample) of the outputs by the free parameters, and before the record."""
    here, driven = _driven(block, record, start)
    return here.bends(*driven)


def _driven(
    block: Hysteresis[Any] | Identifiable, record: Record, start: InitialState
) -> tuple[Identifiable, tuple[Array, Array, int]]:
    """The block as it counts in a record; voltages, those before, and how often they are played."""
    here = cast("Hysteresis[Any]", block).counted_from(record.rest_v).on_grid(record.sample_time_s)
    passes = 2 if start.kind == "repeated" else 1
    return cast(Identifiable, here), (record.u_v, start.path_v(record.u_v), passes)


@dataclass(frozen=True)
class Score:
    """Errors of a model, one number per output.

    Parameters
    ----------
    nrmse_percent : rms error in percent of the range of the readings
    rms_um : rms error about its mean in each record [um]
    output_percent : rms error in percent of the rms of the readings about their mean
    largest_um : largest error about its mean in a record [um]
    """

    nrmse_percent: tuple[float, ...]
    rms_um: tuple[float, ...]
    output_percent: tuple[float, ...]
    largest_um: tuple[float, ...] = ()

    @property
    def mean_percent(self) -> float:
        """Mean over the outputs."""
        return float(np.mean(self.nrmse_percent))


def score(candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]) -> Score:
    """Errors of a model on records, all together."""
    squares, power, largest = np.zeros((3, len(records[0].y_um)))
    samples = 0
    for record, start in zip(records, starts, strict=True):
        residual = candidate.residual(record, start)
        squares += np.sum(residual**2, axis=1)
        largest = np.maximum(largest, np.abs(residual).max(axis=1))
        samples += residual.shape[1]
        power += np.var(record.y_um[:, start.first :], axis=1) * residual.shape[1]
    rms = np.sqrt(squares / samples)
    percent = 100.0 * rms / ranges(records, starts)
    relative = 100.0 * np.sqrt(squares / np.maximum(power, np.finfo(float).tiny))
    return Score(*(tuple(found.tolist()) for found in (percent, rms, relative, largest)))


def invertibility_of(
    hysteresis: Hysteresis[Any],
    dynamics: Dynamics,
    range_v: ArrayLike,
    sample_time_s: float,
    inputs: Sequence[str],
) -> tuple[bool, str]:
    """Whether a model has an inverse, and a sentence with the slope or frequency that prevents it.

    range_v : as ``invertibility`` takes it [V]
    """
    try:
        static = replace(invertibility(hysteresis, range_v), inputs=tuple(inputs))
        static_ok, sentence = static.invertible, static.statement()
    except (InputError, SimulationError) as error:
        static_ok, sentence = False, f"The hysteresis has no inverse: {error}"
    if not isinstance(dynamics, StateSpaceDynamics):
        return static_ok, sentence
    frequency_hz = np.linspace(0.0, 0.5 / sample_time_s, LINES + 1)[:-1]
    response = discretise(dynamics, sample_time_s).response(frequency_hz)
    singular = np.linalg.svd(response, compute_uv=False)
    weakest = int(np.argmin(singular[:, -1]))
    if singular[weakest, -1] >= LOST * singular[0, 0]:
        return static_ok, sentence
    return False, (
        f"{sentence} The linear block has no usable inverse at {frequency_hz[weakest]:.4g} Hz: in one "
        f"direction of the outputs, the gain is only {singular[weakest, -1] / singular[0, 0]:.1e} of "
        "the static gain."
    )


def rest_errors(
    candidate: Candidate, records: Sequence[Record], starts: Sequence[InitialState]
) -> Array | None:
    """Rms over the records of each output's error at their beginning, about that of the whole record [um].

    A path counts from where the actuator rests, and an error of a record about its mean. By as much as the
    prediction is off there, the whole path is off. None where no beginning is explained.
    """
    found = []
    for record, start in zip(records, starts, strict=True):
        if not (start.first or start.held or record.period_samples is not None):
            near = np.abs(record.u_v - record.u_v[:, :1]) <= AT_REST * np.ptp(
                record.u_v, axis=1, keepdims=True
            )
            still = int(np.argmin(np.append(near.all(axis=0), False)))
            found.append(candidate.residual(record, start)[:, :still].mean(axis=1))
    return np.sqrt(np.mean(np.square(found), axis=0)) if found else None


def ranges(records: Sequence[Record], starts: Sequence[InitialState]) -> Array:
    """Largest range of each output (output,) in one record, over the samples that count [um]."""
    spans = [np.ptp(r.y_um[:, s.first :], axis=1) for r, s in zip(records, starts, strict=True)]
    return np.asarray(np.maximum(np.max(spans, axis=0), np.finfo(float).tiny))

"""Known sensor from its data sheet, whose effect on readings is excluded from the model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hammerstein.dynamics import (
    Dynamics,
    FeedbackBlock,
    LinearBlock,
    StaticDynamics,
    discretise,
    on_grid,
    split_delay,
)
from hammerstein.errors import InputError
from hammerstein.quantities import interval
from hammerstein.records.checks import FEWEST_SAMPLES
from hammerstein.records.record import Record


@dataclass(frozen=True)
class SensorModel:
    """Sensor whose readings lag and come late by what is known.

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
        """What whole samples leave of the delay [s]."""
        return split_delay(self.delay_s, sample_time_s)[1]

    def prompt(self, record: Record) -> Record:
        """The record with its readings earlier by the whole samples of the delay; their row numbers stay.

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
        noise. Settled periods repeat; any other record is taken to go back the way it came, so that its last
        samples are less accurate.

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
            read = np.hstack([read, read[:, ::-1]])
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
        """Path of each record; none at all where nothing stands between static block and reading."""
        late = dynamics.input_delay_s or any(self.part_s(record.sample_time_s) for record in records)
        if isinstance(dynamics, StaticDynamics) and self.bandwidth_hz is None and not late:
            return []
        return [self.path(dynamics, record.sample_time_s) for record in records]

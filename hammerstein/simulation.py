"""The actuator on its bench: what a drive does to it and what the sensor says."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import LinearBlock, discretise
from hammerstein.hysteresis import PlayState
from hammerstein.instruments import Instruments
from hammerstein.model import HammersteinModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Response:
    """One run, every wire kept; rows are axes, columns samples.

    reference_um : what was asked for (output, sample) [um]; None for a run in volts
    requested_v : voltage that the compensator asks for (input, sample) [V]
    drive_v : voltage that leaves the converter [V]
    hysteresis_um : output of the Prandtl-Ishlinskii block (output, sample) [um]
    position_um : true position [um]
    reading_um : what the sensor says [um]
    saturated : where the drive's range cut the voltage (input, sample)
    """

    sample_time_s: float
    reference_um: Array | None
    requested_v: Array
    drive_v: Array
    hysteresis_um: Array
    position_um: Array
    reading_um: Array
    saturated: NDArray[np.bool_]

    @property
    def time_s(self) -> Array:
        """Time of each sample [s], from zero."""
        return np.asarray(np.arange(self.drive_v.shape[1]) * self.sample_time_s, dtype=np.float64)

    def after(self, first: int) -> Response:
        """Give the same run from one sample on."""
        wires = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "sample_time_s"}
        cut = {name: wire[:, first:] for name, wire in wires.items() if wire is not None}
        return replace(self, **cut)


class PlantState(NamedTuple):
    """Memory of the plays, state (n,) of the linear block and the sensor, and the generator of the noise."""

    memory: PlayState
    linear: Array
    noise: np.random.Generator


@dataclass(frozen=True, eq=False)
class Plant:
    """The actuator on its bench: drive, hysteresis, dynamics and sensor on one sample grid."""

    model: HammersteinModel
    instruments: Instruments

    @property
    def sample_time_s(self) -> float:
        """Time between samples [s]."""
        return self.instruments.drive.sample_time_s

    @cached_property
    def block(self) -> LinearBlock:
        """Dynamics and the sensor's bandwidth; outputs are the positions, then the filtered ones."""
        return discretise(self.model.dynamics, self.sample_time_s, self.instruments.sensor.bandwidth_hz)

    def rest(self, seed: list[int]) -> PlantState:
        """Actuator that was never driven, and a sensor at the beginning of its noise."""
        noise = np.random.default_rng(seed)
        return PlantState(self.model.hysteresis.rest(), self.block.rest(), noise)

    def respond(self, requested_v: Array, seed: list[int], reference_um: Array | None = None) -> Response:
        """Response to a voltage (input, sample) from rest, every wire kept."""
        return self.carry_on(requested_v, self.rest(seed), reference_um)[0]

    def carry_on(
        self, requested_v: Array, start: PlantState, reference_um: Array | None = None
    ) -> tuple[Response, PlantState]:
        """Response to a stretch of voltage, and the state after it.

        A run cut in stretches gives the same numbers as in one piece, to the last bit. The generator of the
        noise is moved on, not copied.

        Parameters
        ----------
        requested_v : (input, sample) voltage [V]
        start : state before the first sample
        reference_um : (output, sample) what was asked for [um], where a law asks for the voltage
        """
        drive_v, saturated = self.instruments.drive.apply(requested_v)
        if reference_um is not None:
            # A law stays within the range itself; where it stands at the range, it wanted more.
            saturated |= np.abs(requested_v) >= self.instruments.drive.range_v * (1.0 - 1e-9)
        hysteresis_um, memory = self.model.hysteresis.respond(drive_v, start.memory)
        both_um, linear = self.block.respond(hysteresis_um, start.linear)
        position_um, filtered_um = np.split(both_um, 2)
        reading_um = self.instruments.sensor.read(filtered_um, start.noise)
        response = Response(
            sample_time_s=self.sample_time_s,
            reference_um=reference_um,
            requested_v=requested_v,
            drive_v=drive_v,
            hysteresis_um=hysteresis_um,
            position_um=position_um,
            reading_um=reading_um,
            saturated=saturated,
        )
        return response, PlantState(memory, linear, start.noise)

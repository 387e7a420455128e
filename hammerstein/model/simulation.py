"""Simulation of an actuator with drive and sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array, allocate_wires
from hammerstein.blocks import Controller
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import FeedbackBlock, LinearBlock, on_grid
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Memory
from hammerstein.hysteresis.kind import refuse_not_finite
from hammerstein.model import HammersteinModel
from hammerstein.notebook_repr import NotebookRepr
from hammerstein.quantities import POSITION_UM, VOLTAGE_V, Range, column, interval, number_of

if TYPE_CHECKING:
    import control
    import pandas as pd

    from hammerstein.blocks.block_system import BlockSystem

Wire = Literal["reference_um", "requested_v", "drive_v", "hysteresis_um", "position_um", "reading_um"]
WIRES = ("reference_um", "requested_v", "drive_v", "hysteresis_um", "position_um", "reading_um")
"""Wires in the order of the block diagram."""


BLOCK = 16_384
"""Samples that pass the whole chain at a time, so that they fit the cache."""


def within(limits: Range, wires: Sequence[Array], first: int, stop: int) -> bool:
    """Whether wires (axis, sample) stay within bounds from one sample to another."""
    from hammerstein.blocks.instrument_kernels import outside

    return not any(outside(wire, first, stop, limits.low, limits.high) for wire in wires)


def refuse_unbounded(name: str, wire: Array, sample_time_s: float) -> None:
    """Raise SimulationError, with axis and time, for a wire (axis, sample) that diverges or is not finite."""
    quantity, _, unit = name.rpartition("_")
    limits = {"um": POSITION_UM, "v": VOLTAGE_V}[unit]
    if wire.size == 0 or (limits.low <= wire.min() and wire.max() <= limits.high):  # never true for NaN
        return
    bad = ~((wire >= limits.low) & (wire <= limits.high))
    sample = int(np.argmax(bad.any(axis=0)))
    axis = int(np.argmax(bad[:, sample]))
    raise SimulationError(
        f"{quantity.replace('_', ' ')} of axis {axis + 1} reaches {wire[axis, sample]:.3g} "
        f"{('V' if unit == 'v' else unit)} after {sample * sample_time_s:.4g} s: a block in the chain "
        "is unstable. Check the actuator's dynamics and the gains of the law"
    )


@dataclass(frozen=True, eq=False)
class Response(NotebookRepr):
    """All signals of one run; rows are axes, columns samples.

    reference_um : desired position (output, sample) [um]; None for a run in volts
    requested_v : voltage from the compensator (input, sample) [V]
    drive_v : voltage after the converter [V]
    hysteresis_um : output of the hysteresis (output, sample) [um]
    position_um : true position [um]
    reading_um : output of the sensor [um]
    saturated : samples at which the drive's range clipped the voltage (input, sample)
    inputs, outputs : names of the axes; numbers from 1 if not given
    known : whether all signals were already checked

    Raises
    ------
    SimulationError : a signal that is not finite or exceeds all bounds

    Examples
    --------
    >>> plant = Plant(HammersteinModel.load("duo_bimorph_static"), Instruments.ideal())
    >>> response = plant.respond(np.array([[0.0, 5.0], [0.0, 0.0]]), [0])
    >>> response
    Response(2 samples of 50 us, 2 inputs, 2 outputs; position 0 to 24.32 um)
    >>> list(response.to_frame())[-2:]
    ['reading_x_um', 'reading_y_um']
    """

    sample_time_s: float
    reference_um: Array | None
    requested_v: Array
    drive_v: Array
    hysteresis_um: Array
    position_um: Array
    reading_um: Array
    saturated: NDArray[np.bool_]
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    known: InitVar[bool] = False

    def __repr__(self) -> str:
        m, samples = self.drive_v.shape
        low, high = np.min(self.position_um, initial=0.0), np.max(self.position_um, initial=0.0)
        cut = f", the range clipped {n} samples" if (n := int(self.saturated.any(axis=0).sum())) else ""
        return (
            f"Response({samples} samples of {interval(self.sample_time_s)}, {number_of(m, 'input')}, "
            f"{number_of(len(self.position_um), 'output')}; position {low:.4g} to {high:.4g} um{cut})"
        )

    @property
    def time_s(self) -> Array:
        """Time of each sample [s], from zero."""
        return np.asarray(np.arange(self.drive_v.shape[1]) * self.sample_time_s, dtype=np.float64)

    def __post_init__(self, known: bool) -> None:
        for name, wire in () if known else self._given().items():
            refuse_unbounded(name, wire, self.sample_time_s)

    def after(self, first: int) -> Response:
        """Return the same run from one sample on."""
        cut: dict[str, Any] = {name: wire[:, first:] for name, wire in self.wires().items()}
        return replace(self, known=True, **cut)

    def wires(self) -> dict[str, NDArray[Any]]:
        """Signals of this run by name, and the samples at which the range clipped the voltage."""
        return {**self._given(), "saturated": self.saturated}

    def _given(self) -> dict[str, Array]:
        """Every wire that this run has, by name."""
        return {name: wire for name in WIRES if (wire := getattr(self, name)) is not None}

    def columns(self) -> dict[str, Array]:
        """All signals of every axis (sample,), by names such as ``drive_x_v``; without time."""
        columns: dict[str, Array] = {}
        for name, wire in self._given().items():
            quantity, unit = name.rsplit("_", 1)
            axes = (self.inputs if unit == "v" else self.outputs) or range(1, len(wire) + 1)
            columns |= {column(quantity, str(axis), unit): row for axis, row in zip(axes, wire, strict=True)}
        return columns

    def to_frame(self) -> pd.DataFrame:
        """Every wire as a pandas table, a row a sample, by time [s]: columns such as ``position_x_um``."""
        import pandas as pd

        return pd.DataFrame(self.columns(), index=pd.Index(self.time_s, name="time_s"))

    def to_time_response(
        self, outputs: Sequence[Wire] = ("position_um",), inputs: Sequence[Wire] | None = None
    ) -> control.TimeResponseData:
        """Return the run as ``control.TimeResponseData``, for example for ``plot``.

        Parameters
        ----------
        outputs, inputs : wires; the input is the reference, or the drive without one, if not given

        Raises InputError for a reference that this run does not have.
        """
        import control

        given: tuple[Wire, ...] = ("drive_v",) if self.reference_um is None else ("reference_um",)
        leaving, entering = self._signals(outputs), self._signals(inputs or given)
        return control.TimeResponseData(
            self.time_s,
            np.array(list(leaving.values())),
            inputs=np.array(list(entering.values())),
            output_labels=list(leaving),
            input_labels=list(entering),
            issiso=False,
            title="Response",
            sysname="actuator",
        )

    def _signals(self, wires: Sequence[str]) -> dict[str, Array]:
        """Signals of some wires by the names that systems give them, ``drive_v[0]`` and so on."""
        from hammerstein.blocks.block_system import signals

        found, given = dict[str, Array](), self._given()
        for name in wires:
            if name not in given:
                raise InputError("wire", f"{name!r} is not a signal of this run; it has {', '.join(given)}")
            found |= dict(zip(signals(name, len(given[name])), given[name], strict=True))
        return found

    def every(self, samples: int) -> Response:
        """Keep every n-th sample; it counts as clipped if any of the n samples is."""
        if samples == 1:
            return self
        starts = np.arange(0, self.drive_v.shape[1], samples)
        kept: dict[str, Any] = {name: wire[:, ::samples].copy() for name, wire in self.wires().items()}
        kept["saturated"] = np.logical_or.reduceat(self.saturated, starts, axis=1)
        return replace(self, sample_time_s=samples * self.sample_time_s, known=True, **kept)

    @classmethod
    def joined(cls, parts: Sequence[Response]) -> Response:
        """Join the parts of one run."""
        first = parts[0]
        if len(parts) == 1:
            return first
        each = [part.wires() for part in parts]
        whole: dict[str, Any] = {n: np.concatenate([one[n] for one in each], axis=1) for n in each[0]}
        return replace(first, known=True, **whole)


class AppliedDrive(NamedTuple):
    """A part of the voltage (input, sample): requested [V], applied [V], and samples cut by the range.

    left : (m,) inputs that have moved from the working point
    """

    requested_v: Array
    drive_v: Array
    saturated: NDArray[np.bool_]
    left: NDArray[np.bool_] | None


class PlantState(NamedTuple):
    """Memory of the hysteresis, state (n,) of linear block and sensor, and the generator of the noise.

    left : (m,) which inputs a law has moved from the working point; None: no one
    """

    memory: Memory
    linear: Array
    noise: np.random.Generator
    left: NDArray[np.bool_] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers; the generator's state is one of them.

        Inputs that a law has moved are not included; the memory of the law has them.
        """
        noise = self.noise.bit_generator.state
        return {"memory": self.memory.as_dict(), "linear": self.linear.tolist(), "noise": noise}


@dataclass(frozen=True, eq=False)
class Plant:
    """Actuator with its instruments: drive, hysteresis, dynamics and sensor on one sample grid."""

    model: HammersteinModel
    instruments: Instruments

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", self.model.on_grid(self.sample_time_s))

    @property
    def sample_time_s(self) -> float:
        """Time between samples [s]."""
        return self.instruments.drive.sample_time_s

    @cached_property
    def block(self) -> LinearBlock | FeedbackBlock:
        """Dynamics and the sensor's bandwidth; outputs are the positions, then the filtered ones."""
        return on_grid(self.model.dynamics, self.sample_time_s, self.instruments.sensor.bandwidth_hz)

    @cached_property
    def range(self) -> DriveRange:
        """Range of the drive; before the first voltage, the actuator rests at its working point."""
        return DriveRange.of(self.instruments.drive.limits(self.model.hysteresis.n_inputs).T, self.model)

    def rest(self, seed: list[int]) -> PlantState:
        """State of an actuator at rest, and of a sensor at the start of its noise."""
        return PlantState(*self._at_rest, np.random.default_rng(seed))

    @cached_property
    def _at_rest(self) -> tuple[Any, Array]:
        """Memory of the hysteresis and state of the block, which no response changes."""
        return self.model.hysteresis.rest(), self.block.rest()

    def restore(self, data: dict[str, Any]) -> PlantState:
        """State from the result of its ``as_dict``."""
        noise = np.random.PCG64(0)
        noise.state = data["noise"]
        memory = self.model.hysteresis.restore(data["memory"])
        return PlantState(memory, np.array(data["linear"], dtype=np.float64), np.random.Generator(noise))

    def respond(self, requested_v: Array, seed: list[int], reference_um: Array | None = None) -> Response:
        """Response to a voltage (input, sample) from rest, with all signals."""
        return self.carry_on(requested_v, self.rest(seed), reference_um)[0]

    def from_history(self, requested_v: Array, seed: list[int], before: DriveRange) -> Response:
        """Response to a voltage (input, sample) after slow voltages, at whose end all positions are zero.

        Raises InputError for hysteresis in a loop, whose history is not known without its motion.
        """
        block = self.block
        if not isinstance(block, LinearBlock):
            raise InputError("conditioned", "a model with hysteresis in its loop starts from rest")
        v_um, memory = self.model.hysteresis.standing(before.history())

        def start() -> PlantState:
            return PlantState(memory, block.settled(v_um), np.random.default_rng(seed))

        still = self.carry_on(before.start_v[:, None], start())[0]
        found = self.carry_on(requested_v, start())[0]
        return replace(
            found,
            hysteresis_um=found.hysteresis_um - still.hysteresis_um,
            position_um=found.position_um - still.position_um,
            reading_um=found.reading_um - still.position_um,
        )

    def carry_on(
        self, requested_v: Array, start: PlantState, reference_um: Array | None = None
    ) -> tuple[Response, PlantState]:
        """Response to a part of the voltage, and the state after it.

        A run in parts gives the same numbers as in one piece, to the last bit. The generator of the noise is
        advanced, not copied.

        Parameters
        ----------
        requested_v : (input, sample) voltage [V]
        start : state before the first sample
        reference_um : (output, sample) reference [um], if the voltage comes from a law
        """
        driven = self.driven(requested_v, reference_um is not None, start.left)
        return self.follow(driven, start, reference_um)

    def driven(
        self,
        requested_v: Array,
        by_law: bool,
        left: NDArray[np.bool_] | None = None,
        out: Array | None = None,
    ) -> AppliedDrive:
        """Output of the drive for a voltage (input, sample).

        by_law : whether the voltage comes from a law, which keeps within the range itself
        left : (m,) inputs that have moved from the working point before; it may be an end of the range
        out : (input, sample) array for the output voltages; a new one if not given
        """
        asked = np.ascontiguousarray(requested_v, dtype=np.float64)
        drive_v, saturated = self.instruments.drive.apply(asked, out)
        if by_law and asked.size:
            from hammerstein.blocks.instrument_kernels import leaving

            rest = self.range.working_point_v
            before = np.zeros(len(asked), dtype=np.bool_) if left is None else left
            left = before.copy()
            if leaving(asked, rest, self.range.ends, left):  # where it stands at the range, it wanted more
                away = np.logical_or.accumulate(asked != rest[:, None], axis=1) | before[:, None]
                saturated |= self.range.reached(asked) & away
        return AppliedDrive(asked, drive_v, saturated, left)

    def follow(
        self, driven: AppliedDrive, start: PlantState, reference_um: Array | None = None
    ) -> tuple[Response, PlantState]:
        """Response to the output of the drive, and the state after it; see ``carry_on``."""
        samples = driven.drive_v.shape[1]
        p = self.model.hysteresis.n_outputs
        paths = [] if reference_um is None else [reference_um]
        given = ((VOLTAGE_V, [driven.requested_v]), (POSITION_UM, paths))  # the drive stays within its range
        wires = allocate_wires(3 * p, samples)
        v_um, moved_um, reading_um = wires[:p], wires[p:], wires[2 * p :]
        memory, linear, known = start.memory, start.linear.copy(), True
        for first in range(0, samples, BLOCK):
            here = slice(first, min(first + BLOCK, samples))
            known = known and all(within(*one, here.start, here.stop) for one in given)
            if not (known or np.isfinite(driven.drive_v).all()):
                refuse_not_finite(driven.drive_v)
            memory = self.model.static_part(driven.drive_v, memory, here.start, here.stop, v_um)
            self.block.carry_on(v_um, linear, here.start, here.stop, moved_um)
            self.instruments.sensor.read_in_place(reading_um, start.noise, here.start, here.stop)
            known = known and within(POSITION_UM, [wires], here.start, here.stop)
        response = Response(
            sample_time_s=self.sample_time_s,
            saturated=driven.saturated,
            inputs=self.model.inputs,
            outputs=self.model.outputs,
            known=known,
            reference_um=reference_um,
            requested_v=driven.requested_v,
            drive_v=driven.drive_v,
            hysteresis_um=v_um,
            position_um=wires[p : 2 * p],
            reading_um=reading_um,
        )
        return response, PlantState(memory, linear, start.noise, driven.left)

    def closed_loop(self, law: Controller[Any], reference_um: Array, seed: list[int]) -> Response:
        """Response to a controller that reads the sensor, sample by sample from rest, with all signals.

        This is the plain block diagram; ``FeedbackController`` runs the same, compiled.
        """
        path_um, forward_v = law.path_and_feedforward(reference_um)
        state, here = law.rest(), self.rest(seed)
        parts = []
        for t in range(reference_um.shape[1]):
            asked_v, state = law.request(state, forward_v[:, t])
            response, here = self.carry_on(asked_v[:, None], here)
            state = law.correct(path_um[:, t], response.reading_um[:, 0], state)
            parts.append(response)
        return replace(Response.joined(parts), reference_um=reference_um)

    def to_iosys(
        self,
        seed: int | Sequence[int] = 0,
        outputs: Sequence[Wire] = ("position_um",),
        name: str = "actuator",
    ) -> BlockSystem:
        """Return drive, hysteresis, dynamics and sensor as one discrete ``control.NonlinearIOSystem``.

        Inputs are ``requested_v[k]``, outputs those of the wires that are named, such as ``position_um[o]``.

        Parameters
        ----------
        seed : of the sensor's noise, as for ``respond``
        outputs : wires that leave the system
        name : of the system

        Raises InputError for a wire that does not leave the plant.
        """
        from hammerstein.blocks.block_system import BlockSystem

        m, p = self.model.hysteresis.n_inputs, self.model.hysteresis.n_outputs
        counts = {"drive_v": m, "hysteresis_um": p, "position_um": p, "reading_um": p}
        unknown = [wire for wire in outputs if wire not in counts]
        if unknown or not outputs:
            what = f"{', '.join(unknown) or 'nothing'} is not an output; give some of {', '.join(counts)}"
            raise InputError("outputs", what)

        def step(requested_v: Array, state: PlantState) -> tuple[Array, PlantState]:
            response, after = self.carry_on(requested_v[:, None], state)
            return np.concatenate([getattr(response, wire)[:, 0] for wire in outputs]), after

        rest, asked = self.rest(np.atleast_1d(seed).tolist()), {"requested_v": m}
        wires: dict[str, int] = {wire: counts[wire] for wire in outputs}
        return BlockSystem(rest, step, self.restore, asked, wires, self.sample_time_s, name)

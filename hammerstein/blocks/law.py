"""Interfaces of compensators: laws from a reference in um to a drive in V, and streaming laws."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, rows_of
from hammerstein.blocks.driving import DriveRange
from hammerstein.errors import InputError, SimulationError
from hammerstein.quantities import number_of

if TYPE_CHECKING:
    from hammerstein.blocks.block_system import BlockSystem


@dataclass(frozen=True, eq=False)
class Memory:
    """State of a block between two samples; JSON keeps it to the last bit.

    The memory of a block derives from this class, as a frozen dataclass of arrays, numbers, other memories
    and tuples of them. A block without memory uses this class itself.

    Examples
    --------
    >>> @dataclass(frozen=True, eq=False)
    ... class Held(Memory):
    ...     last_v: np.ndarray
    >>> before = Held(np.zeros(2))
    >>> before.restored({"last_v": [0.5, 1.0]}).as_dict()
    {'last_v': [0.5, 1.0]}
    """

    def as_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers."""
        return {name: _plain(getattr(self, name)) for name in self._names()}

    def restored(self, data: dict[str, Any]) -> Self:
        """Memory of the same shape as this one, from the result of ``as_dict``; InputError if a part is
        missing.
        """
        missing = [name for name in self._names() if name not in data]
        if missing:
            what = f"has no {', '.join(missing)}: it belongs to another block, or to another version"
            raise InputError("memory", f"{what}; start at rest")
        return self._with(lambda name, own: _shaped(own, data[name]))

    def copy(self) -> Self:
        """Return an independent copy."""
        return self._with(lambda _, own: own.copy() if isinstance(own, np.ndarray | Memory) else own)

    def _names(self) -> tuple[str, ...]:
        """Names of its parts, known once a class: a loop in Python copies a memory at every sample."""
        return self.__match_args__

    def _with(self, value: Callable[[str, Any], Any]) -> Self:
        return type(self)(*[value(name, getattr(self, name)) for name in self._names()])


def _plain(own: Any) -> Any:
    if isinstance(own, Memory):
        return own.as_dict()
    if isinstance(own, tuple):
        return [_plain(part) for part in own]
    return own.tolist() if isinstance(own, np.ndarray) else own


def _shaped(own: Any, data: Any) -> Any:
    """Plain data in the type of a given value: an array of its shape, or its class."""
    if isinstance(own, Memory):
        return own.restored(data)
    if isinstance(own, tuple):
        return tuple(_shaped(part, given) for part, given in zip(own, data, strict=True))
    return np.array(data, dtype=own.dtype).reshape(own.shape) if isinstance(own, np.ndarray) else data


S = TypeVar("S", bound=Memory)


class Designed(ABC):
    """A compensator that was designed for a model with m inputs and p outputs, and a range of the drive."""

    n_inputs: int
    n_outputs: int
    range: DriveRange

    def __repr__(self) -> str:
        inputs = [f"input {k + 1}" for k in range(self.n_inputs)]
        return f"{type(self).__name__}({number_of(self.n_outputs, 'output')}, {self.range.words(inputs)})"

    def statement(self) -> str:
        """Information that a user needs before a run; may be empty."""
        return ""


class WithMemory(Designed, Generic[S]):
    """A compensator whose output depends on earlier samples."""

    @abstractmethod
    def rest(self) -> S:
        """Initial state: actuator at its start, reference at zero."""

    def restore(self, data: dict[str, Any]) -> S:
        """State from the result of ``as_dict``."""
        return self.rest().restored(data)


class Law(WithMemory[S]):
    """A sensorless compensator of an actuator with m inputs and p outputs.

    ``respond`` and ``step`` work on a stream: their output at sample k is the drive for the reference sample
    k - ``preview_samples``. ``drive_for`` aligns a whole reference that is known ahead.

    A law keeps within the range of the drive itself, so its memory stays that of the actuator. Where the
    drive is at its range, the reference is not reached.

    The output voltages of a law are absolute. The reference is relative to the position at the start
    (``range.start_v``). Inside, a law counts from rest at the working point, as its model does.
    """

    origin_um: Array
    preview_samples: int = 0
    sample_time_s: float | None = None  # the grid it was designed for; None: any
    leaves: ClassVar[float] = 0.0
    """Allowed difference of periods of a drive, in parts of the path."""

    def softens(self, reference_um: Array) -> bool:
        """Whether the law replaces the beginning of a path (p, N) by a soft start."""
        return False

    @property
    def start_samples(self) -> int:
        """Samples of a path that must be known for its start."""
        return self.preview_samples

    @property
    def delay_samples(self) -> int:
        """Delay of the position in samples."""
        return 0

    @abstractmethod
    def _respond(self, reference_um: Array, start: S) -> tuple[Array, S]:
        """Drive (m, N), relative to the working point, for a checked reference (p, N), and the state after.

        ``start`` is kept.
        """

    def _from_rest(self, position_um: Array) -> Array:
        """Positions (p, N) counted from rest at the working point, from those counted from the start."""
        return position_um + self.origin_um[:, None] if self.origin_um.any() else position_um

    def respond(self, reference_um: ArrayLike, start: S | None = None) -> tuple[Array, S]:
        """Drive for a part of a reference.

        Parameters
        ----------
        reference_um : (output, sample) reference [um], finite
        start : state before the first sample; at rest if not given

        Returns
        -------
        drive_v : (input, sample) voltages [V], later by ``preview_samples``
        state : state after the last sample

        Raises
        ------
        InputError : wrong number of axes, or a value that is not finite
        """
        reference = checked_reference(reference_um, self.n_outputs)
        drive, state = self._respond(reference, self.rest() if start is None else start)
        if not np.isfinite(drive).all():
            sample = int(np.nonzero(~np.isfinite(drive).all(axis=0))[0][0])
            raise SimulationError(f"the compensator's drive grows beyond all bounds at sample {sample}")
        return self.range.absolute(drive), state

    def step(self, reference_um: ArrayLike, state: S) -> tuple[Array, S]:
        """Drive (m,) for one sample of reference (p,); equal to ``respond`` to the last bit."""
        sample = np.array(reference_um, dtype=np.float64)  # writable, and of one type: it is compiled once
        if sample.shape == (self.n_outputs,) and (found := self._step(sample, state)) is not None:
            return found
        drive, after = self.respond(sample.reshape(-1, 1), state)  # says what is wrong, where something is
        return drive[:, 0], after

    @cached_property
    def _frame(self) -> Array:
        """Where a step counts from (4, m): origin [um], working point, lowest and highest voltage [V]."""
        limits, rows = self.range, np.zeros((4, max(self.n_inputs, self.n_outputs)))
        rows[0, : self.n_outputs] = self.origin_um
        rows[1:, : self.n_inputs] = limits.working_point_v, limits.low_v, limits.high_v
        return rows

    def _step(self, sample_um: Array, state: S) -> tuple[Array, S] | None:
        """Drive for one sample (p,) in one compiled call; None where it cannot, or not finite."""
        return None

    def primed(self, reference_um: ArrayLike) -> tuple[S, Array]:
        """State of the law at the drive of the first sample of a reference (p, N) known in advance.

        Returns
        -------
        state : the law has seen the first ``preview_samples`` of the reference
        coming : (p, N) the reference from there on, its last value held at the end
        """
        reference = checked_reference(reference_um, self.n_outputs)
        ahead = self.preview_samples
        if not ahead:
            return self.rest(), reference
        whole = np.hstack([reference, np.repeat(reference[:, -1:], ahead, axis=1)])
        return self.respond(whole[:, :ahead])[1], whole[:, ahead:]

    def drive_for(self, reference_um: ArrayLike) -> Array:
        """Drive (m, N) aligned with a reference (p, N) known in advance; its last value is held."""
        start, coming = self.primed(reference_um)
        return self.respond(coming, start)[0]

    def to_iosys(self, sample_time_s: float, name: str = "compensator") -> BlockSystem:
        """Return the law as a discrete ``control.NonlinearIOSystem``.

        Its inputs are ``reference_um[o]``, its outputs ``requested_v[k]``, which are ``preview_samples``
        later than their reference. If the reference is known ahead, ``primed`` gives the initial state and
        the rest of the reference.

        Raises InputError for another sample time than the law was designed for.
        """
        from hammerstein.blocks.block_system import BlockSystem

        require_grid(self.sample_time_s, sample_time_s, "compensator")
        wires = {"reference_um": self.n_outputs}, {"requested_v": self.n_inputs}
        return BlockSystem(self.rest(), self.step, self.restore, *wires, sample_time_s, name)


class Controller(WithMemory[S]):
    """Compensator with feedback: its sensor reading in one sample acts on the drive of the next.

    In each sample ``request`` gives the voltage, the actuator moves, and ``correct`` takes the reading.
    """

    @abstractmethod
    def path_and_feedforward(self, reference_um: ArrayLike) -> tuple[Array, Array]:
        """Path (p, N) to compare readings with, and feedforward (m, N), for a whole reference."""

    @abstractmethod
    def request(self, state: S, feedforward_v: ArrayLike | None = None) -> tuple[Array, S]:
        """Voltages (m,) for this sample, added to a feedforward (m,)."""

    @abstractmethod
    def correct(self, reference_um: ArrayLike, reading_um: ArrayLike, state: S) -> S:
        """Take reference and reading (p,) of this sample."""


class Learner(Designed):
    """Compensator of a repeating path: the sensor readings of one trial give the drive of the next.

    A trial plays one period of voltages again and again. The sensor is there while it learns, not later.
    """

    trial: int = 1  # the trial that is measured, where nothing else is asked for

    @abstractmethod
    def first(self, reference_um: Array) -> Array:
        """Period (m, N) of voltages of the first trial, for a period (p, N) of the path."""

    @abstractmethod
    def following(
        self,
        reference_um: Array,
        drive_v: Array,
        reading_um: Array,
        before: tuple[Array, Array] | None = None,
    ) -> Array:
        """Period (m, N) of the next trial; the previous one, unchanged, if learning ends with it.

        Parameters
        ----------
        reference_um : (p, N) one period of the path
        drive_v : (m, N) the period that was played
        reading_um : (p, periods N) settled periods that the sensor read
        before : drive and reading of the trial before, if there was one
        """


def checked_reference(reference_um: ArrayLike, n_outputs: int) -> Array:
    """Reference as a contiguous (output, sample) array; InputError names axis and sample of a bad value."""
    reference = rows_of(reference_um)
    if reference.shape[0] != n_outputs or reference.ndim != 2:
        raise InputError("reference", f"has shape {reference.shape}; it must be ({n_outputs}, samples)")
    if not np.isfinite(reference).all():
        axis, sample = (int(i[0]) for i in np.nonzero(~np.isfinite(reference)))
        raise InputError("reference", f"axis {axis + 1} is not finite at sample {sample}")
    return reference


def require_square(n_inputs: int, n_outputs: int, law: str) -> None:
    """Raise InputError unless the model has as many inputs as outputs."""
    if n_inputs != n_outputs:
        raise InputError(
            law, f"needs as many inputs as outputs; the model has {n_inputs} inputs and {n_outputs} outputs"
        )


def require_grid(designed_s: float | None, sample_time_s: float, what: str) -> None:
    """Raise InputError if a block runs on another sample time than its design."""
    if not (math.isfinite(sample_time_s) and sample_time_s > 0.0):
        raise InputError("sample_time_s", f"is {sample_time_s:g}; it must be above 0")
    if designed_s is not None and not math.isclose(designed_s, sample_time_s, rel_tol=1e-9):
        raise InputError(
            "sample_time_s",
            f"is {sample_time_s:g}, but the {what} was designed for {designed_s:g}; use this sample "
            "time, or design it again",
        )


class Stream:
    """A running law that holds its own state.

    A step creates no garbage, so the garbage collector does not pause it. The voltages equal those of
    ``law.step`` to the last bit.

    Attributes
    ----------
    law : the law
    state : state after the last sample; you may keep it and pass it in again, it is never modified

    Examples
    --------
    >>> import hammerstein
    >>> model = hammerstein.HammersteinModel.load("duo_bimorph_static")
    >>> law = hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=50e-6)
    >>> loop = hammerstein.stream(law)
    >>> drive_v = loop.step([5.0, 0.0])
    >>> model.hysteresis.respond(drive_v[:, None])[0].round(9).ravel() + 0.0
    array([5., 0.])
    >>> loop.block([[6.0, 7.0], [0.0, 0.0]]).shape
    (2, 2)
    """

    def __init__(self, law: Law[Any], state: Any = None):
        self.law = law
        self.state = law.rest() if state is None else state
        self._drive = np.empty(law.n_inputs)
        idle = np.zeros((law.n_outputs, 1))  # compiles what is not yet: no sample waits for that
        law.step(idle[:, 0], self.state)
        law.respond(idle, self.state)

    def __repr__(self) -> str:
        return f"Stream({self.law!r})"

    def step(self, reference_um: ArrayLike) -> Array:
        """Voltages (m,) to send now for one sample of reference (p,); the same array in every step.

        Raises InputError for a reference that is not finite or has another number of axes; the memory is
        then that of the sample before.
        """
        drive, self.state = self.law.step(reference_um, self.state)
        self._drive[:] = drive
        return self._drive

    def block(self, reference_um: ArrayLike) -> Array:
        """Voltages (m, N) for a block of reference (p, N), of any length."""
        drive, self.state = self.law.respond(reference_um, self.state)
        return drive


def stream(compensator: Law[Any], state: Any = None) -> Stream:
    """Run a designed law in a loop of your own.

    Parameters
    ----------
    compensator : result of ``design``
    state : initial state, for example of another stream or from ``law.primed``; at rest if not given

    Raises
    ------
    InputError : a compensator that was not designed, or one that reads the sensor
    """
    if not isinstance(compensator, Law):
        what = type(compensator).__name__
        raise InputError(
            "stream",
            f"{what} is not a sensorless law; design one first, as in ExactInverse().design(model, "
            "range_v, sample_time_s). For a controller that reads the sensor, call its methods "
            "request and correct",
        )
    return Stream(compensator, state)

"""Conversion to python-control: blocks that run sample by sample, and signals over time."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.errors import InputError

LIMBS, BITS = 4, 32  # a lone whole number, such as the state of a random generator, has up to 128 bits


class Packing:
    """Position of each number of plain data in a vector.

    ``numbers`` and ``data`` keep every bit. ``pack`` and ``unpack`` count from the data that it was made
    from, so zero is that data; they are exact where that holds zeros and whole numbers.

    Parameters
    ----------
    like : dictionaries, and lists of them, of numbers, lists of numbers, and words; all packed data must have
        this shape

    Examples
    --------
    >>> packing = Packing({"count": [1, 2], "x": [[0.0, 0.0]]})
    >>> vector = packing.pack({"count": [1, 4], "x": [[0.5, 0.0]]})
    >>> vector
    array([0. , 2. , 0.5, 0. ])
    >>> packing.unpack(vector)
    {'count': array([1, 4]), 'x': array([[0.5, 0. ]])}
    """

    def __init__(self, like: dict[str, Any]):
        pieces = list(_numbers(like))
        self._sizes = [piece.size for piece in pieces]
        self._like, self._origin = _filled(like, iter(pieces)), np.concatenate([np.zeros(0), *pieces])

    @property
    def length(self) -> int:
        """Numbers in the vector."""
        return len(self._origin)

    def pack(self, data: dict[str, Any]) -> Array:
        """Vector (length,) of data; zero for the initial data."""
        return np.asarray(self.numbers(data) - self._origin)

    def unpack(self, vector: Array) -> dict[str, Any]:
        """Data of a vector (length,) of ``pack``."""
        return self.data(vector + self._origin)

    def numbers(self, data: dict[str, Any]) -> Array:
        """Numbers (length,) of some data."""
        pieces = list(_numbers(data))
        if [piece.size for piece in pieces] != self._sizes:
            raise InputError("state", "does not belong to this block: the number of values differs")
        return np.concatenate([np.zeros(0), *pieces])

    def data(self, numbers: Array) -> dict[str, Any]:
        """Data from numbers (length,); lists become arrays."""
        pieces = np.split(numbers, np.cumsum(self._sizes))
        found: dict[str, Any] = _filled(self._like, iter(pieces))
        return found


def _parts(data: Any) -> Sequence[Any] | None:
    """What stands in a dictionary, or in a list of them; None of anything else."""
    if isinstance(data, dict):
        return list(data.values())
    several = isinstance(data, list | tuple) and any(isinstance(part, dict) for part in data)
    return data if several else None


def _numbers(data: Any) -> Iterator[Array]:
    """Numbers of each value in some data, one after the other; words have none."""
    parts = _parts(data)
    if parts is not None:
        for part in parts:
            yield from _numbers(part)
    elif isinstance(data, int):
        yield np.array([float(data >> BITS * limb & 2**BITS - 1) for limb in range(LIMBS)])
    elif not isinstance(data, str):
        yield np.asarray(data, dtype=np.float64).ravel()


def _filled(like: Any, pieces: Iterator[Array]) -> Any:
    """Data of the shape of some other, with these numbers in it."""
    parts = _parts(like)
    if parts is not None:
        filled = [_filled(part, pieces) for part in parts]
        return dict(zip(like, filled, strict=True)) if isinstance(like, dict) else filled
    if isinstance(like, str):
        return like
    numbers, array = next(pieces), np.asarray(like)
    if isinstance(like, int):
        return sum(round(limb) << BITS * place for place, limb in enumerate(numbers.tolist()))
    shaped = numbers.reshape(array.shape)
    return np.rint(shaped).astype(np.int64) if np.issubdtype(array.dtype, np.integer) else shaped


REMEMBERED = 4
"""Number of cached steps: python-control requests each output several times, then the next state."""


class BlockSystem(control.NonlinearIOSystem):  # type: ignore[misc]  # control has no types
    """A block on its sample grid as a discrete ``control.NonlinearIOSystem``.

        y[k] = outputs of step(u[k], x[k]),    x[k+1] = state after it

    The state vector is the memory of the block before the sample. Zero is the block at rest, so
    ``control.input_output_response`` starts from rest. There is no hidden state: the same state and input
    give the same output, however often python-control evaluates them.

    Parameters
    ----------
    rest : state of a block that was never driven, which has an ``as_dict`` or is an array
    step : from an input (m,) and the state before the sample to the output (p,) and the state after it
    restore : the state of plain data; that of an array is ``x``
    inputs, outputs : wires, and how many signals each has
    sample_time_s : time between samples [s]
    name : name of the system
    """

    def __init__(
        self,
        rest: Any,
        step: Callable[[Array, Any], tuple[Array, Any]],
        restore: Callable[[dict[str, Any]], Any],
        inputs: Mapping[str, int],
        outputs: Mapping[str, int],
        sample_time_s: float,
        name: str,
    ):
        self._restore, self._packing = restore, Packing(_saved(rest))

        @lru_cache(maxsize=REMEMBERED)
        def stepped(state: bytes, values: bytes) -> tuple[Array, Array]:
            output, after = step(np.frombuffer(values), self.state_of(np.frombuffer(state)))
            return output, self.state_vector(after)

        def both(x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
            return stepped(*(np.asarray(v, dtype=np.float64).tobytes() for v in (x, u)))

        super().__init__(
            lambda t, x, u, params: both(x, u)[1].copy(),
            lambda t, x, u, params: both(x, u)[0].copy(),
            inputs=[label for wire, count in inputs.items() for label in signals(wire, count)],
            outputs=[label for wire, count in outputs.items() for label in signals(wire, count)],
            states=self._packing.length,
            dt=sample_time_s,
            name=name,
        )

    def state_vector(self, state: Any) -> Array:
        """Vector for ``initial_state`` of a state of the block."""
        return self._packing.pack(_saved(state))

    def state_of(self, vector: ArrayLike) -> Any:
        """State of the block from its vector."""
        return self._restore(self._packing.unpack(np.asarray(vector, dtype=np.float64)))


def _saved(state: Any) -> dict[str, Any]:
    """Plain data of a state."""
    return {"x": state} if isinstance(state, np.ndarray) else state.as_dict()


def signals(wire: str, count: int) -> list[str]:
    """Names of the signals of one wire, which python-control selects by the name of the wire.

    >>> signals("requested_v", 2)
    ['requested_v[0]', 'requested_v[1]']
    """
    return [f"{wire}[{i}]" for i in range(count)]


def traces_of(
    data: control.TimeResponseData, inputs: Sequence[str], outputs: Sequence[str]
) -> Iterator[tuple[Array, Array, Array]]:
    """Every trace of a time response, of the signals with these labels.

    Of each, time (sample,) [s], inputs (input, sample) and outputs (output, sample).

    Raises InputError where there are no inputs, or no such signal.
    """
    if data.u is None:
        raise InputError("time response", "holds no inputs; a record needs the input signal")
    rows_in = _rows(data.input_labels, inputs, "input")
    rows_out = _rows(data.output_labels, outputs, "output")
    for u, y in zip(_by_trace(data.u), _by_trace(data.y), strict=True):
        yield np.asarray(data.t, dtype=np.float64), u[rows_in], y[rows_out]


def _by_trace(values: Array) -> list[Array]:
    """Signals (axis, sample) of each trace, from (axis, sample) or (axis, trace, sample)."""
    return [values] if values.ndim == 2 else list(np.swapaxes(values, 0, 1))


def _rows(labels: Sequence[str], wanted: Sequence[str], kind: str) -> list[int]:
    missing = [name for name in wanted if name not in labels]
    if missing:
        known = ", ".join(labels)
        raise InputError("time response", f"has no {kind} {', '.join(missing)}; it has {known}")
    return [list(labels).index(name) for name in wanted]

"""Any block that moves sample by sample, as a python-control system."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar

import control
import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.blocks.interop.packing import Packing

S = TypeVar("S")

REMEMBERED = 4
"""Steps kept: python-control asks for each sample's output several times, then for the state after it."""


@dataclass(frozen=True)
class Stepwise(Generic[S]):
    """What a block must offer.

    rest : state of a block that was never driven
    step : from an input (m,) and the state before the sample to the output (p,) and the state after it
    save : plain data of a state; restore : the state of such data
    """

    rest: S
    step: Callable[[Array, S], tuple[Array, S]]
    save: Callable[[S], dict[str, Any]]
    restore: Callable[[dict[str, Any]], S]


class BlockSystem(control.NonlinearIOSystem):  # type: ignore[misc]  # control has no types
    """A block on its sample grid as a discrete ``control.NonlinearIOSystem``.

        y[k] = outputs of step(u[k], x[k]),    x[k+1] = state after it

    The state vector is the memory of the block before the sample. Zero is the block at rest, so
    ``control.input_output_response`` starts from rest. There is no hidden state: the same state and input
    give the same output, however often python-control evaluates them.

    Parameters
    ----------
    block : the block
    inputs, outputs : names of the signals
    sample_time_s : time between samples [s]
    name : name of the system
    """

    def __init__(
        self,
        block: Stepwise[Any],
        inputs: Sequence[str],
        outputs: Sequence[str],
        sample_time_s: float,
        name: str,
    ):
        self._block, self._packing = block, Packing(block.save(block.rest))

        @lru_cache(maxsize=REMEMBERED)
        def stepped(state: bytes, values: bytes) -> tuple[Array, Array]:
            output, after = block.step(np.frombuffer(values), self.state_of(np.frombuffer(state)))
            return output, self.state_vector(after)

        def both(x: ArrayLike, u: ArrayLike) -> tuple[Array, Array]:
            return stepped(*(np.asarray(v, dtype=np.float64).tobytes() for v in (x, u)))

        super().__init__(
            lambda t, x, u, params: both(x, u)[1].copy(),
            lambda t, x, u, params: both(x, u)[0].copy(),
            inputs=list(inputs),
            outputs=list(outputs),
            states=self._packing.length,
            dt=sample_time_s,
            name=name,
        )

    def state_vector(self, state: Any) -> Array:
        """Vector for ``initial_state`` of a state of the block."""
        return self._packing.pack(self._block.save(state))

    def state_of(self, vector: ArrayLike) -> Any:
        """State of the block that a vector stands for."""
        return self._block.restore(self._packing.unpack(np.asarray(vector, dtype=np.float64)))


def signals(wire: str, count: int) -> list[str]:
    """Names of the signals of one wire, which python-control finds again by the name of the wire.

    >>> signals("requested_v", 2)
    ['requested_v[0]', 'requested_v[1]']
    """
    return [f"{wire}[{i}]" for i in range(count)]

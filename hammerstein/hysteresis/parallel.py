"""Sums of blocks of several kinds, for an actuator that is both asymmetric and rate-dependent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.blocks import Memory
from hammerstein.errors import InputError
from hammerstein.hysteresis.asymmetric import AsymmetricFile
from hammerstein.hysteresis.bouc_wen import BoucWenFile
from hammerstein.hysteresis.generalised import GeneralisedFile
from hammerstein.hysteresis.kind import SLOW_S, Hysteresis, HysteresisFile
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskiiFile
from hammerstein.hysteresis.preisach import PreisachFile
from hammerstein.hysteresis.rate_dependent import RateDependentFile


@dataclass(frozen=True, eq=False)
class ParallelState(Memory):
    """Memory of every part, in their order."""

    parts: tuple[Any, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Parallel(Hysteresis[ParallelState]):
    """Hysteresis whose outputs are the sums of those of its parts, all driven by the same m inputs.

        v = v_1 + v_2 + ...

    It represents actuators that no single kind describes. It can be simulated, but neither identified
    nor inverted.

    Parameters
    ----------
    parts : two blocks or more, of one shape

    Raises
    ------
    InputError : fewer than two parts, or parts of different shapes

    Examples
    --------
    >>> from hammerstein.hysteresis import Pair, PrandtlIshlinskii
    >>> soft = PrandtlIshlinskii([[Pair([0.0, 1.0], [1.0, 1.0])]])
    >>> Parallel((soft, soft)).respond([[0.0, 3.0, 2.0]])[0]
    array([[ 0., 10.,  8.]])
    """

    parts: tuple[Hysteresis[Any], ...]

    kind: ClassVar[str] = "parallel"
    weight_covariance = None  # it is not identified

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        shapes = {(part.n_outputs, part.n_inputs) for part in self.parts}
        if any(isinstance(part, Parallel) for part in self.parts):
            raise InputError("parallel hysteresis", "has no parallel part; give all parts in one")
        if len(self.parts) < 2 or len(shapes) != 1:
            raise InputError(
                "parallel hysteresis", "needs two parts or more with the same inputs and outputs"
            )

    @property
    def operators(self) -> tuple[tuple[int, ...], ...]:
        """Number of weights of every pair (output, input), those of all parts."""
        counts = np.sum([np.array(part.operators) for part in self.parts], axis=0)
        return tuple(tuple(row) for row in counts.tolist())

    @property
    def n_beside_weights(self) -> int:
        """Sum over all parts."""
        return sum(part.n_beside_weights for part in self.parts)

    def describe(self) -> str:
        """Short description."""
        return " beside ".join(f"{part.kind} ({part.describe()})" for part in self.parts)

    def on_grid(self, sample_time_s: float) -> Parallel:
        """Return the block on a sample grid."""
        return replace(self, parts=tuple(part.on_grid(sample_time_s) for part in self.parts))

    def counted_from(self, working_point_v: ArrayLike) -> Parallel:
        """Return the block relative to a working point (m,) [V]."""
        return replace(self, parts=tuple(part.counted_from(working_point_v) for part in self.parts))

    def rest(self) -> ParallelState:
        """Memory at rest."""
        return ParallelState(tuple(part.rest() for part in self.parts))

    def after(self, path_v: Array) -> ParallelState:
        """Memory after a path; see ``Hysteresis.after``."""
        return ParallelState(tuple(part.after(path_v) for part in self.parts))

    def standing(self, path_v: Array) -> tuple[Array, ParallelState]:
        """Sum of the outputs, and memory, at the end of a slow path."""
        found = [part.standing(path_v) for part in self.parts]
        return np.sum([v for v, _ in found], axis=0), ParallelState(tuple(own for _, own in found))

    def _respond(self, u_v: Array, start: ParallelState) -> tuple[Array, ParallelState]:
        found = [part.respond(u_v, own) for part, own in zip(self.parts, start.parts, strict=True)]
        return np.sum([v for v, _ in found], axis=0), ParallelState(tuple(own for _, own in found))

    def in_loop(self, memory: ParallelState) -> tuple[Any, ...] | None:
        """Parameters of every part and of their sum; see ``Hysteresis.in_loop``."""
        from hammerstein.hysteresis.loop_kernels import Sum

        found = [part.in_loop(own) for part, own in zip(self.parts, memory.parts, strict=True)]
        if any(one is None for one in found):
            return None
        return reduce(Sum, found)

    def _swept(self, k: int, low_v: float, high_v: float) -> Array:
        """As of every kind, driven so slowly that no part knows of a rate."""
        return np.asarray(
            np.sum([part.on_grid(SLOW_S)._swept(k, low_v, high_v) for part in self.parts], axis=0)
        )

    @property
    def weights(self) -> tuple[Array, ...]:
        """Weights of each output, part after part [um/V]."""
        return tuple(np.concatenate(rows) for rows in zip(*(p.weights for p in self.parts), strict=True))

    def with_weights(self, weights: Sequence[ArrayLike]) -> Parallel:
        """Return the same operators with other weights."""
        sizes = zip(*([len(own) for own in part.weights] for part in self.parts), strict=True)
        each = zip(weights, sizes, strict=True)
        rows = zip(*(np.split(np.asarray(w), np.cumsum(n)[:-1]) for w, n in each), strict=True)
        parts = (part.with_weights(own) for part, own in zip(self.parts, rows, strict=True))
        return replace(self, parts=tuple(parts))

    def file(self) -> ParallelFile:
        """Form in a model file."""
        return ParallelFile.model_validate({"parts": [part.file() for part in self.parts]})


Part = Annotated[
    PrandtlIshlinskiiFile | AsymmetricFile | GeneralisedFile | PreisachFile | RateDependentFile | BoucWenFile,
    Field(discriminator="kind"),
]


class ParallelFile(HysteresisFile):
    """Parallel blocks whose outputs add; for simulation only."""

    kind: Literal["parallel"] = "parallel"
    describes: ClassVar = Parallel
    parts: Annotated[tuple[Part, ...], Field(min_length=2)]

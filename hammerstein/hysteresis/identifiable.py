"""Interface between identification and a kind of hysteresis: columns for weights, bounded other parameters.

A kind that can be identified derives from ``Identifiable`` and ``Hysteresis``. The fit of the package then
estimates the weights by bounded least squares, the other parameters and the linear dynamics by variable
projection (Golub and Pereyra, Inverse Problems 19 (2003) R1).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, cast

import numpy as np

from hammerstein.arrays import Array, Flags
from hammerstein.errors import IdentificationError

if TYPE_CHECKING:
    from hammerstein.hysteresis.kind import Hysteresis

LEAST_ENGAGED = 1e-3
"""Distance of a threshold from the half swing, in parts of it, so that its play moves."""
STEP = 1e-3
"""Change of a free number for its derivative: plays bend where they engage, so that it is not too small."""


@dataclass(frozen=True, eq=False)
class Driven:
    """Excitation of the inputs by the records, for initial guesses and limits of a kind.

    Parameters
    ----------
    low_v, high_v : (m,) lowest and highest voltage of each input, as sent [V]
    working_point_v : (m,) voltage that the first record is relative to [V]
    outputs : number p of outputs
    inputs : names of the inputs
    thresholds_v : (m,) thresholds of each input that suit plays [V], sorted
    sample_time_s : of the records, the shortest [s]
    duration_s : of the longest record [s]
    fastest_rad_per_s : (m,) largest rms rate of a part of a record over the half swing of the input [rad/s]
    several_rates : (m,) whether an input is driven at rates different enough to separate rate and loop
    invertible : whether the model shall have an inverse
    given : whether the user gave the thresholds, so that all of them stay
    dead_zones : requested number of dead-zones of an input; None: estimated
    """

    low_v: Array
    high_v: Array
    working_point_v: Array
    outputs: int
    inputs: tuple[str, ...]
    thresholds_v: tuple[Array, ...]
    sample_time_s: float
    duration_s: float
    fastest_rad_per_s: Array
    several_rates: tuple[bool, ...]
    invertible: bool = True
    given: bool = False
    dead_zones: int | None = None

    @property
    def half_swing_v(self) -> Array:
        """Half of the range of each input (m,) [V]."""
        return 0.5 * (self.high_v - self.low_v)

    def refuse_still(self) -> None:
        """Raise IdentificationError if an input never moves."""
        if not self.half_swing_v.all():
            name = self.inputs[int(np.argmin(self.half_swing_v))]
            raise IdentificationError(f"input {name} never moves, so no record identifies its effect")


class Limits(NamedTuple):
    """Smallest and largest value of each free parameter that records can determine."""

    lower: Array
    upper: Array


class ColumnChoice(NamedTuple):
    """Alternative sets of columns, as masks (weight,) of the kept columns, the smallest set first.

    ``beside`` is the mask that applies while earlier choices are made.
    """

    masks: Sequence[Flags]
    beside: Flags


class Bounds(NamedTuple):
    """One-sided bounds of the unknowns x that make up the coefficients c = basis x.

    ``side`` is 1 where x stays above ``bound``, -1 where it stays below, 0 where it is free.
    """

    basis: Array
    side: Array
    bound: Array


class Identifiable(ABC):
    """Ability of a kind to be identified from records.

    Parameters other than weights are ``free``. Scale them so that 1 is a large change, for example by
    logarithms. A kind without free parameters is identified by one linear least squares. Weights are those of
    ``Hysteresis.weights``, in the same order.
    """

    passes_for_delay: ClassVar[bool] = False
    """Whether the effect of this kind resembles a delay, so that no delay is estimated."""
    finest: ClassVar[int] = 0
    """Thresholds of an input among which ``column_choices`` chooses; 0: those that suit plays are taken."""

    @classmethod
    @abstractmethod
    def first_guesses(cls, driven: Driven) -> Sequence[Self]:
        """Initial blocks with any weights, the smallest first; each is refined, and the best is kept.

        Raises IdentificationError where the records cannot determine this kind.
        """

    @property
    def free(self) -> Array:
        """Fitted parameters other than weights (number,)."""
        return np.empty(0)

    def at(self, free: Array) -> Self:
        """Return the block with other free parameters (number,)."""
        return self

    @property
    def free_spread(self) -> Array:
        """Possible change of each free parameter (number,), as a standard deviation, where it is linear."""
        return np.ones(len(self.free))

    @property
    def places(self) -> tuple[Array, ...]:
        """Places that are fixed, not ``free``, in sorted groups (place,) [V].

        First the thresholds of each input, then breakpoints of each pair, as absolute voltages.
        """
        return ()

    def at_places(self, places: Sequence[Array]) -> Self:
        """Return the block with other ``places``."""
        return self

    def limits(self, driven: Driven) -> Limits:
        """Return the bounds of the free parameters; one at a bound is reported as not determined."""
        return Limits(np.empty(0), np.empty(0))

    def columns(self, u_v: Array, before_v: Array, output: int, passes: int = 1) -> tuple[Array, Array]:
        """Response of one output to each of its weights alone.

        Parameters
        ----------
        u_v : (input, sample) voltages, relative to the working point [V]
        before_v : (input, turn) earlier voltages, of which the last one is held [V]
        output : its number, from 0
        passes : number of repetitions of the voltages; only the last one counts

        Returns
        -------
        values : (weight, sample) [V for plays]
        held : (weight,) values before the first sample
        """
        block: Hysteresis[Any] = self  # type: ignore[assignment]  # the ability of a hysteresis
        sizes, values, held = [len(w) for w in block.weights], [], []
        for unit in np.eye(sizes[output]):
            one = block.with_weights([unit if o == output else np.zeros(n) for o, n in enumerate(sizes)])
            memory = one.after(before_v)
            stood, _ = one.respond(before_v[:, -1:], memory)
            for _ in range(passes):
                v, memory = one.respond(u_v, memory)
            values.append(v[output])
            held.append(stood[output, 0])
        return np.array(values), np.array(held)

    def bends(self, u_v: Array, before_v: Array, passes: int = 1) -> tuple[Array, Array]:
        """Derivatives of the outputs by each free parameter, for the weights that the block has.

        Returns
        -------
        values : (number, output, sample) [um]
        held : (number, output) before the first sample
        """
        weights = cast("Hysteresis[Any]", self).weights

        def outputs(block: Self) -> Array:
            each = [block.columns(u_v, before_v, o, passes) for o in range(len(weights))]
            return np.array([w @ np.column_stack(both[::-1]) for w, both in zip(weights, each, strict=True)])

        now = outputs(self.at(self.free))
        found = np.array(
            [outputs(self.at(self.free + change)) - now for change in STEP * np.eye(len(self.free))]
        )
        return found[:, :, 1:] / STEP, found[:, :, 0] / STEP

    def column_choices(self, driven: Driven) -> Sequence[ColumnChoice]:
        """Sets of columns, the same for every output, from which cross-validation chooses; none by default.

        If there are any, it also chooses a ridge, see ``roughness``, and one of several first guesses.
        """
        return ()

    @classmethod
    def spread(cls, driven: Driven) -> Sequence[Self]:
        """Initial blocks with few, ``free`` ``places``; empty for kinds with fixed places."""
        return ()

    def released(self, driven: Driven) -> Self:
        """The block with its ``places`` among the ``free`` parameters."""
        return self

    def settled(self) -> Self:
        """The block with fixed ``places``."""
        return self

    def with_columns(self, kept: Flags) -> Self:
        """Return the block with some of its columns, the same of every output: a mask (weight,)."""
        raise NotImplementedError

    @property
    def roughness(self) -> Array:
        """Combinations (number, weight) of the weights of an output that a ridge penalises."""
        return np.zeros((0, 0))

    def weight_bounds(self, output: int, input_: int, least: float, driven: Driven) -> Bounds | None:
        """Bounds of the weights of one pair that keep the model invertible.

        The slope of the pair must exceed ``least`` [um/V], with its sign. None: no bounds.
        """
        return None

    def without_own(self) -> tuple[Self, str] | None:
        """The block with plays only, and the name of the effect that it lacks; None if there is none.

        If it is as good as the block itself, the records do not determine the effect, and plays are kept.
        """
        return None

    def statements(self, inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
        """Sentences about the fitted parameters, for the report."""
        return []


def kept_apart(places: Array, top: float = 1.0 - 0.5 * LEAST_ENGAGED) -> Array:
    """Ordered places, in parts of their range, kept so far apart that the readings separate them.

    Weights of two that nearly coincide would grow until their products are rounding errors: 4.5e8 um/V were
    seen, for which the sums gave a tenth of the true error.
    """
    steps = LEAST_ENGAGED * np.arange(len(places))
    up = np.maximum.accumulate(np.sort(places) - steps) + steps
    return np.asarray(np.minimum(up, top - steps[::-1]))


def within_gaps(r: Array, low: float, high: float) -> Array:
    """Standard deviation (place,) of a uniform distribution over the nearest gap."""
    gaps = np.maximum(np.diff(r, prepend=low, append=high), 0.0)
    return np.asarray(np.minimum(gaps[:-1], gaps[1:]) / np.sqrt(12.0))


def mean_slopes(block: Hysteresis[Any], driven: Driven) -> Array:
    """Mean slope (output, input) of the loops over the whole range [um/V]."""
    low, high = driven.low_v - driven.working_point_v, driven.high_v - driven.working_point_v
    slopes = np.zeros((block.n_outputs, block.n_inputs))
    for k in np.flatnonzero(high > low):
        path = np.zeros((block.n_inputs, 4))
        path[k] = [0.0, high[k], low[k], high[k]]
        slopes[:, k] = (block.standing(path)[0] - block.standing(path[:, :-1])[0]) / (high[k] - low[k])
    return slopes

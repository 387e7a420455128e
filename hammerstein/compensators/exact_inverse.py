"""The exact inverse of the multivariable model: Gamma(U) = Y_r in every sample, cross-couplings included."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hammerstein.compensators.invertibility import completed, invertibility, require_inverse
from hammerstein.compensators.law import Array, Law
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel

STILL = 1e-13


@dataclass(frozen=True, eq=False)
class ExactState:
    """Memory of the exact inverse, in the tables of ``exact_kernel``.

    stack : (m, n_max+2, 3+m) the stacks of segments behind the smallest plays
    hand : (m, 3) height of each stack, the last q asked for [V], ramp of the jump from -1 to 1
    """

    stack: Array
    hand: Array

    def as_dict(self) -> dict[str, Any]:
        """Give plain lists."""
        return {"stack": self.stack.tolist(), "hand": self.hand.tolist()}

    def copy(self) -> ExactState:
        """Give an independent copy."""
        return ExactState(self.stack.copy(), self.hand.copy())

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> ExactState:
        """Restore what ``as_dict`` saved."""
        return cls(np.array(data["stack"], dtype=np.float64), np.array(data["hand"], dtype=np.float64))


class Tables(NamedTuple):
    """The model and the scratch of a walk in the tables of ``exact_kernel``, in the order of its arguments."""

    grid: Array
    about: Array


class Recovery(NamedTuple):
    """How a linear block comes back to its path after the range kept it off: x+ = a x + b (v - gain x)."""

    a: Array
    b: Array
    gain: Array


class ExactInverse(Law[ExactState]):
    """Solves ``Gamma(U) = Y_r`` in every sample by walking the affine pieces of the model.

    The model may be any square one whose slope determinants have one sign (``invertibility``), with its own
    thresholds for every pair and weights of either sign. One with more inputs than outputs is solved with
    the least drive: of all drives that the gain matrix of the settled loops maps to the same displacement,
    the shortest one (least sum of squares of the inputs, up to their smallest plays).

    Where the smallest threshold r_0 of an input is above zero the drive jumps by 2 r_0 when that input turns,
    for nothing moves in between. ``softening_v`` spreads the jump over that much movement of the input; until
    it is over the plant's smallest play stands still, at most ``2 r_0 s / (2 r_0 + s)`` volts behind, and the
    memory of the law follows the play, not the wish.

    An input that would leave the drive's range stays at the range. The output that it moves most is then
    missed; the other inputs go on solving the other outputs exactly.

    Parameters
    ----------
    model : m inputs, p <= m outputs; its static block is used
    range_v : range of the drive [V]
    softening_v : movement over which the jump at a reversal is spread [V]; 0: at once
    run_anyway : accept a model without an inverse; where no solution is found the drive stays where the walk
        ended

    Attributes
    ----------
    invertibility : what was found before the run

    Raises
    ------
    InputError : more outputs than inputs, a smallest threshold beyond the range, or softening below zero
    SimulationError : the model has no inverse, with the slopes and the remedy

    Source: this work; the method is that of ``exact_kernel``.

    Examples
    --------
    >>> from hammerstein.dynamics import StaticDynamics
    >>> from hammerstein.hysteresis import Pair, PrandtlIshlinskii
    >>> plant = PrandtlIshlinskii([[Pair([0.1, 1.0], [4.0, 2.0])]])
    >>> law = ExactInverse(HammersteinModel("one axis", plant, StaticDynamics(n_outputs=1), 10.0, ("u",), ("y",)), 10.0)
    >>> drive_v, _ = law.respond([[0.0, 10.0, 8.0]])
    >>> plant.respond(drive_v)[0].round(9)
    array([[ 0., 10.,  8.]])
    """

    def __init__(
        self, model: HammersteinModel, range_v: float, softening_v: float = 0.0, run_anyway: bool = False
    ):
        hysteresis = model.hysteresis
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self.range_v, self.softening_v = range_v, softening_v
        if not (np.isfinite(softening_v) and softening_v >= 0.0):
            raise InputError("softening_v", f"must be 0 or more volts, not {softening_v:g}")
        self.invertibility = invertibility(hysteresis, range_v, model.amplitude_v)
        require_inverse(self.invertibility, "exact_inverse", run_anyway)
        self.square, self.smallest_v = completed(hysteresis, model.amplitude_v)
        if (self.smallest_v >= range_v).any():
            k = int(np.argmax(self.smallest_v >= range_v))
            message = f"{self.smallest_v[k]:g} V of input {k + 1} is beyond the range of {range_v:g} V; nothing moves"
            raise InputError("smallest threshold", message)
        self.tables = self._tables()

    def _tables(self) -> Tables:
        m, bank = self.n_inputs, self.square.bank
        grid = np.full((m, bank.r.shape[1] + 1, 1 + 2 * m), np.inf)
        grid[:, :-1, 0] = bank.r
        grid[:, :, 1 : 1 + m], grid[:, :, 1 + m :] = bank.slope, bank.moment
        largest = float(bank.r[np.isfinite(bank.r)].max())
        about = np.empty((m, 4 + m))
        about[:, 0], about[:, 1] = self.smallest_v, self.range_v - self.smallest_v
        about[:, 2] = np.where(self.smallest_v > 0.0, self.softening_v, 0.0)
        about[:, 3] = STILL * (1.0 + largest)
        about[:, 4:] = np.abs([bank.slope[k, n] for k, n in enumerate(bank.n)])
        return Tables(grid, about)

    def rest(self) -> ExactState:
        """Actuator never driven: one segment an input, nothing engaged."""
        m, bank = self.n_inputs, self.square.bank
        stack, hand = np.zeros((m, bank.r.shape[1] + 1, 3 + m)), np.zeros((m, 3))
        stack[:, 0, 0], hand[:, 0] = bank.n, 1.0
        return ExactState(stack, hand)

    def restore(self, data: dict[str, Any]) -> ExactState:
        """State from what ``as_dict`` gave."""
        return ExactState.from_dict(data)

    def _scratch(self) -> tuple[Array, Array, Array]:
        """Tables that a walk writes into: now, passed, matrix."""
        m, width = self.n_inputs, self.tables.grid.shape[1] + 1
        return np.zeros((m, 16 + m)), np.zeros((m, width, 3)), np.zeros((3, m, 2 * m))

    def _respond(self, reference_um: Array, start: ExactState) -> tuple[Array, ExactState]:
        state = start.copy()
        return self.solve(reference_um, state, np.zeros(0)), state

    def solve(self, v_um: Array, state: ExactState, away: Array, recovery: Recovery | None = None) -> Array:
        """Drive (m, N) for outputs (p, N) of the static block; ``state`` is moved on in place.

        away : (n,) distance of a linear block behind it from where its inverse believes it to be, updated
        recovery : how that distance is taken away; needed if there is such a block
        """
        from hammerstein.compensators.exact_kernel import respond_exact

        p, drive = self.n_outputs, np.empty((self.n_inputs, v_um.shape[1]))
        back = recovery or Recovery(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((p, 0)))
        tables = (*self.tables, state.stack, state.hand, *self._scratch())
        respond_exact(v_um, self.n_inputs - p, *back, away, *tables, drive)
        return drive

"""The exact inverse of the multivariable model: Gamma(U) = Y_r in every sample, cross-couplings included."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, singledispatch
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from hammerstein.arrays import Array, filled
from hammerstein.blocks import Memory
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.blocks.law import Law, S
from hammerstein.blocks.voltages import Voltages
from hammerstein.compensators.base import Compensator
from hammerstein.compensators.exact import piece_kernels as at
from hammerstein.dynamics import linear
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import (
    Asymmetric,
    Generalised,
    Hysteresis,
    PrandtlIshlinskii,
    Preisach,
    PreisachState,
    RateDependent,
    RateState,
    play,
)
from hammerstein.hysteresis.invertibility import Invertibility, completed, invertibility, require_inverse
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Volts

STILL = 1e-13
"""Step of the drive, in parts of the largest threshold, up to which it is rounding."""


@dataclass(frozen=True, eq=False)
class ExactState(Memory):
    """Memory of the exact inverse, as in the tables of ``piece_kernels``.

    stack : (m, n_max+2, 3+m) the stacks of segments behind the smallest plays
    hand : (m, 3) height of each stack, the last requested q [V], ramp of the jump from -1 to 1
    """

    stack: Array
    hand: Array


class Recovery(NamedTuple):
    """Return of a linear block to its path after saturation: x+ = a x + b (v - gain x)."""

    a: Array
    b: Array
    gain: Array

    @classmethod
    def none(cls, outputs: int) -> Recovery:
        """Recovery without linear block."""
        return cls(np.zeros((0, 0)), np.zeros((0, outputs)), np.zeros((outputs, 0)))


class Tables(NamedTuple):
    """Working tables of ``piece_kernels``: records of rows (input, row), and of each input (input,)."""

    w: np.ndarray[Any, Any]
    here: np.ndarray[Any, Any]


def tables(m: int, rows: int) -> Tables:
    """Empty tables of m inputs with this number of operators, segments, pieces or zones."""
    return Tables(np.zeros((m, rows), at.of_rows(m)), np.zeros(m, at.of_inputs(m)))


class StaticInverse(Law[S]):
    """Exact inverse of a static block, the base of other laws.

    invertibility : result of the check before the run
    """

    invertibility: Invertibility
    hysteresis: Hysteresis[Any]
    _design: Tables
    _start: S

    def __init__(
        self,
        hysteresis: Hysteresis[Any],
        model: HammersteinModel,
        range_v: RangeLike,
        softening_v: float = 0.0,
        run_anyway: bool = False,
    ):
        self.range, self.softening_v = DriveRange.of(range_v, model), softening_v
        self.hysteresis = hysteresis.counted_from(self.range.working_point_v)
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self._prepare(model, run_anyway)

    @abstractmethod
    def _prepare(self, model: HammersteinModel, run_anyway: bool) -> None:
        """Look whether there is an inverse; set its tables, its start, and the positions there."""

    def design_tables(self) -> Tables:
        """Tables of ``piece_kernels`` before a run."""
        return Tables(*(table.copy() for table in self._design))

    def statement(self) -> str:
        """State whether there is an inverse, and how far the drive jumps at a reversal."""
        return self.invertibility.statement()

    def rest(self) -> S:
        """Memory of an actuator at its start."""
        return self._start

    def _respond(self, reference_um: Array, start: S) -> tuple[Array, S]:
        drive, state, _ = self.solve(self._from_rest(reference_um), start, np.zeros(0))
        return drive, state

    @abstractmethod
    def solve(
        self, v_um: Array, start: S, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, S, Array]:
        """Drive (m, N) for outputs (p, N) of the static block, relative to rest, and the state after it.

        away : (n,) difference between the state of a linear block behind it and the one that its inverse
            assumes; the last value returned is that difference afterwards
        recovery : how this difference is removed; needed if there is such a block
        """


@dataclass(frozen=True, eq=False)
class DriveState(Memory):
    """Memory of the model, and the last voltages (m,) [V]."""

    model: Any
    drive_v: Array


class ZonesInverse(StaticInverse[DriveState]):
    """Exact inverse of a block whose memory changes its affine pieces in each sample.

    The walk finds them as zones beside one play of threshold and weight 0.
    """

    def _prepare(self, model: HammersteinModel, run_anyway: bool) -> None:
        """See ``StaticInverse._prepare``."""
        self.invertibility = replace(invertibility(self.hysteresis), inputs=model.inputs)
        require_inverse(self.invertibility, "exact_inverse", run_anyway)
        zones, largest_v, gain = self._room(run_anyway)
        w, here = tables(self.n_inputs, zones)
        here["low"], here["high"] = self.range.counted
        here["still"] = STILL * (1.0 + largest_v)
        here["fixed"] = -1
        here["count"] = here["ramp"] = 1
        here["gain"] = gain
        w["end"][:, 0] = w["d"][:, 0] = 1
        self._design, history = Tables(w, here), self.range.history()
        self.origin_um, state = self.hysteresis.standing(history)
        self._start = DriveState(state, history[:, -1].copy())

    @abstractmethod
    def _room(self, run_anyway: bool) -> tuple[int, float, Array]:
        """Room for the zones of an input, size of the voltages [V], and gain (m, row) [um/V]."""

    @abstractmethod
    def _loop(self, state: Any) -> tuple[Callable[..., None], int, tuple[Any, ...]]:
        """Compiled loop, the work of a sample, and what the loop takes of the block; a memory it moves on."""

    def solve(
        self, v_um: Array, start: DriveState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, DriveState, Array]:
        """See ``StaticInverse.solve``."""
        left, state, wanted = away.copy(), start.model.copy(), np.ascontiguousarray(v_um)
        back, (w, here) = recovery or Recovery.none(self.n_outputs), self.design_tables()
        w["x"][:, 0] = start.drive_v
        loop, work, own = self._loop(state)
        given, shape = (wanted, *back, left, w, here, *own), (self.n_inputs, wanted.shape[1])
        drive = filled(loop, *given, shape=shape, products=work)
        return drive, DriveState(state, w["x"][:, 0].copy()), left


class ExactInverseLaw(StaticInverse[ExactState]):
    """Solves ``Gamma(U) = Y_r`` in every sample by walking the affine pieces of the model.

    The model may be any square one whose slope determinants have one sign (``invertibility``), with its own
    thresholds for every pair and weights of either sign. One with more inputs than outputs is solved with
    the least drive: of all drives that the gain matrix of the settled loops maps to the same displacement,
    the shortest one (least sum of squares of the inputs, up to their smallest plays).

    Where the smallest threshold r_0 of an input is above zero the drive jumps by 2 r_0 when that input turns,
    for nothing moves in between. ``softening_v`` spreads the jump over that movement of the input;
    meanwhile the actuator's smallest play stays constant, at most ``2 r_0 s / (2 r_0 + s)`` volts behind,
    and the memory of the law follows the play, not the request.

    An input that would leave the drive's range stays at the range. The output that it moves most is then
    missed; the other inputs go on solving the other outputs exactly.

    Parameters
    ----------
    model : m inputs, p <= m outputs; its static block is used
    range_v : range of the drive [V], see ``DriveRange.of``
    softening_v : movement over which the jump at a reversal is spread [V]; 0: at once
    run_anyway : accept a model without an inverse; where no solution is found the drive stays where the walk
        ended

    Attributes
    ----------
    invertibility : result of the check before the run

    Raises
    ------
    InputError : more outputs than inputs, a smallest threshold beyond the range, or softening below zero
    SimulationError : the model has no inverse, with the slopes and the remedy

    Source: this work; the method is that of ``inverse_kernel``.

    Examples
    --------
    >>> from hammerstein.dynamics.models import StaticDynamics
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> plant = PrandtlIshlinskii([[Pair([0.1, 1.0], [4.0, 2.0])]])
    >>> model = HammersteinModel("one axis", plant, StaticDynamics(n_outputs=1), 10.0, ("u",), ("y",))
    >>> law = ExactInverseLaw(model, 10.0)
    >>> drive_v, _ = law.respond([[0.0, 10.0, 8.0]])
    >>> plant.respond(drive_v)[0].round(9)
    array([[ 0., 10.,  8.]])
    """

    def __init__(
        self, model: HammersteinModel, range_v: RangeLike, softening_v: float = 0.0, run_anyway: bool = False
    ):
        super().__init__(model.hysteresis, model, range_v, softening_v, run_anyway)

    def _prepare(self, model: HammersteinModel, run_anyway: bool) -> None:
        """See ``StaticInverse._prepare``."""
        hysteresis, softening_v = self.hysteresis, self.softening_v
        assert isinstance(hysteresis, PrandtlIshlinskii | Asymmetric)
        if not (np.isfinite(softening_v) and softening_v >= 0.0):
            raise InputError("softening_v", f"must be 0 V or more, not {softening_v:g}")
        found = invertibility(hysteresis, np.array(self.range.counted), model.amplitude_v)
        self.invertibility = replace(found, inputs=model.inputs)
        require_inverse(self.invertibility, "exact_inverse", run_anyway)
        self.square, self.smallest_v = completed(hysteresis, model.amplitude_v)
        self._design = self._new_design()
        self._start, self.origin_um = self._at_start()

    @cached_property
    def _compiled_step(self) -> Any:
        # looked up once: a step is short
        from hammerstein.compensators.exact.inverse_kernel import step_exact

        return step_exact

    def _new_design(self) -> Tables:
        """Tables of ``piece_kernels`` with the model in them."""
        m, bank, zones = self.n_inputs, self.square.plays.bank, self.square.lines
        operators, ends = bank.r.shape[1], zones.ends.shape[1]
        w, here = tables(m, operators + ends + 1)
        w["zone_end"][:, :ends] = zones.ends
        w["zone_slope"][:, :ends] = zones.slope
        w["zone_start"][:, :ends] = zones.intercept
        w["r"][:, :operators] = bank.r
        w["slope"][:, : operators + 1] = bank.slope
        w["moment"][:, : operators + 1] = bank.moment
        here["play"] = self.smallest_v
        low, high = (ends.tolist() for ends in self.range.counted)
        here["low"] = [-_difference(-u, r) for u, r in zip(low, self.smallest_v.tolist(), strict=True)]
        here["high"] = [_difference(u, r) for u, r in zip(high, self.smallest_v.tolist(), strict=True)]
        here["soft"] = np.where(self.smallest_v > 0.0, self.softening_v, 0.0)
        here["still"] = STILL * (1.0 + float(bank.r[np.isfinite(bank.r)].max()))
        here["gain"] = np.abs([bank.slope[k, n] for k, n in enumerate(bank.n)])
        return Tables(w, here)

    def _at_start(self) -> tuple[ExactState, Array]:
        """Memory where the actuator stands, and the positions (p,) there [um].

        The stacks of segments are those of the forward model behind the smallest plays: for an actuator that
        was never driven one segment an input, nothing engaged. What has no output keeps its value.
        """
        m, history = self.n_inputs, self.range.history()
        q = np.stack([play(u, [r])[0] for u, r in zip(history, self.smallest_v, strict=True)])
        rows, memory = self.square.respond(q) if q.any() else (np.zeros((m, 1)), self.square.rest())
        plays = memory.plays
        stack, hand = np.zeros((m, self.square.plays.bank.r.shape[1] + 2, 3 + m)), np.zeros((m, 3))
        for column, values in ((at.END, plays.end), (at.X, plays.x), (at.D, plays.d)):
            stack[:, :-1, column] = values
        stack[:, :-1, at.BELOW :] = plays.below
        slack = np.where(self.smallest_v > 0.0, self.smallest_v, np.inf)
        hand[:, at.COUNT], hand[:, at.WANTED] = plays.count, q[:, -1]
        hand[:, at.RAMP] = np.clip((history[:, -1] - q[:, -1]) / slack, -1.0, 1.0)
        self._design.here["y"][self.n_outputs :] = rows[self.n_outputs :, -1]
        return ExactState(stack, hand), rows[: self.n_outputs, -1].copy()

    def _step(self, sample_um: Array, state: ExactState) -> tuple[Array, ExactState] | None:
        drive, stack, hand, sound = self._compiled_step(
            sample_um, self._frame, *self._design, state.stack, state.hand
        )
        return (drive, ExactState(stack, hand)) if sound else None

    def solve(
        self, v_um: Array, start: ExactState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, ExactState, Array]:
        """See ``StaticInverse.solve``."""
        from hammerstein.compensators.exact.inverse_kernel import respond_exact

        p, v_um = self.n_outputs, np.ascontiguousarray(v_um)  # of one type: it is compiled once
        left, (w, here) = away.copy(), at.loaded(*self._design, start.stack, start.hand)
        given = (v_um, self.n_inputs - p, *(recovery or Recovery.none(p)), left, w, here)
        drive = filled(respond_exact, *given, shape=(self.n_inputs, v_um.shape[1]))
        after = ExactState(np.empty(start.stack.shape), np.empty(start.hand.shape))
        at.unloaded(w, here, after.stack, after.hand)
        return drive, after, left


class GeneralisedInverseLaw(StaticInverse[ExactState]):
    """Solves ``Gamma(U) = Y_r`` in every sample: the walk of the plays, then the inverse of each envelope.

    Parameters
    ----------
    hysteresis : the static block; its plays and envelopes
    model : the model that it is of
    range_v : range of the drive [V], see ``DriveRange.of``
    softening_v : as of ``ExactInverseLaw``, in the unit of the envelopes
    run_anyway : accept plays without an inverse

    Raises
    ------
    InputError : more outputs than inputs, a smallest threshold beyond the range, or softening below zero
    SimulationError : the plays have no inverse
    """

    hysteresis: Generalised

    def _prepare(self, model: HammersteinModel, run_anyway: bool) -> None:
        """See ``StaticInverse._prepare``."""
        self.plays = self._of_plays(model, run_anyway)
        self._design, self._start = self.plays.design_tables(), self.plays.rest()
        found = invertibility(self.hysteresis, np.array(self.range.counted), model.amplitude_v)
        self.invertibility = replace(found, inputs=model.inputs)
        self.origin_um = self.plays.origin_um

    def _of_plays(self, model: HammersteinModel, run_anyway: bool) -> ExactInverseLaw:
        """The exact inverse of the plays, within what the envelopes make of the range."""
        limits, zero = self.range, np.zeros(self.n_inputs)
        start = limits.start_v - limits.working_point_v
        between = limits.conditioning_v - limits.working_point_v
        seen = self.hysteresis.inner(np.stack([*limits.counted, start, *between], axis=1))
        low, high, start, *ends = np.ascontiguousarray(seen.T)
        within = DriveRange(low, high, zero, start, limits.conditioned, np.stack(ends))
        voltages = Voltages.symmetric(model.amplitude_v, self.n_inputs)
        plays = replace(model, hysteresis=self.hysteresis.plays, voltages=voltages, covariance=None)
        return ExactInverseLaw(plays, within, self.softening_v, run_anyway)

    def solve(
        self, v_um: Array, start: ExactState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, ExactState, Array]:
        """See ``StaticInverse.solve``; at an end of the range the drive stands there to the last bit."""
        seen, state, left = self.plays.solve(v_um, start, away, recovery)
        drive, (low, high) = self.hysteresis.outer(seen), self.range.counted
        ends = self.plays.range
        drive = np.where(seen >= ends.high_v[:, None], high[:, None], drive)
        drive = np.where(seen <= ends.low_v[:, None], low[:, None], drive)
        return np.clip(drive, low[:, None], high[:, None]), state, left


class PreisachInverseLaw(ZonesInverse):
    """Solves ``Gamma(U) = Y_r`` in every sample along the branches that begin at the memory of each input.

    Parameters
    ----------
    hysteresis : the static block, m inputs and m outputs
    model : the model that it is of
    range_v : range of the drive [V], see ``DriveRange.of``
    softening_v : of no effect: the diagonal of each plane moves always, and nothing jumps
    run_anyway : accept a model without an inverse

    Raises
    ------
    InputError : the model is not square
    SimulationError : the slopes that the planes can have do not keep one sign
    """

    hysteresis: Preisach

    def _room(self, run_anyway: bool) -> tuple[int, float, Array]:
        """See ``ZonesInverse._room``."""
        planes, turns = self.hysteresis.planes, self.hysteresis.rest().x.shape[1]
        largest_v = float(np.maximum(np.abs(planes.low), np.abs(planes.high)).max())
        return most_pieces(int(planes.cells.max()), turns), largest_v, np.abs(planes.beyond.sum(axis=1))

    def _loop(self, state: PreisachState) -> tuple[Callable[..., None], int, tuple[Any, ...]]:
        """See ``ZonesInverse._loop``."""
        from hammerstein.compensators.exact.zones_kernel import respond_exact_preisach

        memory = (state.count, state.x, state.tip, state.last)
        return respond_exact_preisach, 64 * self.n_inputs**2, (tuple(self.hysteresis.planes), memory)


def most_pieces(cells: int, turns: int) -> int:
    """Pieces of the map of a sample: on each side at most the cells, the turns it passes, and a last one."""
    return 2 * (cells + turns // 2 + 2)


class RateDependentInverseLaw(ZonesInverse):
    """Solves ``Gamma(U) = Y_r`` in every sample, with the thresholds that follow from the previous samples.

    Parameters
    ----------
    model : m inputs, m outputs; its static block is used
    hysteresis : that block on its sample grid
    range_v : range of the drive [V], see ``DriveRange.of``
    softening_v : of no effect: play(0) of each input moves always, and nothing jumps
    run_anyway : accept a model without an inverse, or one whose inverse is not stable

    Raises
    ------
    InputError : the model is not square
    SimulationError : no inverse, or growth and filter for which the inverse rings up
    """

    hysteresis: RateDependent

    def _room(self, run_anyway: bool) -> tuple[int, float, Array]:
        """See ``ZonesInverse._room``; also refuses an inverse that is not stable."""
        self.sample_time_s = self.hysteresis.grid_s
        gain = float(self.hysteresis.loop_gain().max())
        if gain >= 1.0 and not run_anyway:
            raise SimulationError(
                "The inverse of this rate-dependent model is unstable: its loop through the rate has "
                f"{gain:.3g} times the gain of the stability limit. Identify with a lower bandwidth "
                "of the rate or smaller growth, or set run_anyway = true."
            )
        bank = self.hysteresis.bank
        return 2 * bank.r.shape[1] + 4, float(bank.r.max()), np.abs(bank.w.sum(axis=1))

    def statement(self) -> str:
        """State whether there is an inverse, and its margin to ringing."""
        gain = float(self.hysteresis.loop_gain().max())
        return (
            f"{self.invertibility.statement()} Its loop through the rate has {gain:.3g} times the "
            "gain of the stability limit."
        )

    def _loop(self, state: RateState) -> tuple[Callable[..., None], int, tuple[Any, ...]]:
        """See ``ZonesInverse._loop``."""
        from hammerstein.compensators.exact.zones_kernel import respond_exact_rate

        bank, grid = self.hysteresis.bank, (self.hysteresis.grid_s, self.hysteresis.poles)
        memory = (state.plays_v, state.last_v, state.rate_v_per_s)
        return respond_exact_rate, 64 * bank.w.size, (grid, tuple(bank), memory)


@singledispatch
def exact_inverse_of(
    hysteresis: Hysteresis[Any],
    model: HammersteinModel,
    range_v: RangeLike,
    softening_v: float = 0.0,
    run_anyway: bool = False,
) -> StaticInverse[Any]:
    """Build the exact inverse of a hysteresis on its sample grid; each kind that has one registers it.

    model : the model whose static block this is; the other options are those of the law

    Raises InputError for a kind without an exact inverse.
    """
    raise InputError(
        "exact_inverse",
        f"hysteresis of kind {hysteresis.kind!r} has no exact inverse; use inverse_multiplicative, or "
        "identify another kind",
    )


def has_exact_inverse(hysteresis: Hysteresis[Any]) -> bool:
    """Whether the kind of a hysteresis has registered an exact inverse."""
    return exact_inverse_of.dispatch(type(hysteresis)) is not exact_inverse_of.dispatch(object)


@exact_inverse_of.register(PrandtlIshlinskii)
@exact_inverse_of.register(Asymmetric)
def _(hysteresis: Hysteresis[Any], model: HammersteinModel, *options: Any) -> ExactInverseLaw:
    return ExactInverseLaw(model, *options)


exact_inverse_of.register(Generalised, GeneralisedInverseLaw)
exact_inverse_of.register(Preisach, PreisachInverseLaw)
exact_inverse_of.register(RateDependent, RateDependentInverseLaw)


def _difference(whole: float, part: float) -> float:
    """Return whole - part, rounded such that adding the part gives the whole, the range, again."""
    rest = whole - part
    while rest + part < whole:
        rest = math.nextafter(rest, math.inf)
    while rest + part > whole:
        rest = math.nextafter(rest, -math.inf)
    return rest


class ExactInverse(Compensator):
    """The exact inverse of the static block, cross-couplings included."""

    static: ClassVar[bool] = True
    law: Literal["exact_inverse"] = "exact_inverse"
    softening_v: Volts = Field(
        default=0.0, description="voltage over which the drive jump at a reversal is spread"
    )
    run_anyway: bool = Field(default=False, description="accept a model without an inverse")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        linear(model.dynamics)
        here = model.hysteresis.on_grid(sample_time_s)
        return exact_inverse_of(here, model, range_v, self.softening_v, self.run_anyway)

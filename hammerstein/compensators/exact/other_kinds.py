"""The exact inverses of generalised, Preisach and rate-dependent hysteresis."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.voltages import Voltages
from hammerstein.compensators.exact.inverse import (
    ExactInverseLaw,
    ExactState,
    Recovery,
    StaticInverse,
    ZonesInverse,
    exact_inverse_of,
)
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import Generalised, Preisach, PreisachState, RateDependent, RateState
from hammerstein.hysteresis.invertibility import invertibility
from hammerstein.model import HammersteinModel


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
        seen = self.hysteresis.inner(np.stack([*limits.counted, start], axis=1))
        low, high, start = np.ascontiguousarray(seen.T)
        within = DriveRange(low, high, zero, start, limits.conditioned)
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


exact_inverse_of.register(Generalised, GeneralisedInverseLaw)


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


exact_inverse_of.register(Preisach, PreisachInverseLaw)


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


exact_inverse_of.register(RateDependent, RateDependentInverseLaw)

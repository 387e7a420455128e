"""The exact inverse of rate-dependent hysteresis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hammerstein.blocks import Array
from hammerstein.compensators.exact.inverse import STILL, Recovery, StaticInverse
from hammerstein.driving import DriveRange, RangeLike
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import RateDependent, RateState
from hammerstein.hysteresis.invertibility import invertibility, require_inverse
from hammerstein.model import HammersteinModel


@dataclass(frozen=True, eq=False)
class RateInverseState:
    """Memory of the inverse: that of the model's plays and rates, and the last voltages (m,) [V]."""

    model: RateState
    drive_v: Array

    def as_dict(self) -> dict[str, Any]:
        """Give plain lists."""
        return {"model": self.model.as_dict(), "drive_v": self.drive_v.tolist()}


class RateDependentInverseLaw(StaticInverse[RateInverseState]):
    """Solves ``Gamma(U) = Y_r`` in every sample with the thresholds that the samples before have set.

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

    def __init__(
        self,
        hysteresis: RateDependent,
        model: HammersteinModel,
        range_v: RangeLike,
        softening_v: float = 0.0,
        run_anyway: bool = False,
    ):
        self.hysteresis, self.range = hysteresis, DriveRange.of(range_v, model)
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self.sample_time_s = hysteresis.grid_s
        self.softening_v = softening_v
        self.invertibility = replace(invertibility(hysteresis), inputs=model.inputs)
        require_inverse(self.invertibility, "exact_inverse", run_anyway)
        gain = float(hysteresis.loop_gain().max())
        if gain >= 1.0 and not run_anyway:
            raise SimulationError(
                f"The inverse of this rate-dependent model rings up: growth (1 - a) / T reaches {gain:.3g}, "
                "and must stay below 1. Identify with a lower bandwidth of the rate or smaller growth, or "
                "set run_anyway = true."
            )
        self._table = self._new_table()
        history = self.range.history()
        v, state = hysteresis.respond(history)
        if history.shape[1] > 1:  # it has stood there long enough to be at rest
            state = replace(
                state, last_v=np.repeat(history[:, -1:], 2, axis=1), rate_v_per_s=np.zeros(self.n_inputs)
            )
        self._start, self.origin_um = RateInverseState(state, history[:, -1].copy()), v[:, -1].copy()

    def _new_table(self) -> Array:
        """Table of ``pieces`` with one play of threshold and weight 0, and room for the zones of a sample."""
        from hammerstein.compensators.exact import pieces as at

        m, bank = self.n_inputs, self.hysteresis.bank
        rows = max(2 * bank.r.shape[1] + 4, at.SCRATCH + 1)
        table = np.zeros((5, m, rows, at.CONSTANT + 1 + 2 * m))
        about = table[at.HERE, :, at.ABOUT]
        about[:, at.LOW], about[:, at.HIGH] = self.range.counted
        about[:, at.STILL] = STILL * (1.0 + float(bank.r.max()))
        about[:, at.GAIN : at.GAIN + m] = np.abs(bank.w.sum(axis=1))
        table[at.HERE, :, at.NOW, at.FIXED] = -1.0
        table[at.STACK, :, 0, at.END] = table[at.STACK, :, 0, at.D] = 1.0
        table[at.HERE, :, at.HAND, at.COUNT] = table[at.HERE, :, at.HAND, at.RAMP] = 1.0
        return table

    def design_table(self) -> Array:
        """Table of ``pieces`` as it is before a run."""
        return self._table.copy()

    def statement(self) -> str:
        """Say whether there is an inverse, and how far it is from ringing."""
        gain = float(self.hysteresis.loop_gain().max())
        return (
            f"{self.invertibility.statement()} Its loop through the rate has gain {gain:.3g}, stable below 1."
        )

    def rest(self) -> RateInverseState:
        """Memory of an actuator at its start."""
        return self._start

    def restore(self, data: dict[str, Any]) -> RateInverseState:
        """State from what ``as_dict`` gave."""
        return RateInverseState(
            RateState.from_dict(data["model"]), np.array(data["drive_v"], dtype=np.float64)
        )

    def _respond(self, reference_um: Array, start: RateInverseState) -> tuple[Array, RateInverseState]:
        drive, state, _ = self.solve(self._from_rest(reference_um), start, np.zeros(0))
        return drive, state

    def solve(
        self, v_um: Array, start: RateInverseState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, RateInverseState, Array]:
        """Drive (m, N) for outputs (p, N) of the static block; see ``StaticInverse.solve``."""
        from hammerstein.compensators.exact import pieces as at
        from hammerstein.compensators.exact.rate_kernel import respond_exact_rate
        from hammerstein.compiled import spans

        p, drive, bank = self.n_outputs, np.empty((self.n_inputs, v_um.shape[1])), self.hysteresis.bank
        back = recovery or Recovery(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((p, 0)))
        table, left = self._table.copy(), away.copy()
        table[at.STACK, :, 0, at.X] = start.drive_v
        own = start.model
        state = RateState(own.plays_v.copy(), own.last_v.copy(), own.rate_v_per_s.copy())
        grid = (self.hysteresis.grid_s, self.hysteresis.poles)
        plays = (bank.n, bank.r, bank.b, bank.lam, bank.w)
        memory = (state.plays_v, state.last_v, state.rate_v_per_s)
        wanted, work = np.ascontiguousarray(v_um), 64 * bank.w.size
        for first, stop in spans(wanted.shape[1], work):
            respond_exact_rate(wanted, *back, left, table, *grid, *plays, *memory, first, stop, drive)
        return drive, RateInverseState(state, table[at.STACK, :, 0, at.X].copy()), left

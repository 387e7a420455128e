"""The exact inverse of rate-dependent hysteresis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Memory
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.exact.inverse import (
    STILL,
    Recovery,
    StaticInverse,
    Tables,
    exact_inverse_of,
    tables,
)
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import RateDependent, RateState
from hammerstein.hysteresis.invertibility import invertibility, require_inverse
from hammerstein.model import HammersteinModel


@dataclass(frozen=True, eq=False)
class RateInverseState(Memory):
    """Memory of the inverse: that of the model's plays and rates, and the last voltages (m,) [V]."""

    model: RateState
    drive_v: Array


class RateDependentInverseLaw(StaticInverse[RateInverseState]):
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
                "The inverse of this rate-dependent model is unstable: its loop through the rate has "
                f"{gain:.3g} times the gain of the stability limit. Identify with a lower bandwidth "
                "of the rate or smaller growth, or set run_anyway = true."
            )
        self._design = self._new_design()
        history = self.range.history()
        self.origin_um, state = hysteresis.standing(history)
        self._start = RateInverseState(state, history[:, -1].copy())

    def _new_design(self) -> Tables:
        """Tables of ``pieces``: one play of threshold and weight 0, room for the zones of a sample."""
        m, bank = self.n_inputs, self.hysteresis.bank
        w, here = tables(m, 2 * bank.r.shape[1] + 4)
        here["low"], here["high"] = self.range.counted
        here["still"] = STILL * (1.0 + float(bank.r.max()))
        here["fixed"] = -1
        here["count"] = here["ramp"] = 1
        here["gain"] = np.abs(bank.w.sum(axis=1))
        w["end"][:, 0] = w["d"][:, 0] = 1
        return Tables(w, here)

    def statement(self) -> str:
        """State whether there is an inverse, and its margin to ringing."""
        gain = float(self.hysteresis.loop_gain().max())
        return (
            f"{self.invertibility.statement()} Its loop through the rate has {gain:.3g} times the "
            "gain of the stability limit."
        )

    def rest(self) -> RateInverseState:
        """Memory of an actuator at its start."""
        return self._start

    def _respond(self, reference_um: Array, start: RateInverseState) -> tuple[Array, RateInverseState]:
        drive, state, _ = self.solve(self._from_rest(reference_um), start, np.zeros(0))
        return drive, state

    def solve(
        self, v_um: Array, start: RateInverseState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, RateInverseState, Array]:
        """Drive (m, N) for outputs (p, N) of the static block; see ``StaticInverse.solve``."""
        from hammerstein.compensators.exact.rate_kernel import respond_exact_rate
        from hammerstein.compiled import spans

        p, drive, bank = self.n_outputs, np.empty((self.n_inputs, v_um.shape[1])), self.hysteresis.bank
        back = recovery or Recovery(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((p, 0)))
        (w, here), left = self.design_tables(), away.copy()
        w["x"][:, 0] = start.drive_v
        own = start.model
        state = RateState(own.plays_v.copy(), own.last_v.copy(), own.rate_v_per_s.copy())
        grid = (self.hysteresis.grid_s, self.hysteresis.poles)
        plays = (bank.n, bank.r, bank.b, bank.lam, bank.w)
        memory = (state.plays_v, state.last_v, state.rate_v_per_s)
        wanted, work = np.ascontiguousarray(v_um), 64 * bank.w.size
        for first, stop in spans(wanted.shape[1], work):
            respond_exact_rate(wanted, *back, left, w, here, *grid, *plays, *memory, first, stop, drive)
        return drive, RateInverseState(state, w["x"][:, 0].copy()), left


@exact_inverse_of.register
def _(hysteresis: RateDependent, model: HammersteinModel, *options: Any) -> StaticInverse[Any]:
    return RateDependentInverseLaw(hysteresis, model, *options)

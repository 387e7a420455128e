"""The exact inverse of rate-dependent hysteresis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.exact.inverse import DriveState, Recovery, ZonesInverse, exact_inverse_of
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import RateDependent
from hammerstein.hysteresis.invertibility import invertibility, require_inverse
from hammerstein.model import HammersteinModel


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
        bank = hysteresis.bank
        self._begin(2 * bank.r.shape[1] + 4, float(bank.r.max()), np.abs(bank.w.sum(axis=1)))

    def statement(self) -> str:
        """State whether there is an inverse, and its margin to ringing."""
        gain = float(self.hysteresis.loop_gain().max())
        return (
            f"{self.invertibility.statement()} Its loop through the rate has {gain:.3g} times the "
            "gain of the stability limit."
        )

    def solve(
        self, v_um: Array, start: DriveState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, DriveState, Array]:
        """Drive (m, N) for outputs (p, N) of the static block; see ``StaticInverse.solve``."""
        from hammerstein.compensators.exact.rate_kernel import respond_exact_rate
        from hammerstein.compiled import spans

        drive, bank = np.empty((self.n_inputs, v_um.shape[1])), self.hysteresis.bank
        back = recovery or Recovery.none(self.n_outputs)
        (w, here), left, state = self.design_tables(), away.copy(), start.model.copy()
        w["x"][:, 0] = start.drive_v
        grid = (self.hysteresis.grid_s, self.hysteresis.poles)
        plays = (bank.n, bank.r, bank.b, bank.lam, bank.w)
        memory = (state.plays_v, state.last_v, state.rate_v_per_s)
        wanted, work = np.ascontiguousarray(v_um), 64 * bank.w.size
        for first, stop in spans(wanted.shape[1], work):
            respond_exact_rate(wanted, *back, left, w, here, *grid, *plays, *memory, first, stop, drive)
        return drive, DriveState(state, w["x"][:, 0].copy()), left


exact_inverse_of.register(RateDependent, RateDependentInverseLaw)

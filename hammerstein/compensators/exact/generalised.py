"""The exact inverse of generalised hysteresis: that of its plays, then that of its envelopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.blocks.voltages import Voltages
from hammerstein.compensators.exact.inverse import (
    ExactInverseLaw,
    ExactState,
    Recovery,
    StaticInverse,
    exact_inverse_of,
)
from hammerstein.hysteresis import Generalised
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

    def __init__(
        self,
        hysteresis: Generalised,
        model: HammersteinModel,
        range_v: RangeLike,
        softening_v: float = 0.0,
        run_anyway: bool = False,
    ):
        self.range = DriveRange.of(range_v, model)
        self.hysteresis = hysteresis.counted_from(self.range.working_point_v)
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self.plays = self._of_plays(model, softening_v, run_anyway)
        self._design, self._start = self.plays.design_tables(), self.plays.rest()
        found = invertibility(self.hysteresis, np.array(self.range.counted), model.amplitude_v)
        self.invertibility = replace(found, inputs=model.inputs)
        self.softening_v, self.origin_um = softening_v, self.plays.origin_um

    def _of_plays(self, model: HammersteinModel, softening_v: float, run_anyway: bool) -> ExactInverseLaw:
        """The exact inverse of the plays, within what the envelopes make of the range."""
        limits, zero = self.range, np.zeros(self.n_inputs)
        start = limits.start_v - limits.working_point_v
        seen = self.hysteresis.inner(np.stack([*limits.counted, start], axis=1))
        low, high, start = np.ascontiguousarray(seen.T)
        within = DriveRange(low, high, zero, start, limits.conditioned)
        voltages = Voltages.symmetric(model.amplitude_v, self.n_inputs)
        plays = replace(model, hysteresis=self.hysteresis.plays, voltages=voltages, covariance=None)
        return ExactInverseLaw(plays, within, softening_v, run_anyway)

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

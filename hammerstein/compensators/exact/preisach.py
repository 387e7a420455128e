"""The exact inverse of Preisach hysteresis: a walk along the staircase of each input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.exact.inverse import DriveState, Recovery, ZonesInverse, exact_inverse_of
from hammerstein.hysteresis import Preisach
from hammerstein.hysteresis.invertibility import invertibility, require_inverse
from hammerstein.model import HammersteinModel


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

    def __init__(
        self,
        hysteresis: Preisach,
        model: HammersteinModel,
        range_v: RangeLike,
        softening_v: float = 0.0,
        run_anyway: bool = False,
    ):
        self.range, self.softening_v = DriveRange.of(range_v, model), softening_v
        self.hysteresis = hysteresis.counted_from(self.range.working_point_v)
        self.n_inputs, self.n_outputs = hysteresis.n_inputs, hysteresis.n_outputs
        self.invertibility = replace(invertibility(hysteresis), inputs=model.inputs)
        require_inverse(self.invertibility, "exact_inverse", run_anyway)
        planes, turns = self.hysteresis.planes, self.hysteresis.rest().x.shape[1]
        largest_v = float(np.maximum(np.abs(planes.low), np.abs(planes.high)).max())
        zones = most_pieces(int(planes.cells.max()), turns)
        self._begin(zones, largest_v, np.abs(planes.beyond.sum(axis=1)))

    def solve(
        self, v_um: Array, start: DriveState, away: Array, recovery: Recovery | None = None
    ) -> tuple[Array, DriveState, Array]:
        """Drive (m, N) for outputs (p, N) of the static block; see ``StaticInverse.solve``."""
        from hammerstein.compensators.exact.preisach_kernel import respond_exact_preisach
        from hammerstein.compiled import spans

        drive, own = np.empty((self.n_inputs, v_um.shape[1])), self.hysteresis.planes
        back = recovery or Recovery.none(self.n_outputs)
        (w, here), left, after = self.design_tables(), away.copy(), start.copy()
        planes = (own.rest, own.low, own.high, own.size, own.cells, own.node, own.beyond)
        memory = (after.model.count, after.model.x, after.model.tip, after.model.last, after.drive_v)
        wanted, work = np.ascontiguousarray(v_um), 64 * self.n_inputs**2
        for first, stop in spans(wanted.shape[1], work):
            respond_exact_preisach(wanted, *back, left, w, here, planes, memory, first, stop, drive)
        return drive, after, left


def most_pieces(cells: int, turns: int) -> int:
    """Pieces of the map of a sample: on each side at most the cells, the turns it passes, and a last one."""
    return 2 * (cells + turns // 2 + 2)


exact_inverse_of.register(Preisach, PreisachInverseLaw)

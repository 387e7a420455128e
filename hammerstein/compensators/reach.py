"""How far an actuator reaches, within the range of its drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hammerstein.compensators.law import Array
from hammerstein.errors import InputError
from hammerstein.hysteresis import PrandtlIshlinskii


@dataclass(frozen=True, eq=False)
class Reach:
    """Slow paths that a drive of +-range can hold, from the corners of the reachable set.

    corners_um : (output, input) what full range of each input moves
    alone_um : (output,) reach of each axis while the other axes stay at zero
    together_um : (output,) box in which every combination of the axes is reached, in the proportion of
        ``alone_um``
    """

    corners_um: Array
    alone_um: Array
    together_um: Array


def reach(hysteresis: PrandtlIshlinskii, range_v: float) -> Reach:
    """Reach of a static block for inputs within +-``range_v`` [V].

    At full range every play of threshold below it is engaged, so that the corners of the reachable set are
    sums of the settled half heights, sum of w (R - r). Between the corners the set is taken as flat.

    Raises
    ------
    InputError : an infinite range, or a model whose outputs cannot be held independently

    Examples
    --------
    >>> from hammerstein.hysteresis import Pair
    >>> model = PrandtlIshlinskii([[Pair([1.0], [5.0]), Pair.absent()], [Pair.absent(), Pair.linear(4.0)]])
    >>> reach(model, 10.0).alone_um
    array([45., 40.])
    """
    if math.isinf(range_v):
        raise InputError("range_v", "is infinite; every position is reached")
    corners = hysteresis.amplitude(range_v)
    p = hysteresis.n_outputs
    if p > hysteresis.n_inputs or np.linalg.matrix_rank(corners) < p:
        raise InputError("model", "its outputs cannot be held independently with the inputs it has")
    parts = np.abs(np.linalg.pinv(corners))  # of full range, for 1 um on each axis
    alone = 1.0 / parts.max(axis=0)
    together = alone / (parts @ alone).max()
    return Reach(corners, np.asarray(alone), np.asarray(together))

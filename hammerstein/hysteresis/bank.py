"""All play operators of a model side by side, as the kernels want them, and their memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array, Indices, freeze
from hammerstein.blocks import Memory
from hammerstein.hysteresis.pair import Pair


@dataclass(frozen=True, eq=False)
class PlayState(Memory):
    """Memory of a Prandtl-Ishlinskii model: the stack of segments of each input (see ``kernels``).

    ``PrandtlIshlinskii.rest``, ``.state_of`` and every run return one; its arrays are read-only.

    count : (m,) height of each stack; end, x, d : (m, operator+1); below : (m, operator+1, p)
    window : (m, columns) which form each input is in, and how often it turned lately (see ``busy_kernels``)
    """

    count: Indices
    end: Indices
    x: Array
    d: Array
    below: Array
    window: Array


@dataclass(frozen=True, eq=False)
class Bank:
    """All operators of every input on one threshold grid an input, as the kernels want them.

    n : (m,) operators of each input
    r : (m, n_max) thresholds [V], filled up with infinity
    w : (m, n_max, p) weights [um/V], zero where an output lacks the operator
    slope, moment : (m, n_max+1, p) partial sums of w and of w r
    lines : (m, n_max+1, 2 p) the two side by side
    guide, scale : (m, levels), (m,) where the search for a threshold begins, see ``kernels``
    """

    n: Indices
    r: Array
    w: Array
    slope: Array
    moment: Array
    lines: Array
    guide: Indices
    scale: Array

    @classmethod
    def of(cls, pairs: Sequence[Sequence[Pair]]) -> Bank:
        """Merge the pairs (output, input) onto one grid an input."""
        from hammerstein.hysteresis.play_kernels import search_guide

        p, m = len(pairs), len(pairs[0])
        grids = [np.unique(np.concatenate([pairs[o][k].thresholds_v for o in range(p)])) for k in range(m)]
        n = np.array([len(grid) for grid in grids], dtype=np.int64)
        r = np.full((m, max(1, int(n.max()))), np.inf)
        w = np.zeros((*r.shape, p))
        for k, grid in enumerate(grids):
            r[k, : len(grid)] = grid
            for o in range(p):
                pair = pairs[o][k]
                w[k, np.searchsorted(grid, pair.thresholds_v), o] = pair.weights_um_per_v
        slope, moment = np.zeros((2, m, r.shape[1] + 1, p))
        np.cumsum(w, axis=1, out=slope[:, 1:])
        np.cumsum(w * np.where(np.isfinite(r), r, 0.0)[:, :, None], axis=1, out=moment[:, 1:])
        lines = np.concatenate([slope, moment], axis=2)
        guide, scale = search_guide(r, n)
        freeze(n, r, w, slope, moment, lines, guide, scale)
        return cls(n, r, w, slope, moment, lines, guide, scale)

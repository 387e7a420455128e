"""The dearest step of exported code, looked for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hammerstein.arrays import Array
from hammerstein.export.golden import Uniform

STARTS, ROUNDS, SAMPLES = 8, 80, 60  # of a random search: begins, changes of each, length of a drive
LEVELS = 40  # from the middle to the reach, and a quarter of that beyond it


def worst_case_step(operations: Callable[[Array], int], reach: Array) -> tuple[int, int]:
    """Most operations of a step that a climbing search finds, and the samples it tried.

    Sequences of levels are changed in a few samples at a time, and kept where their dearest step is no
    cheaper: what is dear is a jump that many turns lead up to. Every other search jumps to the ends of the
    reach only: the longest jumps cost most where blocks stand side by side.

    Parameters
    ----------
    operations : the dearest step of a signal (axis, sample) from the start
    reach : (axis,) largest value of each axis
    """
    rng, axes, worst = Uniform(seed=11), len(reach), 0

    def levels(samples: int) -> Array:
        return np.asarray(np.round(1.25 * LEVELS * rng.of(axes, samples)) / LEVELS)

    for start in range(STARTS):
        best, most = levels(SAMPLES), 0
        for _ in range(ROUNDS):
            trial = best.copy()
            where = (0.5 * SAMPLES * (rng.of(1, 3)[0] + 1.0)).astype(np.int64)
            jumps = levels(len(where))
            trial[:, where] = 1.25 * np.sign(jumps) if start % 2 else jumps
            found = operations(reach[:, None] * trial)
            if found >= most:
                best, most = trial, found
        worst = max(worst, most)
    return worst, STARTS * ROUNDS * SAMPLES

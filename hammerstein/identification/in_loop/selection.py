"""Experiments that choose the structure of a loop, and the errors of any model on them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.search import SettledPeriod
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.score import Candidate
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record

HELD = 3
"""One of so many experiments is held back while the structure is chosen."""


@dataclass(frozen=True, eq=False)
class Selection:
    """Experiments that are fitted while the structure is chosen, and those held back that choose it."""

    seen: Sequence[SettledPeriod]
    held: Sequence[SettledPeriod]

    @classmethod
    def of(cls, periods: Sequence[SettledPeriod]) -> Selection:
        """Hold back one of ``HELD`` in the order of their amplitudes.

        Without the largest amplitudes, the others do not determine what the hysteresis does there.
        """
        order = np.argsort([period.u.std() for period in periods], kind="stable").tolist()
        back = sorted(order[HELD // 2 :: HELD])
        seen = [period for i, period in enumerate(periods) if i not in back]
        return cls(seen, [periods[i] for i in back])

    def of_linear(self, block: LinearBlock) -> Trial:
        """Linear dynamics on what is held back."""
        errors = [p.left(block.respond(p.sent)[0][:, p.warm :]) for p in self.held]
        n, (p, m) = len(block.A), block.D.shape
        return Trial(f"linear dynamics, order {n}", 2 * n + n * m + p * n + p * m, self._squares(errors))

    def of_loop(self, found: LoopParameters, pool: Executor) -> Trial:
        """Parameters on what is held back."""
        errors = pool.map(lambda p: p.left(found.simulate(p.u, p.warm)), self.held)
        return Trial(found.describe(), len(found.vector()), self._squares(list(errors)))

    def of_model(self, candidate: Candidate, trial: Trial, record: Record) -> Trial:
        """Any model on what is held back, in place of its errors elsewhere.

        record : one of the experiments, with their sample time and the voltage from which they count
        """
        errors = []
        for p in self.held:
            none, rows = np.zeros((len(p.y), p.sent.shape[1])), np.empty(0, dtype=np.int64)
            sent = replace(record, u_v=p.sent, y_um=none, rows=rows, verified=True)
            with np.errstate(all="ignore"):  # of a model that diverges
                errors.append(p.left(candidate.predict(sent, InitialState("rest"))[:, p.warm :]))
        return replace(trial, squares=self._squares(errors))

    def _squares(self, errors: Sequence[Array]) -> Array:
        """Mean squares (experiment,) of weighted errors in parts of the ranges of the weighted outputs."""
        ranges = np.max([np.ptp(period.weight * period.y, axis=1) for period in self.held], axis=0)
        with np.errstate(all="ignore"):  # of a simulation that diverged
            return np.array([np.mean((error / ranges[:, None]) ** 2) for error in errors])

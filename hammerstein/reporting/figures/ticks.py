"""Ticks at round numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

MOST = 6
STEPS = (1, 2, 5, 10)
ROUNDING = 1e-9


class FewTicks(MaxNLocator):
    """Few round numbers, those alone that an axis shows: others take as long to make, and are not drawn."""

    def __init__(self) -> None:
        super().__init__(nbins=MOST, steps=STEPS)

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Places of the ticks between two ends of an axis, in whichever order."""
        ticks = np.asarray(super().tick_values(vmin, vmax))
        slack = ROUNDING * abs(vmax - vmin)
        return ticks[(ticks >= min(vmin, vmax) - slack) & (ticks <= max(vmin, vmax) + slack)]

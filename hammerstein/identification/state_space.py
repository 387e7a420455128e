"""Fit a linear state-space model of stated order to a measured frequency response."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import LinearBlock
from hammerstein.identification.frequency_response import FrequencyResponse
from hammerstein.identification.weighted_lines import Weighting, weigh

Array = NDArray[np.float64]

STARTS = (1.0, 1.2)
"""Block rows of the subspace starts, as multiples of the order."""


def fit_state_space(
    response: FrequencyResponse,
    order: int,
    *,
    weighting: Weighting = "power",
    max_iterations: int = 50,
    tolerance: float = 1e-4,
    progress: Callable[[str], None] | None = None,
) -> LinearBlock:
    starts = _starts(weigh(response, weighting), order)

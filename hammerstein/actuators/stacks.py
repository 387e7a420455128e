"""Made-up stacks by recipe, for kinds of hysteresis that the paper's table does not show."""

from __future__ import annotations

import numpy as np

from hammerstein.dynamics import StaticDynamics
from hammerstein.hysteresis import RateDependent, RatePlays
from hammerstein.instruments import Instruments
from hammerstein.model import HammersteinModel

RATE_PLAYS = 14
GROWTH_S, BANDWIDTH_HZ = 4.3e-4, 350.0
"""So chosen that the loop of the first axis at 10 V is 15 % wide at 1 Hz and 25 % at 200 Hz."""


def rate_dependent_stack(instruments: Instruments) -> HammersteinModel:
    """Two axes whose loops widen with the rate, without dynamics: 69 and 58 um at 10 V.

    Thresholds 10 (i / 14)^1.4 V, i = 0 ... 13, unlike those of any identification, and weights that waver;
    every threshold but the first grows by 0.43 mV for each V/s seen through 350 Hz. Cross-couplings are 3 and
    -4 % of the axes.
    """
    i = np.arange(RATE_PLAYS)
    x = np.where(i == 0, 4.4, 0.33 + 0.12 * np.cos(1.7 * i))
    y = np.where(i == 0, 3.7, 0.28 + 0.10 * np.cos(1.3 * i + 0.5))
    growth = np.where(i == 0, 0.0, GROWTH_S)
    plays = RatePlays(10.0 * (i / RATE_PLAYS) ** 1.4, growth, BANDWIDTH_HZ)
    return HammersteinModel(
        name="rate_dependent_stack",
        hysteresis=RateDependent((plays, plays), ((x, 0.03 * x), (-0.04 * y, y))),
        dynamics=StaticDynamics(n_outputs=2),
        amplitude_v=10.0,
        inputs=("u_x", "u_y"),
        outputs=("x", "y"),
        instruments=instruments,
        provenance={
            "source": "made up by the recipe of hammerstein.actuators.stacks",
            "command": "python -m hammerstein.actuators.build",
        },
    )

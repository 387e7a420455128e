"""Made-up stacks by recipe, asymmetric and rate-dependent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.actuators import DEFAULT
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, CreepMode, StaticDynamics
from hammerstein.hysteresis import (
    Asymmetric,
    DeadZones,
    Hysteresis,
    Pair,
    Parallel,
    PrandtlIshlinskii,
    RateDependent,
    RatePlays,
)
from hammerstein.model import HammersteinModel

RATE_PLAYS = 14  # plays of each input of the rate-dependent stack
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
    block = RateDependent((plays, plays), ((x, 0.03 * x), (-0.04 * y, y)))
    return _made_up("rate_dependent_stack", block, StaticDynamics(n_outputs=2), instruments)


BENT_PLAYS, SLOW_PLAYS = 9, 7
"""Plays beside the dead-zones, and plays whose thresholds grow, of each input of the asymmetric stack."""
STACK_CREEP = tuple(CreepMode(gain=g, time_constant_s=t) for g, t in ((0.02, 0.4), (0.03, 9.0)))


def asymmetric_stack(instruments: Instruments) -> HammersteinModel:
    """Two axes that are asymmetric, rate-dependent and creeping at once: 77 and 63 um at 10 V.

    No kind that is identified is what it is: plays and dead-zones stand beside plays whose thresholds grow by
    0.5 mV for each V/s seen through 300 Hz, behind them resonances at 610 and 690 Hz, and creep of 2 and 3 %
    over 0.4 and 9 s.

    Thresholds are 9.3 sin(pi i / 18)^1.3 V, i = 0 ... 8, and 8.7 (i / 7)^1.8 V, i = 1 ... 6 after 0: spaced
    like those of no identification. Breakpoints are -6.1, -1.7, 2.9 and 7.3 V. Cross-couplings are 4 and
    -3 % of the axes.
    """
    i, j = np.arange(BENT_PLAYS), np.arange(SLOW_PLAYS)
    thresholds_v = 9.3 * np.sin(np.pi * i / (2.0 * BENT_PLAYS)) ** 1.3
    bent = [
        np.where(i == 0, 3.6, 0.26 + 0.09 * np.cos(1.9 * i)),
        np.where(i == 0, 4.0, 0.23 + 0.08 * np.cos(1.4 * i + 0.7)),
    ]
    breakpoints_v = np.array([-6.1, -1.7, 2.9, 7.3])
    bends = [np.array([0.5, 0.3, 0.65, 0.25]), np.array([-0.35, -0.2, -0.3, -0.4])]
    slow = [
        np.where(j == 0, 1.1, 0.30 + 0.10 * np.sin(2.1 * j)),
        np.where(j == 0, 0.9, 0.27 + 0.09 * np.sin(1.6 * j)),
    ]
    growing = RatePlays(8.7 * (j / SLOW_PLAYS) ** 1.8, np.where(j == 0, 0.0, 5e-4), 300.0)
    shares = ((1.0, 0.04), (-0.03, 1.0))
    block = Asymmetric(
        PrandtlIshlinskii(
            tuple(
                tuple(Pair(thresholds_v, share * w) for share in row)
                for row, w in zip(shares, bent, strict=True)
            )
        ),
        tuple(
            tuple(DeadZones(breakpoints_v, share * b) for share in row)
            for row, b in zip(shares, bends, strict=True)
        ),
    )
    beside = RateDependent(
        (growing, growing),
        tuple(tuple(share * w for share in row) for row, w in zip(shares, slow, strict=True)),
    )
    axes = tuple(
        Axis(resonance_hz=hz, damping_ratio=ratio, creep=STACK_CREEP)
        for hz, ratio in ((610.0, 0.11), (690.0, 0.09))
    )
    return _made_up("asymmetric_stack", Parallel((block, beside)), AxesDynamics(axes=axes), instruments)


def _made_up(
    name: str,
    hysteresis: Hysteresis[Any],
    dynamics: AxesDynamics | StaticDynamics,
    instruments: Instruments,
) -> HammersteinModel:
    """Two axes that are driven to 10 V about 0 V."""
    return HammersteinModel(
        name=name,
        hysteresis=hysteresis,
        dynamics=dynamics,
        amplitude_v=10.0,
        inputs=("u_x", "u_y"),
        outputs=("x", "y"),
        instruments=instruments,
        provenance={
            "source": "made up by the recipe of tests/shipped/stacks.py",
            "command": "python -m tests.shipped",
        },
    )


def build(folder: Path) -> list[Path]:
    """Write the stacks into a folder, with converter and sensor of the default actuator."""
    instruments = HammersteinModel.load(DEFAULT).instruments
    stacks = (rate_dependent_stack(instruments), asymmetric_stack(instruments))
    for stack in stacks:
        stack.save(folder / f"{stack.name}.json")
    return [folder / f"{stack.name}.json" for stack in stacks]

"""Actuators drawn by a seed, identified from a noisy record and compensated: is the true error in the band?

Each seed draws another actuator. Its record, the drive and the true error are simulated by the package's own
blocks, whose theory other tests check; what is judged here is the covariance alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    BoucWenPair,
    DeadZones,
    Envelope,
    Generalised,
    Pair,
    PrandtlIshlinskii,
    RateDependent,
    RatePlays,
)
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

SAMPLE_TIME_S, SECONDS = 1e-4, 1.2
RANGE_V, NOISE_UM, DRAWS = 10.0, 0.03, 100
BAND = (5.0, 95.0)


@dataclass(frozen=True)
class Kind:
    """What is identified and how, and the law whose error is judged."""

    hysteresis: str
    dynamic: bool
    partition: str = "auto"
    dead_zones: int | None = None

    @property
    def name(self) -> str:
        """Words for a table."""
        how = f"{self.dead_zones} breakpoint" if self.dead_zones else self.partition
        return f"{self.hysteresis}, {how}, {'second order' if self.dynamic else 'static'}"


KINDS = [
    Kind(hysteresis, dynamic, partition)
    for dynamic in (False, True)
    for hysteresis, partition in (
        ("prandtl_ishlinskii", "time"),
        ("prandtl_ishlinskii", "voltage"),
        ("prandtl_ishlinskii", "fitted"),
        ("bouc_wen", "auto"),
        ("rate_dependent", "auto"),
        ("asymmetric", "auto"),
        ("generalised", "auto"),
    )
]
KINDS.append(Kind("asymmetric", False, dead_zones=1))


def actuator(kind: Kind, rng: np.random.Generator) -> HammersteinModel:
    """An actuator with thresholds of its own: no grid of an identification is that of the actuator."""
    r = np.concatenate([[0.0], np.sort(rng.uniform(0.2, 7.0, 9))])
    w = np.concatenate([[rng.uniform(3.0, 5.0)], rng.uniform(0.05, 0.6, 9)])
    plays = PrandtlIshlinskii([[Pair(r, w)]])
    zones = kind.dead_zones or 2
    hysteresis = {
        "prandtl_ishlinskii": lambda: plays,
        "bouc_wen": lambda: BoucWen(
            [
                [
                    BoucWenPair(
                        rng.uniform(5, 7),
                        rng.uniform(1.5, 2.5),
                        rng.uniform(0.2, 0.3),
                        rng.uniform(-0.1, 0.1),
                    )
                ]
            ]
        ),
        "rate_dependent": lambda: RateDependent(
            (RatePlays(r, np.where(r > 0.0, rng.uniform(2e-4, 6e-4), 0.0), 300.0),), ((w,),)
        ),
        "generalised": lambda: Generalised((_envelope(rng),), plays),
        "asymmetric": lambda: Asymmetric(
            plays, ((DeadZones(np.sort(rng.uniform(-7.0, 7.0, zones)), rng.uniform(-0.5, 0.5, zones)),),)
        ),
    }[kind.hysteresis]()
    dynamics = StaticDynamics(n_outputs=1)
    if kind.dynamic:
        axis = Axis(resonance_hz=rng.uniform(250.0, 400.0), damping_ratio=rng.uniform(0.05, 0.2))
        dynamics = AxesDynamics(axes=(axis,))
    return HammersteinModel(
        "truth", hysteresis, dynamics, RANGE_V, ("u",), ("y",), Instruments.ideal(SAMPLE_TIME_S)
    )


def _envelope(rng: np.random.Generator) -> Envelope:
    """Three lines whose slopes are up to a factor of two apart."""
    ends = np.array([-RANGE_V, rng.uniform(-6.0, -2.0), rng.uniform(2.0, 6.0), RANGE_V])
    rises = np.diff(ends) * rng.uniform(0.6, 1.2, 3)
    return Envelope(ends, -RANGE_V + np.cumsum([0.0, *rises]))


def voltages(kind: Kind) -> np.ndarray:
    """Rest, slow loops of falling amplitude, then a sweep."""
    t = np.arange(round(SECONDS / SAMPLE_TIME_S)) * SAMPLE_TIME_S
    slow = RANGE_V * np.linspace(1.0, 0.3, t.size) * np.sin(2.0 * np.pi * 5.0 * t)
    fast = 0.0 * t
    if kind.dynamic or kind.hysteresis == "rate_dependent":
        fast = 0.5 * RANGE_V * np.sin(2.0 * np.pi * (20.0 * t + 0.5 * 400.0 / SECONDS * t**2))
    return np.concatenate([np.zeros(400), slow, fast])[None]


def reference() -> np.ndarray:
    """A path that the record does not hold."""
    t = np.arange(2000) * SAMPLE_TIME_S
    return (
        20.0
        * (np.sin(2.0 * np.pi * 20.0 * t) + 0.3 * np.sin(2.0 * np.pi * 50.0 * t))[None]
        * np.minimum(t / 0.02, 1.0)
    )


@dataclass(frozen=True)
class Found:
    """True error of a seed, its band and its place among the draws [um]."""

    true_um: float
    low_um: float
    median_um: float
    high_um: float

    @property
    def covered(self) -> bool:
        """Whether the true error lies in the band."""
        return self.low_um <= self.true_um <= self.high_um


def found(kind: Kind, seed: int) -> Found:
    """Identify, compensate, and compare the true error with the band of the draws."""
    rng = np.random.default_rng([seed, 28])
    truth, u = actuator(kind, rng), voltages(kind)
    y = truth.simulate(u, SAMPLE_TIME_S).position_um
    record = Record(u, y + NOISE_UM * rng.standard_normal(y.shape), SAMPLE_TIME_S)
    settings = Settings(
        hysteresis=kind.hysteresis,
        dynamics="second_order" if kind.dynamic else "none",
        partition=kind.partition,
        dead_zones=kind.dead_zones,
        error_curve=False,
        creep_modes=0,
        delay_samples=0,
    )
    model, _ = identify([record], settings, instruments=truth.instruments)
    law = "hammerstein_inverse" if kind.dynamic else "exact_inverse"
    if kind.hysteresis == "bouc_wen":
        law = "inverse_multiplicative"
    path = reference()
    drive = model.compensate(path, law=law, beyond_records=True, accept_flagged=True).drive_v
    true = _rms(truth, drive, path)
    drawn = [_rms(model.drawn(np.random.default_rng([seed, 29, i])), drive, path) for i in range(DRAWS)]
    low, high = np.percentile(drawn, BAND)
    return Found(true, float(low), float(np.median(drawn)), float(high))


def _rms(model: HammersteinModel, drive: np.ndarray, path: np.ndarray) -> float:
    y = model.simulate(drive, SAMPLE_TIME_S).position_um[:, : path.shape[1]]
    return float(np.sqrt(np.mean((y - path)[:, 400:] ** 2)))

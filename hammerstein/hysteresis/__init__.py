"""Hysteresis: what every kind is, and the classical Prandtl-Ishlinskii block with its compiled loops.

To add a kind to the package, write it in a file of its own and name it here.
"""

from hammerstein.hysteresis.bank import Bank, PlayState
from hammerstein.hysteresis.covariance import ThresholdCovariance
from hammerstein.hysteresis.kind import (
    HYSTERESIS,
    Hysteresis,
    HysteresisFile,
    Memory,
    Normals,
    Sloped,
    slopes_of,
)
from hammerstein.hysteresis.pair import Pair, WeightCovariance, play
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii, PrandtlIshlinskiiFile

__all__ = [
    "HYSTERESIS",
    "Bank",
    "Hysteresis",
    "HysteresisFile",
    "Memory",
    "Normals",
    "Pair",
    "PlayState",
    "PrandtlIshlinskii",
    "Sloped",
    "ThresholdCovariance",
    "WeightCovariance",
    "play",
    "slopes_of",
]

HYSTERESIS.register(PrandtlIshlinskiiFile)

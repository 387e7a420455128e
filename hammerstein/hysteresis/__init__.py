"""Hysteresis of every kind, each with its compiled loops."""

from hammerstein.hysteresis.asymmetric import Asymmetric, AsymmetricState, DeadZones
from hammerstein.hysteresis.prandtl_ishlinskii import (
    Bank,
    Pair,
    PlayState,
    PrandtlIshlinskii,
    WeightCovariance,
    play,
)

__all__ = [
    "Asymmetric",
    "AsymmetricState",
    "Bank",
    "DeadZones",
    "Pair",
    "PlayState",
    "PrandtlIshlinskii",
    "WeightCovariance",
    "play",
]

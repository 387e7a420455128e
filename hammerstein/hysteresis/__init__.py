"""Rate-independent hysteresis: the Prandtl-Ishlinskii block and its compiled loops."""

from hammerstein.hysteresis.covariance import ThresholdCovariance, WeightCovariance
from hammerstein.hysteresis.prandtl_ishlinskii import (
    Bank,
    Pair,
    PlayState,
    PrandtlIshlinskii,
    play,
)

__all__ = [
    "Bank",
    "Pair",
    "PlayState",
    "PrandtlIshlinskii",
    "ThresholdCovariance",
    "WeightCovariance",
    "play",
]

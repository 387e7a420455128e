"""Rate-independent hysteresis: the Prandtl-Ishlinskii block and its compiled loops."""

from hammerstein.hysteresis.prandtl_ishlinskii import (
    Bank,
    Pair,
    PlayState,
    PrandtlIshlinskii,
    WeightCovariance,
    play,
)

__all__ = ["Bank", "Pair", "PlayState", "PrandtlIshlinskii", "WeightCovariance", "play"]

"""Hysteresis: the base class, and every kind with its compiled loops.

To add a kind to the package, write it in a file of its own and name it here.
"""

from hammerstein.blocks import Memory
from hammerstein.hysteresis.asymmetric import Asymmetric, AsymmetricFile, AsymmetricState, DeadZones
from hammerstein.hysteresis.bouc_wen import BoucWen, BoucWenFile, BoucWenPair, BoucWenState
from hammerstein.hysteresis.generalised import Envelope, Generalised, GeneralisedFile
from hammerstein.hysteresis.kind import HYSTERESIS, Hysteresis, HysteresisFile, Normals, Sloped, slopes_of
from hammerstein.hysteresis.pair import Pair, PlayState, WeightCovariance, play
from hammerstein.hysteresis.parallel import Parallel, ParallelFile, ParallelState
from hammerstein.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii, PrandtlIshlinskiiFile
from hammerstein.hysteresis.preisach import Preisach, PreisachFile, PreisachState
from hammerstein.hysteresis.rate_dependent import RateDependent, RateDependentFile, RatePlays, RateState

__all__ = [
    "HYSTERESIS",
    "Asymmetric",
    "AsymmetricState",
    "BoucWen",
    "BoucWenPair",
    "BoucWenState",
    "DeadZones",
    "Envelope",
    "Generalised",
    "Hysteresis",
    "HysteresisFile",
    "Memory",
    "Normals",
    "Pair",
    "Parallel",
    "ParallelState",
    "PlayState",
    "PrandtlIshlinskii",
    "Preisach",
    "PreisachState",
    "RateDependent",
    "RatePlays",
    "RateState",
    "Sloped",
    "WeightCovariance",
    "play",
    "slopes_of",
]

HYSTERESIS.register(PrandtlIshlinskiiFile)
HYSTERESIS.register(AsymmetricFile)
HYSTERESIS.register(RateDependentFile)
HYSTERESIS.register(BoucWenFile)
HYSTERESIS.register(GeneralisedFile)
HYSTERESIS.register(PreisachFile)
HYSTERESIS.register(ParallelFile)

"""Iterative learning at the set-up: next drive of a periodic path, from sensor readings of the last one."""

from hammerstein.compensators.learning.ilc_update import (
    IlcUpdate as IlcUpdate,
    ModelUncertainty as ModelUncertainty,
    ilc_update as ilc_update,
)
from hammerstein.compensators.learning.learned import Learned as Learned

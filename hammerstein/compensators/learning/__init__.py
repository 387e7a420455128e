"""Iterative learning at the set-up: next drive of a periodic path, from sensor readings of the last one."""

from hammerstein.compensators.learning.ilc_update import IlcUpdate as IlcUpdate, ilc_update as ilc_update
from hammerstein.compensators.learning.learned import Learned as Learned
from hammerstein.compensators.learning.model_uncertainty import ModelUncertainty as ModelUncertainty

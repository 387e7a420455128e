"""Linear dynamics of the actuator, and their exact discretisation."""

from hammerstein.dynamics.linear_block import LinearBlock, low_pass
from hammerstein.dynamics.models import (
    AxesDynamics,
    Axis,
    CreepMode,
    Dynamics,
    StateSpaceDynamics,
    StaticDynamics,
    cantilever,
    creep,
    discretise,
    natural_frequency_hz,
    split_delay,
)

__all__ = [
    "AxesDynamics",
    "Axis",
    "CreepMode",
    "Dynamics",
    "LinearBlock",
    "StateSpaceDynamics",
    "StaticDynamics",
    "cantilever",
    "creep",
    "discretise",
    "low_pass",
    "natural_frequency_hz",
    "split_delay",
]

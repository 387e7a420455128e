"""Dynamics of the actuator, linear or with hysteresis in the loop, and their exact discretisation."""

from hammerstein.dynamics.feedback_block import FeedbackBlock
from hammerstein.dynamics.feedback_hysteresis import (
    ElastoSlip,
    ElectromechanicalDynamics,
    FeedbackHysteresisDynamics,
    StackAxis,
)
from hammerstein.dynamics.linear_block import LinearBlock, low_pass
from hammerstein.dynamics.models import (
    AxesDynamics,
    Axis,
    CreepMode,
    Dynamics,
    StateSpaceDynamics,
    StaticDynamics,
    WithLoop,
    cantilever,
    creep,
    discretise,
    linear,
    linearised,
    natural_frequency_hz,
    on_grid,
    split_delay,
)

__all__ = [
    "AxesDynamics",
    "Axis",
    "CreepMode",
    "Dynamics",
    "ElastoSlip",
    "ElectromechanicalDynamics",
    "FeedbackBlock",
    "FeedbackHysteresisDynamics",
    "LinearBlock",
    "StackAxis",
    "StateSpaceDynamics",
    "StaticDynamics",
    "WithLoop",
    "cantilever",
    "creep",
    "discretise",
    "linear",
    "linearised",
    "low_pass",
    "natural_frequency_hz",
    "on_grid",
    "split_delay",
]

"""Dynamics of the actuator, linear or with hysteresis in the loop, and their exact discretisation."""

from hammerstein.dynamics.feedback_block import FeedbackBlock as FeedbackBlock
from hammerstein.dynamics.feedback_hysteresis import (
    ElastoSlip as ElastoSlip,
    ElectromechanicalDynamics as ElectromechanicalDynamics,
    FeedbackHysteresisDynamics as FeedbackHysteresisDynamics,
    StackAxis as StackAxis,
    StackMode as StackMode,
)
from hammerstein.dynamics.linear_block import LinearBlock as LinearBlock
from hammerstein.dynamics.models import (
    AxesDynamics as AxesDynamics,
    Axis as Axis,
    CreepMode as CreepMode,
    Dynamics as Dynamics,
    StateSpaceDynamics as StateSpaceDynamics,
    StaticDynamics as StaticDynamics,
    WithLoop as WithLoop,
    cantilever as cantilever,
    discretise as discretise,
    linear as linear,
    linearised as linearised,
    natural_frequency_hz as natural_frequency_hz,
    on_grid as on_grid,
    split_delay as split_delay,
)

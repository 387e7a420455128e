"""Simulate, identify and compensate multi-axis actuators with hysteresis.

Conventions
-----------
* Signals are arrays (axis, sample), time last; operators stand in between: (output, input, operator).
* Units are V, um, s, Hz; names that cross a boundary carry them, such as ``rms_um`` and ``frequency_hz``.
* Blocks start at rest. Where a block has memory, it is an explicit state that goes in and comes out;
  ``respond`` on a whole signal and ``step`` on one sample give identical numbers.
* A voltage is held over each sample; the linear block is discretised exactly for that.

Examples
--------
>>> import hammerstein
>>> actuator = hammerstein.HammersteinModel.load("duo_bimorph_static")
>>> actuator.hysteresis.amplitude(10.0).round(2)
array([[58.4 ,  1.41],
       [ 2.08, 50.57]])
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as typing has it, which takes longer to import than all of this
if TYPE_CHECKING:
    from typing import Any

    from hammerstein.dynamics import (
        AxesDynamics,
        Axis,
        CreepMode,
        LinearBlock,
        StateSpaceDynamics,
        StaticDynamics,
        cantilever,
        discretise,
    )
    from hammerstein.errors import (
        HammersteinError,
        IdentificationError,
        InputError,
        SimulationError,
        ToleranceError,
    )
    from hammerstein.experiment.report import Report
    from hammerstein.experiment.run import run, simulate, simulate_in_stretches
    from hammerstein.hysteresis import Pair, PlayState, PrandtlIshlinskii, play
    from hammerstein.instruments import Drive, Instruments, Sensor
    from hammerstein.model import HammersteinModel
    from hammerstein.scenario import Scenario, load_scenario
    from hammerstein.simulation import Plant, Response

# Where each public name lives. Names are imported when they are used: the command line must answer at once.
_HOMES = {
    "dynamics": (
        "AxesDynamics",
        "Axis",
        "CreepMode",
        "LinearBlock",
        "StateSpaceDynamics",
        "StaticDynamics",
        "cantilever",
        "discretise",
    ),
    "errors": (
        "HammersteinError",
        "IdentificationError",
        "InputError",
        "SimulationError",
        "ToleranceError",
    ),
    "experiment.run": ("run", "simulate", "simulate_in_stretches"),
    "hysteresis": ("Pair", "PlayState", "PrandtlIshlinskii", "play"),
    "instruments": ("Drive", "Instruments", "Sensor"),
    "model": ("HammersteinModel",),
    "simulation": ("Plant", "Response"),
    "experiment.report": ("Report",),
    "scenario": ("Scenario", "load_scenario"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "AxesDynamics",
    "Axis",
    "CreepMode",
    "Drive",
    "HammersteinError",
    "HammersteinModel",
    "IdentificationError",
    "InputError",
    "Instruments",
    "LinearBlock",
    "Pair",
    "Plant",
    "PlayState",
    "PrandtlIshlinskii",
    "Report",
    "Response",
    "Scenario",
    "Sensor",
    "SimulationError",
    "StateSpaceDynamics",
    "StaticDynamics",
    "ToleranceError",
    "cantilever",
    "discretise",
    "load_scenario",
    "play",
    "run",
    "simulate",
    "simulate_in_stretches",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'hammerstein' has no attribute {name!r}")
    return getattr(import_module(f"hammerstein.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__

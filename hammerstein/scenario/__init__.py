"""Scenarios: one validated value for each scenario file."""

from hammerstein.scenario.scenario import Scenario, load_scenario, scenario_of

__all__ = ["Scenario", "load_scenario", "scenario_of"]

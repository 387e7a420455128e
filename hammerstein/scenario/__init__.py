"""What to run: one validated value for each scenario file."""

from hammerstein.scenario.scenario import Scenario, load_scenario

__all__ = ["Scenario", "load_scenario"]

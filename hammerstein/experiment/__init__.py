"""From a scenario to its report."""

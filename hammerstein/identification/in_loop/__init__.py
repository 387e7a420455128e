"""Hysteresis inside the loop: all its numbers together, from the simulated output."""

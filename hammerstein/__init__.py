"""Simulate, identify and compensate multi-axis actuators with hysteresis."""

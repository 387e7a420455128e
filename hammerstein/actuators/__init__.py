"""Packaged actuators, as model files."""

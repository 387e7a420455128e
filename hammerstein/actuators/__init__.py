"""Packaged actuators, as model files."""

DEFAULT = "duo_bimorph"
"""Default actuator."""

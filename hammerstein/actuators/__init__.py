"""Packaged actuators, as model files."""

DEFAULT = "duo_bimorph"
"""The one that stands where none is named."""

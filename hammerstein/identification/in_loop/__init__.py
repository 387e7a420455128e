"""Identification of hysteresis inside the loop by simulation error."""

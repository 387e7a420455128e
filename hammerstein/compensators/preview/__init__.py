"""Inverse of hysteresis and dynamics together, for a path that is known in advance."""

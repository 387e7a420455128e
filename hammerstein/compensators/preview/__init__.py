"""The inverse of hysteresis and dynamics together, for a path that is known ahead."""

"""The static block: thresholds and weights."""

"""Measured records: reading, checks, excitation and loops."""

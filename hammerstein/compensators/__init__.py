"""Compensators: laws from a reference in um to a drive in V."""

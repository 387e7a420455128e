"""Hostile and broken input, thousands of times: ``python -m tests.fuzz`` for a long campaign."""

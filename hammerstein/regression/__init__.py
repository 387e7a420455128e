"""Regression tests: accepted numbers (baselines), and comparison with them."""

"""Exact inverse of the multivariable model."""

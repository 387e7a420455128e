"""The exact inverse of the multivariable model, and what of a path it can reach."""

"""Blocks that are made for one sample time run on it alone."""

from __future__ import annotations

import math

from hammerstein.errors import InputError


def require_grid(designed_s: float | None, sample_time_s: float, what: str) -> None:
    """Raise InputError where a block designed for one sample time is asked to run on another."""
    if not (math.isfinite(sample_time_s) and sample_time_s > 0.0):
        raise InputError("sample_time_s", f"is {sample_time_s:g}; it must be above 0")
    if designed_s is not None and not math.isclose(designed_s, sample_time_s, rel_tol=1e-9):
        raise InputError(
            "sample_time_s",
            f"is {sample_time_s:g}, but the {what} was made for {designed_s:g}; make it again, or use that",
        )

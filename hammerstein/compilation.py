"""Whether the time loops still have to be compiled."""

from __future__ import annotations

from pathlib import Path


def must_compile() -> bool:
    """Tell whether numba's cache holds no loops yet, as after installation: the first run takes longer."""
    from hammerstein.compensators import kernels as compensators
    from hammerstein.hysteresis import kernels as hysteresis

    loops = (hysteresis.respond_turning_points, compensators.respond_inverse_multiplicative)
    return not all(_is_cached(loop) for loop in loops)


def _is_cached(loop: object) -> bool:
    """Whether an index file of this loop lies where numba keeps it."""
    folder = Path(loop.stats.cache_path)  # type: ignore[attr-defined]  # numba's dispatcher has no types
    name = loop.__name__  # type: ignore[attr-defined]
    return any(folder.glob(f"*.{name}-*.nbi"))

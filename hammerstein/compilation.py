"""Whether the time loops still have to be compiled."""

from __future__ import annotations

from pathlib import Path


def must_compile() -> bool:
    """Tell whether numba's cache holds no loops yet, as after installation: the first run takes longer."""
    from hammerstein.compensators.exact_kernel import respond_exact
    from hammerstein.compensators.kernels import respond_inverse_multiplicative
    from hammerstein.hysteresis.kernels import respond_turning_points

    loops = (respond_turning_points, respond_inverse_multiplicative, respond_exact)
    return not all(_is_cached(loop) for loop in loops)


def _is_cached(loop: object) -> bool:
    """Whether an index file of this loop lies where numba keeps it."""
    folder = Path(loop.stats.cache_path)  # type: ignore[attr-defined]  # numba's dispatcher has no types
    name = loop.__name__  # type: ignore[attr-defined]
    return any(folder.glob(f"*.{name}-*.nbi"))
